"""From what a user names to what is baked: folders, archives, tiles, documents, lists and globs of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from mipbake.errors import InputError, UsageError
from mipbake.io import disk
from mipbake.io.archives import Archive, Shelf
from mipbake.io.candidates import is_map, is_textures, name_of, refuse_baked
from mipbake.io.discover import find
from mipbake.io.gltf.document import Document, read_document
from mipbake.io.gltf.materials import GltfBake, read_materials
from mipbake.io.gltf.plain import PlainTexture
from mipbake.io.gltf.specular_glossiness import without_specular_glossiness
from mipbake.io.inputs import expand, kind
from mipbake.io.messages import listed
from mipbake.io.mtlx.materials import read_materialx
from mipbake.io.options import LoadOptions
from mipbake.io.safe_names import safe_name, unique_name
from mipbake.io.sources import Discovery
from mipbake.io.split import Division, divided, resolved
from mipbake.io.tiles import is_pattern, name_with, pattern_files, text_of, tile_options, tiles_of
from mipbake.packing import source_files
from mipbake.stack import MipStack
from mipbake.texture_set import TextureSet, load
from mipbake.udim import CLAMPED, Mosaic, islands, joined, split

_T = TypeVar("_T")


@dataclass(frozen=True)
class Part:
    """What `load` reads one texture set from, and the archive that the files lie in."""

    files: Path | tuple[Path, ...]
    options: LoadOptions
    archive: Archive | None = None

    @property
    def name(self) -> str:
        """Of the texture set; nothing is read."""
        return self.options.name or name_of(self.files)

    def find(self) -> Discovery:
        """What it would read. InputError where it cannot."""
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
        parts: tile number to what it is read from; a single one without a number (0) for sets that are no tiles.
        notes, warnings: what was found in the source, in sentences.
        place: folder of the result's folder, relative to that of all results.
        document, bake: of a glTF source, and which of its bakes this is. plain: all its textures that are averaged.
    """

    source: Path
    parts: Mapping[int, Part]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    place: str = ""
    document: Document | None = None
    bake: GltfBake | None = None
    plain: tuple[PlainTexture, ...] = ()

    @property
    def tiled(self) -> bool:
        """Whether it is about tiles, which share a folder with all others of their source."""
        return 0 not in self.parts

    @property
    def archive(self) -> Archive | None:
        """The archive that it lies in."""
        return next(iter(self.parts.values())).archive

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

    def read(self, change: Callable[[TextureSet], TextureSet] = lambda each: each) -> Read:
        """What is baked, every texture set changed as it is wanted. InputError where it cannot be read."""
        if list(self.parts) == [0]:
            alone = change(self.parts[0].load())
            return Read({0: alone}, alone)
        # Their borders meet other tiles, not their own other sides.
        sets = {tile: change(replace(_of_tile(tile, p.load), wrap=CLAMPED)) for tile, p in self.parts.items()}
        mosaic = joined(sets)
        named = {tile: replace(each, name=mosaic.tiles[tile].name) for tile, each in sets.items()}
        return Read(named, mosaic.texture_set, mosaic)


@dataclass(frozen=True, eq=False)
class Read:
    """What a job holds.

    Args:
        sets: texture sets by tile.
        texture_set: what is baked: the only one, or all tiles side by side.
        mosaic: where the tiles lie in it.
    """

    sets: Mapping[int, TextureSet]
    texture_set: TextureSet
    mosaic: Mosaic | None = field(default=None)

    def stacks(self, baked: MipStack) -> Iterator[tuple[TextureSet, MipStack]]:
        """Every texture set with its own stack."""
        if self.mosaic is None:
            yield self.texture_set, baked
            return
        for tile, stack in split(baked, self.mosaic).items():
            tiled = replace(self.sets[tile], wrap=stack.wrap)
            yield tiled, replace(stack, source_files=source_files(tiled), tile=tile)


def _of_tile(tile: int, read: Callable[[], _T]) -> _T:
    """What is read of a part; an InputError says which tile it is about."""
    try:
        return read()
    except InputError as error:
        if not tile:
            raise
        raise InputError(f"tile {tile}: {error}") from error


