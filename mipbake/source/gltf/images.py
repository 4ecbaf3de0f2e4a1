"""The images of a glTF document: their bytes, wherever they lie, what kind of file those are, and what they show."""

from __future__ import annotations

import hashlib
import math
import urllib.parse
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.colour import SRGB, decode, unit_range
from mipbake.base.errors import InputError
from mipbake.base.publish import temporary_files, temporary_folder, write_temporary
from mipbake.base.safe_names import unique_name
from mipbake.base.srgb import linear_to_srgb
from mipbake.source.gltf import uris
from mipbake.source.gltf.document import Document, Json, extensions_in, view_bytes
from mipbake.source.images.image import Header, Image
from mipbake.source.images.oiio_levels import write_png
from mipbake.source.images.read import read_image

BASISU = "KHR_texture_basisu"

SOURCE_EXTENSIONS = (BASISU, "EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds")
"""Extensions of a texture that name another image than its `source`."""

_SUFFIXES = ("png", "jpg", "jpeg", "webp")


@dataclass(frozen=True)
class ImageKind:
    """A kind of image file: its media type, the suffix of its files, and bytes in their beginning."""

    mime: str
    suffix: str
    starts: tuple[bytes, ...]
    at: int = 0

    def is_of(self, data: bytes) -> bool:
        """Whether a file is of this kind."""
        return data.startswith(self.starts, self.at)


PNG = ImageKind("image/png", ".png", (b"\x89PNG\r\n\x1a\n",))
KTX2 = ImageKind("image/ktx2", ".ktx2", (b"\xabKTX 20\xbb\r\n\x1a\n",))
_KINDS = (
    PNG,
    ImageKind("image/jpeg", ".jpg", (b"\xff\xd8\xff",)),
    KTX2,
    ImageKind("image/vnd-ms.dds", ".dds", (b"DDS ",)),
    ImageKind("image/webp", ".webp", (b"WEBP",), 8),
    ImageKind("image/avif", ".avif", (b"ftypavif", b"ftypavis"), 4),
)


def stored_image(document: Document, index: object, where: str = "a texture") -> tuple[bytes, ImageKind]:
    """The bytes of an image and its kind, which the content decides: declared types are often wrong. InputError where
    there is no such image, it has no bytes, or they are of no kind that glTF knows."""
    image = document.one("images", index, where)
    what = image_label(index, image)
    uri = image.get("uri")
    if "bufferView" in image:
        data = view_bytes(document, image["bufferView"], what)
    elif isinstance(uri, str):
        data = uris.read_uri(uri, document.path, what, within=False)
    else:
        raise InputError(f"{document.path}: {what} has neither a bufferView nor a URI: export it again")
    kind = next((kind for kind in _KINDS if kind.is_of(data)), None)
    if kind is None:
        declared = f" (declared as {image['mimeType']})" if image.get("mimeType") else ""
        raise InputError(
            f"{document.path}: {what} is not of an image type that glTF knows{declared}: expected PNG or JPEG, convert "
            "it and export again"
        )
    return data, kind


def image_files(document: Document, within: Path) -> list[Path]:
    """The files that images of a document lie in, without those that are missing; InputError where one would lie
    outside the folder `within`."""
    images = enumerate(document.all("images"))
    found = [uris.file_of(image.get("uri"), document.path, within, image_label(i, image)) for i, image in images]
    return [path for path in found if path is not None]


def image_label(index: object, image: Json) -> str:
    """The name of an image in messages."""
    name = image.get("name") or image.get("uri")
    return f"image {index} ({name})" if isinstance(name, str) and not name.startswith("data:") else f"image {index}"


def sources_of(texture: Json) -> list[object]:
    """What a texture names as its images: its `source` first, then those of extensions."""
    extensions = extensions_in(texture)
    holders = [texture, *(extensions.get(name) for name in SOURCE_EXTENSIONS)]
    return [holder["source"] for holder in holders if isinstance(holder, dict) and "source" in holder]


def source_of(document: Document, texture: object, where: str) -> int:
    """The index of the image that a texture shows; InputError where it names none."""
    named = sources_of(document.one("textures", texture, where))
    if not named:
        raise InputError(
            f"{document.path}: texture {texture} ({where}) names no image: expected a source, export it again"
        )
    document.one("images", named[0], where)
    return int(str(named[0]))


