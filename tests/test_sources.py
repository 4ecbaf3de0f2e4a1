"""Every command takes every source: archives, folders of several sets, lists on stdin; and from Python the same."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import mipbake
from mipbake.base.errors import InputError, UsageError
from mipbake.cli.main import main
from mipbake.source.options import LoadOptions
from mipbake.source.split import divided

from .command_line import fails
from .gltf_files import png
from .gltf_results import two_textures
from .input_files import pixels_for, plain_set, write_image, write_set

pytestmark = pytest.mark.usefixtures("quick_validation")


def run(capsys, *arguments: object) -> dict:
    """The JSON of a command that succeeds."""
    code = main([*map(str, arguments), "--json"])
    out, err = capsys.readouterr()
    assert code == 0, err
    return json.loads(out)


def substance(folder: Path, *sets: str) -> Path:
    """An export of Substance Painter: several sets in one folder."""
    roles = {"BaseColor": "base_color", "Normal_OpenGL": "normal", "Roughness": "roughness", "Metallic": "metallic"}
    for name in sets:
        write_set(folder, {f"{name}_{word}.png": role for word, role in roles.items()})
    return folder


# ---- archives


# ---- several sets in a folder


@pytest.mark.long
def test_an_export_of_several_sets_is_split_by_their_names(tmp_path: Path, capsys) -> None:
    folder = substance(tmp_path / "export", "Robot_Body", "Robot_Head", "T_Rock")
    results = run(capsys, "inspect", folder)["results"]
    assert [result["name"] for result in results] == ["Robot_Body", "Robot_Head", "T_Rock"]
    for result in results:
        paths = [each["path"] for each in result["maps"].values() if each["path"]]
        assert len(paths) == 4 and all(Path(path).name.startswith(result["name"]) for path in paths)
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "linear", "--format", "png", "-q"]) == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["Robot_Body", "Robot_Head", "T_Rock"]
    assert [each.name for each in mipbake.load_all(folder)] == ["Robot_Body", "Robot_Head", "T_Rock"]
    with pytest.raises(InputError, match="export holds 3 texture sets, Robot_Body, Robot_Head, T_Rock"):
        mipbake.load(folder)
    with pytest.raises(UsageError, match="leave the name out"):
        next(mipbake.load_all(folder, name="robot"))


def test_sets_in_other_scripts_are_told_apart(tmp_path: Path, capsys) -> None:
    folder = substance(tmp_path, "石", "木の板", "пол 2")
    assert [result["name"] for result in run(capsys, "inspect", folder)["results"]] == ["пол_2", "木の板", "石"]


def test_one_broken_set_of_an_export_leaves_the_others(tmp_path: Path, capsys) -> None:
    folder = substance(tmp_path, "A", "B", "C")
    (folder / "B_Roughness.png").unlink()
    assert main(["inspect", str(folder), "--json"]) == 3
    out, err = capsys.readouterr()
    assert [result["ok"] for result in json.loads(out)["results"]] == [True, False, True]
    assert "no roughness map" in err and "B_BaseColor.png" in err and "A_BaseColor.png" not in err


def test_patterns_tell_what_names_do_not(tmp_path: Path, capsys) -> None:
    folder = substance(tmp_path / "export", "Body", "Head")
    for name in ("Body", "Head"):
        (folder / f"{name}_BaseColor.png").rename(folder / f"{name}_clr.png")
        (folder / f"{name}_Roughness.png").rename(folder / f"{name}_rgx.png")
    patterns = ("--map", "base_color=*_clr.png", "--map", "roughness=*_rgx.png:R")
    results = run(capsys, "inspect", folder, *patterns)["results"]
    assert [result["name"] for result in results] == ["Body", "Head"]
    for result in results:
        assert Path(result["maps"]["base_color"]["path"]).name == f"{result['name']}_clr.png"
        assert Path(result["maps"]["roughness"]["path"]).name == f"{result['name']}_rgx.png"
    one = substance(tmp_path / "one", "Body")
    (one / "Body_BaseColor.png").rename(one / "Body_clr.png")
    assert mipbake.load(one, maps={"base_color": "*_clr.png"}).name == "one"
    write_image(one / "Other_clr.png", pixels_for("base_color"))
    said = fails(capsys, 3, "inspect", one, "--map", "base_color=*_clr.png")
    assert "matches Body_clr.png, Other_clr.png of" in said and "expected one file for each set" in said
    assert "with * once" in fails(capsys, 2, "inspect", folder, "--map", "base_color=*_*.png")


@pytest.mark.parametrize(
    "names",
    [
        ["wood_color", "wood_normal", "wood_roughness"],
        ["wood_color", "wood_albedo", "wood_normal", "wood_roughness"],
        ["wood_red_color", "wood_blue_color", "wood_normal", "wood_roughness"],
        ["wood_color", "wood_normal", "wood_roughness", "floor_normal"],
        ["color", "normal", "roughness", "wood_orm"],
    ],
)
def test_one_set_is_not_split(names: list[str]) -> None:
    assert divided([Path(f"{name}.png") for name in names], LoadOptions()) == {}


def test_files_of_no_set_are_told(tmp_path: Path, capsys) -> None:
    folder = substance(tmp_path, "Body", "Head")
    write_image(folder / "sheet.png", pixels_for("base_color"))
    assert main(["inspect", str(folder)]) == 0
    out = capsys.readouterr().out
    assert (
        "holds 2 texture sets: Body, Head" in out
        and "warning: sheet.png belongs to none of the sets, and is left out" in out
    )


def test_tiles_of_several_sets_in_one_folder(tmp_path: Path, capsys) -> None:
    roles = {"BaseColor": "base_color", "Normal_OpenGL": "normal", "Roughness": "roughness"}
    for name in ("Body", "Head"):
        for tile in (1001, 1002):
            write_set(tmp_path, {f"{name}_{word}.{tile}.png": role for word, role in roles.items()})
    results = run(capsys, "inspect", tmp_path)["results"]
    assert [result["name"] for result in results] == ["Body_1001", "Body_1002", "Head_1001", "Head_1002"]
    results = run(capsys, "inspect", tmp_path / "Head_BaseColor.<UDIM>.png")["results"]
    assert [Path(r["maps"]["normal"]["path"]).name[:4] for r in results] == ["Head", "Head"]
    with pytest.raises(UsageError, match="holds 2 texture sets, Body, Head: leave the name out"):
        next(mipbake.load_all(tmp_path, name="robot"))


# ---- every command


@pytest.mark.parametrize("kind", ["archive", "tiles", "document"])
def test_every_command_takes(kind: str, tmp_path: Path, capsys) -> None:
    roles = {"color": "base_color", "normal_gl": "normal", "roughness": "roughness"}
    if kind == "archive":
        source, names = tmp_path / "rock.zip", ["rock"]
        with zipfile.ZipFile(source, "w") as archive:
            for stem, role in roles.items():
                archive.write(write_image(tmp_path / f"{stem}.png", pixels_for(role, 8)), f"{stem}.png")
    elif kind == "tiles":
        source, names = tmp_path / "rock", ["rock_1001", "rock_1002"]
        for tile in (1001, 1002):
            write_set(source, {f"rock_{word}.{tile}.png": pixels_for(role, 8) for word, role in roles.items()})
    else:
        source, names = two_textures(png("normal"), png("mr")).write(tmp_path / "rock"), ["M"]
    results = run(capsys, "inspect", source)["results"]
    assert [result["name"] for result in results] == names
    assert next(mipbake.load_all(source)).width == results[0]["width"]
    run(capsys, "bake", source, "-o", tmp_path / "out", "--method", "linear", "--format", "exr", "--max-level", "2")
    measured = run(capsys, "validate", source, tmp_path / "out")["results"]
    stacks = [Path(result["stack"]) for result in measured]
    wanted = [f"stack.{tile}.json" for tile in (1001, 1002)] if kind == "tiles" else names
    assert [stack.name for stack in stacks] == wanted
    assert kind == "tiles" or "hashes differ" not in str(measured)
    run(capsys, "convert", source, "--to", "ggx", "-o", tmp_path / "ggx")


def test_a_stack_of_several_sets_that_is_not_there_is_told(tmp_path: Path, capsys) -> None:
    for name in ("a", "b"):
        plain_set(tmp_path / name)
    (tmp_path / "out").mkdir()
    assert main(["validate", str(tmp_path / "a"), str(tmp_path / "b"), str(tmp_path / "out"), "-q"]) == 3
    assert "holds no stack of b: expected " in capsys.readouterr().err


def test_lists_come_from_stdin(tmp_path: Path, capsys, monkeypatch) -> None:
    for name in ("a", "b", "c"):
        plain_set(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(b"a\n# not b\nc\n")))
    assert [result["name"] for result in run(capsys, "inspect", "@-")["results"]] == ["a", "c"]
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(b"\n")))
    assert "the list of the standard input holds no path" in fails(capsys, 3, "inspect", "@-")


@pytest.mark.usefixtures("quick_comparison")
@pytest.mark.long
def test_compare_writes_a_report_for_each(tmp_path: Path, capsys) -> None:
    for name in ("a", "b"):
        plain_set(tmp_path / name, normal_gl=np.full((8, 8, 3), (128, 128, 255), np.uint8))
    given = ("--methods", "linear", "--size", "16", "--no-cache", "--no-films")
    made = run(capsys, "compare", tmp_path / "a", tmp_path / "b", "-o", tmp_path / "report", *given)["results"]
    assert [Path(each["out"]) for each in made] == [tmp_path / "report" / name for name in ("a", "b")]
    assert all((Path(each["out"]) / "index.html").is_file() for each in made)


def test_load_takes_what_the_commands_take(tmp_path: Path, monkeypatch) -> None:
    folder = plain_set(tmp_path / "wood")
    (tmp_path / "list.txt").write_text("wood\n")
    expected = mipbake.load(folder).source_hash
    for source in (str(folder), f"@{tmp_path / 'list.txt'}", f"{tmp_path}/w**", sorted(folder.iterdir())):
        assert mipbake.load(source).source_hash == expected
    other = plain_set(tmp_path / "other" / "wood")
    assert [each.name for each in mipbake.load_all([folder, other])] == [f"{tmp_path.name}_wood", "other_wood"]
    with pytest.raises(InputError, match="none does not exist"):
        list(mipbake.load_all([folder, tmp_path / "none"]))
    with pytest.raises(UsageError, match="unknown option"):
        mipbake.load(folder, colour="x")
