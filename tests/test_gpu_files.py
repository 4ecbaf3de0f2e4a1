"""KTX 2 and DDS files: what goes in comes back, Khronos's rules are kept, others read them, broken ones are told."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from mipbake.source.images import dds, ktx2
from mipbake.source.images.blocks import to_blocks
from mipbake.source.images.gpu_format import GPU_FORMATS, GpuFormat, GpuTexture

from .gpu_textures import (
    CHANNELS,
    FORMATS,
    SIZES,
    VALUES,
    basis_levels,
    dds_header,
    decoded_levels,
    halved,
    levels_of,
    line_psnr,
    openimageio_levels,
    psnr,
    read_ktx2,
    smooth_levels,
    texture,
)

VULKAN = {
    **{"R8_UNORM": 9, "R8G8_UNORM": 16, "R8G8B8A8_UNORM": 37, "R8G8B8A8_SRGB": 43, "R16_SFLOAT": 76},
    **{"R16G16_SFLOAT": 83, "R16G16B16A16_SFLOAT": 97, "BC1_RGB_UNORM_BLOCK": 131, "BC1_RGB_SRGB_BLOCK": 132},
    **{"BC4_UNORM_BLOCK": 139, "BC5_UNORM_BLOCK": 141, "BC7_UNORM_BLOCK": 145, "BC7_SRGB_BLOCK": 146},
}
"""VkFormat, from vulkan_core.h. UASTC has none: it is 0 for formats that are transcoded."""

DXGI = {
    **{"R8_UNORM": 61, "R8G8_UNORM": 49, "R8G8B8A8_UNORM": 28, "R8G8B8A8_SRGB": 29, "R16_SFLOAT": 54},
    **{"R16G16_SFLOAT": 34, "R16G16B16A16_SFLOAT": 10, "BC1_RGB_UNORM_BLOCK": 71, "BC1_RGB_SRGB_BLOCK": 72},
    **{"BC4_UNORM_BLOCK": 80, "BC5_UNORM_BLOCK": 83, "BC7_UNORM_BLOCK": 98, "BC7_SRGB_BLOCK": 99},
}
"""DXGI_FORMAT, from dxgiformat.h."""

STORED = [made for made in FORMATS if made.name in DXGI]
EXACT = [made for made in FORMATS if made.side == 1]
PACKED = [made for made in FORMATS if made.side > 1]
UASTC = [made for made in FORMATS if made.name.startswith("UASTC")]
BLOCK_BYTES = {"BC1": 8, "BC4": 8, "BC5": 16, "BC7": 16, "UAS": 16}

formats = pytest.mark.parametrize("made", FORMATS, ids=lambda made: made.name)
sizes = pytest.mark.parametrize(("width", "height"), SIZES)


def level_bytes(made: GpuFormat, width: int, height: int) -> int:
    if made.side == 1:
        return width * height * CHANNELS[made.name] * (2 if "SFLOAT" in made.name else 1)
    return -(-width // 4) * -(-height // 4) * BLOCK_BYTES[made.name[:3]]


def test_every_format_is_tested() -> None:
    assert set(CHANNELS) == set(GPU_FORMATS)
    assert set(VULKAN) == set(DXGI) == {made.name for made in STORED}
    assert {made.name for made in FORMATS} - set(DXGI) == {made.name for made in UASTC}
    for made in FORMATS:
        assert (made.vulkan, made.dxgi) == (VULKAN.get(made.name, 0), DXGI.get(made.name, 0))
        assert made.channels == CHANNELS[made.name] and made.srgb == ("SRGB" in made.name)


@formats
@sizes
def test_files_give_back_what_went_in(made: GpuFormat, width: int, height: int) -> None:
    given = texture(made, width, height)
    assert [len(level) for level in given.levels] == [level_bytes(made, *s) for s in halved(width, height)]
    for supercompress in (False, True):
        assert ktx2.decoded(ktx2.encoded(given, supercompress), "a.ktx2") == given
    if made.name in DXGI:
        found = dds.decoded(dds.encoded(given), "a.dds")
        assert (found.format, found.width, found.height, found.levels) == (made, width, height, given.levels)


@pytest.mark.parametrize("made", EXACT, ids=lambda made: made.name)
@sizes
def test_plain_formats_are_exact(made: GpuFormat, width: int, height: int) -> None:
    for found, given in zip(decoded_levels(texture(made, width, height)), levels_of(made, width, height), strict=True):
        assert found.dtype == given.dtype
        np.testing.assert_array_equal(found, given)


@pytest.mark.parametrize("made", PACKED, ids=lambda made: made.name)
@sizes
def test_blocks_come_as_near_as_the_simplest_encoder_does(made: GpuFormat, width: int, height: int) -> None:
    """BC4 and BC5 have 8 values a channel and block, BC1 4 colours with ends of 5, 6 and 5 bits, the others up to 16.

    The ends that they store are rounded, too; an error of one code everywhere is 48.1 dB.
    """
    for found, given in zip(decoded_levels(texture(made, width, height)), levels_of(made, width, height), strict=True):
        assert found.shape == given.shape and found.dtype == np.float32
        parts = [given[..., i : i + 1] for i in range(given.shape[2])] if made.name[:3] in ("BC4", "BC5") else [given]
        steps, bits = {"BC4": (8, (8,)), "BC5": (8, (8,)), "BC1": (4, (5, 6, 5))}.get(made.name[:3], (16, (7,) * 4))
        least = min(*(line_psnr(part, steps, bits) for part in parts), 49) - 1
        assert psnr(found, given) > least, (given.shape, least)


@formats
@pytest.mark.parametrize("supercompress", [False, True])
@sizes
def test_khronos_rules_of_the_header(made: GpuFormat, supercompress: bool, width: int, height: int) -> None:
    data = ktx2.encoded(texture(made, width, height), supercompress)
    found = read_ktx2(data)
    assert data[:12] == b"\xabKTX 20\xbb\r\n\x1a\n"
    assert found.vk_format == VULKAN.get(made.name, 0)
    assert (found.vk_format == 0) == (made in UASTC)
    assert found.type_size == (2 if "SFLOAT" in made.name else 1)
    assert (found.size, found.layers, found.faces) == ((width, height, 0), 0, 1)
    assert found.scheme == (2 if supercompress else 0)
    # What follows the header lies without gaps: index of levels, descriptor, key-value data.
    assert found.ends["descriptor"][0] == found.ends["index"][1]
    assert found.ends["values"][0] == found.ends["descriptor"][1]
    assert all(begin % 4 == 0 for begin, _ in found.ends.values())
    assert found.keys == sorted(VALUES) and found.values == VALUES


@formats
@pytest.mark.parametrize("supercompress", [False, True])
@sizes
def test_khronos_rules_of_levels(made: GpuFormat, supercompress: bool, width: int, height: int) -> None:
    """Coarsest first in the file, aligned to lcm(4, bytes of a block) with zeros between, except for streams."""
    given = texture(made, width, height)
    data = ktx2.encoded(given, supercompress)
    found = read_ktx2(data)
    assert len(found.levels) == len(halved(width, height))
    block = level_bytes(made, 1, 1)
    alignment = 1 if supercompress else math.lcm(block, 4)
    place = found.ends["values"][1]
    for (at, length, inflated), size in zip(found.levels[::-1], halved(width, height)[::-1], strict=True):
        assert at % alignment == 0 and 0 <= at - place < alignment
        assert not any(data[place:at])
        assert inflated == level_bytes(made, *size)
        if not supercompress:
            assert length == inflated
        place = at + length
    assert place == len(data)
    if supercompress:
        import zstandard

        for (at, length, inflated), level in zip(found.levels, given.levels, strict=True):
            stream = data[at : at + length]
            assert zstandard.get_frame_parameters(stream).content_size == inflated
            assert zstandard.ZstdDecompressor().decompress(stream) == level


@formats
@pytest.mark.parametrize("supercompress", [False, True])
def test_khronos_rules_of_the_descriptor(made: GpuFormat, supercompress: bool) -> None:
    """One basic block of Khronos Data Format 1.3, section 5.

    Supercompression changes nothing in it, bytesPlane0 neither, which early editions wanted to be 0.
    KHR_texture_basisu wants linear UASTC to have no colour primaries.
    """
    full = 0xFFFFFFFF
    model = {"BC1": 128, "BC4": 131, "BC5": 132, "BC7": 134, "UAS": 166}.get(made.name[:3], 1)
    block = level_bytes(made, 1, 1)
    if "SFLOAT" in made.name:
        samples = [(16 * i, 15, (0, 1, 2, 15)[i] | 0xC0, 0xBF800000, 0x3F800000) for i in range(CHANNELS[made.name])]
    elif made.side == 1:
        channels = (0, 1, 2, 15 | 0x10 if made.srgb else 15)  # the alpha of sRGB is linear
        samples = [(8 * i, 7, channels[i], 0, 255) for i in range(CHANNELS[made.name])]
    elif made in UASTC:
        samples = [(0, 127, {2: 6, 3: 0, 4: 3}[CHANNELS[made.name]], 0, full)]
    elif made.name.startswith("BC5"):
        samples = [(0, 63, 0, 0, full), (64, 63, 1, 0, full)]
    else:
        samples = [(0, 8 * block - 1, 0, 0, full)]
    side = 3 if made.side > 1 else 0
    expected = struct.pack("<IIHH", 4 + 24 + 16 * len(samples), 0, 2, 24 + 16 * len(samples))
    expected += bytes([model, 0 if made in UASTC and not made.srgb else 1, 2 if made.srgb else 1, 0])
    expected += bytes([side, side, 0, 0, block, 0, 0, 0, 0, 0, 0, 0])
    for offset, length, channel, lower, upper in samples:
        expected += struct.pack("<HBB4B2I", offset, length, channel, 0, 0, 0, 0, lower, upper)
    assert read_ktx2(ktx2.encoded(texture(made, 12, 5), supercompress)).descriptor == expected


@pytest.mark.parametrize("made", STORED, ids=lambda made: made.name)
@sizes
def test_header_of_dds(made: GpuFormat, width: int, height: int) -> None:
    data = dds.encoded(texture(made, width, height))
    found = dds_header(data)
    several = len(halved(width, height)) > 1
    compressed = made.side > 1
    assert (found["size"], found["format size"], found["format flags"]) == (124, 32, 4)
    assert (found["width"], found["height"], found["levels"]) == (width, height, len(halved(width, height)))
    assert found["flags"] == (0x1 | 0x2 | 0x4 | 0x1000 | 0x20000 | (0x80000 if compressed else 0x8))
    assert found["pitch"] == level_bytes(made, width, height if compressed else 1)
    assert found["caps"] == 0x1000 | (0x400008 if several else 0) and found["caps2"] == 0
    assert (found["dxgi"], found["dimension"], found["array"]) == (DXGI[made.name], 3, 1)
    assert len(data) == 148 + sum(level_bytes(made, *size) for size in halved(width, height))


READ_BY_OPENIMAGEIO = [made for made in STORED if made.name.startswith(("R8G8B8A8", "BC"))]


@pytest.mark.parametrize("made", READ_BY_OPENIMAGEIO, ids=lambda made: made.name)
@sizes
def test_openimageio_reads_every_level_of_dds(tmp_path, made: GpuFormat, width: int, height: int) -> None:
    given = texture(made, width, height)
    path = tmp_path / "a.dds"
    path.write_bytes(dds.encoded(given))
    found = openimageio_levels(path, CHANNELS[made.name])
    for theirs, ours in zip(found, decoded_levels(given), strict=True):
        if not made.name.startswith("BC7"):  # theirs rounds between ends in its own way
            assert np.abs(theirs - ours.astype(float)).max() <= 2
        else:
            np.testing.assert_array_equal(theirs, np.rint(ours))


@pytest.mark.parametrize("made", UASTC, ids=lambda made: made.name)
@pytest.mark.parametrize("supercompress", [False, True])
def test_basis_universal_reads_every_level_of_uastc(made: GpuFormat, supercompress: bool) -> None:
    alktx2 = pytest.importorskip("alktx2")
    for width, height in ((8, 8), (12, 5), (1, 9)):
        given = texture(made, width, height)
        data = ktx2.encoded(given, supercompress)
        found = alktx2.inspect_ktx2(data)
        assert (found["width"], found["height"], found["levels"]) == (width, height, len(given.levels))
        assert found["is_uastc"] and found["is_srgb"] == made.srgb
        assert found["has_alpha"] == (CHANNELS[made.name] == 4)
        count = CHANNELS[made.name]
        for level, wanted in zip(basis_levels(data, width, height), levels_of(made, width, height), strict=True):
            assert psnr(level[..., :count], wanted) > min(line_psnr(wanted, 16, (7,) * 4), 49) - 1


@pytest.mark.parametrize("name", [name for name, count in CHANNELS.items() if count >= 3])
def test_one_channel_fills_all_colours(name: str) -> None:
    made = GPU_FORMATS[name]
    half = "SFLOAT" in name
    levels = smooth_levels(1, 8, 8, half)
    found = decoded_levels(GpuTexture(made, 8, 8, to_blocks(levels, made), {}))
    for level, wanted in zip(found, levels, strict=True):
        assert level.shape[2] == CHANNELS[name]
        if made.side == 1:
            np.testing.assert_array_equal(level[..., :3], np.repeat(wanted, 3, -1))
            assert (level[..., 3] == (1 if half else 255)).all()
        else:
            grey = np.repeat(wanted, 3, -1)
            steps, bits = (4, (5, 6, 5)) if name.startswith("BC1") else (16, (7, 7, 7))
            assert psnr(level[..., :3], grey) > min(line_psnr(grey, steps, bits), 49) - 1
            if name != "BC7_UNORM_BLOCK":  # nobody asks what the alpha of data is
                assert (level[..., 3:] == 255).all()
