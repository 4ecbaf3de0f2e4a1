"""Texels for the tests of what graphics cards sample, and readings of their files that take nothing from mipbake."""

from __future__ import annotations

import math
import struct
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mipbake.source.images.blocks import from_blocks, to_blocks
from mipbake.source.images.gpu_format import GPU_FORMATS, GpuFormat, GpuTexture

SIZES = [(8, 8), (12, 5), (1, 9), (7, 1), (1, 1), (33, 18)]
"""(width, height): whole blocks, odd, lines of texels, one texel, more than one tile of blocks."""

FORMATS = list(GPU_FORMATS.values())
CHANNELS = {
    **{name: 1 for name in ("R8_UNORM", "R16_SFLOAT", "BC4_UNORM_BLOCK")},
    **{name: 2 for name in ("R8G8_UNORM", "R16G16_SFLOAT", "BC5_UNORM_BLOCK", "UASTC_RG_UNORM_BLOCK")},
    **{name: 3 for name in GPU_FORMATS if name.startswith(("BC1", "UASTC_RGB_"))},
    **{name: 4 for name in GPU_FORMATS if name.startswith(("R8G8B8A8", "R16G16B16A16", "BC7", "UASTC_RGBA"))},
}
"""Format to how many channels its texels have."""

VALUES = {"KTXwriter": b"mipbake 1\0", "KTXorientation": b"rd\0", "mipbake": b'{"set": "a"}\0'}


