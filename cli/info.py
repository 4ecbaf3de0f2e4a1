"""`mipbake info`: what is in a file of a stack, or in all of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from mipbake.cli.commands import JSON
from mipbake.cli.session import Session, counted
from mipbake.source.images.file_facts import FileInfo, ImageInfo
from mipbake.source.layout import MANIFEST, manifests
from mipbake.stack.file_info import file_info, stack_info
from mipbake.stack.manifest import manifest_path, read_manifest


def info(
    context: typer.Context,
    path: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A texture, a GLB, a stack.json or a stack's folder.",
            show_default=False,
            readable=False,  # the library says what is wrong
        ),
    ],
    json: Annotated[bool, JSON] = False,
) -> None:
    """Show what is in a texture file, or in every file of a stack.

    It lists levels, formats, conventions and provenance.
    """
    session: Session = context.obj
    session.configure(False, json)
    if path in manifests(path.parent):
        stacks = [_stack(session, path)]
    elif path.is_dir():
        several = manifests(path)
        stacks = [_stack(session, file) for file in several] if len(several) > 1 else [_stack(session, path)]
    else:
        file = file_info(path)
        session.print(*_lines(file))
        session.dump({"files": [file]})
        return
    content: dict[str, Any] = {"tiles": stacks} if len(stacks) > 1 else stacks[0]
    session.dump(content)


def _stack(session: Session, path: Path) -> dict[str, Any]:
    """Prints what is in a stack and its files, and returns it for JSON."""
    where = manifest_path(path)
    path = where.parent if where.name == MANIFEST else where
    stack = stack_info(where, read_manifest(where))
    files = [file_info(file) for file in stack.files]
    levels = stack.levels or max((len(image.levels) for file in files for image in file.images), default=0)
    session.print(f"{path}: {stack.title}, {counted(levels, 'level')}, wrap {stack.wrap}", *stack.about)
    for each in files:
        holds = stack.channels.get(each.path)
        first, *others = _lines(each)
        session.print(first, *([f"  holds: {holds}"] if holds else []), *others)
    return {"stack": stack.content, "files": files}


def _lines(file: FileInfo) -> list[str]:
    channels = f", channels {' '.join(file.channels)}" if file.channels else ""
    images = "" if file.levels else f", {counted(len(file.images), 'image')}"
    lines = [f"{file.path.name}: {file.container}{_texels(file, channels)}{images}, {file.bytes} bytes"]
    lines += [f"  {name}: {value}" for name, value in file.attributes.items()]
    if file.about:
        # A document says it of every material that was baked.
        materials = file.about.get("materials")
        materials = materials if isinstance(materials, dict) else {}
        own = {key: value for key, value in file.about.items() if key != "materials"}
        lines.append(f"  made by mipbake: {_told(own)}")
        lines += [f"  material {name}: {_told(each)}" for name, each in materials.items() if isinstance(each, dict)]
    lines += [f"  image {i.name}: {i.mime}{_texels(i)}, {counted(i.bytes, 'byte')}" for i in file.images]
    return lines


def _texels(image: FileInfo | ImageInfo, channels: str = "") -> str:
    """Texels, channels, colour space and levels, where they are known."""
    if not image.levels:
        return ""
    width, height = image.levels[0]
    space = f", {image.colour_space}" if image.colour_space else ""
    return f", {image.texels}{channels}{space}, {width} x {height}, {counted(len(image.levels), 'level')}"


def _told(about: Mapping[str, Any]) -> str:
    said = {key: ", ".join(map(str, value)) if isinstance(value, list) else value for key, value in about.items()}
    measured = said.pop("measured", None)
    lines = [f"{key} {value}" for key, value in said.items() if value not in (None, "")]
    return ", ".join(lines + ([_measured(measured)] if measured else []))


def _measured(figures: Any) -> str:
    """SNR of level 0 of what was measured; --json has all levels."""
    try:
        told = [f"{name} {row[0]} dB" for name, row in figures["snr"].items()]
    except (AttributeError, IndexError, KeyError, TypeError):
        return "measured figures that are damaged"
    return f"SNR at lod 0 {', '.join(told)}"
