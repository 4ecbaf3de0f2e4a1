"""A source, packed for a machine that does not see where it lies, and its results, packed for the way back.

There the files lie in a temporary folder, one to another as they do here, so what is baked of them is the same. What is
said of them names the paths of this machine all the same.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path, PurePath
from typing import Any, TypeVar, cast

from mipbake.baking.results import BakedSet, Listener, NotBaked, Planned, Result
from mipbake.baking.sets import Run
from mipbake.batch.results import result_places
from mipbake.batch.state import FileState
from mipbake.batch.task import Done, Task, done, tried
from mipbake.errors import MipbakeError
from mipbake.glb import check_file
from mipbake.io import disk
from mipbake.io.publish import published, replaced_file, temporary_files, temporary_folder
from mipbake.manifest import is_stack_folder

T = TypeVar("T")


@dataclass(frozen=True)
class Parcel:
    """What another machine needs for a task.

    Args:
        task: with absolute paths of this machine.
        root: the folder here that the paths of files are relative to.
        files: path to content, of the source and of what it refers to.
    """

    task: Task
    root: Path
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
    around = task.entry.source.parent
    paths = [Path(os.path.normpath(around / file.path)) for file in files if file.size >= 0]
    root = Path(os.path.commonpath([around, *(path.parent for path in paths)]))
    return Parcel(task, root, {str(path.relative_to(root)): disk.read_bytes(path) for path in paths})


def baked_from(parcel: Parcel) -> list[Delivery]:
    """Bakes what a parcel holds, on the machine that has got it."""
    with temporary_folder() as folder:
        inside, out = folder / "in", folder / "out"
        with temporary_files():
            for name, content in parcel.files.items():
                (inside / name).parent.mkdir(parents=True, exist_ok=True)
                (inside / name).write_bytes(content)
        task, source = parcel.task, parcel.task.entry.source
        there = inside / source.relative_to(parcel.root)
        results, _ = tried(replace(task, entry=replace(task.entry, source=there), out=out, which="all"))
        back = {str(inside): str(parcel.root), str(out): str(task.out)}
        failed = [Delivery((moved(each, back),)) for each in results if isinstance(each, NotBaked)]
        return failed + [
            Delivery(tuple(moved(each, back) for each in lying), place.relative_to(out), _content(place))
            for place, lying in result_places(results).items()
        ]


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
    with published(place, is_stack_folder) as folder:
        for name, content in delivery.content.items():
            (folder / name).write_bytes(content)


def moved(value: T, places: Mapping[str, str]) -> T:
    """The same value, with the paths in it that begin with one place beginning with another one.

    Args:
        value: of dataclasses, errors, sequences, mappings, paths and text. places: the first that fits counts.
    """
    found: Any = value
    if isinstance(value, str):
        for before, after in places.items():
            found = found.replace(before, after)
    elif isinstance(value, PurePath):
        found = type(value)(moved(str(value), places))
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


def absolute(task: Task) -> Task:
    """The same task, whatever the working directory is. Links stay."""
    source, out = (Path(os.path.abspath(path)) for path in (task.entry.source, task.out))  # noqa: PTH100
    return replace(task, entry=replace(task.entry, source=source), out=out)


def as_named(value: T, task: Task) -> T:
    """What was said of `absolute(task)`, with the paths that the task itself has."""
    far = absolute(task)
    there = (far.entry.source, far.entry.source.parent, far.out)
    here = (task.entry.source, task.entry.source.parent, task.out)
    return moved(value, {str(before): str(after) for before, after in zip(there, here, strict=True)})
