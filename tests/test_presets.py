"""Presets: what the table says is what lies in the files, as others read them."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import zstandard

import mipbake
from mipbake.material.aim import SAMPLERS
from mipbake.stack.presets import PRESETS
from mipbake.stack.stack import MipStack

from . import packed_sets
from .command_line import run
from .gpu_textures import as_dds, basis_levels, dds_header, openimageio_levels, read_ktx2
from .input_files import encoded
from .packed_sets import NORMALS, grey, waves

SIZE = 16

COLOURS = ("base_color 0", "base_color 1", "base_color 2")
EMISSION = ("emissive 0", "emissive 1", "emissive 2")
XYZ = ("normal 0", "normal 1", "normal 2")
XY = XYZ[:2]
ORM = ("occlusion 0", "roughness 0", "metallic 0")
MASK = ("metallic 0", "occlusion 0", "1", "smoothness")
ANISOTROPY = ("anisotropy 0", "anisotropy 1", "anisotropy 2")

VULKAN_SRGB = 2
VULKAN_BLOCKS = {139: "BC4", 141: "BC5", 145: "BC7", 146: "BC7 sRGB"}
DXGI = {"RGBA8": 28, "RGBA8 sRGB": 29, "BC4": 80, "BC5": 83, "BC7": 98, "BC7 sRGB": 99}

GLTF_FILES = {
    "wood_baseColor.ktx2": ((*COLOURS, "opacity 0"), "UASTC sRGB"),
    "wood_normal.ktx2": (XYZ, "UASTC"),
    "wood_occlusionRoughnessMetallic.ktx2": (ORM, "UASTC"),
    "wood_emissive.ktx2": (EMISSION, "UASTC sRGB"),
    "wood_height.ktx2": (("height 0",) * 3, "UASTC"),
}
PLAIN_FILES = {
    "wood_base_color": COLOURS,
    "wood_normal": XYZ,
    "wood_roughness": ("roughness 0",),
    "wood_metallic": ("metallic 0",),
    "wood_occlusion": ("occlusion 0",),
    "wood_emissive": EMISSION,
    "wood_height": ("height 0",),
    "wood_opacity": ("opacity 0",),
}
EXPECTED = {
    "three": GLTF_FILES | {"wood_anisotropy.ktx2": (ANISOTROPY, "UASTC")},
    "babylon": GLTF_FILES | {"wood_anisotropy.ktx2": (ANISOTROPY, "UASTC")},
    "filament": GLTF_FILES,
    "unreal": {
        "T_wood_BC.dds": ((*COLOURS, "opacity 0"), "RGBA8 sRGB"),
        "T_wood_N.dds": (XYZ, "RGBA8"),
        "T_wood_ORM.dds": (ORM, "RGBA8"),
        "T_wood_E.dds": (EMISSION, "RGBA8 sRGB"),
        "T_wood_H.dds": (("height 0",) * 3, "RGBA8"),
    },
    "unity": {
        "wood_BaseMap.dds": ((*COLOURS, "opacity 0"), "BC7 sRGB"),
        "wood_Normal.dds": (XY, "BC5"),
        "wood_MaskMap.dds": (MASK, "BC7"),
        "wood_Emission.dds": (EMISSION, "BC7 sRGB"),
        "wood_Height.dds": (("height 0",), "BC4"),
    },
    "godot": {
        "wood_albedo.dds": ((*COLOURS, "opacity 0"), "BC7 sRGB"),
        "wood_normal.dds": (XY, "BC5"),
        "wood_orm.dds": (ORM, "BC7"),
        "wood_emission.dds": (EMISSION, "BC7 sRGB"),
        "wood_height.dds": (("height 0",), "BC4"),
    },
    "bevy": {
        "wood_baseColor.ktx2": ((*COLOURS, "opacity 0"), "BC7 sRGB"),
        "wood_normal.ktx2": (XY, "BC5"),
        "wood_occlusionRoughnessMetallic.ktx2": (ORM, "BC7"),
        "wood_emissive.ktx2": (EMISSION, "BC7 sRGB"),
        "wood_height.ktx2": (("height 0",), "BC4"),
    },
    "arnold": {f"{name}.tx": (channels, "half") for name, channels in PLAIN_FILES.items()},
    "renderman": {
        **{f"{name}.exr": (channels, "half") for name, channels in PLAIN_FILES.items()},
        **{f"{name}_mip00.png": (channels, "uint16") for name, channels in PLAIN_FILES.items()},
    },
    "blender": {f"{name}.exr": (channels, "half") for name, channels in PLAIN_FILES.items()},
}
"""Files of a set that has every map: their channels, and what their texels are."""

DIRECTX = {"unreal"}


@dataclass
class Written:
    folder: Path
    stack: MipStack


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set with every map. Its normals are DirectX's, so that no preset can be right by doing nothing."""
    directions = np.dstack([waves(1), waves(4), waves(2)])
    colours = np.dstack([waves(3), waves(6), waves(9)])
    return packed_sets.write(
        tmp_path_factory.mktemp("source") / "wood",
        wood_base_color=np.dstack([colours, np.maximum(waves(8), 60)]),
        wood_normal_gl=None,
        wood_normal_dx=encoded(NORMALS, directx=True),
        wood_gloss=waves(5),
        wood_metallic=waves(10),
        wood_occlusion=waves(7),
        wood_emissive=colours[::-1],
        wood_height=waves(11),
        wood_anisotropy=directions,
    )