def jobs(sources: Sequence[str], options: LoadOptions, scratch: Path) -> list[Job | Failure]:
    """What is to be baked, in order; a source that cannot be read does not keep others from it. All commands and
    `mipbake.load_all` read what they are given through here.

    No two results have one name: sets of one name are called after the folders around them, too.

    Args:
        sources: paths, globs, `@FILE` for a list of paths, `@-` for one on the standard input.
        options: how sets are read; documents say that themselves. Names of files in `maps` may be patterns with *.
        scratch: an empty folder for images that lie within documents and archives, as long as jobs are read.

    Raises:
        InputError: a list or a glob that stands for nothing.
    """
    found: list[Job | Failure] = []
    shelf = Shelf(scratch)
    for index, path in enumerate(expand(sources)):
        try:
            with disk.reading(path):  # a file or folder that went away meanwhile
                if kind(path) == "archive":
                    found += _archived(path, options, shelf, str(index))
                else:
                    found += _jobs_of(path, options, scratch / str(index))
        except (InputError, UsageError) as error:
            found.append(Failure(path, error))
    return with_names_apart(found)


@dataclass(frozen=True)
class Failure:
    """A source, or some of the materials of a document, that cannot be read, and why."""

    source: Path
    error: InputError | UsageError


def _jobs_of(path: Path, options: LoadOptions, scratch: Path) -> Sequence[Job | Failure]:
    what = kind(path)
    if what in ("materialx", "gltf"):
        if options != LoadOptions():
            raise UsageError(f"{path} says itself how its textures are read: leave the options for reading a set out")
        return _materialx(path) if what == "materialx" else _gltf(path, scratch)
    if path.is_dir():
        refuse_baked(path)  # tiles of a stack are tiles, too
    if what == "udim":
        files = list(pattern_files(path).values()) if is_pattern(path) else _files(path)
        return _tiled(path, files, options)
    return _folder(path, options) if what == "folder" else [Job(path, {0: Part(path, options)})]


def _archived(path: Path, options: LoadOptions, shelf: Shelf, place: str) -> list[Job | Failure]:
    """The jobs of an archive: of every folder inside that holds maps."""
    archive = shelf.archive(path, place)

    def inside() -> list[Job | Failure]:
        return [job for folder in _folders_of_maps(archive.folder) for job in _jobs_of(folder, options, archive.folder)]

    made = []
    for job in archive.using(inside):
        if isinstance(job, Job):
            parts = {tile: replace(part, archive=archive) for tile, part in job.parts.items()}
            job = replace(job, source=path, parts=parts)  # noqa: PLW2901
        made.append(job)
    return made


def _folders_of_maps(root: Path) -> list[Path]:
    """Folders in an unpacked archive that hold files with a role, else all that hold images."""
    images: dict[Path, list[Path]] = {}
    for file in sorted(p for p in root.rglob("*") if p.is_file()):
        folder = file.parent
        images.setdefault(folder.parent if folder != root and is_textures(folder) else folder, []).append(file)
    with_maps = [folder for folder, files in images.items() if any(is_map(file) for file in files)]
    return with_maps or list(images)


def _folder(path: Path, options: LoadOptions) -> list[Job | Failure]:
    """The job of a folder, or those of the several sets in it."""
    files = _files(path)
    division = divided(files, options)
    if division is None:
        return [Job(path, {0: Part(path, resolved(options, files, str(path)))})]
    if options.name is not None:
        names = listed(part.name or path.name for part in division.parts)
        raise UsageError(f"{path} holds {len(division.parts)} texture sets, {names}: leave the name out")
    made: list[Job | Failure] = []
    for part in division.parts:
        named = part.name or name_of(path)
        try:
            own = replace(resolved(options, part.files, named), name=safe_name(named, "texture_set"))
            made.append(Job(path, {0: Part(part.files, own)}))
        except InputError as error:
            made.append(Failure(path, error))
    return _told_of_division(made, path, division)


def _told_of_division(made: list[Job | Failure], path: Path, division: Division) -> list[Job | Failure]:
    """The jobs of several sets; the first says what the folder holds."""
    names = [part.name or name_of(path) for part in division.parts]
    note = f"{path} holds {len(names)} texture sets: {listed(names)}"
    left = tuple(f"{file.name} is of none of the sets: left out" for file in division.left_out)
    first = next((index for index, job in enumerate(made) if isinstance(job, Job)), None)
    if first is not None:
        job = made[first]
        if isinstance(job, Job):
            made[first] = replace(job, notes=(note, *job.notes), warnings=(*left, *job.warnings))
    return made


def _files(folder: Path) -> list[Path]:
    """Files of a folder, or of the `textures` folder inside."""
    files = disk.files_in(folder)
    if tiles_of(files):
        return files
    if any(is_map(file) for file in files):
        return files
    inner = [p for p in disk.folders_in(folder) if is_textures(p)]
    return _files(inner[0]) if inner else files


