"""What is baked at once: one texture set, or tiles that touch, with what it is read from and what it is called."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
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
from mipbake.source.sources import Discovery
from mipbake.source.texture_set import TextureSet, load
from mipbake.source.tiles import name_with
from mipbake.source.udim import CLAMPED, Mosaic, mosaics

_T = TypeVar("_T")


@dataclass(frozen=True)
class SetFiles:
    """What `load` reads one texture set from, and the archive that the files lie in."""

    files: Path | tuple[Path, ...]
    options: LoadOptions
    archive: Archive | None = None

    @property
    def name(self) -> str:
        """Name of the texture set; nothing is read."""
        return self.options.name or name_of(self.files)

    def find(self) -> Discovery:
        """What would be read. InputError where it cannot be."""
        return self._using(lambda: find(self.files, self.options))

    def load(self) -> TextureSet:
        """The texture set. InputError where it cannot be read."""
        return self._using(lambda: load(self.files, self.options))

    def _using(self, read: Callable[[], _T]) -> _T:
        return read() if self.archive is None else self.archive.using(read)


@dataclass(frozen=True)
class Job:
    """What is baked at once: one texture set, or tiles that touch.

    Args:
        source: what the user named.
        parts: tile number to what it is read from; a single part without a number (0) for sets that are not tiles.
        notes, warnings: what was found in the source, in sentences.
        place: folder of the result's folder, relative to the folder of all results.
        document, bake: the document of a glTF source, and which of its bakes this is. plain: all its averaged textures.
    """

    source: Path
    parts: Mapping[int, SetFiles]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    place: str = ""
    document: Document | None = None
    bake: GltfBake | None = None
    plain: tuple[PlainTexture, ...] = ()

    @property
    def tiled(self) -> bool:
        """Whether the job is about tiles, which share a folder with all other tiles of their source."""
        return 0 not in self.parts

    @property
    def archive(self) -> Archive | None:
        """The archive that it lies in."""
        return next(iter(self.parts.values())).archive

    def using(self, read: Callable[[], _T]) -> _T:
        """What is read of the files that its document refers to, which may lie in an archive."""
        return read() if self.archive is None else self.archive.using(read)

    def naming(self) -> AbstractContextManager[None]:
        """Errors of the block name the archive that it lies in, not the folder that it is unpacked to."""
        return nullcontext() if self.archive is None else self.archive.naming()

    @property
    def names(self) -> dict[int, str]:
        """What the texture sets will be called, by tile; nothing is read."""
        return {tile: name_with(part.name, tile) if tile else part.name for tile, part in self.parts.items()}

    def sets(self) -> Iterator[TextureSet]:
        """The texture sets, one after the other. InputError where one cannot be read."""
        return (self.read_tile(tile) for tile in self.parts)

    def read_tile(self, tile: int) -> TextureSet:
        """The texture set of one part, clamped where it is a tile. InputError where it cannot be read."""
        alone = _of_tile(tile, self.parts[tile].load)
        return replace(alone, wrap=CLAMPED, name=self.names[tile]) if tile else alone

    def found(self) -> dict[int, Discovery]:
        """What would be read, by tile. InputError where it cannot."""
        return {tile: _of_tile(tile, part.find) for tile, part in self.parts.items()}

    def read(self, change: Callable[[TextureSet], TextureSet] = lambda each: each) -> list[Read]:
        """What is baked, every texture set changed as it is wanted: tiles that differ in size are baked one size after
        the other. InputError where it cannot be read."""
        if list(self.parts) == [0]:
            alone = change(self.parts[0].load())
            return [Read({0: alone}, alone)]
        # Their borders meet other tiles, not their own other sides.
        sets = {tile: change(replace(_of_tile(tile, p.load), wrap=CLAMPED)) for tile, p in self.parts.items()}
        return [
            Read({n: replace(sets[n], name=tile.name) for n, tile in each.tiles.items()}, each.texture_set, each)
            for each in mosaics(sets)
        ]


@dataclass(frozen=True, eq=False)
class Read:
    """What is baked at once.

    Args:
        sets: texture sets by tile.
        texture_set: what is baked: the only one, or all tiles side by side.
        mosaic: where the tiles lie in it.
    """

    sets: Mapping[int, TextureSet]
    texture_set: TextureSet
    mosaic: Mosaic | None = field(default=None)


@dataclass(frozen=True)
class Failure:
    """A source, or some of the materials of a document, that cannot be read, and why."""

    source: Path
    error: InputError | UsageError


def with_names_apart(found: Sequence[Job | Failure]) -> list[Job | Failure]:
    """The same jobs, no two results of one name: jobs that would share a name are also called after the folder around
    their source, or numbered where that folder is the same.
    """
    tops: dict[str, dict[object, Job]] = {}
    for index, job in enumerate(found):
        if isinstance(job, Job):
            tops.setdefault(_top(job).casefold(), {}).setdefault(_unit(job, index), job)
    taken = set(tops)
    renamed: dict[object, tuple[str, str]] = {}
    for units in tops.values():
        if len(units) < 2:
            continue
        told = listed(dict.fromkeys(str(job.source) for job in units.values()))
        around = {
            unit: f"{job.source.resolve().parent.name.removesuffix(SUFFIX)}_{_top(job)}" for unit, job in units.items()
        }
        apart = len({name.casefold() for name in around.values()}) == len(units)
        for unit, job in units.items():
            name = unique_name(around[unit], "texture_set", taken) if apart else _top(job)
            if not apart and job is not next(iter(units.values())):
                name = unique_name(_top(job), "texture_set", taken)
            renamed[unit] = (name, f"it is called {name} here, because several are called {_top(job)}: {told}")
    made: list[Job | Failure] = []
    for index, job in enumerate(found):
        if not isinstance(job, Job) or _unit(job, index) not in renamed:
            made.append(job)
            continue
        name, note = renamed[_unit(job, index)]
        notes = (*job.notes, note) if name != _top(job) else job.notes
        if job.place:
            made.append(replace(job, place=name, notes=notes))
            continue
        parts = {tile: replace(part, options=replace(part.options, name=name)) for tile, part in job.parts.items()}
        made.append(replace(job, parts=parts, notes=notes))
    return made


def _top(job: Job) -> str:
    """What the result of a job, or of its document, is called in the folder of all results."""
    return job.place or next(iter(job.parts.values())).name


def _unit(job: Job, index: int) -> object:
    """Equal for jobs whose results share a folder: the jobs of a document, or the groups of tiles of one set."""
    if job.place:
        return job.source, job.place
    if not job.tiled:
        return index
    files = next(iter(job.parts.values())).files
    return job.source, _top(job), files.parent if isinstance(files, Path) else files[0].parent


def _of_tile(tile: int, read: Callable[[], _T]) -> _T:
    """What is read of a part; an InputError says which tile it is about."""
    try:
        return read()
    except InputError as error:
        if not tile:
            raise
        raise InputError(f"tile {tile}: {error}") from error
