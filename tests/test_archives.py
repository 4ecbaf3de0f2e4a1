"""Archives as sources: sets and documents in them are read as they are in folders, and nothing lies outside."""

from __future__ import annotations

import json
import stat
import struct
import tempfile
import zipfile
import zlib
from pathlib import Path

import pytest

import mipbake
from mipbake.base.errors import InputError
from mipbake.cli.main import main
from mipbake.source import archives
from mipbake.source.gltf.images import image_files
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions

from .command_line import fails, tree, write_set
from .gltf_files import png
from .gltf_results import two_textures
from .input_files import pixels_for, plain_set, write_image
from .input_files import write_set as write_files
from .mtlx_documents import document, image, surface, write_textures
from .test_sources import run

pytestmark = pytest.mark.usefixtures("unmeasured")

Capture = pytest.CaptureFixture[str]
LINEAR = ("--method", "linear", "--max-level", "0")


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
    write_files(folder, {f"Metal007_1K-JPG_{word}.png": role for word, role in roles.items()})
    write_image(folder / "Metal007_1K-JPG.png", pixels_for("base_color"))
    (folder / "Metal007_1K-JPG.mtlx").write_text("<materialx/>")
    return folder


def polyhaven(folder: Path) -> Path:
    """A download of Poly Haven, unpacked: maps in a folder of their own."""
    names = {"wall_diff_1k.png": "base_color", "wall_nor_gl_1k.png": "normal", "wall_arm_1k.png": "packed"}
    write_files(folder / "textures", names)
    (folder / "wall_1k.blend").write_bytes(b"BLENDER")
    return folder


def found_in(*sources: Path) -> list[Job | Failure]:
    """What sources hold, archives unpacked beside the first one."""
    return jobs([str(source) for source in sources], LoadOptions(), sources[0].parent / "scratch")


@pytest.mark.parametrize("inside", ["", "some/where/"])
def test_an_archive_is_read_as_its_folder(inside: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = ambientcg(tmp_path / "Metal007_1K-JPG")
    archive = zipped(tmp_path / "in" / "Metal007_1K-JPG.zip", plain, inside)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    found, wanted = mipbake.load(archive), mipbake.load(plain)
    assert found.source_hash == wanted.source_hash and found.name == (Path(inside).name or "Metal007_1K-JPG")
    assert tree(tmp_path / "in") == ["Metal007_1K-JPG.zip"]  # nothing is unpacked beside it
    found = mipbake.load(zipped(tmp_path / "wall_1k.zip", polyhaven(tmp_path / "wall")))
    assert found.name == "wall_1k" and found.maps["roughness"].source.channels == "G"


def test_paths_are_said_from_the_archive_on(tmp_path: Path, capsys: Capture) -> None:
    folder = plain_set(tmp_path / "set")
    (folder / "preview.png").write_bytes((folder / "base_color.png").read_bytes())
    archive = zipped(tmp_path / "set.zip", folder)
    (result,) = run(capsys, "inspect", archive)["results"]
    assert result["maps"]["roughness"]["path"] == f"{archive}/roughness.png"
    assert [each["path"] for each in result["ignored"]] == [f"{archive}/preview.png"]
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
def test_members_that_would_lie_elsewhere_are_refused(name, tmp_path, capsys, monkeypatch):
    (tmp_path / "in").mkdir()
    name = name.format(tmp_path / "new")
    take_second_names(monkeypatch)
    for member in (name, with_second_name("a.png", name)):
        archive = written(tmp_path / "in" / "a.zip", (member, b"x"))
        assert "would lie outside its folder: do not trust it" in fails(capsys, 3, "inspect", archive)
        assert tree(tmp_path) == ["in", "in/a.zip"]


def linked() -> zipfile.ZipInfo:
    link = zipfile.ZipInfo("a_color.png")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    return link


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("a_color.png", "A_Color.PNG"), "twice"),
        (("\u00e9.png", "e\u0301.png"), "twice"),
        (("a.gltf", "b.png", "b.png/c.png"), "'b.png' twice"),
        ((f"{'a' * 300}/b.png",), "whose name is too long"),
        ((linked(),), "which is a link"),
        (("a.txt",), "holds neither an image nor a document: expected the maps of texture sets"),
        (("a/scene.glb",), "a.zip/a/scene.glb is not a glTF file"),
        ([f"{i}.png" for i in range(3)], "holds 3 files"),
        ((), "is not a ZIP archive"),
    ],
)
def test_archives_of_nothing_usable_are_refused(names, told, tmp_path, capsys, monkeypatch):
    archive = written(tmp_path / "a.zip", *((name, b"x") for name in names))
    if told == "holds 3 files":
        monkeypatch.setattr(archives, "MOST_FILES", 2)
    if not names:
        archive.write_bytes(b"no archive")
    assert told in fails(capsys, 3, "inspect", archive)


