"""From what a user names to a library; documents that lie beside maps are read for it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from mipbake.batch.library import Library, entries_below, entries_of
from mipbake.errors import InputError
from mipbake.io import disk
from mipbake.io.archives import MATERIALX
from mipbake.io.gltf.document import read_document
from mipbake.io.gltf.images import image_files
from mipbake.io.inputs import expand
from mipbake.io.mtlx.materials import read_materialx

PathLike: TypeAlias = "str | os.PathLike[str]"


def found_library(
    sources: PathLike | Sequence[PathLike], out: Path, recursive: bool = True, within: Sequence[Path] = ()
) -> Library:
    """What can be baked.

    Args:
        sources: what `mipbake.load_all` takes. out: the folder of all results.
        recursive: whether everything below the sources is meant; else the sources themselves.
        within: paths, one of which an entry must be or lie in; empty for all entries.

    Raises:
        InputError: a source or a path is not there, or nothing can be baked.
    """
    given = [sources] if isinstance(sources, (str, os.PathLike)) else sources
    paths = expand([os.fspath(each) for each in given])
    library = entries_below(paths, out, _document_files) if recursive else entries_of(paths)
    for place in within:
        if not any(disk.lies_in(entry.source, place) for entry in library.entries):
            raise InputError(f"{place} holds nothing of the library: expected a source in it, or a folder around some")
    kept = (e for e in library.entries if not within or any(disk.lies_in(e.source, place) for place in within))
    return replace(library, entries=tuple(kept))


def _document_files(document: Path) -> list[Path]:
    """The images that a document shows; InputError where it cannot be read."""
    if document.suffix.lower() == MATERIALX:
        return [file for material in read_materialx(document).materials for file in material.files]
    return image_files(read_document(document), Path(disk.resolved(document).anchor))
