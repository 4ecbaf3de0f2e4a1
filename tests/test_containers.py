"""Every container and kind of texel: the levels that come back are those that went in, to what texels can hold."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from mipbake.source.layout import FileLayout
from mipbake.stack.containers import DEFAULT_FORMAT, FORMATS, format_named
from mipbake.stack.file_info import file_info
from mipbake.stack.gpu_files import GpuFile
from mipbake.stack.output import Output
from mipbake.stack.packing import SEPARATE
from mipbake.stack.stack import MipStack

from .gpu_textures import halved, openimageio_levels, read_ktx2
from .stacks import made_stack, read_output

NAMES = [f"{name}:{texels}" for name, kinds in FORMATS.items() for texels in kinds]
EXACT = [name for name in NAMES if format_named(name).exact]
GPU = [name for name in NAMES if isinstance(format_named(name), GpuFile)]
READ_BY_OPENIMAGEIO = [name for name in EXACT if not name.startswith("ktx2") and name != "dds:rgba16f"]
SIZES = [(7, 5), (12, 1)]
"""(height, width)."""

every_format = pytest.mark.parametrize("fmt", NAMES)


def srgb(linear: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    linear = linear.astype(float)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def in_file(stack: MipStack, map: str, fmt: str) -> list[np.ndarray]:
    """What a map's texels are in a file of its own, as real numbers: colours sRGB where texels are integers."""
    (levels,) = (levels for layout, levels in stack.maps() if layout.name == map)
    if map == "normal":
        return [(level.astype(float) + 1) / 2 for level in levels]
    integers = fmt.split(":")[1] not in ("half", "float", "rgba16f")
    return [srgb(level) if integers and level.shape[2] == 3 else level.astype(float) for level in levels]


def texels_of(values: np.ndarray, fmt: str) -> np.ndarray:
    """The nearest texels."""
    kind = fmt.split(":")[1]
    if kind in ("half", "rgba16f"):
        return values.astype(np.float16)
    if kind == "float":
        return values.astype(np.float32)
    most = 65535 if kind == "16" else 255
    return np.floor(values * most + 0.5).astype(np.uint16 if kind == "16" else np.uint8)


def texels_in(folder: Path, layout: FileLayout, fmt: str, levels: int) -> list[np.ndarray]:
    """Texels of a map as others read them, from a file for all levels or from one for each."""
    kind = {"half": "half", "float": "float", "16": "uint16", "rgba16f": "half"}.get(fmt.split(":")[1], "uint8")
    files = format_named(fmt).files(layout, levels)
    return [level for name in files for level in openimageio_levels(folder / name, len(layout.channels), kind)]


@every_format
def test_advice_leads_from_every_format_to_the_most_precise(fmt: str) -> None:
    """Each format is advised where the one before costs too much: none twice, and floats are the last."""
    said: list[str] = []
    better: str | None = fmt
    while better is not None:
        container = format_named(better)
        better = container.finer
        said.append(f"{container.name}:{container.texels}")
    assert len(set(said)) == len(said)
    layout = made_stack((1, 1)).files(Output(DEFAULT_FORMAT, SEPARATE))[0].layout
    assert format_named(said[-1]).quantise(np.zeros((1, 1, len(layout.channels))), layout).dtype == np.float32
    exact = [format_named(each).exact for each in said]
    assert exact == sorted(exact)  # blocks are left and never come back


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("fmt", READ_BY_OPENIMAGEIO)
def test_others_read_the_same_texels(tmp_path, fmt: str, size: tuple[int, int]) -> None:
    """Through OpenImageIO, which reads neither KTX 2 nor half floats in DDS."""
    stack = made_stack(size)
    stack.save(tmp_path / "s", format=fmt)
    for layout in (file.layout for file in read_output(tmp_path / "s", 0)):
        wanted = [texels_of(level, fmt) for level in in_file(stack, layout.name, fmt)]
        found = texels_in(tmp_path / "s", layout, fmt, len(wanted))
        assert len(found) == len(wanted)
        for theirs, ours in zip(found, wanted, strict=True):
            np.testing.assert_array_equal(theirs.astype(ours.dtype), ours)