class Images:
    """The images of a document, each written as a file when it is first wanted; images of equal bytes are one file.

    Args:
        document: the document that the images belong to.
        folder: an existing one, for these files alone.
    """

    def __init__(self, document: Document, folder: Path) -> None:
        self.document, self.folder = document, folder
        self._files: dict[tuple[Any, ...], Path] = {}
        self._headers: dict[str, Header] = {}
        self._names: set[str] = set()
        self._keys: dict[int, str] = {}

    def key(self, image: int) -> str:
        """The key of an image's content; equal for equal bytes, which some exporters store several times."""
        if image not in self._keys:
            self._keys[image] = hashlib.sha256(stored_image(self.document, image)[0]).hexdigest()
        return self._keys[image]

    def file(self, image: int) -> Path:
        """The file of an image, named after the image or its file. What it holds, the material says."""
        key = (self.key(image),)
        if key not in self._files:
            data, kind = stored_image(self.document, image)
            self._files[key] = self._path(self._stem(image), f"image_{image}", kind.suffix)
            write_temporary(self._files[key], data)
        return self._files[key]

    def header(self, image: int) -> Header:
        """The header of an image's file; InputError, which names the document and the image, where any of it is
        damaged."""
        key = self.key(image)
        if key not in self._headers:
            self._headers[key] = self._read(image).header
        return self._headers[key]

    def _read(self, image: int) -> Image:
        path = self.file(image)
        try:
            return read_image(path, metadata=False)
        except InputError as error:
            reason = error.full.replace(str(path), "its data")  # the file is gone when this is read
            raise InputError(
                f"{self.document.path}: {self._label(image)} is not a readable image: export it again ({reason})"
            ) from error

    def linear(self, image: int, srgb: bool = True) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """(H, W, 3) red, green and blue in [0, 1], decoded where they are sRGB-encoded, grey three times; and
        (H, W, 1) alpha, None where there is none."""
        stored, at = self._read(image).pixels, self.header(image).alpha
        colours = np.broadcast_to(stored[..., : 1 if self.is_grey(image) else 3], (*stored.shape[:2], 3))
        alpha = None if at < 0 else unit_range(stored[..., at : at + 1])
        return decode(colours, SRGB) if srgb else unit_range(colours), alpha

    def is_grey(self, image: int) -> bool:
        """Whether an image has no three channels of colour."""
        header = self.header(image)
        return header.channels - (header.alpha >= 0) < 3

    def check_directions(self, image: int, slot: str) -> None:
        """InputError where an image lacks a channel of the vectors that its slot holds."""
        if self.is_grey(image):
            raise InputError(
                f"{self.document.path}: {self._label(image)} is grey, and cannot hold the directions of a {slot}: "
                "expected red, green and blue, export it again"
            )

    def colour(self, linear: NDArray[np.float64]) -> Path:
        """A file of one texel with a linear colour (3,) in [0, 1], sRGB-encoded in 16 bits."""
        return self._made(("colour", *np.round(linear, 6)), linear_to_srgb(linear)[None, None])

    def directions(self, image: int | None, strength: float, rotation: float) -> Path:
        """A file of anisotropy directions and strengths with strength and rotation of the material in it, in 16 bits.

        Without an image it is one texel: KHR_materials_anisotropy takes (1, 0.5, 1) where there is no texture.
        """
        stored = np.array([[[1.0, 0.5, 1.0]]])
        if image is not None:
            stored = unit_range(self._read(image).pixels).astype(np.float64)
        x, y = (stored[..., i] * 2 - 1 for i in (0, 1))
        length = np.maximum(np.hypot(x, y), 1e-6)
        c, s = math.cos(rotation), math.sin(rotation)
        turned = np.stack([(c * x - s * y) / length, (s * x + c * y) / length], -1)
        values = np.concatenate([(turned + 1) / 2, stored[..., 2:3] * strength], -1)
        return self._made(("directions", image, strength, rotation), values)

    def _label(self, image: int) -> str:
        return image_label(image, self.document.all("images")[image])

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

    def _path(self, name: str, otherwise: str, suffix: str) -> Path:
        return self.folder / f"{unique_name(name, otherwise, self._names)}{suffix}"

    def _made(self, key: tuple[Any, ...], values: NDArray[np.float64]) -> Path:
        """(H, W, 3) in [0, 1] to a PNG of 16 bits; one file for one key."""
        if key not in self._files:
            count = sum(len(each) > 1 for each in self._files)
            self._files[key] = self._path(f"made_{count}", "made", PNG.suffix)
            write_temporary(self._files[key], png_of(values))
        return self._files[key]


def png_of(values: NDArray[np.floating]) -> bytes:
    """(H, W, C) in [0, 1] as a PNG of 16 bits, alpha (a fourth channel) not multiplied into the colours."""
    texels = np.floor(np.clip(values, 0, 1) * 65535 + 0.5).astype(np.uint16)
    with temporary_folder() as folder, temporary_files():
        path = folder / "texels.png"
        write_png(path, texels)
        return path.read_bytes()
