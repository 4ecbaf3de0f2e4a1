"""`mipbake compare`: what it writes, what it says of broken conditions, meshes, lights and foreign stacks."""

import json
from dataclasses import asdict

import numpy as np
import OpenImageIO
import pytest

from mipbake.base.errors import UsageError
from mipbake.cli.main import main
from mipbake.comparing.film_figures import film_measures
from mipbake.material.aim import ANISOTROPIC

from .command_line import bumps, fails, tree, write_set

QUICK = ["--points", "64", "--samples", "8", "--size", "32", "--passes", "32", "--no-cache", "--no-films"]
FILMS = [argument for argument in QUICK if argument != "--no-films"]
FEW = ["--methods", "linear,lean (gaussian)"]


@pytest.fixture
def folder(tmp_path):
    return write_set(tmp_path / "metal")


def run(folder, out, *arguments):
    return main(["compare", str(folder), "-o", str(out), *QUICK, *arguments])


def test_a_report_with_its_renders(folder, tmp_path, capsys):
    out = tmp_path / "report"
    assert run(folder, out, *FEW, "--keep-renders", "--fail-if", "snr near-mirror lod=0 < -90") == 0
    printed = capsys.readouterr().out
    assert "near-mirror, SNR in dB" in printed and "does not hold" in printed and str(out / "index.html") in printed
    results = json.loads((out / "results.json").read_text())
    names = [method["name"] for method in results["methods"]]
    assert names == ["linear (box)", "linear (gaussian)", "lean (gaussian)"]
    assert results["source"]["maps"]["normal"]["path"].endswith("normal.png")
    lods = [point["lod"] for point in results["curve"] if (point["method"], point["view"]) == (names[0], "hemisphere")]
    assert lods == list(np.arange(0, 4.01, 0.25))  # 16 x 16 texels have five levels
    scenes = {scene["name"] for scene in results["scenes"]}
    assert len(list((out / "renders").glob("*.exr"))) == len(scenes) * len(names)
    for view in ("near-mirror", "hemisphere", "sphere", "plane", "rotation"):
        assert {f["method"] for f in results["figures"] if f["view"] == view} == set(names), view
    page = (out / "index.html").read_text()
    assert 'src="http' not in page and 'href="http' not in page


@pytest.mark.long
def test_films_are_made_unless_they_are_not_asked_for(folder, tmp_path, capsys):
    out = tmp_path / "report"
    given = ["compare", str(folder), "-o", str(out), *FILMS, *FEW, "--motion", "light"]
    given += ["--sampler", "accumulated, anisotropic 4x", "--lod-bias", "-1"]
    assert main([*given, "--fail-if", "flip film-wall > 1", "--fail-if", "sparkle film-floor over best > 1"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("In films, as ") and "floor" in printed and "sphere" in printed and "films, " in printed
    results = json.loads((out / "results.json").read_text())
    views = {"film-floor", "film-low-floor", "film-wall", "film-sphere"}
    assert [film["name"] for film in results["films"]] == ["film-floor", "film-low-floor", "film-wall", "film-sphere"]
    for film in results["films"]:
        assert (film["motion"], film["frames"]) == ("light", 12)
        assert film["sampler"] == "accumulated, anisotropic 4x, bias -1"
        assert film["resolution"] == [32, 48] and film["passes"] <= 32
    measured = {(f["view"], f["method"], f["measure"]) for f in results["figures"] if f["view"].startswith("film-")}
    methods = [method["name"] for method in results["methods"]]
    assert measured == {(view, name, measure) for view in views for name in methods for measure in film_measures()}
    assert results["settings"]["motion"] == "light"
    assert results["settings"]["sampler"] == {"lookups": 4, "bias": -1.0, "frames": 8}


@pytest.mark.long
def test_no_films_are_made_where_none_are_wanted(folder, tmp_path):
    assert run(folder, tmp_path / "report", "--methods", "linear (box)", "--sampler", "stochastic") == 0
    results = json.loads((tmp_path / "report" / "results.json").read_text())
    assert results["films"] == [] and not any(f["view"].startswith("film") for f in results["figures"])


def test_a_condition_on_a_film_needs_its_judge(folder, tmp_path, capsys, monkeypatch):
    def missing():
        raise UsageError("a film is judged by ColorVideoVDP, which is not installed: type 'pip'")

    monkeypatch.setattr("mipbake.comparing.comparison.check_color_video_vdp", missing)
    given = ["compare", folder, "-o", tmp_path / "r", *FILMS, *FEW]
    assert "type 'pip'" in fails(capsys, 2, *given, "--fail-if", "jod-37 film-floor < 9")
    for condition in ("jod-37 film-floor < 9", "flip film-floor < 9"):
        assert "has no films: leave it out" in fails(capsys, 2, *given, "--no-films", "--fail-if", condition)
    assert not (tmp_path / "r").exists()


@pytest.mark.long
def test_a_stack_that_was_baked_is_what_the_verdict_is_about(folder, tmp_path, capsys):
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "lean", "--filter", "box", "-q"]) == 0
    baked = ["--baked", str(tmp_path / "out" / "metal"), "--methods", "linear"]
    assert (
        run(
            folder,
            tmp_path / "report",
            *baked,
            "--json",
            "--fail-if",
            "snr near-mirror lod=0 method='linear (box)' > -90",
        )
        == 5
    )
    out, err = capsys.readouterr()
    report = json.loads(out)
    (found,) = report["results"]
    assert found["subject"] == "baked" and found["pixel_filter"] == "box" and report["exit_code"] == 5
    assert [c["failed"] for c in found["conditions"]] == [True]
    assert found["foreign"] is False and not any("not baked from" in warning for warning in found["warnings"])
    assert err.count("\n") == 1 and "holds" in err


