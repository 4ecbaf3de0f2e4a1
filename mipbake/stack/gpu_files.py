"""`ktx2` and `dds`: one file for each map with every level, as graphics cards sample it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.base import disk
from mipbake.base.errors import InputError, OutputError
from mipbake.base.version import __version__
from mipbake.source.images import dds, ktx2
from mipbake.source.images.blocks import StoredLevel, Weigh, levels_of, to_blocks
from mipbake.source.images.file_facts import FileInfo, colour_space, told
from mipbake.source.images.gpu_format import GPU_FORMATS, GpuFormat, GpuTexture
from mipbake.source.images.image_files import ABOUT
from mipbake.source.images.quantise import check_fits, quantised
from mipbake.source.layout import ENCODINGS, LOG, FileLayout
from mipbake.stack.container import Band, Container, Sizes, Texels

_BC = ("BC4_UNORM_BLOCK", "BC5_UNORM_BLOCK", "BC7_UNORM_BLOCK", "BC7_UNORM_BLOCK")
_FORMATS = {
    "rgba8": ("R8G8B8A8_UNORM",) * 4,
    "rgba16f": ("R16G16B16A16_SFLOAT",) * 4,
    "bc": _BC,
    "bc1": (*_BC[:2], "BC1_RGB_UNORM_BLOCK", _BC[3]),
    "uastc": (*("UASTC_RGB_UNORM_BLOCK", "UASTC_RG_UNORM_BLOCK"), *("UASTC_RGB_UNORM_BLOCK", "UASTC_RGBA_UNORM_BLOCK")),
}
"""The format of a file with one, two, three and four channels, by the name that users give."""


_ROUNDS, _SHRUNK, _RADIUS = 12, 0.95, 0.998
"""Of normals whose x and y, as blocks give them back, are no unit vector's: rounds of mending, by what each multiplies
them, and how long they may be."""


def _upright(found: StoredLevel, wanted: NDArray[np.generic]) -> tuple[bool, NDArray[np.generic]]:
    """Whether texels of x and y, from 0 to 1, leave room for a z. Shaders work it out as the root of 1 - x^2 - y^2, and
    not all of them guard it against numbers below 0. And what is wanted, shorter in the blocks that leave none."""
    flat = np.square(2 * np.asarray(found[...], np.float32) - 1).sum(-1) > _RADIUS**2
    if not flat.any():
        return True, wanted
    blocks = np.add.reduceat(np.add.reduceat(flat, range(0, flat.shape[0], 4), 0), range(0, flat.shape[1], 4), 1) > 0
    inside = blocks.repeat(4, 0).repeat(4, 1)[: flat.shape[0], : flat.shape[1], None]
    return False, np.where(inside, 0.5 + np.float32(_SHRUNK) * (np.asarray(wanted, np.float32) - 0.5), wanted)


class GpuFile(Container):
    """A file for each map, which holds one texture with its levels. `choices`: the texels that files of a kind may
    have, the default first.

    Args:
        texels: "bc": BC4, BC5 and BC7 by the number of channels; "bc1": BC1 in place of BC7 where there is no alpha
            channel; "uastc"; "rgba8"; "rgba16f", half floats with colours linear Rec.709. Colours are sRGB-encoded in
            all other formats. One channel fills red, green and blue where a format has more.
    """

    choices: tuple[str, ...]

    def __init__(self, texels: str) -> None:
        self.texels = texels
        stored = GPU_FORMATS[_FORMATS[texels][0]]
        self.exact = stored.side == 1
        self._kind = "half" if stored.is_float else "8"
        if not stored.is_float:
            self.encodings = ENCODINGS - {LOG}

    @abstractmethod
    def encoded(self, texture: GpuTexture) -> bytes:
        """The bytes of a file that holds a texture."""

    @abstractmethod
    def decoded(self, data: bytes, name: str) -> GpuTexture:
        """The texture that the bytes of a file hold; InputError, which calls the file by the name, for none."""

    @property
    def finer(self) -> str:
        """See Container. What blocks lose, 8 bits often lose too: where they cost much, normals have gloss to show."""
        if self.texels == "rgba16f":
            return "exr:float"
        return f"{self.name}:{'bc' if self.texels == 'bc1' else 'rgba16f'}"

    def gpu_bytes(self, layout: FileLayout, sizes: Sizes) -> int:
        """How much of a graphics card's memory a file takes with levels of (height, width)."""
        made = self.gpu_format(layout)
        return sum(made.level_size(width, height) for height, width in sizes)

    def gpu_format(self, layout: FileLayout) -> GpuFormat:
        """What the texels of a file are stored as."""
        name = _FORMATS[self.texels][len(layout.channels) - 1]
        if self.srgb(layout):
            name = name.replace("UNORM", "SRGB")
        return GPU_FORMATS[name]

    def precision(self, layout: FileLayout) -> str:
        """See Container."""
        return self.gpu_format(layout).name

    def srgb(self, layout: FileLayout) -> bool:
        """See Container. Formats of one and two channels have no sRGB form."""
        return layout.is_colour and len(layout.channels) >= 3 and self._kind != "half"

    def quantise(self, values: NDArray[np.float64], layout: FileLayout) -> NDArray[np.generic]:
        """See Container. Texels of blocks are not rounded: the numbers that a block can hold depend on the block."""
        what = f"the map {layout.name}"
        if self.exact:
            return quantised(values, self._kind, what)
        check_fits(values, self._kind, what)
        return np.clip(values, 0, 1).astype(np.float32)

    def write(
        self, folder: Path, layout: FileLayout, levels: Texels, wrap: tuple[str, str], about: str, weigh: Weigh | None
    ) -> None:
        """See Container."""
        del wrap  # neither container has a place for it; `about` tells
        texture = self.texture(layout, levels, about, weigh)
        path = folder / self.files(layout, len(levels))[0]
        path.write_bytes(self.encoded(texture))
        if replace(self._opened(path), values=texture.values) != texture:
            raise OutputError(f"{path} changed while it was written: check the disk")

    def texture(self, layout: FileLayout, levels: Texels, about: str, weigh: Weigh | None = None) -> GpuTexture:
        """The encoded texture of a map, from quantised levels; `weigh`: see Container.write."""
        made = self.gpu_format(layout)
        height, width = levels[0].shape[:2]
        swizzle = {"KTXswizzle": b"rrr1\0"} if len(layout.channels) == 1 else {}
        values = {
            "KTXorientation": b"rd\0",
            "KTXwriter": f"mipbake {__version__}\0".encode(),
            ABOUT: about.encode() + b"\0",
            **(swizzle if made.channels == 1 else {}),
        }
        texture = GpuTexture(made, width, height, to_blocks(levels, made, weigh), values)
        if not self.exact and [channel.map for channel in layout.channels] == ["normal"] * 2:
            for _ in range(_ROUNDS):
                held, levels = zip(*map(_upright, levels_of(texture), levels), strict=True)
                if all(held):
                    break
                texture = replace(texture, levels=to_blocks(levels, made, weigh))
        return texture

    def read(self, folder: Path, layout: FileLayout, sizes: Sizes) -> list[StoredLevel]:
        """See Container: levels are decoded when they are read."""
        path = folder / self.files(layout, len(sizes))[0]
        texture = self._opened(path)
        expected = self.gpu_format(layout)
        found = [size[::-1] for size in texture.sizes]
        if texture.format != expected or found != list(sizes):
            raise InputError(
                f"{path} has {len(found)} levels of {texture.format.name}, the first {texture.width} x "
                f"{texture.height}, expected {len(sizes)} of {expected.name}, the first {sizes[0][1]} x {sizes[0][0]}: "
                "bake it again"
            )
        return levels_of(texture, len(layout.channels))

    def bands(self, folder: Path, layout: FileLayout, sizes: Sizes) -> Iterator[Band]:
        """See Container: of blocks, which have been compared as they are, none."""
        if self.exact:
            return super().bands(folder, layout, sizes)
        self.read(folder, layout, sizes)
        return iter(())

    def _opened(self, path: Path) -> GpuTexture:
        return self.decoded(disk.read_bytes(path), str(path))


