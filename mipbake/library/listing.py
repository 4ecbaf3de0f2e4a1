"""What a library holds: every texture set, document and archive below a folder, and where the result of each lies.

Results keep the tree of the library. The result of a set lies in OUT/PATH/SET, and the GLB of a document in OUT/PATH.
PATH is that of the source, relative to the library, and with its suffix. A source that is named itself is its own
library: the result lies in OUT/SET. So no place depends on what else the library holds.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TypeAlias

from mipbake.base import disk
from mipbake.base.errors import InputError, UsageError
from mipbake.base.json_text import parsed
from mipbake.base.safe_names import safe_name
from mipbake.source.archives import GLTF, MATERIALX, SUFFIX
from mipbake.source.gltf.document import read_document
from mipbake.source.gltf.images import image_files
from mipbake.source.images.read import IMAGE_SUFFIXES
from mipbake.source.inputs import expand, kind
from mipbake.source.intake import files_of_set, jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.layout import SCHEMA, manifests
from mipbake.source.matches import is_map, is_textures, name_of
from mipbake.source.mtlx.materials import read_materialx
from mipbake.source.names import interpretations
from mipbake.source.options import LoadOptions

PathLike: TypeAlias = "str | os.PathLike[str]"


@dataclass(frozen=True)
class Entry:
    """A source of a library.

    Args:
        source: a path that `mipbake.load_all` takes. label: what the entry is called, unique in its library.
        place: the folder that its sets have their folders in, relative to the folder of all results.
        name: of its set, as far as names of files say it; "" where a source must be read for it.
        part: of one of several sets in a folder, what is baked at once: all of it, or tiles that touch; else empty.
        rival: the source whose result lies where the result of this entry would; None where there is none.
    """

    source: Path
    label: str
    place: PurePath
    name: str = ""
    part: tuple[Job, ...] = ()
    rival: Path | None = None

    @property
    def result(self) -> PurePath:
        """The folder that all its results lie in, relative to the folder of all results, as far as it is known."""
        return self.place / self.name

    @property
    def files(self) -> list[Path]:
        """All files of one of several sets in a folder."""
        return [file for job in self.part for each in job.parts.values() for file in each.files]

    def jobs(self, load: LoadOptions, scratch: Path) -> list[Job | Failure]:
        """What is to be baked of it. The options may be others than those that told several sets apart.

        Args:
            scratch: an empty folder, see `mipbake.source.intake.jobs`.
        """
        if not self.part:
            return jobs([os.fspath(self.source)], load, scratch)
        own = replace(load, name=load.name or self.name)
        made: list[Job | Failure] = []
        try:
            for job in self.part:
                parts = {t: files_of_set(each.files, own, self.name, t) for t, each in job.parts.items()}
                made.append(Job(self.source, parts, job.notes, job.warnings))
        except (InputError, UsageError) as error:
            return [Failure(self.source, error)]
        return made


@dataclass(frozen=True)
class Library:
    """What was found below folders.

    Args:
        entries: by their labels.
        notes: what was left out and why, in sentences.
    """

    entries: tuple[Entry, ...]
    notes: tuple[str, ...] = ()


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
    if recursive:
        library = entries_below(paths, out)
    else:
        library = Library(tuple(Entry(path, str(path), PurePath()) for path in paths))
    for place in within:
        if not any(disk.lies_in(entry.source, place) for entry in library.entries):
            raise InputError(f"{place} holds nothing of the library: expected a source in it, or a folder around some")
    kept = [
        entry
        for entry in _apart(each for entry in library.entries for each in _sets_of(entry, load(entry.label)))
        if not within or any(disk.lies_in(entry.source, place) for place in within)
    ]
    return replace(library, entries=tuple(kept) if shard is None else shard.of(kept))


def _sets_of(entry: Entry, load: LoadOptions) -> list[Entry]:
    """The same entry with the name of its set, or an entry for each set in its folder."""
    source = entry.source
    around = "" if entry.label == "." else f"{entry.label}/"
    if sets := sets_in(source, load):
        return [replace(entry, label=f"{around}{name}", name=name, part=part) for name, part in sets.items()]
    if source.suffix.lower() in GLTF:
        return [replace(entry, name=safe_name(source.stem, "document"))]
    return [replace(entry, name=load.name or name_of(source))] if disk.is_dir(source) else [entry]


def _apart(entries: Iterable[Entry]) -> Iterator[Entry]:
    """The same entries, with labels that are unique, and with rivals: no result is or holds the result of another."""
    labels: set[str] = set()
    results: dict[PurePath, Path] = {}
    around: dict[PurePath, Path] = {}
    for entry in entries:
        label, count = entry.label, 2
        while label in labels:  # a folder in the folder has the name of a set in it
            label, count = f"{entry.label}_{count}", count + 1
        labels.add(label)
        path, rival = entry.result, None
        if path.parts:
            rival = next((results[p] for p in (path, *path.parents) if p in results), around.get(path))
        if path.parts and rival is None:
            results[path] = entry.source
            around.update(dict.fromkeys(path.parents, entry.source))
        yield replace(entry, label=label, rival=rival)


def sets_in(folder: Path, load: LoadOptions) -> dict[str, tuple[Job, ...]]:
    """The several sets in a folder, as names tell them: name to what is baked at once of a set. Empty where there is a
    single set, or something is wrong with the folder, which its own turn will say.

    Args:
        load: how it is read; patterns in its maps tell sets apart, too.
    """
    sets: dict[str, tuple[Job, ...]] = {}
    for job in jobs([str(folder)], load, folder) if disk.is_dir(folder) else ():  # which needs no temporary files
        if isinstance(job, Failure):
            return {}
        sets[job.name] = (*sets.get(job.name, ()), job)
    return sets if len(sets) > 1 else {}


def entries_below(roots: Sequence[Path], out: Path) -> Library:
    """Everything below folders that can be baked. Hidden folders, stacks and the folder of all results are passed over.

    Args:
        roots: the folders. What is no folder is a source by itself.
        out: the folder of all results, which may lie in one of them.

    Raises:
        InputError: a folder does not exist, or nothing below all of them can be baked.
    """
    found: dict[Path, tuple[Path, Path]] = {}
    notes: list[str] = []
    for root in roots:
        walked = kind(root) in ("folder", "udim") and disk.is_dir(root)
        for path in _Walk(disk.resolved(out), notes).sources(root) if walked else [root]:
            found.setdefault(disk.resolved(path), (path, root))  # one root may lie in another
    if not found:
        hint = f"; {notes[0]}" if notes else ""
        if any(disk.resolved(root) == disk.resolved(out) for root in roots):
            hint = "; it is the folder of all results, which is passed over, so choose another one"
        raise InputError(
            f"nothing below {', '.join(map(str, roots))} can be baked: expected folders of maps, documents or "
            f"archives{hint}"
        )
    entries = []
    for path, root in found.values():
        place = PurePath(path.relative_to(root))
        label = path.name if path == root and not root.is_dir() else place.as_posix()
        entries.append(Entry(path, str(path) if len(roots) > 1 else label, place))
    return Library(tuple(entries), tuple(notes))


class _Walk:
    """A walk through a library, folder by folder, in the order of names; links to folders come last, because what lies
    in the library itself is called as it lies there."""

    def __init__(self, out: Path, notes: list[str]) -> None:
        self._out = out
        self._notes = notes
        self._seen: set[Path] = set()
        self._links: list[Path] = []

    def sources(self, root: Path) -> Iterator[Path]:
        """What can be baked in a folder and below it. One that cannot be listed is a source, whose bake says so."""
        yield from self._below(root, ())
        while self._links:
            link = self._links.pop(0)
            real, around = disk.resolved(link), disk.resolved(link.parent)
            if real in self._seen and real not in (around, *around.parents):
                self._notes.append(f"{link} is left out: it is a link to {real}, which is found by itself")
            yield from self._below(link, ())

    def _below(self, folder: Path, above: Sequence[Path]) -> Iterator[Path]:
        """`above`: documents beside the folder, which may show images in it."""
        real = disk.resolved(folder)
        if real in self._seen or real == self._out:  # links may lead round
            return
        self._seen.add(real)
        try:
            files, folders = disk.files_in(folder), disk.folders_in(folder)
        except InputError:
            yield folder
            return
        if _is_result(folder):
            return
        documents = [file for file in files if file.suffix.lower() in (*GLTF, MATERIALX)]
        inner = next((each for each in folders if is_textures(each)), None)
        maps, own_maps = [file for file in files if is_map(file)], True
        if not maps and inner is not None:
            with suppress(InputError):
                maps, own_maps = [file for file in disk.files_in(inner) if is_map(file)], False
        is_set = bool(maps)
        if documents and maps:
            if _are_a_set(maps) and all(each.suffix.lower() == MATERIALX for each in documents):
                self._notes += [
                    f"{each} is left out: the names of the maps beside it say what they are" for each in documents
                ]
                documents = []  # as in downloads that hold both
            shown = _shown(documents)
            is_set = _are_a_set([file for file in maps if disk.resolved(file) not in shown])
        if is_set:
            yield folder
        yield from (file for file in documents if not _is_baked(file))
        yield from (file for file in files if file.suffix.lower() == SUFFIX)
        images = {disk.resolved(file) for file in files if file.suffix.lower() in IMAGE_SUFFIXES}
        if images and not is_set and not documents and not images <= _shown(above):
            self._notes.append(f"{folder} is left out: the names of its images tell no map")
        belongs = inner if documents or (is_set and not own_maps) else None  # to what was named
        self._seen.update(disk.resolved(each) for each in folders if each == belongs)
        for each in (folder for folder in folders if folder != belongs):
            if each.is_symlink():
                self._links.append(each)
            else:
                yield from self._below(each, documents)


def _shown(documents: Sequence[Path]) -> set[Path]:
    """The images that documents show. What is wrong with a broken one is said when it is baked."""
    found: set[Path] = set()
    for document in documents:
        with suppress(InputError):
            if document.suffix.lower() == MATERIALX:
                shown = [file for material in read_materialx(document).materials for file in material.files]
            else:
                shown = list(image_files(read_document(document), Path(disk.resolved(document).anchor)))
            found.update(map(disk.resolved, shown))
    return found


def _are_a_set(maps: Sequence[Path]) -> bool:
    """Whether names say the two maps that a set cannot be without."""
    meanings = [meaning for file in maps for name in interpretations(file.stem) for meaning in name.meanings]
    return {"normal", "roughness"} <= {meaning.role for meaning in meanings}


def _is_baked(document: Path) -> bool:
    """Whether a document is a GLB that was baked already."""
    if document.suffix.lower() != ".glb":
        return False
    try:
        with document.open("rb") as file:
            header = file.read(20)
            text = file.read(int.from_bytes(header[12:16], "little")) if header[:4] == b"glTF" else b""
        return "mipbake" in parsed(text)["asset"]["extras"]
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _is_result(folder: Path) -> bool:
    """Whether a folder holds a stack, which is baked already."""
    for file in manifests(folder):
        with suppress(InputError, ValueError):
            manifest = parsed(disk.read_bytes(file))
            if isinstance(manifest, dict) and manifest.get("schema") == SCHEMA:
                return True
    return False
