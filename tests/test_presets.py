"""Presets: what the table says is what lies in the files, as others read them."""

from __future__ import annotations

import io
import json
import re
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import zstandard

import mipbake
from mipbake.base.errors import UsageError
from mipbake.cli.main import main
from mipbake.stack.containers import FORMATS
from mipbake.stack.packing import PACKINGS
from mipbake.stack.presets import PRESETS, preset_named
from mipbake.stack.stack import MipStack

from . import packed_sets
from .gpu_textures import as_dds, basis_levels, dds_header, openimageio_levels, read_ktx2
from .input_files import encoded
from .packed_sets import NORMALS, grey, waves

ENGINES = Path(__file__).resolve().parent.parent / "docs" / "engines"
SIZE = 16

COLOURS = ("base_color 0", "base_color 1", "base_color 2")
EMISSION = ("emissive 0", "emissive 1", "emissive 2")
XYZ = ("normal 0", "normal 1", "normal 2")
XY = XYZ[:2]
ORM = ("occlusion 0", "roughness 0", "metallic 0")
MASK = ("metallic 0", "occlusion 0", "1", "smoothness")
ANISOTROPY = ("anisotropy 0", "anisotropy 1", "anisotropy 2")

VULKAN_SRGB, VULKAN_NONE = 2, 0
VULKAN_BLOCKS = {139: "BC4", 145: "BC7", 146: "BC7 sRGB"}
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
        "wood_normal.ktx2": (XYZ, "BC7"),
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
    report: dict


def run(*arguments: object) -> tuple[int, str]:
    """Exit code and what is printed."""
    said = io.StringIO()
    with redirect_stdout(said):
        code = main([str(each) for each in arguments])
    return code, said.getvalue()


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
    out = tmp_path_factory.mktemp(preset)
    arguments = ("bake", source, "-o", out, "--method", "linear", "--filter", "box", "--preset", preset, "--json")
    code, said = run(*arguments)
    assert code == 0
    texture_set = mipbake.load(source)
    target = "gltf-anisotropic" if preset in ("three", "babylon") else "gltf"
    stack = mipbake.bake(texture_set, "linear", target, "box")
    (result,) = json.loads(said)["results"]
    return Written(out / "wood", stack, result)


def texels(path: Path) -> tuple[list[np.ndarray], str]:
    """Levels as another reader gives them, and what the file says of its texels."""
    if path.suffix == ".ktx2":
        data = path.read_bytes()
        found = read_ktx2(data)
        space = " sRGB" if found.descriptor[14] == VULKAN_SRGB else ""
        if found.vk_format == 0:
            assert found.descriptor[12] == 166  # the colour model of UASTC
            return basis_levels(data, SIZE, SIZE), f"UASTC{space}"
        if found.vk_format in VULKAN_BLOCKS:
            name = VULKAN_BLOCKS[found.vk_format]
            inflated = [zstandard.decompress(data[at : at + length]) for at, length, _ in found.levels]
            twin = path.with_suffix(".dds")
            twin.write_bytes(as_dds(inflated, SIZE, DXGI[name]))
            levels = openimageio_levels(twin, 4)
            twin.unlink()
            return levels, name
        kind = {37: np.uint8, 43: np.uint8, 97: np.float16}[found.vk_format]
        inflated = [zstandard.decompress(data[at : at + length]) for at, length, _ in found.levels]
        sides = [max(1, SIZE >> index) for index in range(len(inflated))]
        levels = [np.frombuffer(d, kind).reshape(s, s, 4) for d, s in zip(inflated, sides, strict=True)]
        return levels, f"{'half' if kind is np.float16 else 'RGBA8'}{space}"
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


@pytest.mark.long
def test_files_and_their_texels(written: Written, preset: str) -> None:
    names = {path.name for path in written.folder.iterdir()} - {"stack.json"}
    levels = re.compile(r"_mip0[1-9]\.png$")
    assert {name for name in names if not levels.search(name)} == set(EXPECTED[preset])
    for name, (_, wanted) in EXPECTED[preset].items():
        kind = texels(written.folder / name)[1]
        finer = [
            re.sub(r"UASTC|BC\d", each, wanted) for each in ("RGBA8", "half") if preset in ("three", "godot", "bevy")
        ]
        assert kind in (wanted, *finer), name