def test_bombs_are_refused_before_they_are_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archives, "SURELY_FINE", 1 << 20)
    archive = written(tmp_path / "a.zip", ("a_color.png", bytes(2 << 20)))
    (failure,) = found_in(archive)
    assert isinstance(failure, Failure) and "no texture set grows so much, so it is not unpacked" in str(failure.error)
    assert tree(tmp_path) == ["a.zip"]
    archive = written(tmp_path / "a.zip", ("a_color.png", bytes(1000)))
    archive.write_bytes(archive.read_bytes().replace((1000).to_bytes(4, "little"), (10).to_bytes(4, "little")))
    (failure,) = found_in(archive)
    assert isinstance(failure, Failure) and str(failure.error).startswith(f"{archive}")


def test_archives_with_broken_bytes_are_read_or_refused(tmp_path: Path) -> None:
    files = {"wood_color.png": pixels_for("base_color", 2), "wood_normal_gl.png": pixels_for("normal", 2)}
    archive = zipped(tmp_path / "a.zip", write_files(tmp_path / "set", files), "in/")
    whole = archive.read_bytes()
    for place in range(0, len(whole), 9):
        data = bytearray(whole)
        data[place] ^= 0x9C
        archive.write_bytes(data)
        with pytest.raises(InputError) as error:  # it has no roughness, whatever else is wrong
            mipbake.load(archive)
        assert "\n" not in str(error.value)


def test_one_archive_at_a_time_is_unpacked(tmp_path: Path) -> None:
    """Sets and documents find their files again once another archive took the room."""
    zipped(tmp_path / "a.zip", plain_set(tmp_path / "a"))
    (tmp_path / "b").mkdir()
    two_textures(png("normal a"), png("mr")).write(tmp_path / "b" / "b", "external")
    zipped(tmp_path / "b.zip", tmp_path / "b")
    found = found_in(tmp_path / "a.zip", tmp_path / "b.zip")
    for job in (*found, *found):
        assert isinstance(job, Job) and job.archive is not None
        job.read_tile(0)
        assert job.archive.folder.is_dir()
        document, folder = job.document, job.archive.folder
        if document is not None:
            assert job.using(lambda d=document, f=folder: all(each.is_file() for each in image_files(d, f)))
    assert len([*(tmp_path / "scratch").glob("*/archive/*")]) == 1