@pytest.fixture(scope="module", params=PRESETS)
def preset(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def written(source: Path, tmp_path_factory: pytest.TempPathFactory, preset: str) -> Written:
    out = tmp_path_factory.mktemp(preset) / "wood"
    target = "gltf-anisotropic" if preset in ("three", "babylon") else "gltf"
    assert PRESETS[preset].target == ("auto" if target != "gltf" else "gltf")
    stack = mipbake.bake(mipbake.load(source), "linear", target, "box")
    stack.save(out, preset=preset)
    return Written(out, stack)


def texels(path: Path) -> tuple[list[np.ndarray], str]:
    """Levels as another reader gives them, and what the file says of its texels."""
    if path.suffix == ".ktx2":
        data = path.read_bytes()
        found = read_ktx2(data)
        space = " sRGB" if found.descriptor[14] == VULKAN_SRGB else ""
        if found.vk_format == 0:
            assert found.descriptor[12] == 166  # the colour model of UASTC
            return basis_levels(data, SIZE, SIZE), f"UASTC{space}"
        name = VULKAN_BLOCKS[found.vk_format]
        inflated = [zstandard.decompress(data[at : at + length]) for at, length, _ in found.levels]
        twin = path.with_suffix(".dds")
        twin.write_bytes(as_dds(inflated, SIZE, DXGI[name]))
        levels = openimageio_levels(twin, 4)
        twin.unlink()
        return levels, name
    if path.suffix == ".dds":
        dxgi = dds_header(path.read_bytes())["dxgi"]
        return openimageio_levels(path, 4), next(name for name, number in DXGI.items() if number == dxgi)
    import OpenImageIO

    kind = str(OpenImageIO.ImageInput.open(str(path)).spec().format)
    return openimageio_levels(path, 4, kind), kind


def expected_channel(stack: MipStack, level: int, what: str, srgb: bool, directx: bool) -> np.ndarray:
    """What a channel of a file should hold, (H, W) from 0 to 1."""
    if what == "1":
        return np.ones(stack.levels[level].shape[:2])
    if what == "smoothness":
        return 1 - expected_channel(stack, level, "roughness 0", False, False)
    name, index = what.split()
    values = next(levels for layout, levels in stack.maps() if layout.name == name)[level][..., int(index)]
    values = values.astype(float)
    if name == "normal" or what in ANISOTROPY[:2]:
        return (1 - values) / 2 if directx and what == XYZ[1] else (values + 1) / 2
    if srgb and name in ("base_color", "emissive"):
        return np.where(values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 1e-9) ** (1 / 2.4) - 0.055)
    return values


def test_every_preset_is_tested() -> None:
    assert set(EXPECTED) == set(PRESETS)


def test_every_channel_of_every_level(written: Written, preset: str) -> None:
    """Waves across or along each other differ by 0.2 in the mean, twice that when one is inverted. At level 0 blocks
    lose half of it at most, more where a block holds whole waves, whose mean is still right; other texels lose half a
    step of 8 or 16 bits or of a half float.
    """
    blocks = "blocks" if preset in ("three", "babylon", "filament", "unity", "godot", "bevy") else ""
    near = {"dds": 0.002, "tx": 2.5e-4, "exr": 2.5e-4}
    near["png"] = 0.5 / 65535 + 1e-6
    for name, (channels, kind) in EXPECTED[preset].items():
        path = written.folder / name
        found, stored = texels(path)
        assert stored == kind, name
        if path.suffix == ".png":
            found += [texels(path.with_name(name.replace("00", f"{i:02}")))[0][0] for i in range(1, 5)]
        assert len(found) == 5
        srgb = "sRGB" in kind or kind == "uint16"
        for index, level in enumerate(found):
            assert level.shape[:2] == (max(1, SIZE >> index),) * 2
            values = level / 255 if level.dtype == np.uint8 else level / 65535 if level.dtype == np.uint16 else level
            for place, what in enumerate(channels):
                wanted = expected_channel(written.stack, index, what, srgb, preset in DIRECTX)
                error = values[..., place].astype(float) - wanted
                if not blocks:
                    assert np.abs(error).max() < near[path.suffix[1:]], (name, index, what)
                elif index == 0:
                    assert np.sqrt(np.mean(np.square(error))) < 0.1, (name, what)
                elif level.size >= 256:
                    assert abs(error.mean()) < 0.1, (name, index, what)


