"""MaterialX documents (1.38, 1.39) whose materials point at textures: which file fills which role, and how.

What a document says holds, whatever the names of its files suggest. The shaders that are read are Autodesk Standard
Surface, glTF PBR, OpenPBR Surface and UsdPreviewSurface.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.base.safe_names import unique_name
from mipbake.source.mtlx.document import Document, Element, Link, Scope, UnreadError, read_document
from mipbake.source.mtlx.roles import read_roles
from mipbake.source.mtlx.shaders import SHADERS
from mipbake.source.mtlx.trace import Tracer
from mipbake.source.options import LoadOptions
from mipbake.source.sources import Log
from mipbake.source.tiles import CHANNELS, is_pattern, pattern_files, tile_options


@dataclass(frozen=True)
class MtlxMaterial:
    """A material that `mipbake.load(files, options)` reads.

    Args:
        name: safe as a folder name, and the document's only one of that name.
        options: what fills every role, with absolute paths. Every role is set, so that names decide nothing.
        files: the files of all its textures, with the files of all tiles.
        udim: whether names in `options.maps` hold <UDIM> or <UVTILE>: `tiles` is to be used then.
        notes, warnings: what was found and assumed, and what the user should look at, in sentences.
    """

    name: str
    options: LoadOptions
    files: tuple[Path, ...]
    udim: bool
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def tiles(self) -> Mapping[int, tuple[list[Path], LoadOptions]]:
        """Tile number to the files and the options that `mipbake.load` takes for it; empty without UDIM. InputError
        where a tile lacks its normal or its roughness map."""
        patterns = [p for p in _paths(self.options) if is_pattern(p)]
        numbers = sorted({tile for pattern in patterns for tile in pattern_files(pattern)})
        own = {tile: tile_options(self.options, tile) for tile in numbers}
        return {tile: (_paths(options), options) for tile, options in own.items()}


@dataclass(frozen=True)
class MtlxMaterials:
    """The materials of a document that point at textures, in its order.

    `errors`: what is wrong with those whose textures are not there, a sentence each. A warning of the first material
    names those that hold nothing to bake.
    """

    materials: tuple[MtlxMaterial, ...]
    errors: tuple[str, ...] = ()


def read_materialx(path: str | os.PathLike[str], within: Path | None = None) -> MtlxMaterials:
    """The materials of a document; `within` as for `read_document`. InputError where it cannot be read, or none of its
    materials: it names textures that are not there, its shaders are of other kinds, or neither normal nor roughness
    comes from a file."""
    document = read_document(Path(path), within)
    surfaces = _surfaces(document)
    if not surfaces:
        raise InputError(f"{document.path} holds no material: expected a surfacematerial with a surface shader")
    tracer, taken = Tracer(document), set[str]()
    materials: list[MtlxMaterial] = []
    errors: list[str] = []
    skipped: list[str] = []
    for given, shader, displaced in surfaces:
        where, log = f"{document.path}: the material {given}", Log(list(document.notes))
        if isinstance(shader, str):
            skipped.append(f"{where} cannot be read ({shader}): expected a surface shader")
            continue
        try:
            options = read_roles(tracer, shader, displaced, where, log)
        except InputError as error:
            skipped.append(error.full)
            continue
        name = unique_name(given or shader.node.get("name", ""), "material", taken)
        udim = any(is_pattern(path) for path in _paths(options))
        try:
            about = (replace(options, name=name), _files(options, where), udim, tuple(log.notes), tuple(log.warnings))
            materials.append(MtlxMaterial(name, *about))
        except InputError as error:
            errors.append(error.full)
    if not materials:
        reasons = errors + skipped
        others = f"; {len(reasons) - 1} more materials cannot be read either" if len(reasons) > 1 else ""
        raise InputError(reasons[0] + others)
    left_out = tuple(f"left out: {reason}" for reason in skipped)
    materials[0] = replace(materials[0], warnings=materials[0].warnings + left_out)
    return MtlxMaterials(tuple(materials), tuple(errors))


def _surfaces(document: Document) -> list[tuple[str, Link | str, Link | str]]:
    """Every surfacematerial; where there is none, every shader that is known. Of each its name, its surface shader and
    the node that displaces it, or why there is none."""
    found = []
    for container in (document.root, *document.root.iterfind("nodegraph")):
        if container.get("nodedef"):
            continue
        scope = document.scope if container is document.root else Scope(container, None, document.scope)
        for node in container.iterfind("surfacematerial"):
            shader = _shader_of(document, node, "surfaceshader", scope)
            found.append((node.get("name", ""), shader, _shader_of(document, node, "displacementshader", scope)))
    alone = (node for node in document.root if node.tag in SHADERS)
    return found or [(node.get("name", ""), Link(node, document.scope), "") for node in alone]


def _shader_of(document: Document, node: Element, name: str, scope: Scope) -> Link | str:
    """The shader that an input is connected to; or why there is none."""
    try:
        given = document.given(node, name, scope)
        return document.source_of(given) if isinstance(given, Link) else f"it has no {name}"
    except UnreadError as error:
        return f"it names {error}"


def _files(options: LoadOptions, where: str) -> tuple[Path, ...]:
    """The files that maps name, with the files of all tiles; InputError where one is not there."""
    files: list[Path] = []
    for file in _paths(options):
        if is_pattern(file):
            files += pattern_files(file).values()
        elif disk.is_file(file):
            files.append(file)
        else:
            raise InputError(f"{where} names {file.name}, which is not there: expected {file}")
    return tuple(dict.fromkeys(files))


def _paths(options: LoadOptions) -> list[Path]:
    """The files and patterns that maps name, each once."""
    named = [choice for choice in options.maps.values() if isinstance(choice, str)]
    return list(dict.fromkeys(Path(CHANNELS.sub("", choice)) for choice in named))
