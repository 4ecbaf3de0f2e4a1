"""The images of a glTF document: their bytes, wherever they lie, and what kind of file those are."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from mipbake.base.errors import InputError
from mipbake.source.gltf import uris
from mipbake.source.gltf.document import Document, Json, view_bytes

BASISU = "KHR_texture_basisu"

SOURCE_EXTENSIONS = (BASISU, "EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds")
"""Extensions of a texture that name another image than its `source`."""


@dataclass(frozen=True)
class ImageKind:
    """A kind of image file: its media type, and the suffix of its files."""

    mime: str
    suffix: str


PNG = ImageKind("image/png", ".png")
_JPEG = ImageKind("image/jpeg", ".jpg")
_WEBP = ImageKind("image/webp", ".webp")
KTX2 = ImageKind("image/ktx2", ".ktx2")
_DDS = ImageKind("image/vnd-ms.dds", ".dds")
_AVIF = ImageKind("image/avif", ".avif")
_KINDS = {kind.mime: kind for kind in (PNG, _JPEG, _WEBP, KTX2, _DDS, _AVIF)}


def kind_of(data: bytes) -> ImageKind | None:
    """The kind of an image file by its first bytes; None where they are of none that glTF knows."""
    starts = (
        (b"\x89PNG\r\n\x1a\n", PNG),
        (b"\xff\xd8\xff", _JPEG),
        (b"\xabKTX 20\xbb\r\n\x1a\n", KTX2),
        (b"DDS ", _DDS),
    )
    for start, kind in starts:
        if data.startswith(start):
            return kind
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _WEBP
    return _AVIF if data[4:12] in (b"ftypavif", b"ftypavis") else None


def stored_image(document: Document, index: object, where: str = "a texture") -> tuple[bytes, ImageKind]:
    """The bytes of an image and its kind, which the content decides: declared types are often wrong.

    Raises:
        InputError: there is no such image, it has no bytes, or they are of no kind that glTF knows.
    """
    image = document.one("images", index, where)
    what = image_label(index, image)
    uri = image.get("uri")
    if "bufferView" in image:
        data = view_bytes(document, image["bufferView"], what)
    elif isinstance(uri, str):
        data = uris.read_uri(uri, document.path, what, within=False)
    else:
        raise InputError(f"{document.path}: {what} has neither a bufferView nor a URI: export it again")
    kind = kind_of(data)
    if kind is None:
        declared = str(image.get("mimeType") or "")
        said = f", though it is declared as {declared}" if declared in _KINDS else f" ({declared})" if declared else ""
        raise InputError(
            f"{document.path}: {what} is not of an image type that glTF knows{said}: expected PNG or JPEG, convert it "
            "and export again"
        )
    return data, kind


def image_bytes(document: Document, index: object) -> tuple[bytes, str]:
    """The bytes of an image that can be baked from, and the suffix that its files have (".png").

    Args:
        document: with its images in a bufferView, an external file or a data URI.
        index: of the image.

    Raises:
        InputError: there is no such image, or its file is missing.
    """
    data, kind = stored_image(document, index)
    return data, kind.suffix


def image_files(document: Document, within: Path) -> list[Path]:
    """The files that images of a document lie in, without those that are missing.

    Raises:
        InputError: one of them would lie outside the folder `within`.
    """
    images = enumerate(document.all("images"))
    found = [uris.file_of(image.get("uri"), document.path, within, image_label(i, image)) for i, image in images]
    return [path for path in found if path is not None]


def image_label(index: object, image: Json) -> str:
    """The name of an image in messages."""
    name = image.get("name") or image.get("uri")
    return f"image {index} ({name})" if isinstance(name, str) and not name.startswith("data:") else f"image {index}"


def source_of(document: Document, texture: object, where: str) -> object:
    """The index of the image that a texture shows: its `source`, else the one that an extension names."""
    found = document.one("textures", texture, where)
    if "source" in found:
        return found["source"]
    extensions = found.get("extensions")
    for name in SOURCE_EXTENSIONS:
        extension = extensions.get(name) if isinstance(extensions, dict) else None
        if isinstance(extension, dict) and "source" in extension:
            return extension["source"]
    raise InputError(f"{document.path}: texture {texture} ({where}) names no image: expected a source, export it again")


def content_key(document: Document, image: object, where: str) -> str:
    """Equal for images of equal bytes, which some exporters store several times."""
    return hashlib.sha256(stored_image(document, image, where)[0]).hexdigest()
