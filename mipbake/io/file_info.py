"""What is in a file of a stack, whoever wrote it: levels, formats, conventions, provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mipbake.errors import InputError
from mipbake.io import dds, disk, ktx2
from mipbake.io.gltf import container
from mipbake.io.gltf.document import Document, read_document
from mipbake.io.gltf.images import KTX2, stored_image
from mipbake.io.gpu_format import GpuTexture, level_size
from mipbake.io.json_text import parsed
from mipbake.io.layout import INVERTED
from mipbake.io.oiio_levels import ABOUT, reader
from mipbake.io.read import PNG_SIGNATURE, check_png

_PNG_HEAD = 128
"""Bytes that hold the first chunks of a PNG file, among them the chunk of the colour space."""


@dataclass(frozen=True)
class ImageInfo:
    """What is known of an image within a document, without a look at its pixels.

    Args:
        name: that the document gives it, else its number.
        mime: media type that its bytes have.
        texels, colour_space, levels: the same as in a `FileInfo`; empty for anything but KTX 2.
        bytes: of the image.
    """

    name: str
    mime: str
    texels: str
    colour_space: str
    levels: tuple[tuple[int, int], ...]
    bytes: int


@dataclass(frozen=True)
class FileInfo:
    """What is in a file.

    Args:
        path: of the file.
        container: what it is.
        texels: what a texel is stored as.
        channels: names of its channels, where the container has names.
        levels: (width, height) of every level, finest first; empty for documents.
        colour_space: of its texels, where it says one.
        bytes: of the file.
        about: what mipbake wrote into it about how it was made; empty in files of others.
        attributes: what else it says that matters to who samples it.
        images: within a document.
    """

    path: Path
    container: str
    texels: str
    channels: tuple[str, ...]
    levels: tuple[tuple[int, int], ...]
    colour_space: str
    bytes: int
    about: Mapping[str, Any] = field(default_factory=dict)
    attributes: Mapping[str, str] = field(default_factory=dict)
    images: tuple[ImageInfo, ...] = ()


@dataclass(frozen=True)
class StackInfo:
    """What a stack's description says.

    Args:
        content: the description, without the files.
        name, model: of the stack.
        width, height: of level 0, in texels.
        levels: the most that an output has; 0 where no output tells.
        wrap: addressing along u and v.
        method, version, weights, pixel_filter: how it was baked, as its provenance has it.
        conventions: format and normal convention of every output that tells one.
        files: all that are listed, in the folder itself.
        channels: file to what each of its channels holds, where that is told.
    """

    content: Mapping[str, Any]
    name: str
    model: str
    width: int
    height: int
    levels: int
    wrap: tuple[str, str]
    method: str
    version: str
    weights: str
    pixel_filter: str
    conventions: tuple[tuple[str, str], ...]
    files: tuple[Path, ...]
    channels: Mapping[Path, str]


def stack_info(file: Path, manifest: Mapping[str, Any]) -> StackInfo:
    """What a stack's description says; nothing is read beside it.

    Args:
        file: that declares the stack. manifest: what it says, from `mipbake.manifest.read_manifest`.

    Raises:
        InputError: it does not describe a stack, or lists files elsewhere.
    """
    try:
        made, outputs = manifest["provenance"], manifest["outputs"]
        entries = [entry for output in outputs for entry in output.get("maps", {}).values()]
        listed = [name for part in (*outputs, *entries) for name in part.get("files", ())]
        return StackInfo(
            {key: value for key, value in manifest.items() if key != "outputs"},
            str(manifest["name"]),
            str(manifest["model"]),
            int(manifest["width"]),
            int(manifest["height"]),
            max((len(entry.get("levels", ())) for entry in entries), default=0),
            (str(manifest["wrap"]["u"]), str(manifest["wrap"]["v"])),
            str(made["method"]),
            str(made["tool_version"]),
            str(made.get("weights") or ""),
            str(made["pixel_filter"]),
            tuple((str(o["format"]), str(o["normal_convention"])) for o in outputs if "normal_convention" in o),
            tuple(_within(file, name) for name in dict.fromkeys(listed)),
            {_within(file, name): _holds(entry) for entry in entries for name in entry.get("files", ())},
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{file} does not describe a stack ({error!r}): bake it again") from error


def _holds(entry: Mapping[str, Any]) -> str:
    """What the channels of a file hold; channels of one map are named together."""
    parts: list[tuple[str, str]] = []
    for channel in entry.get("channels", ()):
        role = str(channel["map"]) or str(channel["meaning"])
        told = f"1 - {role}" if channel["kind"] == INVERTED else role
        if parts and parts[-1][1] == told:
            parts[-1] = (parts[-1][0] + str(channel["name"]), told)
        else:
            parts.append((str(channel["name"]), told))
    return ", ".join(f"{names} {told}" for names, told in parts)


def _within(file: Path, name: object) -> Path:
    if not isinstance(name, str) or name in ("", ".", "..") or any(letter in name for letter in "/\\:\0"):
        raise InputError(f"{file} lists the file {name!r}: expected names of files in its folder; bake it again")
    return file.parent / name


def file_info(path: Path) -> FileInfo:
    """What is in an image file or a glTF document. InputError where it is not there, or nothing that is known.

    Pixels of KTX 2, DDS and documents are not decoded.
    """
    with disk.opened(path, "a file of a stack, or its folder") as file:
        start = file.read(12)
    if start == ktx2.IDENTIFIER:
        return _ktx2(path)
    if path.suffix.lower() == ".ktx2":
        raise InputError(f"{path} is not a KTX 2 file: it does not begin like one; bake or download it again")
    if start.startswith(b"DDS "):
        return _gpu(path, "DDS (Direct3D 10)", dds.decoded(disk.read_bytes(path), str(path)))
    if start.startswith(container.MAGIC) or path.suffix.lower() in (".gltf", ".glb"):
        return _document(path, "GLB (glTF 2.0)" if start.startswith(container.MAGIC) else "glTF 2.0")
    return _image(path)


def _document(path: Path, kind: str) -> FileInfo:
    document = read_document(path)
    images = tuple(_document_image(document, index) for index in range(len(document.all("images"))))
    extras = document.json["asset"].get("extras")
    about = extras.get("mipbake") if isinstance(extras, dict) else None
    about = about if isinstance(about, dict) else {}
    return FileInfo(path, kind, "", (), (), "", path.stat().st_size, about, images=images)


def _document_image(document: Document, index: int) -> ImageInfo:
    data, kind = stored_image(document, index)
    name = document.all("images")[index].get("name")
    name = name if isinstance(name, str) and name else str(index)
    if kind != KTX2:
        return ImageInfo(name, kind.mime, "", "", (), len(data))
    what = f"image {index} ({name}) of {document.path}"
    outline = ktx2.outline(data, what)
    if outline.readable:
        ktx2.stored(data, what)  # whether it is complete
    return ImageInfo(name, kind.mime, outline.texels, _space(outline.srgb), outline.levels, len(data))


def _ktx2(path: Path) -> FileInfo:
    data = disk.read_bytes(path)
    outline = ktx2.outline(data, str(path))
    if outline.readable:
        return _gpu(path, "KTX 2", ktx2.stored(data, str(path)))
    return FileInfo(path, "KTX 2", outline.texels, (), outline.levels, _space(outline.srgb), len(data))


def _space(srgb: bool) -> str:
    return "sRGB" if srgb else "linear"


def _sizes(texture: GpuTexture | ktx2.StoredTexture) -> tuple[tuple[int, int], ...]:
    return tuple(level_size(texture.width, texture.height, index) for index in range(len(texture.levels)))


def _gpu(path: Path, kind: str, texture: GpuTexture | ktx2.StoredTexture) -> FileInfo:
    values = {key: value.rstrip(b"\0").decode("utf-8", "replace") for key, value in texture.values.items()}
    made = texture.format
    return FileInfo(
        path,
        kind,
        made.name,
        (),
        _sizes(texture),
        _space(made.srgb),
        path.stat().st_size,
        _about(values.pop(ABOUT, "")),
        values,
    )


def _image(path: Path) -> FileInfo:
    start = disk.read_bytes(path) if path.suffix.lower() == ".png" else b""
    if start.startswith(PNG_SIGNATURE):
        check_png(path, start)
    source = reader(path)
    try:
        spec = source.spec()

        def said(name: str) -> str:
            value = spec.getattribute(name)
            return value if isinstance(value, str) else ""  # broken files have numbers in places of texts

        attributes = {name: said(name) for name in ("textureformat", "wrapmodes", "compression") if said(name)}
        about = _about(said(ABOUT) or said("ImageDescription"))
        channels, kind = tuple(spec.channelnames), str(spec.format)
        # The library takes PNG files that say nothing for sRGB.
        silent = path.suffix.lower() == ".png" and b"sRGB" not in start[:_PNG_HEAD]
        space = "" if silent else said("oiio:ColorSpace")
        levels = [(spec.width, spec.height)]
        while source.seek_subimage(0, len(levels)):
            levels.append((source.spec().width, source.spec().height))
        name = source.format_name()
    finally:
        source.close()
    return FileInfo(path, name, kind, channels, tuple(levels), space, path.stat().st_size, about, attributes)


def _about(text: str) -> Mapping[str, Any]:
    try:
        content = parsed(text)
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}
