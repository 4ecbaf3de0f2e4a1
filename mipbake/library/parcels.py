"""A source, packed for a machine that does not see where it lies, and its results, packed for the way back.

There the files lie in a temporary folder, one to another as they do here, so what is baked of them is the same. What is
said of them names the paths of this machine all the same.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path, PurePath
from typing import Any, TypeVar, cast

from mipbake.baking.results import BakedSet, Listener, NotBaked, Planned, Result
from mipbake.baking.sets import Run
from mipbake.base import disk
from mipbake.base.errors import MipbakeError
from mipbake.base.publish import published, replaced_file, temporary_files, temporary_folder
from mipbake.library.results import result_places
from mipbake.library.state import FileState
from mipbake.library.task import Done, Task, done, tried
from mipbake.source.options import MapChoice
from mipbake.stack.gltf.glb import check_file

T = TypeVar("T")


@dataclass(frozen=True)
class Parcel:
    """What another machine needs for a task.

    Args:
        task: with absolute paths of this machine.
        root: the folder here that the paths of files are relative to, without links.
        source: of the task, relative to it.
        files: path to content, of the source and of what it refers to.
    """

    task: Task
    root: Path
    source: str
    files: Mapping[str, bytes]


@dataclass(frozen=True)
class Delivery:
    """Results that lie in one folder or file.

    Args:
        results: with the paths of the task in the parcel.
        place: where it lies, relative to the folder of all results; None for results that lie nowhere.
        content: of the file; or name to content, of a folder.
    """

    results: tuple[Result, ...]
    place: PurePath | None = None
    content: bytes | Mapping[str, bytes] | None = None


def packed(task: Task) -> tuple[Parcel | Done, Sequence[FileState]]:
    """A parcel, and the files that decide its task, as they were before they were read; or what can be said of the task
    here, because nothing of it is to be baked."""
    begun = time.monotonic()
    results, files = tried(replace(task, which="none"))
    if not any(isinstance(each, Planned) for each in results) and (task.which != "all" or not files):
        return done(task, results, files, begun), files
    try:
        return _parcel(task, files), files
    except MipbakeError as error:
        return done(task, [NotBaked(task.entry.source, error)], files, begun), files


def _parcel(task: Task, files: Sequence[FileState]) -> Parcel:
    task = absolute(task)
    source, around = task.entry.source, task.entry.source.parent
    paths = [around / file.path for file in files if file.size >= 0]
    real = {_real(path): path for path in paths}
    root = Path(os.path.commonpath([_real_source(source).parent, *(path.parent for path in real)]))
    content = {str(place.relative_to(root)): disk.read_bytes(path) for place, path in real.items()}
    return Parcel(task, root, str(_real_source(source).relative_to(root)), content)


def _real(path: Path) -> Path:
    """Where a file lies, links in the way to it followed; by its own name, which says what map it is."""
    return disk.resolved(path.parent) / path.name


def _real_source(source: Path) -> Path:
    """The same of a source. A folder is called as the folder is that a link leads to."""
    return disk.resolved(source) if source.is_dir() else _real(source)


def baked_from(parcel: Parcel) -> list[Delivery]:
    """Bakes what a parcel holds, on the machine that has got it."""
    with temporary_folder() as folder:
        inside, out = disk.resolved(folder) / "in", folder / "out"
        with temporary_files():
            for name, content in parcel.files.items():
                (inside / name).parent.mkdir(parents=True, exist_ok=True)
                (inside / name).write_bytes(content)
        task, there = parcel.task, inside / parcel.source
        load = replace(task.load, maps={role: _named(each, parcel, inside) for role, each in task.load.maps.items()})
        entry = replace(task.entry, source=there)
        own = replace(task, entry=entry, out=out, load=load, which="all", keeps=False)  # what lies here goes
        results, _ = tried(own)
        source = task.entry.source
        back = {str(there): str(source), str(there.parent): str(source.parent)}
        back |= {str(inside): str(parcel.root), str(out): str(task.out)}
        failed = [Delivery((moved(each, back),)) for each in results if isinstance(each, NotBaked)]
        return failed + [
            Delivery(tuple(moved(each, back) for each in lying), place.relative_to(out), _content(place))
            for place, lying in result_places(results).items()
        ]


def _named(choice: MapChoice, parcel: Parcel, inside: Path) -> MapChoice:
    """What fills a map, with the path that its file has in the parcel."""
    for file, channels in _readings(choice):
        if Path(file).is_absolute() and Path(file).is_file():
            place = _real(Path(file))
            if place.is_relative_to(parcel.root) and str(place.relative_to(parcel.root)) in parcel.files:
                return f"{inside / place.relative_to(parcel.root)}{channels}"
    return choice


def _readings(choice: MapChoice) -> list[tuple[str, str]]:
    """How the text of a choice may be read: as a file, or as a file and its channels."""
    if not isinstance(choice, str):
        return []
    file, colon, channels = choice.rpartition(":")
    return [(choice, ""), *([(file, colon + channels)] if file else [])]


def _content(place: Path) -> bytes | dict[str, bytes] | None:
    """Of a file or of all files in a folder; None where there is nothing, as where all is in the GLB of a document."""
    if place.is_dir():
        return {file.name: file.read_bytes() for file in sorted(place.iterdir())}
    return place.read_bytes() if place.is_file() else None


def unpacked(task: Task, deliveries: Sequence[Delivery], files: Sequence[FileState], begun: float) -> Done:
    """Puts results where they belong.

    Args:
        task: as its user named it. files: that decide it. begun: when, by time.monotonic.
    """
    run = Run(task.options.asked(), Listener(), task.which, task.known, task.by_name)
    results: list[Result] = []
    for each in as_named(list(deliveries), task):
        try:
            _put(run, task, each)
            results += each.results
        except MipbakeError as error:
            results += [NotBaked(result.source, error) for result in each.results[:1]]
    return done(task, results, files, begun)


def _put(run: Run, task: Task, delivery: Delivery) -> None:
    if delivery.place is None or delivery.content is None:
        return
    place = task.out / delivery.place
    if isinstance(delivery.content, bytes):
        check_file(place, task.entry.source)
        replaced_file(place, delivery.content)
        return
    baked = [each for each in delivery.results if isinstance(each, BakedSet)]
    run.check_output(place, {name: told for each in baked for name, told in each.provenance.sources.items()})
    with published(place, run.ours) as folder:
        for name, content in delivery.content.items():
            (folder / name).write_bytes(content)


def moved(value: T, places: Mapping[str, str]) -> T:
    """The same value, with the paths in it that begin with one place beginning with another one.

    Args:
        value: of dataclasses, errors, sequences, mappings, paths and text. places: the longest that fits counts.
    """
    found: Any = value
    if isinstance(value, str):
        found = _pattern(tuple(places)).sub(lambda match: places[match[0]], value)
    elif isinstance(value, PurePath):
        longest = sorted(places, key=len, reverse=True)
        place = next((each for each in longest if value.is_relative_to(each)), None)
        found = value if place is None else type(value)(places[place]) / value.relative_to(place)
    elif isinstance(value, MipbakeError):
        found = type(value)(*moved(value.args, places))
    elif is_dataclass(value) and not isinstance(value, type):
        found = copy(value)
        for field in fields(value):
            object.__setattr__(found, field.name, moved(getattr(value, field.name), places))
    elif isinstance(value, Mapping):
        found = {moved(key, places): moved(each, places) for key, each in value.items()}
    elif isinstance(value, (list, tuple)):
        found = type(value)(moved(each, places) for each in value)
    return cast(T, found)


@lru_cache(maxsize=8)
def _pattern(places: tuple[str, ...]) -> re.Pattern[str]:
    """Places where they stand in text as paths, or as the beginning of paths; the longest first."""
    some = "|".join(re.escape(place) for place in sorted(places, key=len, reverse=True))
    return re.compile(rf"(?<![^\s'\"(\[,;=])(?:{some})(?=$|[/\s'\",;:)\]])")


def absolute(task: Task) -> Task:
    """The same task, whatever the working directory is. Links stay."""
    here = Path.cwd()
    entry, load = task.entry, task.load
    maps = {role: _found(choice, entry.source, here) for role, choice in load.maps.items()}
    load = replace(load, maps=maps) if maps != load.maps else load
    return replace(task, entry=replace(entry, source=here / entry.source), out=here / task.out, load=load)


def _found(choice: MapChoice, source: Path, here: Path) -> MapChoice:
    """What fills a map, whatever the working directory is."""
    folder = source if source.is_dir() else source.parent
    for file, channels in _readings(choice):
        if not (folder / file).is_file() and (here / file).is_file():
            return f"{here / file}{channels}"
    return choice


def as_named(value: T, task: Task) -> T:
    """What was said of `absolute(task)`, with the paths that the task itself has."""
    far = absolute(task)
    there = (far.entry.source.parent, far.entry.source, far.out)
    here = (task.entry.source.parent, task.entry.source, task.out)
    return moved(value, {str(before): str(after) for before, after in zip(there, here, strict=True)})
