"""Every command takes every source: archives, folders of several sets, lists on stdin; and from Python the same."""

from __future__ import annotations

import io
import json
import stat
import struct
import zipfile
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import mipbake
from mipbake.base.errors import InputError, UsageError
from mipbake.cli.main import main
from mipbake.source import archives
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions
from mipbake.source.split import divided

from .command_line import fails, tree
from .gltf_files import png
from .gltf_results import two_textures
from .input_files import pixels_for, plain_set, write_image, write_set

QUICK = ("--points", "4", "--samples", "1", "--lods", "0")


def run(capsys, *arguments: object) -> dict:
    """The JSON of a command that succeeds."""
    code = main([*map(str, arguments), "--json"])
    out, err = capsys.readouterr()
    assert code == 0, err
    return json.loads(out)


def zipped(path: Path, folder: Path, inside: str = "") -> Path:
    """A folder as an archive, its files below a folder inside or at the root."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(p for p in folder.rglob("*") if p.is_file()):
            archive.write(file, f"{inside}{file.relative_to(folder)}")
    return path


def ambientcg(folder: Path) -> Path:
    """A download of ambientCG, unpacked: maps, a preview and documents in one folder."""
    roles = {"Color": "base_color", "NormalGL": "normal", "NormalDX": "normal", "Roughness": "roughness"}
    write_set(folder, {f"Metal007_1K-JPG_{word}.png": role for word, role in roles.items()})
    write_image(folder / "Metal007_1K-JPG.png", pixels_for("base_color"))
    (folder / "Metal007_1K-JPG.mtlx").write_text("<materialx/>")
    return folder


def polyhaven(folder: Path) -> Path:
    """A download of Poly Haven, unpacked: maps in a folder of their own."""
    names = {"wall_diff_1k.png": "base_color", "wall_nor_gl_1k.png": "normal", "wall_arm_1k.png": "packed"}
    write_set(folder / "textures", names)
    (folder / "wall_1k.blend").write_bytes(b"BLENDER")
    return folder


def substance(folder: Path, *sets: str) -> Path:
    """An export of Substance Painter: several sets in one folder."""
    roles = {"BaseColor": "base_color", "Normal_OpenGL": "normal", "Roughness": "roughness", "Metallic": "metallic"}
    for name in sets:
        write_set(folder, {f"{name}_{word}.png": role for word, role in roles.items()})
    return folder


# ---- archives


@pytest.mark.parametrize("inside", ["", "Metal007/", "some/where/"])
def test_an_archive_is_read_as_its_folder(inside: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = ambientcg(tmp_path / "Metal007_1K-JPG")
    archive = zipped(tmp_path / "in" / "Metal007_1K-JPG.zip", plain, inside)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    found, wanted = mipbake.load(archive), mipbake.load(plain)
    assert found.source_hash == wanted.source_hash
    assert found.name == (Path(inside).name or "Metal007_1K-JPG")
    assert tree(tmp_path / "in") == ["Metal007_1K-JPG.zip"]  # nothing is unpacked beside it


def test_an_archive_of_poly_haven_is_called_after_itself(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "wall_1k.zip", polyhaven(tmp_path / "in"))
    found = mipbake.load(archive)
    assert found.name == "wall_1k" and found.maps["roughness"].source.channels == "G"


def test_every_command_takes_archives(tmp_path: Path, capsys) -> None:
    one = zipped(tmp_path / "one.zip", ambientcg(tmp_path / "a"))
    two = zipped(tmp_path / "two.zip", polyhaven(tmp_path / "b"))
    results = run(capsys, "inspect", tmp_path / "*.zip")["results"]
    assert [Path(result["source"]).name for result in results] == ["one.zip", "two.zip"]
    assert results[0]["maps"]["roughness"]["path"] == f"{one}/Metal007_1K-JPG_Roughness.png"
    linear = ("--method", "linear", "--format", "png")
    made = run(capsys, "bake", one, two, "-o", tmp_path / "out", *linear, "--keep-level0")["results"]
    assert [Path(result["out"]).name for result in made] == ["one", "two"]
    measured = run(capsys, "validate", one, two, tmp_path / "out", *QUICK)["results"]
    assert [result["stack"] for result in measured] == [str(tmp_path / "out" / name) for name in ("one", "two")]
    assert not any("hashes differ" in note for result in measured for note in result["notes"])
    run(capsys, "convert", one, two, "--to", "ggx", "-o", tmp_path / "ggx")
    assert sorted(p.name for p in (tmp_path / "ggx").iterdir()) == ["one", "two"]


def test_what_is_broken_in_an_archive_is_told_by_its_place(tmp_path: Path, capsys) -> None:
    folder = plain_set(tmp_path / "set")
    whole = (folder / "roughness.png").read_bytes()
    (folder / "roughness.png").write_bytes(whole[: len(whole) // 2])
    archive = zipped(tmp_path / "set.zip", folder, "inner/")
    assert f"{archive}/inner/roughness.png is cut short" in fails(capsys, 3, "inspect", archive)


def test_every_folder_of_an_archive_is_a_source(tmp_path: Path, capsys) -> None:
    for name in ("oak", "pine"):
        plain_set(tmp_path / "in" / name)
    (tmp_path / "in" / "previews").mkdir()
    write_image(tmp_path / "in" / "previews" / "all.png", pixels_for("base_color"))
    archive = zipped(tmp_path / "woods.zip", tmp_path / "in")
    assert [result["name"] for result in run(capsys, "inspect", archive)["results"]] == ["oak", "pine"]
    with pytest.raises(
        InputError, match=r"woods\.zip holds 2 texture sets, oak, pine: read them with mipbake\.load_all"
    ):
        mipbake.load(archive)
    assert [each.name for each in mipbake.load_all(archive)] == ["oak", "pine"]


def written(path: Path, *members: tuple[str | zipfile.ZipInfo, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return path


ELSEWHERE = ["../a_color.png", "{}/a_color.png", "in/../../a.png", "C:/a.png", "C:a.png", "in/C:a.png", "..\\a.png"]


def with_second_name(name: str, second: str) -> zipfile.ZipInfo:
    """A member with a Unicode path field, whose name newer versions of Python take."""
    member = zipfile.ZipInfo(name)
    data = struct.pack("<BI", 1, zlib.crc32(name.encode())) + second.encode()
    member.extra = struct.pack("<HH", 0x7075, len(data)) + data
    return member


def take_second_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """Members have their second name, as newer versions of Python read it, with any version."""
    read = zipfile.ZipFile.infolist

    def infolist(self: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
        members = read(self)
        for member in members:
            if member.extra[:2] == b"\x75\x70":
                member.filename = member.extra[9:].decode()
        return members

    monkeypatch.setattr(zipfile.ZipFile, "infolist", infolist)


@pytest.mark.parametrize("name", ELSEWHERE)
@pytest.mark.parametrize("second", [False, True])
def test_members_that_would_lie_elsewhere_are_refused(
    name: str, second: bool, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "in").mkdir()
    name = name.format(tmp_path / "new")
    archive = written(tmp_path / "in" / "a.zip", (with_second_name("a.png", name) if second else name, b"x"))
    take_second_names(monkeypatch)
    assert "would lie outside its folder: do not trust it" in fails(capsys, 3, "inspect", archive)
    assert tree(tmp_path) == ["in", "in/a.zip"]


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("a_color.png", "A_Color.PNG"), "twice"),
        (("\u00e9.png", "e\u0301.png"), "twice"),
        (("a.gltf", "b.png", "b.png/c.png"), "'b.png' twice"),
        (("a.gltf", "B.png/c.png", "b.png"), "'b.png' twice"),
        ((f"{'a' * 300}.png",), "whose name is too long"),
        ((f"{'a' * 300}/b.png",), "whose name is too long"),
        (("/".join(["a" * 200] * 30) + ".png",), "whose name is too long"),
    ],
)
def test_members_that_no_folder_can_hold_are_refused(names: tuple[str, ...], told: str, tmp_path: Path, capsys) -> None:
    archive = written(tmp_path / "a.zip", *((name, b"x") for name in names))
    assert told in fails(capsys, 3, "inspect", archive)


def test_links_in_archives_are_refused(tmp_path: Path, capsys) -> None:
    link = zipfile.ZipInfo("a_color.png")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    assert "which is a link" in fails(capsys, 3, "inspect", written(tmp_path / "a.zip", (link, b"/etc/passwd")))


@pytest.mark.parametrize(
    ("members", "told"),
    [
        ([("a_color.png", bytes(2 << 20))], "no texture set grows so much, so it is not unpacked"),
        ([(f"{i}.png", b"") for i in range(3)], "holds 3 files"),
    ],
)
def test_bombs_are_refused_before_they_are_unpacked(
    members: list[tuple[str, bytes]], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives, "MOST_FILES", 2)
    monkeypatch.setattr(archives, "SURELY_FINE", 1 << 20)
    archive = written(tmp_path / "a.zip", *members)
    (failure,) = jobs([str(archive)], LoadOptions(), tmp_path / "scratch")
    assert isinstance(failure, Failure) and told in str(failure.error)
    assert tree(tmp_path) == ["a.zip"]


def test_a_member_that_is_larger_than_it_says_is_refused(tmp_path: Path, capsys) -> None:
    archive = written(tmp_path / "a.zip", ("a_color.png", bytes(1000)))
    data = archive.read_bytes()
    archive.write_bytes(data.replace((1000).to_bytes(4, "little"), (10).to_bytes(4, "little")))
    assert f"{archive}" in fails(capsys, 3, "inspect", archive)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"no archive", "is not a ZIP archive"),
        (b"", "is not a ZIP archive"),
        ((("a.txt", b"x"),), "holds neither an image nor a document: expected the maps of texture sets"),
        ((("a/scene.glb", b"x"),), "a.zip/a/scene.glb is not a glTF file"),
    ],
)
def test_archives_of_nothing(content, told: str, tmp_path: Path, capsys) -> None:
    path = tmp_path / "a.zip"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        written(path, *content)
    assert told in fails(capsys, 3, "inspect", path)


def test_archives_with_broken_bytes_are_read_or_refused(tmp_path: Path) -> None:
    files = {"wood_color.png": pixels_for("base_color", 2), "wood_normal_gl.png": pixels_for("normal", 2)}
    archive = zipped(tmp_path / "a.zip", write_set(tmp_path / "set", files), "in/")
    whole = archive.read_bytes()
    for place in range(0, len(whole), 3):
        data = bytearray(whole)
        data[place] ^= 0x9C
        archive.write_bytes(data)
        with pytest.raises(InputError) as error:  # it has no roughness, whatever else is wrong
            mipbake.load(archive)
        assert "\n" not in str(error.value)


def test_one_archive_at_a_time_is_unpacked(tmp_path: Path) -> None:
    for name in ("a", "b"):
        zipped(tmp_path / f"{name}.zip", plain_set(tmp_path / name))
    found = jobs([str(tmp_path / "*.zip")], LoadOptions(), tmp_path / "scratch")
    for job in (*found, *found):
        assert isinstance(job, Job)
        assert job.read_tile(0).name == job.name
        assert [path.name for path in (tmp_path / "scratch").glob("*/archive/*")] == [job.name]


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


# ---- every command


def test_every_command_takes_tiles(tmp_path: Path, capsys) -> None:
    roles = {"color": "base_color", "normal_gl": "normal", "roughness": "roughness"}
    for tile in (1001, 1002):
        write_set(tmp_path / "rock", {f"rock_{word}.{tile}.png": role for word, role in roles.items()})
    run(capsys, "bake", tmp_path / "rock", "-o", tmp_path / "out", "--method", "linear", "--format", "exr")
    for given in (tmp_path / "out", tmp_path / "out" / "rock"):
        results = run(capsys, "validate", tmp_path / "rock", given, *QUICK)["results"]
        assert [Path(result["stack"]).name for result in results] == ["stack.1001.json", "stack.1002.json"]
    run(capsys, "convert", tmp_path / "rock", "--to", "ggx", "-o", tmp_path / "ggx")
    assert sorted(p.name for p in (tmp_path / "ggx").iterdir()) == ["rock_1001", "rock_1002"]


def test_every_command_takes_documents(tmp_path: Path, capsys) -> None:
    source = two_textures(png("normal"), png("mr")).write(tmp_path / "bolt")
    (result,) = run(capsys, "inspect", source)["results"]
    assert result["maps"]["normal"]["path"]
    assert mipbake.load(source).width == result["width"]
    run(capsys, "bake", source, "-o", tmp_path / "out", "--method", "linear", "--format", "exr")
    (measured,) = run(capsys, "validate", source, tmp_path / "out", *QUICK)["results"]
    assert Path(measured["stack"]).parent == tmp_path / "out" / "bolt"
    assert "hashes differ" not in str(measured["notes"])
    run(capsys, "convert", source, "--to", "ggx", "-o", tmp_path / "ggx")


def test_lists_come_from_stdin(tmp_path: Path, capsys, monkeypatch) -> None:
    for name in ("a", "b", "c"):
        plain_set(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(b"a\n# not b\nc\n")))
    assert [result["name"] for result in run(capsys, "inspect", "@-")["results"]] == ["a", "c"]
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(b"\n")))
    assert "the list of the standard input holds no path" in fails(capsys, 3, "inspect", "@-")


def test_a_stack_of_several_sets_that_is_not_there_is_told(tmp_path: Path, capsys) -> None:
    for name in ("a", "b"):
        plain_set(tmp_path / name)
    run(capsys, "bake", tmp_path / "a", "-o", tmp_path / "out", "--method", "linear", "--format", "exr")
    assert main(["validate", str(tmp_path / "a"), str(tmp_path / "b"), str(tmp_path / "out"), *QUICK, "-q"]) == 3
    assert "holds no stack of b: expected " in capsys.readouterr().err


@pytest.mark.long
def test_compare_writes_a_report_for_each(tmp_path: Path, capsys) -> None:
    for name in ("a", "b"):
        plain_set(tmp_path / name, normal_gl=np.full((8, 8, 3), (128, 128, 255), np.uint8))
    given = ("--methods", "linear", "--points", "4", "--samples", "1", "--passes", "32", "--size", "16", "--no-cache")
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