def _tiled(path: Path, files: Sequence[Path], options: LoadOptions) -> list[Job | Failure]:
    """A job for every group of tiles that touch, of every set."""
    if is_pattern(path):
        return list(_groups(path, files, options, _by_pattern(path, options)))
    division = _divided_tiles(tiles_of(files), options)
    if division is None:
        return list(_groups(path, files, options, tiles_of(files)))
    made: list[Job | Failure] = []
    for part in division.parts:
        own = replace(options, name=safe_name(part.name or name_of(path), "texture_set"))
        made += _groups(path, part.files, own, tiles_of(part.files))
    return _told_of_division(made, path, division)


def _groups(path: Path, files: Sequence[Path], options: LoadOptions, found: Mapping[int, Sequence[Path]]) -> list[Job]:
    """A job for every group of tiles that touch."""
    shared = [file for file in files if not any(file in several for several in found.values())]
    notes = (f"{len(found)} UDIM tiles: {listed(found)}",)
    warnings = tuple(f"{file.name} is no tile: left out" for file in shared if not is_pattern(path))
    made = []
    for group in islands(found):
        parts = {}
        for tile in group:
            own = tile_options(options, tile, found[tile][0].parent)
            parts[tile] = Part(tuple(found[tile]), resolved(own, found[tile], f"tile {tile}"))
        made.append(Job(path, parts, notes, warnings))
    return made


def _divided_tiles(found: Mapping[int, Sequence[Path]], options: LoadOptions) -> Division | None:
    """The several sets that tiles are of."""
    tiles = {file: text_of(file.name, tile) for tile, several in found.items() for file in several}
    return divided(list(tiles), options, tiles)


def _by_pattern(path: Path, options: LoadOptions) -> dict[int, list[Path]]:
    """All maps of the tiles whose folder a pattern names, of the set that it is a map of."""
    folder = path.parent
    wanted = pattern_files(path)
    every = tiles_of(disk.files_in(folder))
    division = _divided_tiles(every, options)
    for part in () if division is None else division.parts:
        if all(file in part.files for file in wanted.values()):
            every = tiles_of(part.files)
    return {tile: list(every.get(tile, [file])) for tile, file in wanted.items()}


def with_names_apart(found: Sequence[Job | Failure]) -> list[Job | Failure]:
    """The same jobs, no two results of one name: those that would share one are called after the folder around their
    source, too, or numbered where that is the same.
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
        around = {unit: f"{job.source.resolve().parent.name}_{_top(job)}" for unit, job in units.items()}
        apart = len({name.casefold() for name in around.values()}) == len(units)
        for unit, job in units.items():
            name = unique_name(around[unit], "texture_set", taken) if apart else _top(job)
            if not apart and job is not next(iter(units.values())):
                name = unique_name(_top(job), "texture_set", taken)
            renamed[unit] = (name, f"it is called {name} here, for several are called {_top(job)}: {told}")
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
    """Equal for jobs whose results share a folder: those of a document, the groups of tiles of one set."""
    if job.place:
        return job.source, job.place
    if not job.tiled:
        return index
    files = next(iter(job.parts.values())).files
    return job.source, _top(job), files.parent if isinstance(files, Path) else files[0].parent


def _gltf(path: Path, scratch: Path) -> list[Job | Failure]:
    (scratch / "converted").mkdir(parents=True)
    converted = without_specular_glossiness(read_document(path), scratch / "converted")
    document = converted.document
    (scratch / "images").mkdir()
    found = read_materials(document, scratch / "images")
    place = safe_name(path.stem, "document")
    made = [
        Job(path, {0: Part(b.files, b.options)}, b.notes, b.warnings, place, document, b, found.plain)
        for b in found.bakes
    ]
    notes = (*converted.notes, *found.notes, *made[0].notes)
    warnings = (*converted.warnings, *found.warnings, *made[0].warnings)
    made[0] = replace(made[0], notes=notes, warnings=warnings)
    return [*made, *(Failure(path, InputError(error)) for error in (*converted.errors, *found.errors))]


def _materialx(path: Path) -> list[Job | Failure]:
    found = read_materialx(path)
    made: list[Job | Failure] = []
    for material in found.materials:
        if not material.udim:
            parts = {0: Part(material.files, material.options)}
            made.append(Job(path, parts, material.notes, material.warnings))
            continue
        try:
            tiles = material.tiles()
        except InputError as error:
            made.append(Failure(path, InputError(f"{path}: the material {material.name}: {error}")))
            continue
        for group in islands(tiles):
            parts = {tile: Part(tuple(tiles[tile][0]), tiles[tile][1]) for tile in group}
            made.append(Job(path, parts, material.notes, material.warnings))
    return [*made, *(Failure(path, InputError(error)) for error in found.errors)]