def test_every_channel_of_every_level(written: Written, preset: str) -> None:
    """Waves across or along each other differ by 0.2 in the mean, twice that when one is inverted. At level 0 blocks
    lose a quarter of it, more where a block holds whole waves, whose mean is still right; other texels lose half a step
    of 8 or 16 bits or of a half float.
    """
    blocks = "blocks" if preset in ("three", "babylon", "filament", "unity", "godot", "bevy") else ""
    near = {"dds": 0.002, "tx": 2.5e-4, "exr": 2.5e-4}
    near["png"] = 0.5 / 65535 + 1e-6
    for name, (channels, kind) in EXPECTED[preset].items():
        path = written.folder / name
        found, _ = texels(path)
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
                    assert np.sqrt(np.mean(np.square(error))) < 0.06, (name, what)
                elif level.size >= 16:
                    assert abs(error.mean()) < 0.06, (name, index, what)


def test_green_of_normals(written: Written, preset: str) -> None:
    """The sign of green is tested against the height field that the set was made from."""
    name = next(name for name, (channels, _) in EXPECTED[preset].items() if channels[0] == "normal 0")
    level = texels(written.folder / name)[0][0].astype(float)
    green = level[..., 1] - (0.5 if level.max() <= 1 else 127.5)
    agreement = np.corrcoef(green.ravel(), NORMALS[..., 1].ravel())[0, 1]
    assert agreement < -0.95 if preset in DIRECTX else agreement > 0.95
    told = json.loads((written.folder / "stack.json").read_text())["outputs"][0]
    assert told["normal_convention"] == ("DirectX" if preset in DIRECTX else "OpenGL")


def test_target(written: Written, preset: str) -> None:
    manifest = json.loads((written.folder / "stack.json").read_text())
    anisotropic = preset in ("three", "babylon")
    assert manifest["model"] == ("gltf-anisotropic" if anisotropic else "gltf")
    assert written.report["stack"]["model"] == manifest["model"]
    assert PRESETS[preset].target == ("auto" if anisotropic else "gltf")


def test_the_stack_opens(written: Written) -> None:
    found = mipbake.open_stack(written.folder)
    assert [level.shape for level in found.levels] == [level.shape for level in written.stack.levels]
    assert np.sqrt(np.mean(np.square(found.levels[0] - written.stack.levels[0]))) < 0.1


SIDES = dict.fromkeys(("three", "babylon", "filament", "unity", "bevy"), "multiples of 4")
SIDES |= dict.fromkeys(("unreal", "godot"), "powers of two")


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize(("width", "height"), [(16, 64), (12, 16), (6, 16), (16, 5), (1, 1)])
def test_sizes(name: str, width: int, height: int) -> None:
    sides = SIDES.get(name, "")
    good = {"": True, "multiples of 4": width % 4 + height % 4 == 0}.get(
        sides, {width, height} <= {2**i for i in range(10)}
    )
    said = PRESETS[name].check(width, height)
    assert bool(said) == (not good)
    assert bool(PRESETS[name].check(width, height, blocks=False)) == (not good and sides != "multiples of 4")
    assert not said or (sides in said[0] and f"{width} x {height}" in said[0] and "\n" not in said[0])


def test_the_command_line_says_what_it_chose_and_warns(tmp_path) -> None:
    size = 12
    folder = packed_sets.write(
        tmp_path / "wood",
        wood_base_color=grey(0, size),
        wood_normal_gl=encoded(NORMALS[:size, :size]),
        wood_roughness=grey(1, size),
    )
    code, said = run("bake", folder, "-o", tmp_path / "out", "--method", "linear", "--preset", "unreal")
    assert code == 0
    assert "preset unreal for Unreal Engine: target gltf, dds:rgba8, packing orm, normals directx" in said
    assert "warning: Unreal Engine needs sides that are powers of two, this set is 12 x 12: resize its maps" in said
    assert "in the engine: keep Mip Gen Settings at Leave Existing Mips" in said


@pytest.mark.long
def test_anisotropy_that_an_engine_does_not_read_is_told(source: Path, tmp_path: Path) -> None:
    for preset, wanted in (("unity", True), ("three", False)):
        code, said = run("bake", source, "-o", tmp_path / preset, "--method", "linear", "--preset", preset)
        assert code == 0 and ("note: the target gltf has no anisotropy" in said) == wanted


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


