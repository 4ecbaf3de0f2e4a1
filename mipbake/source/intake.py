"""Turns what a user names into what is baked: folders, archives, tiles, documents, lists and globs of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mipbake.base import disk
from mipbake.base.errors import InputError, UsageError
from mipbake.base.messages import listed
from mipbake.base.safe_names import safe_name
from mipbake.source.archives import GLTF, MATERIALX, SUFFIX, Shelf
from mipbake.source.gltf.document import Document, read_document
from mipbake.source.gltf.images import image_files
from mipbake.source.gltf.materials import read_materials
from mipbake.source.gltf.specular_glossiness import without_specular_glossiness
from mipbake.source.images.read import IMAGE_SUFFIXES
from mipbake.source.inputs import expand, kind
from mipbake.source.jobs import Failure, Job, SetFiles, with_names_apart
from mipbake.source.matches import files_of_folder, is_map, is_textures, name_of, refuse_baked
from mipbake.source.options import LoadOptions
from mipbake.source.split import divided, resolved
from mipbake.source.tiles import is_pattern, pattern_files, text_of, tile_options, tiles_of
from mipbake.source.udim import islands

if TYPE_CHECKING:
    from mipbake.source.mtlx.materials import MtlxMaterials


def jobs(sources: Sequence[str], options: LoadOptions, scratch: Path) -> list[Job | Failure]:
    """What is to be baked, in order; a source that cannot be read does not keep others from it. All commands,
    `mipbake.load` and `mipbake.load_all` read what they are given through here.

    No two results have one name: sets of one name are also called after the folders around them.

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
        found += _attempted(path, partial(_jobs_of, path, options, scratch / str(index), shelf))
    return with_names_apart(found)


def files_of_set(files: tuple[Path, ...], options: LoadOptions, what: str = "", tile: int = 0) -> SetFiles:
    """One of several sets in a folder, or a tile of one (0: none): patterns among the maps stand for its own files.
    `what`: how messages call a set. InputError where a pattern matches several of the files, or a tile has no normal or
    no roughness map."""
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
        return _materialx(path, _read_materialx(path), options)
    if what == "gltf":
        return _gltf(path, read_document(path), options, scratch)
    if what == "file":
        raise InputError(f"{path} is a file, a single map: expected the folder that holds all maps of the set")
    if is_pattern(path):
        return _groups(path, list(pattern_files(path).values()), options, _by_pattern(path, options))
    refuse_baked(path)  # tiles of a stack are tiles as well
    files = files_of_folder(path)
    if not any(file.suffix.lower() in IMAGE_SUFFIXES for file in files) and not options.maps:
        raise InputError(_without_images(path, files))
    refuse_baked(files[0].parent)
    return _tiled(path, files, options) if what == "udim" else _folder(path, files, options)


def _without_images(path: Path, files: Sequence[Path]) -> str:
    """What is wrong with a folder that holds no image, and what was meant."""
    folders, packed = disk.folders_in(path), _with_suffix(files, (*GLTF, MATERIALX, SUFFIX))
    if not files and not folders:
        return f"{path} is empty: expected the maps of one texture set, such as wood_normal.png and wood_roughness.png"
    meant = [*(each for each in folders if any(map(is_map, files_of_folder(each)))), *packed]
    below = "; `mipbake bake --recursive` bakes all that lies below" if folders or packed else ""
    return (
        f"{path} holds no images: expected the maps of one texture set"
        f"{f' as in {listed(meant)}' if meant else ''}{below}"
    )


def _archived(path: Path, options: LoadOptions, scratch: Path, shelf: Shelf) -> list[Job | Failure]:
    """The jobs of an archive: of every document inside, and of every folder that holds maps of no document."""
    archive = shelf.archive(path, f"{scratch.name}/archive")

    def named(made: Job | Failure) -> Job | Failure:
        """With the archive in place of the folder that it is unpacked to."""
        source = Path(archive.renamed(str(made.source))) if made.source.is_file() else path
        if isinstance(made, Failure):
            return Failure(source, type(made.error)(archive.about(made.error)))
        notes, warnings = (tuple(map(archive.renamed, sentences)) for sentences in (made.notes, made.warnings))
        return replace(made, source=source, archive=archive, notes=notes, warnings=warnings)

    return archive.using(lambda: [named(made) for made in _unpacked(archive.folder, options, scratch, shelf)])


