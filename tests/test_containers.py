"""Every container and kind of texel: the levels that come back are those that went in, to what texels can hold."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from mipbake.base.errors import InputError
from mipbake.source.layout import FileLayout
from mipbake.stack.containers import DEFAULT_FORMAT, FORMATS, format_named
from mipbake.stack.file_info import file_info
from mipbake.stack.gpu_files import GpuFile
from mipbake.stack.manifest import read_output
from mipbake.stack.output import Output
from mipbake.stack.packing import SEPARATE
from mipbake.stack.saving import open_stack
from mipbake.stack.stack import MipStack

from .gpu_textures import halved, openimageio_levels, read_ktx2
from .stacks import made_stack

NAMES = [f"{name}:{texels}" for name, kinds in FORMATS.items() for texels in kinds]
EXACT = [name for name in NAMES if format_named(name).exact]
GPU = [name for name in NAMES if isinstance(format_named(name), GpuFile)]
SIZES = [(8, 8), (7, 5), (1, 9), (12, 1), (1, 1)]
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


@pytest.mark.long
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("fmt", EXACT)
def test_exact_texels_come_back_bit_for_bit(tmp_path, fmt: str, size: tuple[int, int]) -> None:
    """What comes back is what the texels say, and they are the nearest that there are."""
    stack = made_stack(size)
    stack.save(tmp_path / "s", format=fmt)
    found = {file.layout.name: file for file in read_output(tmp_path / "s", 0)}
    assert set(found) == {layout.name for layout, _ in stack.maps()}
    sizes = [(height, width) for width, height in halved(size[1], size[0])]
    for name, file in found.items():
        wanted = in_file(stack, name, fmt)
        assert [level.shape[:2] for level in file.levels] == [level.shape[:2] for level in wanted]
        assert name == "occlusion" or [level.shape[:2] for level in wanted] == sizes
        for back, level in zip(file.levels, wanted, strict=True):
            texels = texels_of(level, fmt)
            np.testing.assert_array_equal(
                file.container.quantise(_values(back, name, fmt), file.layout), texels, err_msg=f"{name} {level.shape}"
            )


def _values(level: np.ndarray, name: str, fmt: str) -> np.ndarray:
    """File values of what was read."""
    if name == "normal":
        return (level.astype(float) + 1) / 2
    return srgb(level) if level.shape[2] == 3 and fmt.split(":")[1] in ("8", "16", "rgba8") else level.astype(float)


@pytest.mark.long
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("fmt", [name for name in EXACT if format_named(name).openimageio])
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


@every_format
def test_a_stack_opens_again(tmp_path, fmt: str) -> None:
    stack = made_stack((8, 12))
    stack.save(tmp_path / "s", format=fmt)
    found = open_stack(tmp_path / "s")
    assert (found.name, found.model, found.wrap) == (stack.name, stack.model, stack.wrap)
    assert (found.provenance, list(found.extra)) == (stack.provenance, list(stack.extra))
    assert [level.shape for level in found.levels] == [level.shape for level in stack.levels]
    for level, given in zip(found.levels, stack.levels, strict=True):
        assert np.abs(level - given).mean() < 0.02


@every_format
def test_colours_are_not_multiplied_by_alpha(tmp_path, fmt: str) -> None:
    """Base colours with opacity in the fourth channel, 0, 51/255 or 1: colours stay what they are."""
    stack = made_stack((8, 8))
    opacity = [np.zeros((*level.shape[:2], 1), np.float32) for level in stack.levels]
    for level in opacity:
        level[:, : level.shape[1] // 2] = 1
        level[: level.shape[0] // 4] = 0.2
    stack = replace(stack, extra={"opacity": opacity})
    stack.save(tmp_path / "s", [Output(fmt, "orm")])
    (file,) = (file for file in read_output(tmp_path / "s", 0) if file.layout.name == "base_color")
    assert file.levels[0].shape == (8, 8, 4)
    near = 0.005 if file.container.exact else 0.12
    for index, level in enumerate(file.levels):
        assert np.abs(srgb(level[..., :3]) - srgb(stack.levels[index][..., :3])).max() < near
        assert np.abs(level[..., 3:] - opacity[index]).max() <= (near / 4 if near > 0.1 else 1e-4)
    if file.container.exact and file.container.openimageio:
        (theirs, *_) = texels_in(tmp_path / "s", file.layout, fmt, len(stack.levels))
        np.testing.assert_array_equal(theirs[..., :3], texels_of(in_file(stack, "base_color", fmt)[0], fmt))


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
def test_info_knows_the_levels_of_every_container(tmp_path, fmt: str) -> None:
    stack = made_stack((4, 8))
    stack.save(tmp_path / "s", format=fmt)
    for file in read_output(tmp_path / "s", 0):
        names = file.container.files(file.layout, len(file.levels))
        found = [size for name in names for size in file_info(tmp_path / "s" / name).levels]
        assert found == [(level.shape[1], level.shape[0]) for level in file.levels]


@every_format
def test_every_container_says_how_it_was_made(tmp_path, fmt: str) -> None:
    """The first file of every map does, where the container has a place for it: DDS has none."""
    stack = made_stack((4, 8))
    files = stack.save(tmp_path / "s", format=fmt)
    maps = read_output(tmp_path / "s", 0)
    first = {file.container.files(file.layout, len(file.levels))[0] for file in maps}
    told = {"set": "sample", "model": "gltf", "method": "linear", "pixel_filter": "gaussian", "version": "0"}
    assert format_named(fmt).tells or fmt.startswith("dds")
    for path in files[1:]:
        about = file_info(path).about
        wanted = told if format_named(fmt).tells and path.name in first else {}
        assert {key: about[key] for key in wanted} == wanted
        assert bool(about) == bool(wanted)
        if wanted:
            assert about["wrap"] == ["wrap", "clamp"] and about["source_hash"] == "cd"


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
def test_colours_are_marked_srgb_and_data_are_not(tmp_path, fmt: str) -> None:
    made_stack((8, 8)).save(tmp_path / "s", format=fmt)
    for map in ("base_color", "normal", "roughness", "occlusion"):
        found = file_info(tmp_path / "s" / f"{map}.{fmt.split(':', maxsplit=1)[0]}")
        assert found.colour_space == ("sRGB" if map == "base_color" and "16f" not in fmt else "linear")
        assert ("SRGB" in found.texels) == (found.colour_space == "sRGB")


@pytest.mark.parametrize("fmt", GPU)
def test_values_above_one_take_half_floats(tmp_path, fmt: str) -> None:
    stack = made_stack((8, 8))
    bright = replace(stack, extra={"emissive": [level[..., :3] * 7 for level in stack.levels]})
    bright.save(tmp_path / "s", format=fmt)
    (file,) = (f for f in read_output(tmp_path / "s", 0) if f.layout.name == "emissive")
    assert file.container.texels == "rgba16f"
    for level, given in zip(file.levels, bright.extra["emissive"], strict=True):
        np.testing.assert_array_equal(level, given.astype(np.float16).astype(np.float32))


@every_format
def test_fewer_levels(tmp_path, fmt: str) -> None:
    """EXR files hold every level down to 1 x 1, whatever is asked for; readers count on it."""
    complete = format_named(fmt).complete
    assert complete or not fmt.startswith("exr")
    made_stack((8, 16)).save(tmp_path / "s", format=fmt, levels=2)
    for file in read_output(tmp_path / "s", 0):
        assert len(file.levels) == (5 if complete else 2)
    assert len(open_stack(tmp_path / "s").levels) == (5 if complete else 2)


@every_format
def test_files_of_another_stack_are_told(tmp_path, fmt: str) -> None:
    """Files that are whole, and not those that stack.json describes: of another size, with other channels."""
    made_stack((8, 8)).save(tmp_path / "s", format=fmt)
    made_stack((8, 16)).save(tmp_path / "other", format=fmt)
    (file,) = (file for file in read_output(tmp_path / "s", 0) if file.layout.name == "normal")
    suffix = file.container.files(file.layout, len(file.levels))[0].removeprefix("normal")
    target, other = (tmp_path / name / f"normal{suffix}" for name in ("s", "other"))
    whole = target.read_bytes()
    wrong = [other]
    if "rgba" not in fmt and "uastc" not in fmt:  # where every file has as many channels
        wrong.append(target.with_name(f"roughness{suffix}"))
    for source in wrong:
        target.write_bytes(source.read_bytes())
        with pytest.raises(InputError, match=rf"normal{suffix}.*bake"):
            open_stack(tmp_path / "s")
    target.write_bytes(whole)
    open_stack(tmp_path / "s")


def test_files_are_named_after_their_maps(tmp_path) -> None:
    stack = made_stack((4, 4))
    for fmt in NAMES:
        container = format_named(fmt)
        layout = stack.files(Output(fmt, SEPARATE))[0].layout
        assert layout.name == "base_color"
        wanted = {"png": [f"base_color_mip{i:02}.png" for i in range(3)]}.get(container.name)
        assert container.files(layout, 3) == (wanted or [f"base_color.{container.name}"])
