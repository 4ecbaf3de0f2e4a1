"""What is in a file of a stack, whoever wrote it: levels, formats, conventions, provenance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.material.aim import sampler_from
from mipbake.source.gltf import container
from mipbake.source.gltf.document import Document, read_document
from mipbake.source.gltf.images import KTX2, stored_image
from mipbake.source.images import ktx2
from mipbake.source.images.file_facts import FileInfo, ImageInfo, colour_space
from mipbake.source.images.oiio_levels import image_info
from mipbake.source.layout import INVERTED
from mipbake.stack.containers import FORMATS

_START = 12
"""Bytes at the beginning that tell what a file is."""


@dataclass(frozen=True)
class StackInfo:
    """What a stack's description says.

    Args:
        content: the description, without the files.
        title, wrap: name, model and size; addressing along u and v.
        levels: the most that an output has; 0 where no output tells.
        about: lines on how it was baked, conventions of normals, and adjustments.
        files: all that are listed. channels: file to what each of its channels holds, where that is told.
    """

    content: Mapping[str, Any]
    title: str
    wrap: str
    levels: int
    about: tuple[str, ...]
    files: tuple[Path, ...]
    channels: Mapping[Path, str]


def stack_info(file: Path, manifest: Mapping[str, Any]) -> StackInfo:
    """What a stack's description, from `mipbake.stack.manifest.read_manifest`, says; nothing is read beside it. `file`
    declares the stack. InputError where it does not describe one, or lists files elsewhere."""
    try:
        outputs, wrap = manifest["outputs"], manifest["wrap"]
        entries = [entry for output in outputs for entry in output.get("maps", {}).values()]
        listed = [name for part in (*outputs, *entries) for name in part.get("files", ())]
        return StackInfo(
            {key: value for key, value in manifest.items() if key != "outputs"},
            f"{manifest['name']}, {manifest['model']}, {manifest['width']} x {manifest['height']}",
            f"{wrap['u']}, {wrap['v']}",
            max((len(entry.get("levels", ())) for entry in entries), default=0),
            tuple(_about(manifest)),
            tuple(_within(file, name) for name in dict.fromkeys(listed)),
            {_within(file, name): _holds(entry) for entry in entries for name in entry.get("files", ())},
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{file} does not describe a stack ({error!r}): bake it again") from error


def _about(manifest: Mapping[str, Any]) -> Iterator[str]:
    made = manifest["provenance"]
    sampler = "" if made.get("sampler") is None else f", sampler {sampler_from(made['sampler'])}"
    aim = "" if made.get("aim") is None else f", aim {made['aim']:g}"
    weights = f" with {made['weights']}" if made.get("weights") else ""
    yield (
        f"baked by {made['method']} of mipbake {made['tool_version']}{weights}, pixel filter {made['pixel_filter']}"
        f"{sampler}{aim}"
    )
    for output in manifest["outputs"]:
        if "normal_convention" in output:
            yield f"{output['format']}: normals {output['normal_convention']}"
    for adjustment in made.get("adjustments", ()):
        yield f"adjusted: {adjustment}"


def _holds(entry: Mapping[str, Any]) -> str:
    """What the channels of a file hold; channels of one map are named together."""
    parts: list[tuple[str, str]] = []
    for channel in entry.get("channels", ()):
        role = str(channel["map"]) or str(channel["meaning"])
        held = f"1 - {role}" if channel["kind"] == INVERTED else role
        if parts and parts[-1][1] == held:
            parts[-1] = (parts[-1][0] + str(channel["name"]), held)
        else:
            parts.append((str(channel["name"]), held))
    return ", ".join(f"{names} {held}" for names, held in parts)


def _within(file: Path, name: object) -> Path:
    if not isinstance(name, str) or name in ("", ".", "..") or any(letter in name for letter in "/\\:\0"):
        raise InputError(f"{file} lists the file {name!r}: expected names of files in its folder; bake it again")
    return file.parent / name


def file_info(path: Path) -> FileInfo:
    """What is in an image file or a glTF document. InputError where it is not there, or nothing that is known.

    Pixels of KTX 2, DDS and documents are not decoded.
    """
    with disk.opened(path, "a file of a stack, or its folder") as file:
        start = file.read(_START)
    suffix = path.suffix.lower()
    for each in (next(iter(kinds.values())) for kinds in FORMATS.values()):
        # OpenImageIO tells the files that it reads by what is in them.
        if each.signature and (suffix == f".{each.name}" or start.startswith(each.signature)):
            return each.info(path)
    if start.startswith(container.MAGIC) or suffix in (".gltf", ".glb"):
        return _document(path, "GLB (glTF 2.0)" if start.startswith(container.MAGIC) else "glTF 2.0")
    return image_info(path)


def _document(path: Path, kind: str) -> FileInfo:
    document = read_document(path)
    images = tuple(_document_image(document, index) for index in range(len(document.all("images"))))
    return FileInfo(path, kind, "", (), (), "", path.stat().st_size, document.about or {}, images=images)


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
    return ImageInfo(name, kind.mime, outline.texels, colour_space(outline.srgb), outline.levels, len(data))
