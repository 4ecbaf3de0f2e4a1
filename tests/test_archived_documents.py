"""Documents in .zip archives are sources as they are in folders: with what lies beside them, and nothing else."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.base.errors import InputError
from mipbake.cli.main import main
from mipbake.source import archives
from mipbake.source.gltf.images import image_files
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions

from .command_line import bumps, fails, tree, write_png, write_set
from .gltf_files import png
from .gltf_results import two_textures
from .input_files import pixels_for, plain_set, write_image
from .mtlx_documents import document, image, surface, write_textures
from .test_sources import ambientcg, run, written, zipped

LINEAR = ("--method", "linear", "--max-level", "0")


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
def test_a_gltf_in_an_archive_is_baked_as_it_is_in_a_folder(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
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
    np.testing.assert_array_equal(found.maps["base_color"].pixels, wanted.maps["base_color"].pixels)


@pytest.mark.long
def test_every_source_of_an_archive_is_read_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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


def test_names_are_enough_beside_a_material_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Downloads hold documents that say what the names of the maps say: they are read by name, with every option."""
    folder = ambientcg(tmp_path / "Metal007_1K-JPG")
    body = surface().replace("rough.png", "Metal007_1K-JPG_Roughness.png")
    document(folder, body, name="Metal007_1K-JPG.mtlx")
    archive = zipped(tmp_path / "in" / "Metal007_1K-JPG.zip", folder)
    assert main(["inspect", str(archive), "--no-gloss"]) == 0
    assert "note: Metal007_1K-JPG.mtlx is left out" in capsys.readouterr().out
    assert mipbake.load(archive).source_hash == mipbake.load(folder).source_hash


@pytest.mark.parametrize("uri", ["../../secret.png", "../secret.png", "..%2Fsecret.png", "%2E%2E/secret.png"])
def test_documents_that_look_out_of_their_archive_are_refused(
    uri: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    gltf = two_textures(png("normal a"), png("mr")).write(tmp_path / "scene", "external")
    content = json.loads(gltf.read_text())
    content["images"][0]["uri"] = uri
    files = [(each.name, each.read_bytes()) for each in tmp_path.iterdir() if each != gltf]
    archive = written(tmp_path / "a.zip", ("scene.gltf", json.dumps(content).encode()), *files)
    said = fails(capsys, 3, "bake", archive, "-o", tmp_path / "out", *LINEAR)
    assert "do not trust it" in said and f"{archive}/scene.gltf" in said and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["../../a.png", "/etc/hostname", "..\\a.png"])
@pytest.mark.parametrize("include", [False, True])
def test_material_documents_that_look_out_of_their_archive_are_refused(
    name: str, include: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = wood(tmp_path / "wood")
    text = path.read_text()
    asked = f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="{name}"/>'
    path.write_text(text.replace("<image", f"{asked}<image", 1) if include else text.replace("a.png", name))
    said = fails(capsys, 3, "inspect", zipped(tmp_path / "wood.zip", tmp_path / "wood"))
    assert "do not trust it" in said or "expected the relative path" in said
    assert f"{tmp_path}/wood.zip/wood.mtlx" in said


@pytest.mark.long
def test_what_lies_beside_a_document_counts_as_unpacked(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives, "SURELY_FINE", 1 << 20)
    (scene / "the buffer.bin").write_bytes(bytes(1 << 28))
    archive = zipped(tmp_path / "scene.zip", scene)
    (failure,) = jobs([str(archive)], LoadOptions(), tmp_path / "scratch")
    assert isinstance(failure, Failure) and "so it is not unpacked" in str(failure.error)


def test_a_broken_document_leaves_the_other_sources(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain_set(tmp_path / "in" / "oak")
    (tmp_path / "in" / "scene.glb").write_bytes(b"glTF")
    archive = zipped(tmp_path / "a.zip", tmp_path / "in")
    assert main(["inspect", str(archive), "--json"]) == 3
    out, err = capsys.readouterr()
    assert [each["ok"] for each in json.loads(out)["results"]] == [False, True]
    assert err.startswith(f"mipbake: {archive}/scene.glb") and err.count("\n") == 1


def images_there(job: Job | Failure) -> list[bool]:
    """Whether each image of a job's document is there while the job is read."""
    assert isinstance(job, Job) and job.document is not None and job.archive is not None
    document, folder = job.document, job.archive.folder
    return job.using(lambda: [image.is_file() for image in image_files(document, folder)])


def test_documents_find_their_files_again_once_other_archives_took_the_room(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        two_textures(png("normal a"), png("mr")).write(tmp_path / name / name, "external")
        zipped(tmp_path / f"{name}.zip", tmp_path / name)
    found = jobs([str(tmp_path / "*.zip")], LoadOptions(), tmp_path / "scratch")
    assert [images_there(job) for job in (*found, *found)] == [[True, True]] * 4


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


def broken_map(folder: Path) -> None:
    (write_set(folder) / "roughness.png").write_bytes(b"no image")


def broken_tile(folder: Path) -> None:
    for name, pixels in bumps().items():
        for tile in (1001, 1002):
            folder.mkdir(exist_ok=True)
            write_png(folder / f"w_{name}.{tile}.png", pixels)
    (folder / "w_roughness.1002.png").write_bytes(b"no image")


def broken_image(folder: Path) -> None:
    folder.mkdir()
    two_textures(png("normal a")[:60], png("mr")).write(folder / "scene", "glb")


def long_address(folder: Path) -> None:
    folder.mkdir()
    gltf = two_textures(png("normal a"), png("mr")).write(folder / "scene", "external")
    content = json.loads(gltf.read_text())
    gltf.write_text(json.dumps(content | {"images": [{"uri": f"{'x' * 3000}.png"}] * 2}))


def long_material(folder: Path) -> None:
    folder.mkdir()
    gltf = two_textures(png("normal a"), png("mr")).write(folder / "scene", "external")
    content = json.loads(gltf.read_text())
    gltf.write_text(json.dumps(content | {"materials": [{"name": "n" * 2000, "normalTexture": {"index": 99}}]}))


def long_file(folder: Path) -> None:
    folder.mkdir()
    document(folder, surface(image("n", "vector3", f"{'g' * 2000}.png"), normal="n"))


BROKEN = (
    long_names,
    without_roughness,
    broken_map,
    broken_tile,
    broken_image,
    long_address,
    long_material,
    long_file,
)


@pytest.mark.parametrize("broken", BROKEN, ids=lambda each: each.__name__)
@pytest.mark.parametrize("archived", [True, False])
def test_what_is_said_of_broken_sources_is_short_and_names_no_temporary_folder(
    broken: Callable[[Path], None],
    archived: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
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


def test_what_a_report_leaves_out_is_named_by_its_archive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_set(tmp_path / "in", preview=bumps()["base_color"])
    (result,) = run(capsys, "inspect", zipped(tmp_path / "some.zip", tmp_path / "in"))["results"]
    assert [each["path"] for each in result["ignored"]] == [f"{tmp_path}/some.zip/preview.png"]
