"""From what a user names to a library; documents that lie beside maps are read for it."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from mipbake.base import disk
from mipbake.base.errors import InputError, UsageError
from mipbake.library.listing import Entry, Library, entries_below, entries_of
from mipbake.library.parts import parts_of
from mipbake.source.archives import MATERIALX
from mipbake.source.gltf.document import read_document
from mipbake.source.gltf.images import image_files
from mipbake.source.inputs import expand
from mipbake.source.mtlx.materials import read_materialx
from mipbake.source.options import LoadOptions

PathLike: TypeAlias = "str | os.PathLike[str]"


@dataclass(frozen=True)
class Shard:
    """One part of a library, which is baked apart from the others, as on another machine.

    Args:
        number: from 1. count: how many parts there are.

    Raises:
        UsageError: there is no such part.
    """

    number: int
    count: int

    def __post_init__(self) -> None:
        """Checks that there is such a part."""
        if not 1 <= self.number <= self.count:
            raise UsageError(f"the shard is {self}: expected I/N with I from 1 to N")

    @classmethod
    def parsed(cls, text: str) -> Shard:
        """The shard that a user writes as I/N."""
        found = re.fullmatch(r"(\d+)/(\d+)", text.strip())
        if found is None:
            raise UsageError(f"the shard is {text!r}: expected I/N, for example 1/16 and on to 16/16")
        return cls(int(found[1]), int(found[2]))

    def of(self, entries: Sequence[Entry]) -> tuple[Entry, ...]:
        """Its entries: every N-th one, because neighbours often take as long as each other."""
        return tuple(entries[self.number - 1 :: self.count])

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


def found_library(
    sources: PathLike | Sequence[PathLike],
    out: Path,
    load: Callable[[str], LoadOptions],
    recursive: bool = True,
    within: Sequence[Path] = (),
    shard: Shard | None = None,
) -> Library:
    """What can be baked.

    Args:
        sources: what `mipbake.load_all` takes. out: the folder of all results.
        load: label of a folder to how it is read, which tells the sets in it apart.
        recursive: whether everything below the sources is meant; else the sources themselves.
        within: paths, one of which an entry must be or lie in; empty for all entries.
        shard: the part of these entries that is meant, which may be empty; None for all of them.

    Raises:
        InputError: a source or a path is not there, or nothing can be baked. UsageError: as `load` raises it.
    """
    given = [sources] if isinstance(sources, (str, os.PathLike)) else sources
    paths = expand([os.fspath(each) for each in given])
    library = entries_below(paths, out, _document_files) if recursive else entries_of(paths)
    for place in within:
        if not any(disk.lies_in(entry.source, place) for entry in library.entries):
            raise InputError(f"{place} holds nothing of the library: expected a source in it, or a folder around some")
    kept = [e for e in library.entries if not within or any(disk.lies_in(e.source, place) for place in within)]
    single = tuple(_one_by_one(kept, load))
    return replace(library, entries=single if shard is None else shard.of(single))


def _one_by_one(entries: Sequence[Entry], load: Callable[[str], LoadOptions]) -> Iterator[Entry]:
    """The same entries, with an entry for each set where a folder holds several."""
    taken = {entry.label for entry in entries}
    for entry in entries:
        for each in entry.parted(parts_of(entry.source, load(entry.label))):
            label, count = each.label, 2
            while each.part is not None and label in taken:  # a folder in the folder has the name of a set in it
                label, count = f"{each.label}_{count}", count + 1
            taken.add(label)
            yield replace(each, label=label)


def _document_files(document: Path) -> list[Path]:
    """The images that a document shows; InputError where it cannot be read."""
    if document.suffix.lower() == MATERIALX:
        return [file for material in read_materialx(document).materials for file in material.files]
    return image_files(read_document(document), Path(disk.resolved(document).anchor))
