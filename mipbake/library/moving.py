"""Results that move in the folder of all results, because a source was added or is gone: what lay there before.

A folder with one set has its stack in `bricks`. With a second set the stacks lie in `bricks/Brick_01` and
`bricks/Brick_02`, and the other way round. A stack lies alone in its folder, so one of the two has to go.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePath

from mipbake.baking.results import NotBaked, Planned
from mipbake.base import disk
from mipbake.base.errors import InputError, OutputError
from mipbake.base.json_text import parsed
from mipbake.base.publish import is_companion
from mipbake.library.listing import Entry, Home
from mipbake.library.results import declares
from mipbake.library.state import FileState, Known, results_are_same
from mipbake.source.layout import SCHEMA, is_manifest, manifests
from mipbake.stack.manifest import check_output, holds_stacks
from mipbake.stack.map_files import listed_files


def may_replace(home: Home, out: Path, places: Collection[str]) -> bool:
    """Whether what lies where an entry puts its results is known to be of the same library, or of a source that is
    gone.

    Args:
        out: the folder of all results. places: folders of results of which that is known, relative to it.
    """
    place = home.folder / home.name
    among = any(_is_in(PurePath(each), place) for each in places)
    return among and all(each in places for each in _stacks_in(out / place, out))


def folders_around(home: Home) -> set[PurePath]:
    """Folders that the results of an entry lie in, below the folder of all results and relative to it."""
    return {home.folder, *home.folder.parents} - {PurePath()}


def with_stacks(folders: Iterable[PurePath], out: Path) -> set[PurePath]:
    """Those of the folders that hold a stack themselves, not in a folder."""
    return {each for each in folders if any(_listed(file) is not None for file in manifests(out / each))}


def in_the_way(folder: PurePath, out: Path, home: Home) -> OutputError:
    """The error of an entry whose results would lie in the folder of a stack that nothing is known of."""
    return OutputError(
        f"cannot write to {out / home.folder / home.name}: {out / folder} holds a stack of another source, remove it "
        "or choose another folder"
    )


def withdraw(folder: Path) -> None:
    """Removes the stacks of a folder, and what engines have put beside their files; folders in it stay.

    What declares a stack goes last, so that the next call goes on where this one was killed. OSError where that fails.
    """
    declared = {file: names for file in manifests(folder) if (names := _listed(file)) is not None}
    listed = {name for names in declared.values() for name in names}
    ours = listed | {file.name for file in declared}
    inside = list(folder.iterdir())  # nothing else is removed, whatever a file that somebody changed may list
    beside = [each for each in inside if is_companion(each) and each.stem in ours]
    for each in (*beside, *(each for each in inside if each.name in listed), *declared):
        each.unlink(missing_ok=True)


def remains(known: Known, out: Path) -> list[Path]:
    """What is left of results whose `stack.json` is gone: build systems remove the file that they know, and a folder
    without it is nobody's. Only files that nobody changed since they were written, in folders that hold nothing else.

    Args:
        known: of an entry, from the last time. out: the folder of all results.
    """
    folders: dict[Path, list[FileState]] = {}
    for each in known.results:
        folders.setdefault((out / each.path).parent, []).append(each)
    found: list[Path] = []
    for folder, files in folders.items():
        declaring = [out / each.path for each in files if is_manifest(PurePath(each.path).name)]
        if not declaring or all(file.exists() for file in declaring):
            continue
        ours = {out / each.path for each in files if results_are_same(replace(known, results=(each,)), out)}
        with suppress(OSError):  # the whole folder may be gone
            inside = [each for each in folder.iterdir() if not is_companion(each)]
            found += inside if set(inside) <= ours else []
    return found


def planned(entry: Entry, last: Known, out: Path) -> Planned | NotBaked:
    """What a dry run says of an entry whose result somebody changed or removed in part.

    Args:
        last: what is known of the entry. out: the folder of all results.
    """
    place = out / entry.home.folder / entry.home.name
    try:
        if not remains(last, out):  # which a bake would remove
            check_output(place)
    except OutputError as error:
        return NotBaked(entry.source, error)
    return Planned(entry.source, place, "its result changed")


def forsaken(gone: Iterable[Known], homes: Iterable[Home], out: Path) -> list[Path]:
    """Results whose sources are gone, and that no other source has replaced: folders of stacks, and files.

    Args:
        gone: what is known of such sources. homes: of all other results. out: the folder of all results.
    """
    taken = {home.folder / home.name for home in homes}
    found: dict[Path, None] = {}
    for known in gone:
        for path in (PurePath(each.path) for each in known.results):
            place = path.parent if is_manifest(path.name) else path
            if declares(path) and taken.isdisjoint((place, *place.parents)) and (out / path).exists():
                found[out / place] = None
    return list(found)


def _is_in(path: PurePath, folder: PurePath) -> bool:
    return path == folder or folder in path.parents


def _stacks_in(place: Path, out: Path) -> Iterator[str]:
    """Folders of stacks in a folder that holds nothing else, relative to the folder of all results."""
    if holds_stacks(place):
        yield from (
            file.parent.relative_to(out).as_posix() for file in place.rglob("*.json") if _listed(file) is not None
        )


def _listed(file: Path) -> list[str] | None:
    """The files of the stack that a file declares; None where it declares none."""
    try:
        manifest = parsed(disk.read_bytes(file))
        return listed_files(manifest) if manifest["schema"] == SCHEMA else None
    except (InputError, ValueError, KeyError, TypeError, AttributeError):
        return None
