"""The image files that bakes of glTF materials read: extracted, or written where a factor has no other place."""

from __future__ import annotations

import math
import urllib.parse
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.colour import SRGB, decode, unit_range
from mipbake.base.errors import InputError
from mipbake.base.publish import temporary_files, temporary_folder, write_temporary
from mipbake.base.safe_names import unique_name
from mipbake.base.srgb import linear_to_srgb
from mipbake.source.gltf.document import Document
from mipbake.source.gltf.images import content_key, image_bytes, image_label
from mipbake.source.images.image import Header
from mipbake.source.images.oiio_levels import write_png
from mipbake.source.images.read import read_header, read_image

_SUFFIXES = ("png", "jpg", "jpeg", "webp")


class Extracted:
    """Files in a folder, one for each image that is asked for; images of equal bytes are one file.

    Args:
        document: the document that the images belong to.
        folder: an existing one, for these files alone.
    """

    def __init__(self, document: Document, folder: Path) -> None:
        self.document, self.folder = document, folder
        self._files: dict[str, Path] = {}
        self._headers: dict[str, Header] = {}
        self._names: set[str] = set()
        self._keys: dict[int, str] = {}
        self._written: dict[tuple[Any, ...], Path] = {}

    def key(self, image: int) -> str:
        """The key of an image's content; equal for equal bytes."""
        if image not in self._keys:
            self._keys[image] = content_key(self.document, image, "a texture")
        return self._keys[image]

    def file(self, image: int) -> Path:
        """The file of an image, named after the image or its file. What it holds, the material tells."""
        key = self.key(image)
        if key not in self._files:
            data, suffix = image_bytes(self.document, image)
            path = self.folder / f"{unique_name(self._stem(image), f'image_{image}', self._names)}{suffix}"
            write_temporary(path, data)
            self._files[key] = path
        return self._files[key]

    def header(self, image: int) -> Header:
        """The header of an image's file; InputError, which names the document and the image, where any of it is
        damaged."""
        key = self.key(image)
        if key not in self._headers:
            self.pixels(image)
            self._headers[key] = read_header(self.file(image), metadata=False)
        return self._headers[key]

    def pixels(self, image: int) -> NDArray[Any]:
        """Pixels as they are stored; InputError, which names the document and the image, where they are damaged."""
        path = self.file(image)
        try:
            return read_image(path, metadata=False).pixels
        except InputError as error:
            label = image_label(image, self.document.all("images")[image])
            # The extracted file is gone when this is read.
            reason = error.full.replace(str(path), "its data")
            raise InputError(
                f"{self.document.path}: {label} is not a readable image: export it again ({reason})"
            ) from error

    def _stem(self, image: int) -> str:
        """What an image is called: by its name, else by its file."""
        found = self.document.all("images")[image]
        name, uri = found.get("name"), found.get("uri")
        if isinstance(name, str) and name:
            stem, dot, suffix = name.rpartition(".")
            return stem if dot and suffix.lower() in _SUFFIXES else name
        if isinstance(uri, str) and uri[:5].lower() != "data:":
            return PurePosixPath(urllib.parse.unquote(uri).replace("\\", "/")).stem
        return ""

    def is_grey(self, image: int) -> bool:
        """Whether an image has no three channels of colour."""
        header = self.header(image)
        return header.channels - (header.alpha >= 0) < 3

    def check_directions(self, image: int, slot: str) -> None:
        """InputError where an image lacks a channel of the vectors that its slot holds."""
        if self.is_grey(image):
            raise InputError(
                f"{self.document.path}: {image_label(image, self.document.all('images')[image])} is grey, and cannot "
                f"hold the directions of a {slot}: expected red, green and blue, export it again"
            )

    def mean_colour(self, image: int) -> NDArray[np.float64]:
        """(3,) mean of an image's sRGB-encoded colours, linear."""
        pixels = self.pixels(image)
        colours = pixels[..., :3] if pixels.shape[-1] >= 3 else pixels[..., :1]
        linear = decode(np.broadcast_to(colours, (*colours.shape[:2], 3)), SRGB)
        return np.asarray(linear.mean((0, 1), np.float64))

    def colour(self, linear: NDArray[np.float64]) -> Path:
        """A file of one texel with a linear colour (3,) in [0, 1], sRGB-encoded in 16 bits."""
        return self._write(("colour", *np.round(linear, 6)), linear_to_srgb(linear)[None, None])

    def directions(self, image: int | None, strength: float, rotation: float) -> Path:
        """A file of anisotropy directions and strengths with strength and rotation of the material in it, in 16 bits.

        Without an image it is one texel: KHR_materials_anisotropy takes (1, 0.5, 1) where there is no texture.
        """
        stored = np.array([[[1.0, 0.5, 1.0]]]) if image is None else unit_range(self.pixels(image)).astype(np.float64)
        x, y = (stored[..., i] * 2 - 1 for i in (0, 1))
        length = np.maximum(np.hypot(x, y), 1e-6)
        c, s = math.cos(rotation), math.sin(rotation)
        turned = np.stack([(c * x - s * y) / length, (s * x + c * y) / length], -1)
        values = np.concatenate([(turned + 1) / 2, stored[..., 2:3] * strength], -1)
        return self._write(("directions", image, strength, rotation), values)

    def _write(self, key: tuple[Any, ...], values: NDArray[np.float64]) -> Path:
        """(H, W, 3) in [0, 1] to a PNG of 16 bits; one file for one key."""
        if key not in self._written:
            path = self.folder / f"{unique_name(f'made_{len(self._written)}', 'made', self._names)}.png"
            write_temporary(path, png_of(values))
            self._written[key] = path
        return self._written[key]


def png_of(values: NDArray[np.floating]) -> bytes:
    """(H, W, C) in [0, 1] as a PNG of 16 bits, alpha (a fourth channel) not multiplied into the colours."""
    texels = np.floor(np.clip(values, 0, 1) * 65535 + 0.5).astype(np.uint16)
    with temporary_folder() as folder, temporary_files():
        path = folder / "texels.png"
        write_png(path, texels)
        return path.read_bytes()