def halved(width: int, height: int) -> list[tuple[int, int]]:
    """(width, height) of every level: each half of the one before, rounded down, no less than 1."""
    sizes = [(width, height)]
    while sizes[-1] != (1, 1):
        width, height = (max(1, side // 2) for side in sizes[-1])
        sizes.append((width, height))
    return sizes


def smooth_levels(channels: int, width: int, height: int, half: bool = False, seed: int = 0) -> list[np.ndarray]:
    """(H, W, channels) texels in slow waves with 1 % noise; `half`: float16 from -1 to 3 in place of 8 bits."""
    rng = np.random.default_rng([seed, width, height])
    out = []
    for columns, rows in halved(width, height):
        y, x = np.mgrid[0:rows, 0:columns]
        waves = np.stack([np.sin(x / 9 + i) * np.cos(y / 7 - i) for i in range(channels)], -1)
        values = np.clip(0.5 + 0.4 * waves + rng.normal(0, 0.01, waves.shape), 0, 1)
        out.append((values * 4 - 1).astype(np.float16) if half else np.floor(values * 255 + 0.5).astype(np.uint8))
    return out


def levels_of(made: GpuFormat, width: int, height: int) -> list[np.ndarray]:
    """Levels with as many channels as a format has."""
    return smooth_levels(CHANNELS[made.name], width, height, "SFLOAT" in made.name)


@cache
def texture(made: GpuFormat, width: int, height: int) -> GpuTexture:
    return GpuTexture(made, width, height, to_blocks(levels_of(made, width, height), made), VALUES)


def decoded_levels(texture: GpuTexture) -> list[np.ndarray]:
    """`from_blocks`, numbers from 0 to 255 where they are from 0 to 1."""
    return [level * 255 if level.dtype == np.float32 else level for level in from_blocks(texture)]


def psnr(found: np.ndarray, wanted: np.ndarray, peak: float = 255) -> float:
    """Peak signal-to-noise ratio in dB."""
    error = np.mean(np.square(found.astype(float) - wanted.astype(float)))
    return math.inf if error == 0 else float(10 * np.log10(peak**2 / error))


@dataclass
class Ktx2:
    """Fields of a KTX 2 file at the places that section 3 of its specification gives them."""

    vk_format: int
    type_size: int
    size: tuple[int, int, int]
    layers: int
    faces: int
    scheme: int
    descriptor: bytes
    values: dict[str, bytes]
    keys: list[str]
    levels: list[tuple[int, int, int]]
    """Offset, length, inflated length; finest first."""
    ends: dict[str, tuple[int, int]]
    """Begin and end of index, descriptor and values."""


def read_ktx2(data: bytes) -> Ktx2:
    """Reads the structure, and asserts that entries of the key-value data are padded with zeros to 4 bytes."""
    vk, unit, width, height, depth, layers, faces, count, scheme = struct.unpack_from("<9I", data, 12)
    at, length, values_at, values_length, global_at, global_length = struct.unpack_from("<4I2Q", data, 48)
    assert (global_at, global_length) == (0, 0)
    values, keys, place = {}, [], values_at
    while place < values_at + values_length:
        (size,) = struct.unpack_from("<I", data, place)
        key, end, value = data[place + 4 : place + 4 + size].partition(b"\0")
        assert end
        keys.append(key.decode())
        values[keys[-1]] = value
        padding = data[place + 4 + size : place + 4 + size + -size % 4]
        assert padding == bytes(len(padding))
        place += 4 + size + -size % 4
    assert place == values_at + values_length
    table = [struct.unpack_from("<3Q", data, 80 + 24 * index) for index in range(max(1, count))]
    ends = {"index": (80, 80 + 24 * max(1, count)), "descriptor": (at, at + length), "values": (values_at, place)}
    descriptor = data[at : at + length]
    return Ktx2(vk, unit, (width, height, depth), layers, faces, scheme, descriptor, values, keys, table, ends)


def dds_header(data: bytes) -> dict[str, int]:
    """Fields of DDS_HEADER and DDS_HEADER_DXT10 at the places that Microsoft's reference gives them."""
    assert data[:4] == b"DDS " and data[84:88] == b"DX10"
    places = {"size": 4, "flags": 8, "height": 12, "width": 16, "pitch": 20, "depth": 24, "levels": 28}
    places |= {"format size": 76, "format flags": 80, "caps": 108, "caps2": 112}
    places |= {"dxgi": 128, "dimension": 132, "misc": 136, "array": 140, "misc2": 144}
    return {name: struct.unpack_from("<I", data, at)[0] for name, at in places.items()}


def as_dds(levels: Sequence[bytes], side: int, dxgi: int) -> bytes:
    """A DDS file of square levels of blocks, for readers that know no KTX 2; fields after Microsoft's reference."""
    flags, caps = 0x1 | 0x2 | 0x4 | 0x1000 | 0x20000 | 0x80000, 0x8 | 0x1000 | 0x400000
    head = [124, flags, side, side, len(levels[0]), 0, len(levels), *[0] * 11]
    head += [32, 4, int.from_bytes(b"DX10", "little"), 0, 0, 0, 0, 0, caps, 0, 0, 0, 0]
    return b"DDS " + struct.pack("<36I", *head, dxgi, 3, 0, 1, 0) + b"".join(levels)


def openimageio_levels(path: Any, channels: int, kind: str = "uint8") -> list[np.ndarray]:
    """Every level of a file as OpenImageIO reads it, colours as they are stored, whatever alpha is."""
    import OpenImageIO

    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = OpenImageIO.ImageInput.open(str(path), config)
    assert source is not None, OpenImageIO.geterror()
    levels = []
    while source.seek_subimage(0, len(levels)) and source.spec().width:
        spec = source.spec()
        pixels = np.asarray(source.read_image(0, len(levels), 0, spec.nchannels, kind))
        levels.append(pixels.reshape(spec.height, spec.width, spec.nchannels)[..., :channels])
    source.close()
    return levels


def basis_levels(data: bytes, width: int, height: int) -> list[np.ndarray]:
    """Every level of a file of UASTC as Basis Universal decodes it, (H, W, 3 or 4)."""
    import alktx2

    levels = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "level.png"
        for index, (columns, rows) in enumerate(halved(width, height)):
            path.write_bytes(alktx2.decode_ktx2_to_bytes(data, format="png", level=index)[0])
            levels.append(openimageio_levels(path, 4)[0][:rows, :columns])  # whole blocks come back
    return levels


def line_psnr(level: np.ndarray, steps: int, bits: Sequence[int] = (8, 8, 8, 8)) -> float:
    """PSNR that the simplest encoder reaches: in every block of 4 x 4 texels, so many equal steps between the two ends
    of the principal axis of its colours. `bits`: that the ends have in each channel.
    """
    height, width, channels = level.shape
    padded = np.pad(level.astype(float), ((0, -height % 4), (0, -width % 4), (0, 0)), mode="edge")
    rows, columns = padded.shape[0] // 4, padded.shape[1] // 4
    blocks = padded.reshape(rows, 4, columns, 4, channels).swapaxes(1, 2).reshape(-1, 16, channels)
    most = 2.0 ** np.array(bits[:channels]) - 1
    found = np.empty_like(blocks)
    for index, block in enumerate(blocks):
        axis = np.linalg.svd(block - block.mean(0))[2][0]
        along = (block - block.mean(0)) @ axis
        low, high = (block.mean(0) + axis * end for end in (along.min(), along.max()))
        low, high = (np.rint(np.clip(end, 0, 255) / 255 * most) / most * 255 for end in (low, high))
        span = max(along.max() - along.min(), 1e-9)
        share = np.rint((along - along.min()) / span * (steps - 1)) / (steps - 1)
        found[index] = np.rint(low + share[:, None] * (high - low))
    image = found.reshape(rows, columns, 4, 4, channels).swapaxes(1, 2).reshape(padded.shape)
    return psnr(image[:height, :width], level)
