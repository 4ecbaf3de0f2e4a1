"""`mipbake info` on what `mipbake bake` wrote."""

from __future__ import annotations

import json

import pytest

from mipbake.stack.file_info import file_info

from .command_line import fails, write_set
from .test_cli_bake_documents import bake
from .test_presets import run


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
    given = ("--method", "refine", "--budget", "0.01s", "--sampler", "anisotropic", "--aim", "0")
    code, said = run("bake", folder, "-o", tmp_path / "out", *given)
    assert code == 0 and "pixel filter gaussian, sampler anisotropic, aim 0, " in said
    place = tmp_path / "out" / "metal"
    assert "pixel filter gaussian, sampler anisotropic, aim 0\n" in run("info", place)[1]
    assert "sampler anisotropic, aim 0" in run("info", place / "normal.exr")[1]
    assert json.loads(run("info", place, "--json")[1])["stack"]["provenance"]["aim"] == 0


def test_info_on_a_stack_that_is_a_glb_only(tmp_path) -> None:
    assert bake(write_set(tmp_path / "metal"), "-o", tmp_path / "out", "--format", "glb")[0] == 0
    code, said = run("info", tmp_path / "out" / "metal")
    assert code == 0 and "metal.glb: GLB" in said and "baked by linear" in said


@pytest.mark.parametrize(
    ("name", "part"), [("a.ktx2", "not a KTX 2 file"), ("a.png", "cannot read"), ("a.glb", "not a glTF file")]
)
def test_info_on_what_is_none(tmp_path, capsys, name, part) -> None:
    (tmp_path / name).write_text("nothing of the kind")
    assert part in fails(capsys, 3, "info", tmp_path / name)
    assert "expected a file of a stack" in fails(capsys, 3, "info", tmp_path / "missing.ktx2")
    (tmp_path / "stack.json").write_text('{"schema": "mipbake-stack", "schema_version": 2, "outputs": []}')
    assert "does not describe a stack" in fails(capsys, 3, "info", tmp_path)