@pytest.mark.parametrize("fmt", [name for name in NAMES if name.startswith(("tx", "exr"))])
def test_attributes_that_renderers_look_for(tmp_path, fmt: str) -> None:
    made_stack((70, 130), wrap=("wrap", "clamp")).save(tmp_path / "s", format=fmt)
    for map in ("base_color", "normal", "roughness"):
        path = str(tmp_path / "s" / f"{map}.{fmt.split(':', maxsplit=1)[0]}")
        spec = OpenImageIO.ImageInput.open(path).spec()
        assert spec.getattribute("textureformat") == "Plain Texture"
        assert spec.getattribute("wrapmodes") == "periodic,clamp"
        assert (spec.tile_width, spec.tile_height) == (64, 64)
        assert str(spec.format) == {"8": "uint8", "16": "uint16"}.get(fmt.split(":")[1], fmt.split(":")[1])
        space = spec.getattribute("oiio:ColorSpace")
        if map == "base_color" and fmt in ("tx:8", "tx:16"):
            assert space.startswith("srgb_rec709")
            assert spec.getattribute("Exif:ColorSpace") == 1
        elif fmt.startswith("tx"):  # TIFF has no place for others
            assert space is None
        elif map == "base_color":
            assert space.startswith("lin_rec709")
        assert spec.getattribute("oiio:miplevels") == len(halved(130, 70))
        assert not OpenImageIO.ImageInput.open(path).seek_subimage(1, 0)  # levels of one image, not several images


@pytest.mark.parametrize("fmt", ["tx:half", "exr:half"])
def test_the_texture_system_samples_our_levels(tmp_path, fmt: str) -> None:
    """Every level has a value of its own; a footprint of 2^L texels finds it."""
    stack = made_stack((64, 64))
    levels = [level.copy() for level in stack.levels]
    for index, level in enumerate(levels):
        level[..., 4] = 0.1 + 0.1 * index
    replace(stack, levels=levels).save(tmp_path / "s", format=fmt)
    system = OpenImageIO.TextureSystem()
    options = OpenImageIO.TextureOpt()
    options.mipmode, options.interpmode = OpenImageIO.MipMode.Trilinear, OpenImageIO.InterpMode.Bilinear
    path = str(tmp_path / "s" / f"roughness.{fmt.split(':', maxsplit=1)[0]}")
    for index in range(6):
        step = 2**index / 64
        (value,) = system.texture(path, options, 0.5, 0.5, step, 0, 0, step, 1)
        assert value == pytest.approx(0.1 + 0.1 * index, abs=2e-3)


@every_format
def test_info_tells_levels_colours_and_how_files_were_made(tmp_path, fmt: str) -> None:
    """The first file of every map tells how it was made, where the container has a place for it: DDS has none."""
    made_stack((8, 16)).save(tmp_path / "s", format=fmt, levels=2)
    for file in read_output(tmp_path / "s", 0):
        found = [file_info(tmp_path / "s" / name) for name in file.container.files(file.layout, len(file.levels))]
        assert [size for each in found for size in each.levels] == [level.shape[1::-1] for level in file.levels]
        assert len(file.levels) == (5 if fmt.startswith("exr") else 2)  # readers of EXR count on all of them
        about = found[0].about
        assert bool(about) == (not fmt.startswith("dds"))
        if about:
            assert (about["set"], about["method"], about["source_hash"], about["wrap"]) == (
                *("sample", "linear", "cd"),
                ["wrap", "clamp"],
            )
        if fmt in GPU:
            srgb = file.layout.name == "base_color" and "16f" not in fmt
            assert found[0].colour_space == ("sRGB" if srgb else "linear") and ("SRGB" in found[0].texels) == srgb


@pytest.mark.parametrize("texels", ["bc", "uastc", "rgba8", "rgba16f"])
def test_key_values_of_ktx2(tmp_path, texels: str) -> None:
    made_stack((8, 8)).save(tmp_path / "s", format=f"ktx2:{texels}")
    for map in ("base_color", "roughness"):
        found = read_ktx2((tmp_path / "s" / f"{map}.ktx2").read_bytes())
        assert found.scheme == 2 and found.keys == sorted(found.keys)
        assert found.values["KTXorientation"] == b"rd\0"
        assert found.values["KTXwriter"].startswith(b"mipbake ") and found.values["KTXwriter"].endswith(b"\0")
        assert json.loads(found.values["mipbake"].rstrip(b"\0"))["set"] == "sample"
        # One channel in the file is shown as grey.
        assert found.values.get("KTXswizzle") == (b"rrr1\0" if texels == "bc" and map == "roughness" else None)


@pytest.mark.parametrize("fmt", GPU)
def test_values_above_one_take_half_floats(tmp_path, fmt: str) -> None:
    stack = made_stack((8, 8))
    bright = replace(stack, extra={"emissive": [level[..., :3] * 7 for level in stack.levels]})
    bright.save(tmp_path / "s", format=fmt)
    (file,) = (f for f in read_output(tmp_path / "s", 0) if f.layout.name == "emissive")
    assert file.container.texels == "rgba16f"
    for level, given in zip(file.levels, bright.extra["emissive"], strict=True):
        np.testing.assert_array_equal(level, given.astype(np.float16).astype(np.float32))