def test_green_of_normals(written: Written, preset: str) -> None:
    """The sign of green is tested against the height field that the set was made from."""
    name = next(name for name, (channels, _) in EXPECTED[preset].items() if channels[0] == "normal 0")
    level = texels(written.folder / name)[0][0].astype(float)
    green = level[..., 1] - (0.5 if level.max() <= 1 else 127.5)
    agreement = np.corrcoef(green.ravel(), NORMALS[..., 1].ravel())[0, 1]
    assert agreement < -0.95 if preset in DIRECTX else agreement > 0.95
    told = json.loads((written.folder / "stack.json").read_text())["outputs"][0]
    names = {path.name for path in written.folder.iterdir() if not re.search("_mip0[1-9]", path.name)}
    assert names == {"stack.json", *EXPECTED[preset]}
    assert told["normal_convention"] == ("DirectX" if preset in DIRECTX else "OpenGL")


def test_the_manifest_says_which_file_holds_a_map(written: Written, preset: str) -> None:
    for output in json.loads((written.folder / "stack.json").read_text())["outputs"]:
        files = {
            name: {"roughness" if channel == "smoothness" else channel.split()[0] for channel in channels} - {"1"}
            for name, (channels, _) in EXPECTED[preset].items()
            if name.endswith(output["format"])
        }
        assert output["map_files"] == {each: name for name, maps in files.items() for each in maps}


def test_the_command_line_says_what_it_chose_and_warns(tmp_path) -> None:
    size = 12
    folder = packed_sets.write(
        tmp_path / "wood",
        wood_base_color=grey(0, size),
        wood_normal_gl=encoded(NORMALS[:size, :size]),
        wood_roughness=grey(1, size),
    )
    arguments = ["bake", folder, "-o", tmp_path / "out", "--method", "linear", "--preset", "Unreal"]
    code, said = run(*arguments, "--verbose")
    assert code == 0
    assert "preset unreal for Unreal Engine: target gltf, dds:rgba8, packing orm, normals directx" in said
    code, said = run(*arguments)
    assert code == 0 and "target gltf" not in said
    assert "warning: Unreal Engine needs sides that are powers of two, this set is 12 x 12: resize its maps" in said
    assert "in Unreal Engine: keep Mip Gen Settings at Leave Existing Mips" in said


def test_options_go_before_a_preset(tmp_path) -> None:
    folder = packed_sets.orm(tmp_path / "wood")
    arguments = ["bake", folder, "-o", tmp_path / "out", "--method", "linear", "--preset", "unity"]
    more = ["--format", "png:16", "--packing", "orm", "--write-normals", "directx", "--target", "gltf-anisotropic"]
    assert run(*arguments, *more)[0] == 0
    manifest = json.loads((tmp_path / "out" / "wood" / "stack.json").read_text())
    (output,) = manifest["outputs"]
    assert (output["format"], output["packing"], output["normal_convention"]) == ("png", "orm", "DirectX")
    assert manifest["model"] == "gltf-anisotropic"
    assert (tmp_path / "out" / "wood" / "wood_BaseMap_mip00.png").exists()  # the names still come from the preset


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, None),
        ({"preset": "unreal"}, "accumulated, anisotropic, bias -0.3"),
        ({"preset": "unreal", "lod_bias": -1.58}, "accumulated, anisotropic, bias -1.58"),
        ({"preset": "babylon"}, "anisotropic 4x"),
        ({"preset": "three"}, "trilinear"),
        ({"preset": "unreal", "sampler": "trilinear"}, "trilinear"),
        ({"preset": "unreal", "method": "linear"}, None),
        ({"lod_bias": -1}, "trilinear, bias -1"),
        ({"sampler": mipbake.Sampler(frames=8), "lod_bias": -1}, "accumulated, bias -1"),
    ],
)
def test_presets_choose_a_sampler_for_methods_that_take_one(options: dict[str, object], expected: str | None) -> None:
    asked = mipbake.BakeOptions(**options).plan().options
    assert (None if asked.sampler is None else str(asked.sampler), asked.lod_bias) == (expected, None)


def test_a_method_without_a_sampler_takes_no_bias() -> None:
    for options in ({"preset": "unreal"}, {}):
        with pytest.raises(mipbake.UsageError, match="method linear takes no sampler"):
            mipbake.BakeOptions(**options, method="linear", lod_bias=-1).plan()


@pytest.mark.parametrize(
    ("name", "size", "blocks", "sides"),
    [
        ("three", (6, 16), True, "multiples of 4"),
        ("three", (6, 16), False, ""),
        ("three", (12, 16), True, ""),
        ("godot", (12, 16), True, "powers of two"),
        ("godot", (16, 64), True, ""),
        ("arnold", (6, 16), True, ""),
    ],
)
def test_sizes_that_an_engine_does_not_take_are_said(name, size, blocks, sides):
    said = PRESETS[name].check(*size, blocks)
    assert len(said) == bool(sides) and all(sides in each and f"{size[0]} x {size[1]}" in each for each in said)


def test_a_stack_for_another_sampler_is_said() -> None:
    """Closed forms are for all of them."""
    for made_for in (*SAMPLERS.values(), None):
        said = PRESETS["unity"].check_sampler(made_for)
        assert len(said) == (made_for not in (None, PRESETS["unity"].sampler))
        assert all("with the sampler anisotropic, this stack was made for" in each for each in said)
