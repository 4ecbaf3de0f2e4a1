"""`mipbake compare`: what it writes, what it says of broken conditions, meshes, lights and foreign stacks."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
import pytest

from mipbake.base.errors import UsageError
from mipbake.cli.main import main
from mipbake.comparing import comparison
from mipbake.comparing.filming import film_measures
from mipbake.material.aim import ANISOTROPIC

from .command_line import bumps, fails, tree, write_set

QUICK = ["--size", "32", "--no-cache", "--no-films"]
FILMS = ["--size", "32", "--no-cache"]
FEW = ["--methods", "linear,lean (gaussian)"]

Run = Callable[..., dict[str, Any]]


@pytest.fixture
def run(folder: Path, tmp_path: Path, quick_comparison: None) -> Run:
    """Compares, and gives what results.json says."""

    def compared(*arguments: str | Path, code: int = 0, quick: list[str] = QUICK) -> dict[str, Any]:
        out = tmp_path / "report"
        assert main(["compare", str(folder), "-o", str(out), *quick, *map(str, arguments)]) == code
        found: dict[str, Any] = json.loads((out / "results.json").read_text())
        return found

    return compared


def test_a_report(run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = run(*FEW, "--verbose", "--fail-if", "snr near-mirror lod=0 < -90")
    printed = capsys.readouterr().out
    out = tmp_path / "report"
    assert printed.startswith(f"wrote {out / 'index.html'}: a first page")
    assert "near-mirror, SNR in dB" in printed and "does not hold" in printed
    names = [method["name"] for method in results["methods"]]
    assert names == ["linear (gaussian)", "lean (gaussian)", "linear (box)"]  # plain MIP maps are never the subject
    assert "These are plain MIP maps" not in printed
    assert results["source"]["maps"]["normal"]["path"].endswith("normal.png")
    lods = [point["lod"] for point in results["curve"] if (point["method"], point["view"]) == (names[0], "hemisphere")]
    assert lods == list(np.arange(0, 4.01, 0.25))  # 16 x 16 texels have five levels
    assert [scene["view"] for scene in results["scenes"]] == ["sphere"] * 4 + ["plane"] and results["films"] == []
    for view in ("near-mirror", "hemisphere", "sphere", "plane", "rotation"):
        assert {f["method"] for f in results["figures"] if f["view"] == view} == set(names), view
    gains = {f["method"] for f in results["figures"] if f["measure"] == "snr-gain"}
    assert gains == set(names[1:]) and (results["settings"]["points"], results["settings"]["max_passes"]) == (64, 32)
    page = (out / "index.html").read_text()
    assert 'src="http' not in page and 'href="http' not in page and "mipbake-viewer" in page


@pytest.mark.long
def test_films_are_made_unless_they_are_not_wanted(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    given = [*FEW, "--motion", "light", "--sampler", "accumulated, anisotropic 4x", "--lod-bias", "-1"]
    conditions = ["--fail-if", "flip film-wall > 1", "--fail-if", "sparkle film-floor over best > 1"]
    results = run(*given, *conditions, "--verbose", quick=FILMS)
    printed = capsys.readouterr().out
    assert "\nIn films, as " in printed and "floor" in printed and "sphere" in printed and "films, " in printed
    views = ["film-floor", "film-low-floor", "film-wall", "film-sphere"]
    assert [film["name"] for film in results["films"]] == views
    for film in results["films"]:
        assert (film["motion"], film["frames"]) == ("light", 12)
        assert film["sampler"] == "accumulated, anisotropic 4x, bias -1"
        assert film["resolution"] == [32, 48] and film["passes"] <= 32
    measured = {(f["view"], f["method"], f["measure"]) for f in results["figures"] if f["view"].startswith("film-")}
    methods = [method["name"] for method in results["methods"]]
    assert measured == {(view, name, measure) for view in views for name in methods for measure in film_measures()}
    assert results["settings"]["sampler"] == {"lookups": 4, "bias": -1.0, "frames": 8}


def test_a_condition_on_a_film_needs_its_judge(folder, tmp_path, capsys, monkeypatch):
    def missing() -> None:
        raise UsageError("a film is judged by ColorVideoVDP, which is not installed: type 'pip'")

    monkeypatch.setattr(comparison, "check_color_video_vdp", missing)
    given = ["compare", folder, "-o", tmp_path / "r", *FILMS, *FEW]
    assert "type 'pip'" in fails(capsys, 2, *given, "--fail-if", "jod-37 film-floor < 9")
    assert not (tmp_path / "r").exists()


def test_a_stack_that_was_baked_is_what_the_verdict_is_about(run, folder, tmp_path, capsys):
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "lean", "--filter", "box", "-q"]) == 0
    condition = "snr near-mirror lod=0 method='linear (box)' > -90"
    baked = ["--baked", tmp_path / "out" / "metal", "--methods", "linear", "--sampler", "stochastic"]
    run(*baked, "--json", "--fail-if", condition, code=5)
    out, err = capsys.readouterr()
    report = json.loads(out)
    (found,) = report["results"]
    assert found["subject"] == "baked" and found["pixel_filter"] == "box" and report["exit_code"] == 5
    assert [c["failed"] for c in found["conditions"]] == [True]
    assert found["foreign"] is False and not any("not baked from" in warning for warning in found["warnings"])
    assert err.count("\n") == 1 and "holds" in err
    # A stack of another set is flagged.
    shutil.rmtree(folder)
    write_set(folder, roughness=bumps()["roughness"] // 2)
    results = run("--baked", tmp_path / "out" / "metal", "--methods", "linear (box)")
    said = "not baked from this texture set"
    assert said in capsys.readouterr().out and said in (tmp_path / "report" / "index.html").read_text()
    assert results["foreign"] is True and any(said in warning for warning in results["warnings"])


def write_mesh(path: Path, uv: bool = True) -> Path:
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["vt 0 0", "vt 1 0", "vt 1 1"] * uv
    path.write_text("\n".join([*lines, "f 1/1 2/2 3/3" if uv else "f 1 2 3"]) + "\n")
    return path


def test_a_mesh_and_a_light_of_the_users(run: Run, tmp_path: Path) -> None:
    sky = np.full((8, 16, 3), 0.2, np.float32)
    sky[1, 3] = 40
    OpenImageIO.ImageBuf(sky).write(str(tmp_path / "sky.exr"))
    given = ["--mesh", write_mesh(tmp_path / "triangle.obj"), "--light", tmp_path / "sky.exr"]
    results = run(*given, "--methods", "linear (box),neural", "--sampler", "anisotropic")
    assert [scene["view"] for scene in results["scenes"]] == ["mesh"] * 3
    assert [method["sampler"] for method in results["methods"]] == [asdict(ANISOTROPIC), None]
    assert results["settings"]["sampler"] == asdict(ANISOTROPIC) and "sky.exr" in results["settings"]["lighting"]


@pytest.mark.parametrize(
    ("arguments", "code", "part"),
    [
        (["--fail-if", "snr near-mirror lod=0 <"], 2, "is not a number"),
        (["--fail-if", "snr near-mirror lod=0.3 < 1"], 2, "0.25"),
        (["--fail-if", "snr near-mirror near optimum < 1"], 2, "optimum"),
        (["--fail-if", "flip plane near < 1"], 2, "flip plane was not measured for scale 'near'"),
        (["--fail-if", "flicker sphere middle > 1"], 2, "but for near, 1:1"),
        (["--fail-if", "flip mesh near > 1"], 2, "sphere, plane"),
        (["--fail-if", "flip film-floor > 1"], 2, "'film-floor'"),
        (["--mesh", "triangle.obj", "--fail-if", "flip sphere near > 1"], 2, "mesh"),
        (["--mesh", "triangle.obj", "--fail-if", "flip mesh 1:1 > 1"], 2, "but for near, middle, far"),
        (["--methods", "best"], 2, "'best'"),
        (["--light", "moon"], 2, "'moon'"),
        (["--light", "sky.exr"], 3, "not finite"),
        (["--size", "8"], 2, "size (side) of the comparison is 8: expected 16"),
        (["--seed", "-1"], 2, "-1"),
        (["--mesh", "none.obj"], 3, "none.obj"),
        (["--mesh", "bare.obj"], 3, "texture coordinates"),
        (["--motion", "hands"], 2, "unknown motion 'hands': expected one of camera, light"),
        (["--motion", "light"], 2, "has no films, and motion is for films"),
        (["--sampler", "stochastic", "--lod-bias", "-1"], 2, "takes no MIP bias"),
        (["--films", "--fail-if", "flip film-mesh > 1"], 2, "film-floor, film-low-floor, film-wall"),
        (["--baked", "none"], 3, "none"),
        (["-o", "metal"], 4, "metal"),
    ],
)
def test_what_cannot_be_compared_is_said_before_any_work(folder, tmp_path, capsys, monkeypatch, arguments, code, part):
    monkeypatch.chdir(tmp_path)
    write_mesh(tmp_path / "triangle.obj")
    write_mesh(tmp_path / "bare.obj", uv=False)
    OpenImageIO.ImageBuf(np.full((8, 16, 3), np.nan, np.float32)).write("sky.exr")
    before = tree(tmp_path)
    given = [*QUICK, *([] if "--methods" in arguments else FEW)]
    assert part in fails(capsys, code, "compare", folder, "-o", tmp_path / "report", *given, *arguments)
    assert tree(tmp_path) == before
