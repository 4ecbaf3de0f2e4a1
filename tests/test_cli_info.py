"""What `mipbake info` says of files and folders, GLB files among them, without a look at pixels."""

from __future__ import annotations

import json
import struct
import sys
import tracemalloc

import pytest
import zstandard

from mipbake.cli.main import main
from mipbake.source.images import ktx2 as container
from mipbake.source.images.gpu_format import GPU_FORMATS, GpuTexture
from mipbake.stack.gltf.glb import Encoded
from mipbake.stack.gltf.quad import QuadOptions, standalone

from .command_line import fails, write_set
from .gltf_files import GltfFile, ktx2, png
from .stacks import made_stack


@pytest.fixture(autouse=True)
def _without_decoder(monkeypatch) -> None:
    """Neither levels nor blocks are decoded."""
    monkeypatch.setitem(sys.modules, "alktx2", None)


MAPS = {"baseColorTexture": ktx2(1, True, 16, 8), "normalTexture": ktx2(2)}


def glb() -> bytes:
    return standalone("sample", MAPS, QuadOptions(), {"method": "linear", "version": "0", "wrap": ["wrap", "clamp"]})


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


def test_a_document_of_others(tmp_path, capsys) -> None:
    made = GltfFile()
    made.image(png("a", 8), "a picture")
    made.json["asset"]["extras"] = {"mipbake": {"version": "0", "materials": {"Wood": {"method": "linear"}}}}
    out = shown(capsys, made.write(tmp_path / "a"))
    assert f"image a picture: image/png, {len(png('a', 8))} bytes" in out
    assert "material Wood: method linear" in out


def of_another_kind(place: int, kind: str, value: int) -> bytes:
    """A KTX 2 file of 8 x 8 texels with another number in a field of its header."""
    data = bytearray(ktx2(1))
    struct.pack_into(kind, data, place, value)
    return bytes(data)


COLOUR_MODEL = struct.unpack_from("<I", ktx2(1), 48)[0] + 12


@pytest.mark.parametrize(
    ("data", "texels"),
    [
        (of_another_kind(COLOUR_MODEL, "<B", 163), "ETC1S, linear, 8 x 8, 4 levels"),
        (of_another_kind(COLOUR_MODEL, "<B", 200), "colour model 200, linear, 8 x 8, 4 levels"),
        (of_another_kind(12, "<I", 157), "UASTC (Vulkan format 157), linear, 8 x 8, 4 levels"),
        (of_another_kind(36, "<I", 6), "UASTC_RGB_UNORM_BLOCK, linear, 8 x 8, 4 levels"),
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


@pytest.mark.parametrize("name", ["../secret.exr", "/etc/passwd", "a/b.exr", "..", "", "a\\\\b", 3])
def test_files_elsewhere_are_refused(tmp_path, capsys, name) -> None:
    (tmp_path / "secret.exr").write_bytes(b"secret")
    folder = saved(tmp_path / "s", outputs=[{"format": "exr", "maps": {"a": {"files": [name]}}}])
    assert "expected names of files in its folder" in fails(capsys, 3, "info", folder)


@pytest.mark.parametrize("outputs", [None, [3], [{"maps": []}], [{"files": 3}]])
def test_descriptions_of_no_stack_are_told(tmp_path, capsys, outputs) -> None:
    folder = saved(tmp_path / "s", outputs=outputs)
    assert "does not describe a stack" in fails(capsys, 3, "info", folder)


def test_entries_that_say_little(tmp_path, capsys) -> None:
    assert "0 levels" in shown(capsys, saved(tmp_path / "s", outputs=[{}, {"format": "exr", "maps": {"a": {}}}]))


def test_levels_are_not_inflated(tmp_path, capsys) -> None:
    """A hundred kilobytes of a stream can stand for gigabytes."""
    side, packer = 8192, zstandard.ZstdCompressor()
    made = bytearray(container.encoded(GpuTexture(GPU_FORMATS["R8G8B8A8_UNORM"], 1, 1, (bytes(4),), {}), True))
    struct.pack_into("<2I", made, 20, side, side)
    stream = packer.compress(bytes(4 * side * side))
    struct.pack_into("<3Q", made, 80, len(made), len(stream), 4 * side * side)
    (tmp_path / "a.ktx2").write_bytes(made + stream)
    tracemalloc.start()
    assert "8192 x 8192, 1 level" in shown(capsys, tmp_path / "a.ktx2")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4e6


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


def test_numbers_in_place_of_texts(tmp_path, capsys, exr) -> None:
    (tmp_path / "a.exr").write_bytes(exr.replace(b"mipbake\0string", b"mipbake\0strinx"))
    assert "made by" not in shown(capsys, tmp_path / "a.exr")


def test_broken_png_files_take_one_sentence(tmp_path, capfd) -> None:
    """libpng would print one of its own."""
    (tmp_path / "a.png").write_bytes(png("a", 8).replace(b"IDAT", b"IDA\xff"))
    assert main(["info", str(tmp_path / "a.png")]) == 3
    assert capfd.readouterr().err.count("\n") == 1


def test_descriptions_without_end(tmp_path, capsys) -> None:
    (tmp_path / "stack.json").write_text("[" * 200_000)
    assert "cannot read" in fails(capsys, 3, "info", tmp_path)
    assert "are not mipbake's" in fails(
        capsys, 4, "bake", write_set(tmp_path / "in" / tmp_path.name), "-o", tmp_path.parent
    )