def test_an_unknown_preset_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match=r"unknown preset 'quake': expected one of three, babylon, .*blender"):
        preset_named("quake")


def test_presets_prints_every_row() -> None:
    code, said = run("presets")
    assert code == 0
    rows = {line.split()[0]: line for line in said.splitlines() if line.split() and line.split()[0] in PRESETS}
    assert list(rows) == list(PRESETS)
    for name, row in rows.items():
        each = PRESETS[name]
        formats = ", ".join(output.format for output in each.outputs)
        for cell in (
            each.engine,
            formats,
            each.outputs[0].packing,
            each.sides or "any",
            each.outputs[0].normals.convention,
        ):
            assert cell in row
        assert all(f"in {each.engine}: {note}\n" in said for note in each.notes)
    assert max(map(len, said.splitlines())) <= 120
    code, said = run("presets", "--json")
    assert code == 0 and list(json.loads(said)["presets"]) == list(PRESETS)
    assert json.loads(said)["presets"]["unity"]["outputs"][0]["format"] == "dds:bc"


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
    asked = mipbake.BakeOptions(**options).plan().options  # type: ignore[arg-type]
    assert (None if asked.sampler is None else str(asked.sampler), asked.lod_bias) == (expected, None)


def test_a_method_without_a_sampler_takes_no_bias() -> None:
    for options in ({"preset": "unreal"}, {}):
        with pytest.raises(mipbake.UsageError, match="method linear takes no sampler"):
            mipbake.BakeOptions(**options, method="linear", lod_bias=-1).plan()


def test_formats_and_packings_of_presets_exist() -> None:
    for each in PRESETS.values():
        for output in each.outputs:
            name, _, kind = output.format.partition(":")
            assert kind in FORMATS[name] and output.packing in PACKINGS


def table_of_engines() -> dict[str, list[str]]:
    rows = {}
    for line in (ENGINES / "README.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        link = re.match(r"\[(\w+)\]\((\w+)\.md\)$", cells[0])
        if link:
            assert link[1] == link[2]
            rows[link[1]] = cells[1:]
    return rows


SPOKEN_FILES = {
    "KTX2 UASTC": "ktx2:uastc",
    "KTX2 BC7": "ktx2:bc",
    "DDS RGBA8": "dds:rgba8",
    "DDS BC7": "dds:bc",
    "`.tx` half": "tx:half",
    "EXR half": "exr:half",
    "PNG 16": "png:16",
}
SPOKEN_PACKING = {
    "R occlusion, G roughness, B metallic": "orm",
    "R metallic, G occlusion, B 1, A **smoothness**": "mask-map",
    "one file each": "separate",
}


def test_the_table_of_engines_agrees() -> None:
    rows = table_of_engines()
    assert list(rows) == list(PRESETS)
    for name, (files, colour, normal, packing, sampler, *_) in rows.items():
        each = PRESETS[name]
        assert sampler == str(each.sampler)
        formats = [output.format for output in each.outputs]
        assert [SPOKEN_FILES[part] for part in files.split(", ") if part in SPOKEN_FILES] == formats
        convention, channels = normal.replace("*", "").split(", ")
        first = each.outputs[0]
        assert (convention.lower(), len(channels)) == (first.normals.convention, first.normals.channels)
        assert SPOKEN_PACKING[packing] == first.packing
        assert ("opacity" in colour) == (first.packing != "separate")
        assert ("linear" in colour) == (formats[0].split(":")[1] == "half")


@pytest.mark.parametrize("name", PRESETS)
def test_pages_of_engines_name_the_files(name: str) -> None:
    page = (ENGINES / f"{name}.md").read_text()
    assert f"--preset {name}" in page
    assert f"| sampler | `{PRESETS[name].sampler}`" in page
    for file, (channels, _) in EXPECTED[name].items():
        if channels[0].startswith(("base_color", "normal", "roughness")):
            spoken = file.replace("wood", "SET")
            assert spoken in page or "_mip00" in file, file
    written = page[page.index("## Bake") : page.index("## Import")]
    named = set(re.findall(r"`((?:T_)?SET_\w+\.(?:ktx2|dds|tx|exr|png))`", written))
    assert named <= {file.replace("wood", "SET") for file in EXPECTED[name]}
