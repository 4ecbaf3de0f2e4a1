"""What `mipbake info` says of files and folders, GLB files among them, without a look at pixels."""

from __future__ import annotations

import json
import struct
import sys

import pytest

from mipbake.cli.main import main
from mipbake.stack.file_info import file_info
from mipbake.stack.gltf.glb import Encoded
from mipbake.stack.gltf.quad import standalone

from .command_line import bake, fails, run, write_set
from .gltf_files import GltfFile, ktx2, png
from .stacks import made_stack

pytestmark = pytest.mark.usefixtures("unmeasured")


@pytest.fixture
def _without_decoder(monkeypatch) -> None:
    """Neither levels nor blocks are decoded."""
    monkeypatch.setitem(sys.modules, "alktx2", None)


MAPS = {"baseColorTexture": ktx2(1, True, 16, 8), "normalTexture": ktx2(2)}


def glb() -> bytes:
    return standalone("sample", MAPS, {"method": "linear", "version": "0", "wrap": ["wrap", "clamp"]})


def shown(capsys, *arguments) -> str:
    assert main([str(a) for a in ("info", *arguments)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out


def saved(folder, formats=("exr",), **changes):
    """A stack with a GLB beside; `changes` are changes of its description."""
    textures = MAPS | {"metallicRoughnessTexture": ktx2(2)}
    made_stack((4, 8)).save(folder, ",".join(formats) if formats else (), glb=Encoded(textures, (), ()))
    path = folder / "stack.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    return folder


@pytest.mark.usefixtures("_without_decoder")
def test_images_of_a_glb(tmp_path, capsys) -> None:
    (tmp_path / "a.glb").write_bytes(glb())
    out = shown(capsys, tmp_path / "a.glb")
    assert "a.glb: GLB (glTF 2.0), 2 images" in out
    assert "made by mipbake: method linear, version 0, wrap wrap, clamp\n" in out
    assert "image baseColorTexture: image/ktx2, UASTC_RGB_SRGB_BLOCK, sRGB, 16 x 8, 5 levels" in out
    (file,) = json.loads(shown(capsys, tmp_path / "a.glb", "--json"))["files"]
    assert file["about"] == {"method": "linear", "version": "0", "wrap": ["wrap", "clamp"]}
    assert [image["levels"] for image in file["images"]] == [
        [[16, 8], [8, 4], [4, 2], [2, 1], [1, 1]],
        [[8, 8], [4, 4], [2, 2], [1, 1]],
    ]
    assert [image["bytes"] for image in file["images"]] == [len(ktx2(1, True, 16, 8)), len(ktx2(2))]


def of_another_kind(place: int, kind: str, value: int) -> bytes:
    """A KTX 2 file of 8 x 8 texels with another number in a field of its header."""
    data = bytearray(ktx2(1))
    struct.pack_into(kind, data, place, value)
    return bytes(data)


COLOUR_MODEL = struct.unpack_from("<I", ktx2(1), 48)[0] + 12


@pytest.mark.usefixtures("_without_decoder")
@pytest.mark.parametrize(
    ("data", "texels"),
    [
        (of_another_kind(COLOUR_MODEL, "<B", 163), "ETC1S, linear, 8 x 8, 4 levels"),
        (of_another_kind(12, "<I", 157), "UASTC (Vulkan format 157), linear, 8 x 8, 4 levels"),
        (of_another_kind(44, "<I", 1), "UASTC_RGB_UNORM_BLOCK, linear, 8 x 8, 4 levels"),
    ],
)
def test_textures_that_are_not_read_are_described(tmp_path, capsys, data, texels) -> None:
    """Theirs is the header alone; what follows it is left to who decodes them."""
    (tmp_path / "a.ktx2").write_bytes(data)
    assert f"a.ktx2: KTX 2, {texels}" in shown(capsys, tmp_path / "a.ktx2")
    made = GltfFile()
    made.image(data, "bark", "image/ktx2")
    made.image(ktx2(2), "moss", "image/ktx2")
    out = shown(capsys, made.write(tmp_path / "a"))
    assert f"image bark: image/ktx2, {texels}" in out and "image moss: image/ktx2, UASTC" in out
    (tmp_path / "a.ktx2").write_bytes(data[:60])
    assert "ends within its header" in fails(capsys, 3, "info", tmp_path / "a.ktx2")


@pytest.mark.parametrize("formats", [("exr", "png"), ()])
def test_stacks_with_a_glb(tmp_path, capsys, formats) -> None:
    out = shown(capsys, saved(tmp_path / "s", formats))
    assert "sample, gltf, 8 x 4, " + ("4 levels" if formats else "5 levels") in out
    assert "sample.glb: GLB (glTF 2.0), 3 images" in out
    assert ("exr: normals OpenGL" in out) == ("png: normals OpenGL" in out) == bool(formats)
    assert "glb: normals" not in out


@pytest.mark.parametrize("name", ["../secret.exr", "..", "a\\\\b", 3])
def test_files_elsewhere_are_refused(tmp_path, capsys, name) -> None:
    (tmp_path / "secret.exr").write_bytes(b"secret")
    folder = saved(tmp_path / "s", outputs=[{"format": "exr", "maps": {"a": {"files": [name]}}}])
    assert "expected names of files in its folder" in fails(capsys, 3, "info", folder)


@pytest.mark.parametrize("outputs", [None, [{"files": 3}]])
def test_descriptions_of_no_stack_are_told(tmp_path, capsys, outputs) -> None:
    folder = saved(tmp_path / "s", outputs=outputs)
    assert "does not describe a stack" in fails(capsys, 3, "info", folder)


@pytest.fixture
def exr(tmp_path):
    made_stack((4, 8)).save(tmp_path / "s", "exr")
    return (tmp_path / "s" / "roughness.exr").read_bytes()


def test_broken_files_whose_names_are_no_text(tmp_path, capsys, exr) -> None:
    """The library quotes the bytes that it does not understand."""
    broken = tmp_path / "a.exr"
    broken.write_bytes(exr.replace(b"channels\0chlist", b"channels\xffchlist"))
    assert "cannot read" in fails(capsys, 3, "info", broken)
    assert "a.exr is not a readable .exr image" in fails(
        capsys, 3, "bake", tmp_path, "-o", tmp_path / "out", "--map", "roughness=a.exr", "--map", "normal=none"
    )


def test_broken_png_files_take_one_sentence(tmp_path, capfd) -> None:
    """libpng would print one of its own."""
    (tmp_path / "a.png").write_bytes(png("a", 8).replace(b"IDAT", b"IDA\xff"))
    assert main(["info", str(tmp_path / "a.png")]) == 3
    assert capfd.readouterr().err.count("\n") == 1


@pytest.mark.long
def test_info_on_every_file(tmp_path, capsys) -> None:
    folder = write_set(tmp_path / "metal")
    formats = "exr,tx:8,ktx2:bc,dds:rgba8,png:16,glb"
    assert bake(folder, "-o", tmp_path / "out", "--format", formats)[0] == 0
    place = tmp_path / "out" / "metal"
    names = [p.name for p in place.iterdir()]
    code, said = run("info", place)
    assert code == 0 and all(name in said for name in names if name != "stack.json")
    assert run("info", place / "stack.json") == (code, said)
    assert f"{place}: metal, gltf, 16 x 16, 5 levels, wrap wrap, wrap" in said and "baked by linear of mipbake" in said
    wanted = {
        "normal.exr": ("openexr, half, channels R G B", "textureformat: Plain Texture", "wrapmodes: periodic,periodic"),
        "normal.tx": ("tiff, uint8, channels R G B", "textureformat: Plain Texture", "wrapmodes: periodic,periodic"),
        "base_color.ktx2": ("KTX 2, BC7_SRGB_BLOCK, sRGB", "KTXorientation: rd"),
        "normal.dds": ("DDS (Direct3D 10), R8G8B8A8_UNORM, linear",),
        "base_color_mip00.png": ("png, uint16, channels R G B, srgb",),
        "metal.glb": ("GLB (glTF 2.0)", "UASTC_RGB_SRGB_BLOCK"),
    }
    for name, parts in wanted.items():
        code, said = run("info", place / name)
        assert code == 0 and all(part in said for part in parts), said
        assert ("made by mipbake: set metal, model gltf, method linear" in said) == (not name.endswith("dds"))
        assert ", 16 x 16, 5 levels" in said or name.endswith("png")
        code, said = run("info", place / name, "--json")
        (found,) = json.loads(said)["files"]
        assert (found["path"], found["bytes"]) == (str(place / name), (place / name).stat().st_size)
    assert file_info(place / "roughness_mip00.png").colour_space == ""  # it says none
    code, said = run("info", place, "--json")
    report = json.loads(said)
    assert report["stack"]["name"] == "metal" and len(report["files"]) == len(names) - 1
    capsys.readouterr()


@pytest.mark.long
def test_info_says_what_a_stack_was_made_for(tmp_path) -> None:
    folder = write_set(tmp_path / "metal")
    given = ("--method", "refine", "--budget", "0.01s", "--sampler", "anisotropic", "--aim", "0", "-v")
    code, said = run("bake", folder, "-o", tmp_path / "out", *given)
    assert code == 0 and "pixel filter gaussian, sampler anisotropic, aim 0, " in said
    place = tmp_path / "out" / "metal"
    assert "pixel filter gaussian, sampler anisotropic, aim 0\n" in run("info", place)[1]
    assert "sampler anisotropic, aim 0" in run("info", place / "normal.exr")[1]
    assert json.loads(run("info", place, "--json")[1])["stack"]["provenance"]["aim"] == 0


@pytest.mark.parametrize(
    ("name", "part"), [("a.ktx2", "not a KTX 2 file"), ("a.png", "cannot read"), ("a.glb", "not a glTF file")]
)
def test_info_on_what_is_none(tmp_path, capsys, name, part) -> None:
    (tmp_path / name).write_text("nothing of the kind")
    assert part in fails(capsys, 3, "info", tmp_path / name)
    assert "expected a file of a stack" in fails(capsys, 3, "info", tmp_path / "missing.ktx2")
    (tmp_path / "stack.json").write_text('{"schema": "mipbake-stack", "schema_version": 2, "outputs": []}')
    assert "does not describe a stack" in fails(capsys, 3, "info", tmp_path)
