"""What a library holds: every texture set, document and archive below a folder, and where the result of each lies.

Results keep the tree of the library. The texture set of `metals/steel`, of `metals/steel.zip` or of `metals/steel.glb`
becomes `metals/steel` or `metals/steel.glb` below the folder of all results. A source that holds several sets gets a
folder of its name. Each of several sets in a folder is an entry. Nothing is read to say where results lie, so a source
that is broken takes no place from others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath

from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.base.json_text import parsed
from mipbake.base.safe_names import safe_name, unique_name
from mipbake.library.parts import Part
from mipbake.source.archives import GLTF, MATERIALX, SUFFIX
from mipbake.source.images.read import IMAGE_SUFFIXES
from mipbake.source.inputs import kind
from mipbake.source.layout import SCHEMA, manifests
from mipbake.source.matches import is_map, is_textures
from mipbake.source.names import interpretations


@dataclass(frozen=True)
class Home:
    """Where the results of a source lie, relative to the folder of all results.

    Args:
        folder: for a source with one result that is called `name`. name: folder in it, for all other results.
        own: whether the results lie in `folder/name` whatever they are called, because something else has the name.
    """

    folder: PurePath
    name: str
    own: bool = False

    def place(self, names: Iterable[str]) -> PurePath:
        """The folder that results of these names are written into."""
        alone = {name.casefold() for name in names} == {self.name.casefold()}
        return self.folder if alone and not self.own else self.folder / self.name


@dataclass(frozen=True)
class Entry:
    """A source of a library.

    Args:
        source: a path that `mipbake.load_all` takes. label: what the entry is called, unique in its library.
        home: where its results lie.
        part: which of the several sets in a folder it is; None for all that the source holds.
    """

    source: Path
    label: str
    home: Home
    part: Part | None = None

    def parted(self, parts: Sequence[Part]) -> list[Entry]:
        """An entry for each set in its folder, whose results lie in one folder, as they do where the folder is baked as
        a whole; itself where there are none."""
        around = "" if self.label == "." else f"{self.label}/"
        place = self.home.folder / self.home.name
        return [Entry(self.source, f"{around}{part.name}", Home(place, part.name), part) for part in parts] or [self]


@dataclass(frozen=True)
class Library:
    """What was found below folders.

    Args:
        entries: by their labels.
        notes: what was left out and why, in sentences.
    """

    entries: tuple[Entry, ...]
    notes: tuple[str, ...] = ()


def entries_of(sources: Sequence[Path]) -> Library:
    """Sources that were named one by one. Their results lie side by side."""
    named = [Entry(path, str(path), Home(PurePath(), _name(path))) for path in sources]
    return Library(tuple(_apart(named, set())))


def entries_below(roots: Sequence[Path], out: Path, files_of: Callable[[Path], Iterable[Path]]) -> Library:
    """Everything below folders that can be baked. Hidden folders, stacks and the folder of all results are passed over.

    Args:
        roots: the folders. What is no folder is a source by itself.
        out: the folder of all results, which may lie in one of them.
        files_of: images that a document shows, which are no sets of their own. It is asked of documents that lie
            beside maps, and may raise InputError for broken ones.

    Raises:
        InputError: a folder does not exist, or nothing below all of them can be baked.
    """
    found: list[tuple[Path, Path]] = []
    named: set[Path] = set()
    notes: list[str] = []
    for root in roots:
        if kind(root) not in ("folder", "udim") or not disk.is_dir(root):
            sources: Iterable[tuple[Path, Path]] = [(root, root.parent)]
        else:
            sources = ((path, root) for path in _Walk(disk.resolved(out), files_of, notes).sources(root))
        for path, top in sources:
            if (real := disk.resolved(path)) not in named:  # one root may lie in another
                named.add(real)
                found.append((path, top))
    if not found:
        where = ", ".join(map(str, roots))
        hint = f"; {notes[0]}" if notes else ""
        if any(disk.resolved(root) == disk.resolved(out) for root in roots):
            hint = "; it is the folder of all results, which is passed over, so choose another one"
        raise InputError(f"nothing below {where} can be baked: expected folders of maps, documents or archives{hint}")
    several = len(roots) > 1
    entries = []
    for path, root in found:
        within = path.relative_to(root) if path != root else PurePath(disk.resolved(root).name)
        label = str(path) if several else "." if path == root and root.is_dir() else within.as_posix()
        parents = PurePath(*(safe_name(part, "folder") for part in within.parts[:-1]))
        entries.append(Entry(path, label, Home(parents, _name(path))))
    around = {folder for entry in entries for folder in (entry.home.folder, *entry.home.folder.parents)}
    return Library(tuple(_apart(entries, around)), tuple(notes))


def _name(path: Path) -> str:
    """What the result of a source is called if it has one: its name without the suffix of documents and archives."""
    known = path.suffix.lower() in (SUFFIX, MATERIALX, *GLTF)
    named = disk.resolved(path).name or "texture_set"
    return safe_name(Path(named).stem if known else named, "texture_set")


def _apart(entries: Sequence[Entry], around: set[PurePath]) -> Iterator[Entry]:
    """The same entries, no two of one place. A folder keeps its name; documents and archives beside it take theirs
    with the suffix. A set whose folder also holds others gets a folder of its own in it.

    Args:
        around: folders that hold the results of other entries, so that no result may be one of them.
    """
    taken: set[str] = set()
    held = {str(folder).casefold() for folder in around}
    rank = [not entry.source.suffix or disk.is_dir(entry.source) for entry in entries]
    homes: dict[int, Home] = {}
    for index in sorted(range(len(entries)), key=lambda at: (not rank[at], at)):
        entry = entries[index]
        home = entry.home
        place = str(home.folder / home.name).casefold()
        if place in held:
            home = Home(home.folder / home.name, home.name)
            place = str(home.folder / home.name).casefold()
        if place in taken or place in held:
            beside = {Path(other).name for other in (*taken, *held) if Path(other).parent == Path(place).parent}
            home = Home(home.folder, unique_name(entry.source.name, "texture_set", beside), own=True)
            place = str(home.folder / home.name).casefold()
        taken.add(place)
        homes[index] = home
    return (replace(entry, home=homes[index]) for index, entry in enumerate(entries))


class _Walk:
    """A walk through a library, folder by folder, in the order of names; links to folders come last, because what lies
    in the library itself is called as it lies there."""

    def __init__(self, out: Path, files_of: Callable[[Path], Iterable[Path]], notes: list[str]) -> None:
        self._out = out
        self._files_of = files_of
        self._notes = notes
        self._seen: set[Path] = set()
        self._links: list[Path] = []

    def sources(self, root: Path) -> Iterator[Path]:
        """What can be baked in a folder and below it; a folder that cannot be listed is told of when it is baked."""
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
        maps = self._maps(inner, files)
        own = bool(maps)
        if documents and maps:
            shown = {disk.resolved(file) for each in documents for file in self._shown(each)}
            if all(each.suffix.lower() == MATERIALX for each in documents) and _are_told(maps):
                self._notes += [
                    f"{each} is left out: the names of the maps beside it say what they are" for each in documents
                ]
                documents = []  # as in downloads that hold both
            else:
                own = _are_told([file for file in maps if disk.resolved(file) not in shown])
        if own:
            yield folder
        yield from (file for file in documents if not _is_baked(file))
        yield from (file for file in files if file.suffix.lower() == SUFFIX)
        images = [file for file in files if file.suffix.lower() in IMAGE_SUFFIXES]
        if images and not own and not documents and not self._show_all(above, images):
            self._notes.append(f"{folder} is left out: the names of its images tell no map")
        for each in folders:
            if each == inner and (documents or (own and not any(is_map(file) for file in files))):
                self._seen.add(disk.resolved(each))  # it belongs to what was named
                continue
            if each.is_symlink():
                self._links.append(each)
                continue
            yield from self._below(each, documents)

    def _show_all(self, documents: Sequence[Path], images: Sequence[Path]) -> bool:
        """Whether documents show all of these images."""
        shown = {disk.resolved(file) for each in documents for file in self._shown(each)}
        return shown.issuperset(map(disk.resolved, images))

    def _shown(self, document: Path) -> Iterable[Path]:
        try:
            return list(self._files_of(document))
        except InputError:  # its turn will say what is wrong
            return []

    @staticmethod
    def _maps(inner: Path | None, files: Sequence[Path]) -> list[Path]:
        """Maps of a folder, or of the `textures` folder inside where it has none itself."""
        maps = [file for file in files if is_map(file)]
        if maps or inner is None:
            return maps
        try:
            return [file for file in disk.files_in(inner) if is_map(file)]
        except InputError:
            return []


def _are_told(maps: Sequence[Path]) -> bool:
    """Whether names tell the two maps that a set cannot be without."""
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
        try:
            manifest = parsed(disk.read_bytes(file))
        except (InputError, ValueError):
            continue
        if isinstance(manifest, dict) and manifest.get("schema") == SCHEMA:
            return True
    return False