class Ktx2File(GpuFile):
    """A KTX 2 file for each map."""

    name = "ktx2"
    summary = "one KTX 2 file for each map, supercompressed with Zstandard"
    choices = ("bc", "uastc", "rgba8", "rgba16f")
    signature = ktx2.IDENTIFIER

    def encoded(self, texture: GpuTexture) -> bytes:
        """See GpuFile."""
        return ktx2.encoded(texture, supercompress=True)

    def decoded(self, data: bytes, name: str) -> GpuTexture:
        """See GpuFile."""
        return ktx2.decoded(data, name)

    def info(self, path: Path) -> FileInfo:
        """See Container: of files of kinds that are not read, what their header tells."""
        data = disk.read_bytes(path)
        if not data.startswith(ktx2.IDENTIFIER):
            raise InputError(f"{path} is not a KTX 2 file: it does not begin like one; bake or download it again")
        outline = ktx2.outline(data, str(path))
        values: dict[str, str] = {}
        if outline.readable:
            ktx2.stored(data, str(path))  # whether it is complete
            values = {key: value.rstrip(b"\0").decode("utf-8", "replace") for key, value in outline.values.items()}
        about, space = told(values.pop(ABOUT, "")), colour_space(outline.srgb)
        return FileInfo(path, "KTX 2", outline.texels, (), outline.levels, space, len(data), about, values)


class DdsFile(GpuFile):
    """A DDS file for each map."""

    name = "dds"
    summary = "one DDS file for each map, with the header of Direct3D 10"
    choices = ("bc", "bc1", "rgba8", "rgba16f")
    signature = dds.MAGIC

    def encoded(self, texture: GpuTexture) -> bytes:
        """See GpuFile."""
        return dds.encoded(texture)

    def decoded(self, data: bytes, name: str) -> GpuTexture:
        """See GpuFile."""
        return dds.decoded(data, name)

    def info(self, path: Path) -> FileInfo:
        """See Container."""
        found = self._opened(path)
        space, size = colour_space(found.format.srgb), path.stat().st_size
        return FileInfo(path, "DDS (Direct3D 10)", found.format.name, (), found.sizes, space, size)
