"""The examples of stochastic gradients at a tiny size improve, print a table, and leave picture and figures."""

import numpy as np
import pytest

from .example_scripts import EXAMPLES, figures, scripts

TINY = ["--texture-size", "24", "--fineness", "24", "--resolution", "32", "--cameras", "8"]


@pytest.fixture
def load():
    with scripts(EXAMPLES / "stochastic") as imported:
        yield imported


@pytest.fixture
def run(load, tmp_path, capsys):
    """Runs a script, and gives its figures, which it prints as a table, too."""

    def ran(name, *arguments, results=None):
        load(name).main(["--output", str(tmp_path), *arguments])
        found = figures(tmp_path, results or name)
        printed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
        assert [f"| {' | '.join(row)} |" for row in found["table"]] == [printed[0], *printed[2:]]
        return found

    return ran


@pytest.mark.parametrize("physical", [False, True])
def test_surface(run, physical):
    sizes = [*TINY, "--steps", "3", "--iterations", "60"]
    name, more = ("surface-physical", ["--physical", "--resolution", "48"]) if physical else ("surface", [])
    found = run("surface", *sizes, *more, results=name)
    (first, last), (far, near) = found["psnr"], found["distance"]
    assert last > first + (0.7 if physical else 1.5)
    assert near < far * (0.8 if physical else 0.5)
    assert found["renders"] == 60 * 4 * 2
    assert found["parameters"] == 56 * 3 + 24 * 24 * (8 if physical else 3)


def test_mesh(run):
    found = run("mesh", *TINY, "--steps", "6", "--iterations", "30")
    for kind in ("albedo", "normals"):
        for method in ("exact", "at once", "in turns"):
            (first, last), (far, near) = (found[f"{kind}, {method}"][name] for name in ("psnr", "distance"))
            assert last > first + 1, (kind, method)
            assert near < far, (kind, method)


def test_pose(run):
    found = run("pose", "--resolution", "48", "--trials", "2", "--iterations", "300", "--pixels", "0.5")
    for name in ("object, degrees", "camera, distance", "picture, RMS"):
        start, end = (np.mean([each[name] for each in found[when]]) for when in ("start", "end"))
        assert end < start / 2, name


def test_the_ball_is_closed_and_its_sides_share_no_texels(load):
    ball = load("scene").ball(4, 48)
    edges = [(a, b) for quad in ball.quads.tolist() for a, b in zip(quad, [*quad[1:], quad[0]], strict=True)]
    assert len(set(edges)) == len(edges) == 4 * 96 and all((b, a) in set(edges) for a, b in edges)
    corners = ball.points[ball.triangles]
    assert np.einsum("ti,ti->t", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]).min() > 0
    boxes = [(side.min((0, 1)) * 48, side.max((0, 1)) * 48) for side in ball.uv.reshape(6, 16, 4, 2)]
    for one, (low, high) in enumerate(boxes):
        assert (low > 0.5).all() and (high < 47.5).all()
        for other_low, other_high in boxes[one + 1 :]:
            assert (other_low >= high + 1).any() or (low >= other_high + 1).any()
