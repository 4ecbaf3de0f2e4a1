"""Turns what a user names into what is baked: folders, archives, tiles, documents, lists and globs of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from mipbake.base import disk
from mipbake.base.errors import InputError, UsageError
from mipbake.base.messages import listed
from mipbake.base.safe_names import safe_name
from mipbake.source.archives import GLTF, LIMITS, MATERIALX, Limits, Shelf
from mipbake.source.gltf.document import Document, read_document
from mipbake.source.gltf.images import image_files
from mipbake.source.gltf.materials import read_materials
from mipbake.source.gltf.specular_glossiness import without_specular_glossiness
from mipbake.source.images.read import IMAGE_SUFFIXES
from mipbake.source.inputs import expand, kind
from mipbake.source.jobs import Failure, Job, SetFiles, with_names_apart
from mipbake.source.matches import is_map, is_textures, name_of, refuse_baked
from mipbake.source.mtlx.materials import MtlxMaterials, read_materialx
from mipbake.source.options import LoadOptions
from mipbake.source.split import Division, divided, resolved
from mipbake.source.tiles import is_pattern, pattern_files, text_of, tile_options, tiles_of
from mipbake.source.udim import islands


def jobs(sources: Sequence[str], options: LoadOptions, scratch: Path, limits: Limits = LIMITS) -> list[Job | Failure]:
    """What is to be baked, in order; a source that cannot be read does not keep others from it. All commands and
    `mipbake.load_all` read what they are given through here.

    No two results have one name: sets of one name are also called after the folders around them.

    Args:
        sources: paths, globs, `@FILE` for a list of paths, `@-` for one on the standard input.
        options: how sets are read; documents say that themselves. Names of files in `maps` may be patterns with *.
        scratch: an empty folder for images that lie within documents and archives, as long as jobs are read.
        limits: how large archives may be.

    Raises:
        InputError: a list or a glob that stands for nothing.
    """
    found: list[Job | Failure] = []
    shelf = Shelf(scratch, limits)
    for index, path in enumerate(expand(sources)):
        found += _attempted(path, partial(_jobs_of, path, options, scratch / str(index), shelf))
    return with_names_apart(found)


def files_of_set(files: tuple[Path, ...], options: LoadOptions, what: str = "", tile: int = 0) -> SetFiles:
    """One of several sets in a folder, or a tile of one: patterns among the maps stand for its own files.

    Args:
        files: of the set or tile. options: of the set. what: how messages call a set. tile: its number, 0 for none.

    Raises:
        InputError: a pattern matches several of the files; a tile has no normal or no roughness map.
    """
    own = tile_options(options, tile, files[0].parent) if tile else options
    return SetFiles(files, resolved(own, files, f"tile {tile}" if tile else what))


def _attempted(source: Path, read: Callable[[], Sequence[Job | Failure]]) -> Sequence[Job | Failure]:
    """The jobs of a source, or what is wrong with it."""
    try:
        with disk.reading(source):  # a file or folder that went away meanwhile
            return read()
    except (InputError, UsageError) as error:
        return [Failure(source, error)]


def _jobs_of(path: Path, options: LoadOptions, scratch: Path, shelf: Shelf) -> Sequence[Job | Failure]:
    what = kind(path)
    if what == "archive":
        return _archived(path, options, scratch, shelf)
    if what == "materialx":
        return _materialx(path, read_materialx(path), options)
    if what == "gltf":
        return _gltf(path, read_document(path), options, scratch)
    if path.is_dir():
        refuse_baked(path)  # tiles of a stack are tiles as well
    if what == "udim":
        files = list(pattern_files(path).values()) if is_pattern(path) else _files(path)
        return _tiled(path, files, options)
    return _folder(path, options) if what == "folder" else [Job(path, {0: SetFiles(path, options)})]


def _archived(path: Path, options: LoadOptions, scratch: Path, shelf: Shelf) -> list[Job | Failure]:
    """The jobs of an archive: of every document inside, and of every folder that holds maps of no document."""
    archive = shelf.archive(path, f"{scratch.name}/archive")

    def told(made: Job | Failure) -> Job | Failure:
        """With the archive in place of the folder that it is unpacked to."""
        source = Path(archive.told(str(made.source))) if made.source.is_file() else path
        if isinstance(made, Failure):
            return Failure(source, type(made.error)(archive.about(made.error)))
        notes, warnings = (tuple(map(archive.told, sentences)) for sentences in (made.notes, made.warnings))
        parts = {tile: replace(part, archive=archive) for tile, part in made.parts.items()}
        return replace(made, source=source, parts=parts, notes=notes, warnings=warnings)

    return archive.using(lambda: [told(made) for made in _unpacked(archive.folder, options, scratch, shelf)])


def _unpacked(root: Path, options: LoadOptions, scratch: Path, shelf: Shelf) -> list[Job | Failure]:
    """The jobs of an unpacked archive. What a document says of its textures holds, so their folder is no source; but
    names are enough where they tell a set beside a MaterialX document, as in downloads that hold both.
    """
    files = sorted(path for path in root.rglob("*") if path.is_file())
    images: dict[Path, list[Path]] = {}
    for file in _with_suffix(files, IMAGE_SUFFIXES):
        folder = file.parent
        images.setdefault(folder.parent if folder != root and is_textures(folder) else folder, []).append(file)
    made: list[Job | Failure] = []
    taken: set[Path] = set()
    notes: dict[Path, str] = {}

    def gltf(file: Path, place: Path) -> Sequence[Job | Failure]:
        document = read_document(file)
        taken.update(map(_normal, image_files(document, root)))
        return _gltf(file, document, options, place)

    def materialx(file: Path) -> Sequence[Job | Failure]:
        found = read_materialx(file, root)
        taken.update(_normal(each) for material in found.materials for each in material.files)
        return _materialx(file, found, options)

    def sets(folder: Path) -> Sequence[Job | Failure]:
        return _attempted(folder, partial(_jobs_of, folder, options, scratch, shelf))

    for index, file in enumerate(_with_suffix(files, GLTF)):
        made += _attempted(file, partial(gltf, file, scratch / str(index)))
    for file in _with_suffix(files, (MATERIALX,)):
        beside = images.get(file.parent, [])
        if beside and taken.isdisjoint(beside) and _are_told(sets(file.parent)):
            notes[file.parent] = f"{file.name} is left out: the names of the maps beside it say what they are"
        else:
            taken.update(beside)
            made += _attempted(file, partial(materialx, file))
    images = {folder: inside for folder, inside in images.items() if taken.isdisjoint(inside)}
    with_maps = [folder for folder, inside in images.items() if any(map(is_map, inside))]
    for folder in with_maps or ([] if made else images):
        first, *others = sets(folder)
        if isinstance(first, Job) and folder in notes:
            first = replace(first, notes=(*first.notes, notes[folder]))
        made += [first, *others]
    return made


def _are_told(found: Sequence[Job | Failure]) -> bool:
    """Whether nothing is missing in what names tell of a folder."""
    try:
        return all(isinstance(job, Job) and job.found() for job in found)
    except InputError:
        return False


def _with_suffix(files: Iterable[Path], suffixes: Collection[str]) -> list[Path]:
    return [file for file in files if file.suffix.lower() in suffixes]


def _normal(path: Path) -> Path:
    """The path without steps up, so that it can be compared."""
    return Path(os.path.normpath(path))


def _folder(path: Path, options: LoadOptions) -> list[Job | Failure]:
    """The job of a folder, or the jobs of the several sets in it."""
    files = _files(path)
    division = divided(files, options)
    if division is None:
        return [Job(path, {0: SetFiles(path, resolved(options, files, str(path)))})]
    if options.name is not None:
        names = listed(part.name or path.name for part in division.parts)
        raise UsageError(f"{path} holds {len(division.parts)} texture sets, {names}: leave the name out")
    made: list[Job | Failure] = []
    for part in division.parts:
        named = part.name or name_of(path)
        try:
            own = replace(options, name=safe_name(named, "texture_set"))
            made.append(Job(path, {0: files_of_set(part.files, own, named)}))
        except InputError as error:
            made.append(Failure(path, error))
    return _told_of_division(made, path, division)


def _told_of_division(made: list[Job | Failure], path: Path, division: Division) -> list[Job | Failure]:
    """The jobs of several sets; the first says what the folder holds."""
    names = [part.name or name_of(path) for part in division.parts]
    note = f"{path} holds {len(names)} texture sets: {listed(names)}"
    left = tuple(f"{file.name} belongs to none of the sets, and is left out" for file in division.left_out)
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
    of_tiles = {file for several in found.values() for file in several}
    shared = [file for file in files if file not in of_tiles]
    notes = (f"{len(found)} UDIM tiles: {listed(found)}",)
    warnings = tuple(f"{file.name} is not a tile, and is left out" for file in shared if not is_pattern(path))
    made = []
    for group in islands(found):
        parts = {tile: files_of_set(tuple(found[tile]), options, tile=tile) for tile in group}
        made.append(Job(path, parts, notes, warnings))
    return made


def _divided_tiles(found: Mapping[int, Sequence[Path]], options: LoadOptions) -> Division | None:
    """The several sets that tiles are of."""
    tiles = {file: text_of(file.name, tile) for tile, several in found.items() for file in several}
    return divided(list(tiles), options, tiles)


def _by_pattern(path: Path, options: LoadOptions) -> dict[int, list[Path]]:
    """All maps of the tiles whose folder a pattern names, for the set that the pattern belongs to."""
    folder = path.parent
    wanted = pattern_files(path)
    every = tiles_of(disk.files_in(folder))
    division = _divided_tiles(every, options)
    for part in () if division is None else division.parts:
        if all(file in part.files for file in wanted.values()):
            every = tiles_of(part.files)
    return {tile: list(every.get(tile, [file])) for tile, file in wanted.items()}


def _check_no_options(path: Path, options: LoadOptions) -> None:
    if options != LoadOptions():
        raise UsageError(f"{path} says itself how its textures are read: leave out the options for reading a set")


def _gltf(path: Path, read: Document, options: LoadOptions, scratch: Path) -> list[Job | Failure]:
    """The jobs of a glTF document; `scratch` takes its images, as long as jobs are read."""
    _check_no_options(path, options)
    (scratch / "converted").mkdir(parents=True)
    converted = without_specular_glossiness(read, scratch / "converted")
    document = converted.document
    (scratch / "images").mkdir()
    found = read_materials(document, scratch / "images")
    place = safe_name(path.stem, "document")
    made = [
        Job(path, {0: SetFiles(b.files, b.options)}, b.notes, b.warnings, place, document, b, found.plain)
        for b in found.bakes
    ]
    notes = (*converted.notes, *found.notes, *made[0].notes)
    warnings = (*converted.warnings, *found.warnings, *made[0].warnings)
    made[0] = replace(made[0], notes=notes, warnings=warnings)
    return [*made, *(Failure(path, InputError(error)) for error in (*converted.errors, *found.errors))]


def _materialx(path: Path, found: MtlxMaterials, options: LoadOptions) -> list[Job | Failure]:
    """The jobs of a MaterialX document."""
    _check_no_options(path, options)
    made: list[Job | Failure] = []
    for material in found.materials:
        if not material.udim:
            parts = {0: SetFiles(material.files, material.options)}
            made.append(Job(path, parts, material.notes, material.warnings))
            continue
        try:
            tiles = material.tiles()
        except InputError as error:
            made.append(Failure(path, InputError(f"{path}: the material {material.name}: {error}")))
            continue
        for group in islands(tiles):
            parts = {tile: SetFiles(tuple(tiles[tile][0]), tiles[tile][1]) for tile in group}
            made.append(Job(path, parts, material.notes, material.warnings))
    return [*made, *(Failure(path, InputError(error)) for error in found.errors)]
