"""What a user names as a source: folders, files, lists of them, globs; and the kind of each source."""

from __future__ import annotations

import glob
import os
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Literal

from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.source.archives import GLTF, MATERIALX, SUFFIX
from mipbake.source.images.read import IMAGE_SUFFIXES
from mipbake.source.matches import files_of_folder, is_textures
from mipbake.source.names import interpretations
from mipbake.source.tiles import is_pattern, tiles_of

Kind = Literal["folder", "udim", "gltf", "materialx", "archive", "file"]
"""A folder of maps, tiles of several texture sets, a glTF or MaterialX file, a ZIP archive, a single map."""

_SUFFIXES: Mapping[Kind, Collection[str]] = {
    **{"gltf": GLTF, "materialx": (MATERIALX,), "archive": (SUFFIX,), "file": IMAGE_SUFFIXES},
}

LIST_MARK = "@"
STDIN = "-"
"""In place of a list's name: the list is read from the standard input."""

EXPECTED = "a folder of maps, a .gltf, .glb, .mtlx or .zip file, or tiles (<UDIM>)"


def expand(sources: Sequence[str]) -> list[Path]:
    """The sources that arguments stand for, in their order, each once.

    An argument is a path. `@FILE` stands for the paths that a text file (UTF-8) holds, one on each line, relative to
    its folder, without empty lines and lines that start with #; `@-` reads such a list from the standard input. An
    argument or a line that exists nowhere and holds *, ? or [ is a glob: it stands for what it finds that could be a
    source, sorted; ** crosses folders.

    Raises:
        InputError: an empty name, a list that cannot be read or is empty, or a glob that finds nothing.
    """
    found: dict[str, Path] = {}
    for source in sources:
        if source.startswith(LIST_MARK) and not os.path.lexists(source):
            paths = _listed(Path(source[len(LIST_MARK) :]))
        else:
            paths = _matches(source)
        for path in paths:
            found.setdefault(os.path.abspath(path), path)  # noqa: PTH100  Path.resolve would follow links
    return list(found.values())


def kind(path: str | os.PathLike[str]) -> Kind:
    """What a source is: by its suffix, or by the names of the files in a folder. InputError where it does not exist, or
    is a file of another kind."""
    path = Path(path)
    if is_pattern(path):
        return "udim"
    if disk.is_dir(path):
        return "udim" if _holds_tiles(path) else "folder"
    if not disk.is_file(path):
        what = "is neither a file nor a folder" if disk.exists(path) else "does not exist"
        raise InputError(f"{path} {what}: expected {EXPECTED}")
    suffix = path.suffix.lower()
    for found, suffixes in _SUFFIXES.items():
        if suffix in suffixes:
            return found
    raise InputError(f"{path} is not a source: expected {EXPECTED}; a list of paths is given as {LIST_MARK}FILE")


def _listed(file: Path) -> list[Path]:
    standard = str(file) == STDIN
    name, folder = ("of the standard input", Path()) if standard else (str(file), file.parent)
    try:
        if standard:
            text = sys.stdin.buffer.read().decode("utf-8-sig")
        else:
            text = disk.read_text_or_pipe(file, "a text file of paths")
    except UnicodeDecodeError as error:
        raise InputError(f"the list {name} is not UTF-8 text: expected one path on each line") from error
    entries = [entry for line in text.splitlines() if (entry := line.strip()) and not entry.startswith("#")]
    if not entries:
        raise InputError(f"the list {name} holds no path: expected one on each line")
    return [path for entry in entries for path in _matches(entry, folder)]


def _matches(entry: str, folder: Path = Path()) -> list[Path]:
    if not entry:
        raise InputError("a source has no name: expected a path, look where the empty name came from")
    if "\0" in entry:
        raise InputError(f"the source {entry[:80]!r} holds a zero byte, which no name can hold: expected a path")
    path = folder / entry
    if os.path.lexists(path) or not any(c in entry for c in "*?["):
        return [path]
    # The folder of a list may hold brackets itself: only the entry is a pattern.
    root = "" if folder == Path() else glob.escape(str(folder))
    pattern = os.path.join(root, entry)  # noqa: PTH118
    # A folder that cannot be read says so when its turn comes, once for all that lies in it.
    closed = set(_unreadable(pattern))
    seen = {match for each in glob.glob(pattern, recursive=True) if closed.isdisjoint((match := Path(each)).parents)}  # noqa: PTH207
    matches = sorted(seen | closed)
    if not matches:
        raise InputError(f"{path} matches nothing: check the pattern, or quote a name that holds *, ? or [")
    found = [match for match in matches if _could_be_input(match)]
    if not found:
        raise InputError(
            f"{path} matches {matches[0]} and nothing that can be baked: expected folders of maps, documents or maps"
        )
    return found


def _unreadable(pattern: str) -> list[Path]:
    """Folders that a glob looks into and cannot read: to the glob they are empty."""
    parts = Path(pattern).parts
    first = next(index for index, part in enumerate(parts) if any(c in part for c in "*?["))
    found = []
    for index in range(first, len(parts)):
        inside = ("**",) if parts[index] == "**" else ()
        folders = glob.glob(os.path.join(Path(*parts[:index]), *inside, ""), recursive=True)  # noqa: PTH118, PTH207
        found += [Path(folder) for folder in folders if not disk.is_readable_folder(Path(folder))]
    return found


def _could_be_input(path: Path) -> bool:
    """Whether a match is meant: a document or a map by its suffix, or a folder that holds more than other files."""
    try:
        if not disk.is_dir(path):
            return path.suffix.lower() in (*GLTF, MATERIALX, SUFFIX, *IMAGE_SUFFIXES)
        files = disk.files_in(path)
        textures = any(map(is_textures, disk.folders_in(path)))
    except InputError:  # its turn will say what is wrong
        return True
    return textures or not files or any(p.suffix.lower() in IMAGE_SUFFIXES for p in files)


def _holds_tiles(folder: Path) -> bool:
    """Whether maps of a folder are tiles. Numbers in the names of other pictures, years for one, are not tiles."""
    tiles = tiles_of(file for file in files_of_folder(folder) if file.suffix.lower() in IMAGE_SUFFIXES)
    return any(interpretations(file.stem) for files in tiles.values() for file in files)
