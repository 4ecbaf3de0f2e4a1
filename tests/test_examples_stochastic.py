"""The examples of stochastic gradients at a tiny size improve, print a table, and leave picture and figures."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import torch

STOCHASTIC = Path(__file__).parents[1] / "examples" / "stochastic"
MODULES = ("shared", "scene", "surface", "mesh", "pose", "report", "textures")
TINY = ["--texture-size", "24", "--fineness", "24", "--resolution", "32", "--cameras", "8"]


@pytest.fixture
def run(monkeypatch, tmp_path, capsys):
    """Runs a script, and gives its figures; its modules are forgotten afterwards, since their names are common."""
    threads, path = torch.get_num_threads(), list(sys.path)
    monkeypatch.syspath_prepend(str(STOCHASTIC))
    for name in MODULES:
        monkeypatch.delitem(sys.modules, name, raising=False)

    def figures(name, *arguments, results=None):
        importlib.import_module(name).main(["--output", str(tmp_path), *arguments])
        results = results or name
        picture = OpenImageIO.ImageBuf(str(tmp_path / f"{results}.png")).get_pixels("uint8")
        assert picture.shape[2] == 3 and picture.std() > 10  # it shows something
        found = json.loads((tmp_path / f"{results}.json").read_text())["figures"]
        printed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
        assert [f"| {' | '.join(row)} |" for row in found["table"]] == [printed[0], *printed[2:]]
        return found

    yield figures
    torch.set_num_threads(threads)
    sys.path[:] = path
    for name in MODULES:
        sys.modules.pop(name, None)


@pytest.mark.parametrize("physical", [False, True])
def test_surface(run, physical):
    sizes = [*TINY, "--steps", "3", "--iterations", "60"]
    name, more = ("surface-physical", ["--physical", "--resolution", "48"]) if physical else ("surface", [])
    figures = run("surface", *sizes, *more, results=name)
    (first, last), (far, near) = figures["psnr"], figures["distance"]
    assert last > first + (0.7 if physical else 1.5)
    assert near < far * (0.8 if physical else 0.5)
    assert figures["renders"] == 60 * 4 * 2
    assert figures["parameters"] == 56 * 3 + 24 * 24 * (8 if physical else 3)


def test_mesh(run):
    figures = run("mesh", *TINY, "--steps", "6", "--iterations", "30")
    for kind in ("albedo", "normals"):
        for method in ("exact", "at once", "in turns"):
            (first, last), (far, near) = (figures[f"{kind}, {method}"][name] for name in ("psnr", "distance"))
            assert last > first + 1, (kind, method)
            assert near < far, (kind, method)


def test_pose(run):
    figures = run("pose", "--resolution", "48", "--trials", "2", "--iterations", "300", "--pixels", "0.5")
    for name in ("object, degrees", "camera, distance", "picture, RMS"):
        start, end = (np.mean([each[name] for each in figures[when]]) for when in ("start", "end"))
        assert end < start / 2, name


def test_the_ball_is_closed_and_its_sides_share_no_texels(monkeypatch):
    monkeypatch.syspath_prepend(str(STOCHASTIC))
    path = list(sys.path)
    ball = importlib.import_module("scene").ball(4, 48)
    sys.path[:] = path
    for name in MODULES:
        sys.modules.pop(name, None)
    edges = [(a, b) for quad in ball.quads.tolist() for a, b in zip(quad, [*quad[1:], quad[0]], strict=True)]
    assert len(set(edges)) == len(edges) == 4 * 96 and all((b, a) in set(edges) for a, b in edges)
    corners = ball.points[ball.triangles]
    assert np.einsum("ti,ti->t", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]).min() > 0
    boxes = [(side.min((0, 1)) * 48, side.max((0, 1)) * 48) for side in ball.uv.reshape(6, 16, 4, 2)]
    for one, (low, high) in enumerate(boxes):
        assert (low > 0.5).all() and (high < 47.5).all()
        for other_low, other_high in boxes[one + 1 :]:
            assert (other_low >= high + 1).any() or (low >= other_high + 1).any()
