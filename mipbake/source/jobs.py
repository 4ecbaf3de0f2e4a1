"""What is baked at once: one texture set, or tiles that touch, with what it is read from and what it is called."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from mipbake.base.errors import InputError, UsageError
from mipbake.base.messages import listed
from mipbake.base.safe_names import unique_name
from mipbake.source.archives import SUFFIX, Archive
from mipbake.source.discover import find
from mipbake.source.gltf.document import Document
from mipbake.source.gltf.materials import GltfBake
from mipbake.source.gltf.plain import PlainTexture
from mipbake.source.matches import name_of
from mipbake.source.options import LoadOptions
from mipbake.source.sources import Found
from mipbake.source.texture_set import TextureSet, read
from mipbake.source.tiles import name_with
from mipbake.source.udim import CLAMPED, Mosaic, mosaics

_T = TypeVar("_T")


@dataclass(frozen=True)
class SetFiles:
    """The files of one texture set, and how they are read."""

    files: tuple[Path, ...]
    options: LoadOptions

    @property
    def name(self) -> str:
        """Name of the texture set; nothing is read."""
        return self.options.name or name_of(self.files[0].parent)


@dataclass(frozen=True)
class Job:
    """What is baked at once: one texture set, or tiles that touch.

    Args:
        source: what the user named.
        parts: tile number to what it is read from; a single part without a number (0) for sets that are not tiles.
        notes, warnings: what was found in the source, in sentences.
        place: folder of the result's folder, relative to the folder of all results.
        archive: that the files lie in. document, bake: of a glTF source, and which of its bakes this is. plain: all its
            averaged textures.
    """

    source: Path
    parts: Mapping[int, SetFiles]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    place: str = ""
    archive: Archive | None = None
    document: Document | None = None
    bake: GltfBake | None = None
    plain: tuple[PlainTexture, ...] = ()

    @property
    def tiled(self) -> bool:
        """Whether the job is about tiles, which share a folder with all other tiles of their source."""
        return 0 not in self.parts

    @property
    def name(self) -> str:
        """Name of its texture set, or of the set that its tiles are of; nothing is read."""
        return next(iter(self.parts.values())).name

    @property
    def names(self) -> dict[int, str]:
        """What the texture sets will be called, by tile; nothing is read."""
        return {tile: name_with(part.name, tile) if tile else part.name for tile, part in self.parts.items()}

    def using(self, read: Callable[[], _T]) -> _T:
        """What is read of the files that its document refers to, which may lie in an archive."""
        return read() if self.archive is None else self.archive.using(read)

    def naming(self) -> AbstractContextManager[None]:
        """Errors of the block name the archive that it lies in, not the folder that it is unpacked to."""
        return nullcontext() if self.archive is None else self.archive.naming()

    def named(self, found: Found) -> Found:
        """The same with paths that begin with the path of the archive, where the files lie in one."""
        archive = self.archive
        if archive is None:
            return found
        maps = {r: replace(s, path=Path(archive.renamed(str(s.path)))) if s.path else s for r, s in found.maps.items()}
        ignored = tuple(replace(each, path=Path(archive.renamed(str(each.path)))) for each in found.ignored)
        return replace(found, maps=maps, ignored=ignored)

    def find(self, tile: int) -> Found:
        """What one part is; nothing is decoded. InputError where it cannot be read."""
        return self._part(tile, lambda part: find(part.files, part.options))

    def found(self) -> dict[int, Found]:
        """What all parts are, by tile. InputError where one cannot be read."""
        return {tile: self.find(tile) for tile in self.parts}

    def read_tile(self, tile: int) -> TextureSet:
        """The texture set of one part, clamped where it is a tile. InputError where it cannot be read."""
        return replace(self._read(tile), name=self.names[tile])

    def sets(self) -> Iterator[TextureSet]:
        """The texture sets, one after the other. InputError where one cannot be read."""
        return (self.read_tile(tile) for tile in self.parts)

    def read(self, change: Callable[[TextureSet], TextureSet] = lambda each: each) -> list[Mosaic]:
        """What is baked, every texture set changed as it is wanted: tiles that differ in size are baked one size after
        the other. InputError where it cannot be read."""
        sets = {tile: change(self._read(tile)) for tile in self.parts}
        return mosaics(sets) if self.tiled else [Mosaic(sets[0], sets)]

    def _read(self, tile: int) -> TextureSet:
        made = self._part(tile, lambda part: read(find(part.files, part.options), part.options))
        return replace(made, wrap=CLAMPED) if tile else made  # its borders meet other tiles, not its own other sides

    def _part(self, tile: int, act: Callable[[SetFiles], _T]) -> _T:
        """What is made of a part; an InputError says which tile it is about."""
        try:
            return self.using(lambda: act(self.parts[tile]))
        except InputError as error:
            if not tile:
                raise
            raise InputError(f"tile {tile}: {error}") from error

    @property
    def top(self) -> str:
        """What its result, or that of its document, is called in the folder of all results."""
        return self.place or self.name

    def renamed(self, name: str, note: str) -> Job:
        """The same with another name in the folder of all results; `note` says why."""
        if name == self.top:
            return self
        notes = (*self.notes, note)
        if self.place:
            return replace(self, place=name, notes=notes)
        parts = {tile: replace(part, options=replace(part.options, name=name)) for tile, part in self.parts.items()}
        return replace(self, parts=parts, notes=notes)


@dataclass(frozen=True)
class Failure:
    """A source, or some of the materials of a document, that cannot be read, and why."""

    source: Path
    error: InputError | UsageError


def with_names_apart(found: Sequence[Job | Failure]) -> list[Job | Failure]:
    """The same jobs, no two results of one name: jobs that would share a name are also called after the folder around
    their source, or numbered where that folder is the same.
    """
    jobs = {index: job for index, job in enumerate(found) if isinstance(job, Job)}
    groups: dict[str, dict[object, list[int]]] = {}
    for index, job in jobs.items():
        groups.setdefault(job.top.casefold(), {}).setdefault(_unit(job, index), []).append(index)
    taken = set(groups)
    for units in groups.values():
        if len(units) < 2:
            continue
        firsts = [jobs[unit[0]] for unit in units.values()]
        around = [f"{job.source.resolve().parent.name.removesuffix(SUFFIX)}_{job.top}" for job in firsts]
        apart = len({name.casefold() for name in around}) == len(units)
        sources = listed(dict.fromkeys(str(job.source) for job in firsts))
        for number, (first, unit) in enumerate(zip(firsts, units.values(), strict=True)):
            name = around[number] if apart else first.top
            if apart or number:
                name = unique_name(name, "texture_set", taken)
            note = f"it is called {name} here, because several are called {first.top}: {sources}"
            jobs |= {index: jobs[index].renamed(name, note) for index in unit}
    return [jobs.get(index, each) for index, each in enumerate(found)]


def _unit(job: Job, index: int) -> object:
    """Equal for jobs whose results share a folder: the jobs of a document, or the groups of tiles of one set."""
    if job.place:
        return job.source, job.place
    if not job.tiled:
        return index
    return job.source, job.name, next(iter(job.parts.values())).files[0].parent