def _unpacked(root: Path, options: LoadOptions, scratch: Path, shelf: Shelf) -> list[Job | Failure]:
    """The jobs of an unpacked archive. What a document says of its textures holds, so their folder is no source; but
    names are enough where they say all of a set beside a MaterialX document, as in downloads that hold both.
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
        found = _read_materialx(file, root)
        taken.update(_normal(each) for material in found.materials for each in material.files)
        return _materialx(file, found, options)

    def sets(folder: Path) -> Sequence[Job | Failure]:
        return _attempted(folder, partial(_jobs_of, folder, options, scratch, shelf))

    for index, file in enumerate(_with_suffix(files, GLTF)):
        made += _attempted(file, partial(gltf, file, scratch / str(index)))
    for file in _with_suffix(files, (MATERIALX,)):
        beside = images.get(file.parent, [])
        if beside and taken.isdisjoint(beside) and _are_complete(sets(file.parent)):
            notes[file.parent] = f"{file.name} is left out: the names of the maps beside it say what they are"
        else:
            taken.update(beside)
            made += _attempted(file, partial(materialx, file))
    images = {folder: inside for folder, inside in images.items() if taken.isdisjoint(inside)}
    with_maps = [folder for folder, inside in images.items() if any(map(is_map, inside))]
    for folder in with_maps or ([] if made else images):
        made += _noted(sets(folder), [notes[folder]] if folder in notes else [])
    return made


def _are_complete(found: Sequence[Job | Failure]) -> bool:
    """Whether nothing is missing in what names say of a folder."""
    try:
        return all(isinstance(job, Job) and job.found() for job in found)
    except InputError:
        return False


def _with_suffix(files: Iterable[Path], suffixes: Collection[str]) -> list[Path]:
    return [file for file in files if file.suffix.lower() in suffixes]


def _normal(path: Path) -> Path:
    """The path without steps up, so that it can be compared."""
    return Path(os.path.normpath(path))


def _noted(
    made: Sequence[Job | Failure], notes: Sequence[str], warnings: Sequence[str] = ()
) -> Sequence[Job | Failure]:
    """Jobs, the first of which says what holds for all of them."""
    noted = list(made)
    for index, job in enumerate(noted):
        if isinstance(job, Job):
            noted[index] = replace(job, notes=(*notes, *job.notes), warnings=(*warnings, *job.warnings))
            break
    return noted


def _folder(path: Path, files: Sequence[Path], options: LoadOptions) -> Sequence[Job | Failure]:
    """The job of a folder, or the jobs of the several sets in it."""
    sets = divided(files, options)
    if not sets:
        return [Job(path, {0: files_of_set(tuple(files), options, str(path))})]
    return _several(path, files, sets, options, lambda *own: [Job(path, {0: files_of_set(*own)})])


def _several(
    path: Path,
    files: Sequence[Path],
    sets: Mapping[str, tuple[Path, ...]],
    options: LoadOptions,
    jobs_of: Callable[[tuple[Path, ...], LoadOptions, str], Sequence[Job]],
) -> Sequence[Job | Failure]:
    """The jobs of several sets in a folder, each from its files, its options and its name; one that cannot be read does
    not keep others from it."""
    made: list[Job | Failure] = []
    names = [name or name_of(path) for name in sets]
    if options.name is not None:
        raise UsageError(f"{path} holds {len(sets)} texture sets, {listed(names)}: leave the name out")
    for name, own in zip(names, sets.values(), strict=True):
        asked = replace(options, name=safe_name(name, "texture_set"))
        made += _attempted(path, partial(jobs_of, own, asked, name))
    taken = {file for own in sets.values() for file in own}
    left = [file.name for file in _with_suffix(files, IMAGE_SUFFIXES) if file not in taken]
    note = f"{path} holds {len(names)} texture sets: {listed(names)}"
    return _noted(made, [note], [f"{name} belongs to none of the sets, and is left out" for name in left])


def _tiled(path: Path, files: Sequence[Path], options: LoadOptions) -> Sequence[Job | Failure]:
    """A job for every group of tiles that touch, of every set in a folder."""
    found = tiles_of(files)
    sets = _divided_tiles(found, options)
    if not sets:
        return _groups(path, files, options, found)
    of_tiles = [file for several in found.values() for file in several]
    return _several(path, of_tiles, sets, options, lambda own, asked, _: _groups(path, own, asked, tiles_of(own)))


def _groups(path: Path, files: Sequence[Path], options: LoadOptions, found: Mapping[int, Sequence[Path]]) -> list[Job]:
    """A job for every group of tiles that touch."""
    of_tiles = {file for several in found.values() for file in several}
    shared = [file for file in files if file not in of_tiles]
    notes = (f"{len(found)} UDIM tiles: {listed(found)}",)
    warnings = tuple(f"{file.name} is not a tile, and is left out" for file in shared if not is_pattern(path))
    return [
        Job(path, {tile: files_of_set(tuple(found[tile]), options, tile=tile) for tile in group}, notes, warnings)
        for group in islands(found)
    ]


def _divided_tiles(found: Mapping[int, Sequence[Path]], options: LoadOptions) -> Mapping[str, tuple[Path, ...]]:
    """The several sets that tiles are of."""
    tiles = {file: text_of(file.name, tile) for tile, several in found.items() for file in several}
    return divided(list(tiles), options, tiles)


def _by_pattern(path: Path, options: LoadOptions) -> dict[int, list[Path]]:
    """All maps of the tiles whose folder a pattern names, for the set that the pattern belongs to."""
    wanted = pattern_files(path)
    every = tiles_of(disk.files_in(path.parent))
    for own in _divided_tiles(every, options).values():
        if all(file in own for file in wanted.values()):
            every = tiles_of(own)
    return {tile: list(every.get(tile, [file])) for tile, file in wanted.items()}


def _check_no_options(path: Path, options: LoadOptions) -> None:
    if options != LoadOptions():
        raise UsageError(f"{path} says itself how its textures are read: leave out the options for reading a set")


def _gltf(path: Path, read: Document, options: LoadOptions, scratch: Path) -> list[Job | Failure]:
    """The jobs of a glTF document; `scratch` takes its images, as long as jobs are read."""
    _check_no_options(path, options)
    (scratch / "converted").mkdir(parents=True)
    converted = without_specular_glossiness(read, scratch / "converted")
    (scratch / "images").mkdir()
    found = read_materials(converted.document, scratch / "images")
    place, document = safe_name(path.stem, "document"), converted.document
    made = [
        Job(path, {0: SetFiles(b.files, b.options)}, b.notes, b.warnings, place, None, document, b, found.plain)
        for b in found.bakes
    ]
    noted = _noted(made, (*converted.notes, *found.notes), (*converted.warnings, *found.warnings))
    return [*noted, *(Failure(path, InputError(error)) for error in (*converted.errors, *found.errors))]


def _read_materialx(path: Path, root: Path | None = None) -> MtlxMaterials:
    """A MaterialX document, whose reader other sources need not load."""
    from mipbake.source.mtlx.materials import read_materialx

    return read_materialx(path, root)


def _materialx(path: Path, found: MtlxMaterials, options: LoadOptions) -> list[Job | Failure]:
    """The jobs of a MaterialX document."""
    _check_no_options(path, options)
    made: list[Job | Failure] = []
    for material in found.materials:
        try:
            tiles = material.tiles()
        except InputError as error:
            made.append(Failure(path, InputError(f"{path}: the material {material.name}: {error}")))
            continue
        parts = {tile: SetFiles(tuple(files), own) for tile, (files, own) in tiles.items()}
        apart = [{tile: parts[tile] for tile in group} for group in islands(parts)]
        whole = {0: SetFiles(material.files, material.options)}
        made += [Job(path, each, material.notes, material.warnings) for each in apart or [whole]]
    return [*made, *(Failure(path, InputError(error)) for error in found.errors)]