# ---- documents


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A folder with a .gltf of two materials, its buffer and its images."""
    folder = tmp_path / "unpacked"
    folder.mkdir()
    made = two_textures(png("normal a"), png("mr"))
    made.material("Other", normalTexture={"index": 0})
    made.write(folder / "both", "external")
    return folder


def wood(folder: Path, **inputs: str) -> Path:
    """A .mtlx document with its textures; the names of some say nothing of their role."""
    folder.mkdir(parents=True)
    write_textures(folder)
    (folder / "color.png").rename(folder / "a.png")
    return document(folder, surface(image("base", "color3", "a.png"), base_color="base"))


@pytest.mark.long
def test_a_gltf_in_an_archive_is_baked_as_it_is_in_a_folder(scene, tmp_path, monkeypatch, capsys):
    archive = zipped(tmp_path / "in" / "scene.zip", scene, "some/where/")
    (tmp_path / "scratch").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))
    results = run(capsys, "bake", archive, "-o", tmp_path / "out", *LINEAR)["results"]
    run(capsys, "bake", scene / "both.gltf", "-o", tmp_path / "wanted", *LINEAR)
    assert tree(tmp_path / "out") == tree(tmp_path / "wanted") == ["both.glb"]
    assert (tmp_path / "out" / "both.glb").read_bytes() == (tmp_path / "wanted" / "both.glb").read_bytes()
    assert {result["source"] for result in results} == {f"{archive}/some/where/both.gltf"}
    assert tree(tmp_path / "in") == ["scene.zip"] and tree(tmp_path / "scratch") == []


def test_python_reads_documents_in_archives(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    for kind in ("glb", "external", "embedded"):
        source = two_textures(png("normal a"), png("mr")).write(tmp_path / "a" / "bolt", kind)
        found = mipbake.load(zipped(tmp_path / f"{kind}.zip", tmp_path / "a"))
        assert found.source_hash == mipbake.load(source).source_hash
        source.unlink()
    path = wood(tmp_path / "wood")
    found, wanted = mipbake.load(zipped(tmp_path / "wood.zip", tmp_path / "wood", "in/")), mipbake.load(path)
    assert (found.name, found.source_hash) == (wanted.name, wanted.source_hash) == ("Wood", wanted.source_hash)


@pytest.mark.long
def test_every_source_of_an_archive_is_read_once(tmp_path: Path, capsys: Capture) -> None:
    """Maps that a document names are of no set of their own, whatever their names and their folder."""
    inside = tmp_path / "in"
    for name in ("a", "b"):
        (inside / name / "textures").mkdir(parents=True)
        made = two_textures(png("normal a"), png("mr"))
        gltf = made.write(inside / name / "scene", "external")
        content = json.loads(gltf.read_text())
        for each, file in zip(content["images"], ("wood_normal_gl.png", "wood_roughness.png"), strict=True):
            (gltf.parent / each["uri"].replace("%20", " ")).rename(gltf.parent / "textures" / file)
            each["uri"] = f"../{name}/textures/{file}"
        gltf.write_text(json.dumps(content))
    write_set(inside / "brick")
    wood(inside / "wood")
    archive = zipped(tmp_path / "all.zip", inside)
    results = run(capsys, "inspect", archive)["results"]
    assert [each["name"] for each in results] == ["M", "M", "Wood", "brick"]
    assert [Path(each["source"]).relative_to(tmp_path).as_posix() for each in results] == [
        "all.zip/a/scene.gltf",
        "all.zip/b/scene.gltf",
        "all.zip/wood/wood.mtlx",
        "all.zip",
    ]
    assert main(["bake", str(archive), "-o", str(tmp_path / "out"), *LINEAR, "-q"]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["Wood", "a_scene.glb", "b_scene.glb", "brick"]


def test_names_are_enough_beside_a_material_document(tmp_path: Path, capsys: Capture) -> None:
    """Downloads hold documents that say what the names of the maps say: they are read by name, with every option."""
    folder = ambientcg(tmp_path / "Metal007_1K-JPG")
    body = surface().replace("rough.png", "Metal007_1K-JPG_Roughness.png")
    document(folder, body, name="Metal007_1K-JPG.mtlx")
    archive = zipped(tmp_path / "in" / "Metal007_1K-JPG.zip", folder)
    assert main(["inspect", str(archive), "--no-gloss"]) == 0
    assert "note: Metal007_1K-JPG.mtlx is left out" in capsys.readouterr().out
    assert mipbake.load(archive).source_hash == mipbake.load(folder).source_hash


@pytest.mark.parametrize("uri", ["../../secret.png", "..%2Fsecret.png", "%2E%2E/secret.png"])
def test_documents_that_look_out_of_their_archive_are_refused(uri, tmp_path, capsys, monkeypatch):
    gltf = two_textures(png("normal a"), png("mr")).write(tmp_path / "scene", "external")
    content = json.loads(gltf.read_text())
    content["images"][0]["uri"] = uri
    files = [(each.name, each.read_bytes()) for each in tmp_path.iterdir() if each != gltf]
    archive = written(tmp_path / "a.zip", ("scene.gltf", json.dumps(content).encode()), *files)
    said = fails(capsys, 3, "bake", archive, "-o", tmp_path / "out", *LINEAR)
    assert "do not trust it" in said and f"{archive}/scene.gltf" in said and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["../../a.png", "/etc/hostname", "..\\a.png"])
@pytest.mark.parametrize("include", [False, True])
def test_material_documents_that_look_out_of_their_archive_are_refused(name, include, tmp_path, capsys):
    path = wood(tmp_path / "wood")
    text = path.read_text()
    asked = f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="{name}"/>'
    path.write_text(text.replace("<image", f"{asked}<image", 1) if include else text.replace("a.png", name))
    said = fails(capsys, 3, "inspect", zipped(tmp_path / "wood.zip", tmp_path / "wood"))
    assert "do not trust it" in said or "expected the relative path" in said
    assert f"{tmp_path}/wood.zip/wood.mtlx" in said


def test_a_broken_document_leaves_the_other_sources(tmp_path: Path, capsys: Capture) -> None:
    plain_set(tmp_path / "in" / "oak")
    (tmp_path / "in" / "scene.glb").write_bytes(b"glTF")
    archive = zipped(tmp_path / "a.zip", tmp_path / "in")
    assert main(["inspect", str(archive), "--json"]) == 3
    out, err = capsys.readouterr()
    assert [each["ok"] for each in json.loads(out)["results"]] == [False, True]
    assert err.startswith(f"mipbake: {archive}/scene.glb") and err.count("\n") == 1


def test_options_are_for_sets_alone(scene: Path, tmp_path: Path) -> None:
    archive = zipped(tmp_path / "scene.zip", scene)
    with pytest.raises(mipbake.UsageError, match=r"scene\.zip/both\.gltf says itself how its textures are read"):
        mipbake.load(archive, normal_convention="directx")
    with pytest.raises(InputError, match=r"load_all"):
        mipbake.load(archive)


def long_names(folder: Path) -> None:
    """Sixty images whose names say no role, of 150 letters each."""
    folder.mkdir()
    for index in range(60):
        write_image(folder / f"{'z' * 150}{index}.png", pixels_for("base_color", 2))


def without_roughness(folder: Path) -> None:
    write_set(folder / ("d" * 100) / ("e" * 100), roughness=None)


def broken_image(folder: Path) -> None:
    folder.mkdir()
    two_textures(png("normal a")[:60], png("mr")).write(folder / "scene", "glb")


def long_address(folder: Path) -> None:
    folder.mkdir()
    gltf = two_textures(png("normal a"), png("mr")).write(folder / "scene", "external")
    content = json.loads(gltf.read_text())
    gltf.write_text(json.dumps(content | {"images": [{"uri": f"{'x' * 3000}.png"}] * 2}))


BROKEN = (long_names, without_roughness, broken_image, long_address)


@pytest.mark.parametrize("broken", BROKEN, ids=lambda each: each.__name__)
@pytest.mark.parametrize("archived", [True, False])
def test_what_is_said_of_broken_sources_is_short_and_names_no_temporary_folder(
    broken, archived, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    broken(Path("in"))
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    source = zipped(Path("some.zip"), Path("in")) if archived else Path("in")
    if not archived:  # a document alone
        source = next((path for path in source.iterdir() if path.suffix in (".glb", ".gltf", ".mtlx")), source)
    for command in (["inspect"], ["bake", "-o", "out", *LINEAR], ["convert", "-o", "out", "--to", "ggx"]):
        assert main([*command, str(source), "--json"]) == 3
        out, err = capsys.readouterr()
        told = [each["error"] for each in json.loads(out)["results"] if not each["ok"]]
        assert told and "scratch" not in out + err and err.count("\n") == len(told)
        assert all(len(line) < 300 and (not archived or "some.zip" in line) for line in (*err.splitlines(), *told))