@pytest.mark.long
def test_a_stack_of_another_set_is_flagged(folder, tmp_path, capsys):
    other = write_set(tmp_path / "other", roughness=bumps()["roughness"] // 2)
    assert main(["bake", str(other), "-o", str(tmp_path / "out"), "--method", "linear", "-q"]) == 0
    baked = ["--baked", str(tmp_path / "out" / "other"), "--methods", "linear (box)"]
    assert run(folder, tmp_path / "report", *baked) == 0
    assert "not baked from this texture set" in capsys.readouterr().out
    results = json.loads((tmp_path / "report" / "results.json").read_text())
    assert results["foreign"] is True and any("not baked from" in warning for warning in results["warnings"])
    assert "not baked from this texture set" in (tmp_path / "report" / "index.html").read_text()


def write_mesh(path, uv=True):
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["vt 0 0", "vt 1 0", "vt 1 1"] * uv
    path.write_text("\n".join([*lines, "f 1/1 2/2 3/3" if uv else "f 1 2 3"]) + "\n")
    return path


@pytest.mark.long
def test_a_mesh_and_a_light_of_the_users(folder, tmp_path):
    mesh = write_mesh(tmp_path / "triangle.obj")
    sky = np.full((8, 16, 3), 0.2, np.float32)
    sky[1, 3] = 40
    OpenImageIO.ImageBuf(sky).write(str(tmp_path / "sky.exr"))
    given = [
        "--mesh",
        str(mesh),
        "--light",
        str(tmp_path / "sky.exr"),
        "--methods",
        "linear (box),neural",
        "--sampler",
        "anisotropic",
    ]
    assert run(folder, tmp_path / "report", *given) == 0
    results = json.loads((tmp_path / "report" / "results.json").read_text())
    assert [scene["view"] for scene in results["scenes"]] == ["mesh"] * 3
    assert [method["sampler"] for method in results["methods"]] == [None, asdict(ANISOTROPIC)]
    assert results["settings"]["sampler"] == asdict(ANISOTROPIC) and "sky.exr" in results["settings"]["lighting"]


@pytest.mark.parametrize(
    ("arguments", "code", "part"),
    [
        (["--fail-if", "snr near-mirror lod=0 <"], 2, "is not a number"),
        (["--fail-if", "shininess lod=0 < 1"], 2, "shininess"),
        (["--fail-if", "snr near-mirror lod=0.3 < 1"], 2, "0.25"),
        (["--fail-if", "snr near-mirror near optimum < 1"], 2, "optimum"),
        (["--fail-if", "flip plane near < 1"], 2, "flip plane was not measured for scale 'near'"),
        (["--fail-if", "flicker sphere middle > 1"], 2, "but for near, 1:1"),
        (["--fail-if", "flip mesh near > 1"], 2, "sphere, plane"),
        (["--fail-if", "snr near-mirror lod=0 over best < 0", "--methods", "linear (box)"], 2, "no closed form"),
        (["--methods", "best"], 2, "'best'"),
        (["--light", "moon"], 2, "'moon'"),
        (["--size", "8"], 2, "size (side) of the comparison is 8: expected 16"),
        (["--passes", "33"], 2, "passes (max_passes) of the comparison is 33: expected an even"),
        (["--points", "0"], 2, "points"),
        (["--seed", "-1"], 2, "-1"),
        (["--mesh", "none.obj"], 3, "none.obj"),
        (["--motion", "hands"], 2, "no motion is called 'hands': expected camera or light"),
        (["--motion", "light"], 2, "has no films, and motion is for films"),
        (["--sampler", "stochastic", "--lod-bias", "-1"], 2, "takes no MIP bias"),
        (["--lod-bias", "5"], 2, "expected a number from -4 to 4"),
        (["--films", "--fail-if", "flip film-mesh > 1"], 2, "film-floor, film-low-floor, film-wall"),
        (["--baked", "none"], 3, "none"),
    ],
)
def test_what_cannot_be_compared_is_said_before_any_work(folder, tmp_path, capsys, monkeypatch, arguments, code, part):
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    given = [str(a) for a in QUICK] + ([] if "--methods" in arguments else FEW)
    assert part in fails(capsys, code, "compare", folder, "-o", tmp_path / "report", *given, *arguments)
    assert tree(tmp_path) == before


def test_conditions_follow_what_is_rendered(folder, tmp_path, capsys):
    mesh = write_mesh(tmp_path / "triangle.obj")
    given = ["compare", folder, "-o", tmp_path / "r", *QUICK, *FEW, "--mesh", mesh]
    assert "mesh" in fails(capsys, 2, *given, "--fail-if", "flip sphere near > 1")
    assert "but for near, middle, far" in fails(capsys, 2, *given, "--fail-if", "flip mesh 1:1 > 1")
    assert not (tmp_path / "r").exists()


def test_bad_meshes_and_lights_exit_3(folder, tmp_path, capsys):
    bare = write_mesh(tmp_path / "bare.obj", uv=False)
    assert "texture coordinates" in fails(capsys, 3, "compare", folder, "-o", tmp_path / "r", *QUICK, "--mesh", bare)
    sky = np.full((8, 16, 3), np.nan, np.float32)
    OpenImageIO.ImageBuf(sky).write(str(tmp_path / "sky.exr"))
    assert "not finite" in fails(
        capsys, 3, "compare", folder, "-o", tmp_path / "r", *QUICK, "--light", tmp_path / "sky.exr"
    )
    assert not (tmp_path / "r").exists()


def test_a_folder_with_something_else_in_it_is_left_alone(folder, tmp_path, capsys):
    before = tree(folder)
    assert "metal" in fails(capsys, 4, "compare", folder, "-o", folder, *QUICK)
    assert tree(folder) == before
