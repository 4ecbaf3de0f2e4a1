"""From what a user names to what is baked: folders, tiles, glTF and MaterialX documents, lists and globs of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from mipbake.errors import InputError, UsageError
from mipbake.io.discover import find
from mipbake.io.gltf.document import Document, read_document
from mipbake.io.gltf.materials import GltfBake, read_materials
from mipbake.io.gltf.plain import PlainTexture
from mipbake.io.gltf.specular_glossiness import without_specular_glossiness
from mipbake.io.inputs import expand, kind
from mipbake.io.messages import listed
from mipbake.io.mtlx.materials import read_materialx
from mipbake.io.options import LoadOptions
from mipbake.io.safe_names import safe_name
from mipbake.io.sources import Discovery
from mipbake.io.tiles import is_pattern, pattern_files, tile_options, tiles_of
from mipbake.packing import source_files
from mipbake.stack import MipStack
from mipbake.texture_set import TextureSet, load
from mipbake.udim import CLAMPED, Mosaic, islands, joined, split

_T = TypeVar("_T")


@dataclass(frozen=True)
class Part:
    """What `load` reads one texture set from."""

    files: Path | tuple[Path, ...]
    options: LoadOptions

    def find(self) -> Discovery:
        """What it would read. InputError where it cannot."""
        return find(self.files, self.options)

    def load(self) -> TextureSet:
        """The texture set. InputError where it cannot be read."""
        return load(self.files, self.options)


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
    """What is to be baked, in order; a source that cannot be read does not keep others from it.

    Args:
        sources: paths, globs, `@FILE` for a list of paths.
        options: how sets are read; documents say that themselves.
        scratch: an empty folder for images that lie within documents, as long as jobs are read.

    Raises:
        InputError: a list or a glob that stands for nothing.
    """
    found: list[Job | Failure] = []
    for index, path in enumerate(expand(sources)):
        try:
            found += _jobs_of(path, options, scratch / str(index))
        except (InputError, UsageError) as error:
            found.append(Failure(path, error))
        except OSError as error:  # a name that is too long, here or in a document; a folder that went away meanwhile
            reason = f"{error.strerror}, {str(error.filename)[:80]}"
            found.append(
                Failure(path, InputError(f"{path} cannot be read ({reason}): check the name, and that it is there"))
            )
    return found


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
    if what == "udim":
        files = list(pattern_files(path).values()) if is_pattern(path) else _files(path)
        return _tiled(path, files, options)
    return [Job(path, {0: Part(path, options)})]


def _files(folder: Path) -> list[Path]:
    """Files of a folder, or of the `textures` folder inside."""
    files = sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
    if tiles_of(files):
        return files
    inner = [p for p in folder.iterdir() if p.is_dir() and p.name.lower() == "textures"]
    return _files(inner[0]) if inner else files


def _tiled(path: Path, files: Sequence[Path], options: LoadOptions) -> list[Job]:
    """A job for every group of tiles that touch."""
    found = tiles_of(files) if not is_pattern(path) else _by_pattern(path)
    shared = [file for file in files if not any(file in several for several in found.values())]
    notes = (f"{len(found)} UDIM tiles: {listed(found)}",)
    warnings = tuple(f"{file.name} is no tile: left out" for file in shared if not is_pattern(path))
    made = []
    for group in islands(found):
        parts = {tile: Part(tuple(found[tile]), tile_options(options, tile, found[tile][0].parent)) for tile in group}
        made.append(Job(path, parts, notes, warnings))
    return made


def _by_pattern(path: Path) -> dict[int, list[Path]]:
    """All maps of the tiles whose folder a pattern names."""
    folder = path.parent
    wanted = pattern_files(path)
    every = tiles_of(sorted(p for p in folder.iterdir() if p.is_file()))
    return {tile: list(every.get(tile, [file])) for tile, file in wanted.items()}


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
