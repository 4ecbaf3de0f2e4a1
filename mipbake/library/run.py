"""A batch: what has changed in a library is baked, entry by entry, and the rest is left as it is."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePath
from typing import Any, TypeAlias

from mipbake.baking.options import BakeOptions
from mipbake.baking.recipe import Ingredients
from mipbake.baking.results import BakedDocument, BakedSet, NotBaked, Planned
from mipbake.baking.sets import Which
from mipbake.base import memory
from mipbake.base.errors import InputError, MipbakeError, OutputError, UsageError
from mipbake.base.extras import check_extra
from mipbake.base.leftovers import tidy
from mipbake.base.threads import threads
from mipbake.base.version import __version__
from mipbake.library.cluster import Cluster, cluster
from mipbake.library.listing import Entry, Library, PathLike, Shard, found_library
from mipbake.library.project import Chosen
from mipbake.library.results import BatchListener, EntryResult, Progress, Summary, WorkerError, declares
from mipbake.library.state import (
    Record,
    States,
    places_of,
    recipe_of,
    remains,
    results_are_same,
    sources_are_same,
    state_of,
    states,
)
from mipbake.library.task import Task
from mipbake.library.watching import changes, touched, watched
from mipbake.library.workers import Share, Workers, workers
from mipbake.source.inputs import expand
from mipbake.source.layout import is_manifest, manifests
from mipbake.source.options import LoadOptions, with_overrides
from mipbake.stack.manifest import check_output, holds_stacks

Choose: TypeAlias = Callable[[str], Chosen]
"""Label of an entry to how it is read and baked."""


@dataclass(frozen=True)
class BatchOptions:
    """How a library is baked.

    Args:
        recursive: whether everything below the sources is baked, in a tree like theirs; else the sources themselves.
        jobs: processes at most; None for one, or for as many as fit on a cluster. They share the threads and the memory
            that mipbake may use.
        force: whether what has not changed is baked as well.
        dry_run: whether nothing is baked, and only what would be is said.
        memory: bytes that all processes together are held to, or each process on a cluster; None for what mipbake takes
            of a machine by default.
        within: paths, one of which an entry must be or lie in; empty for all entries.
        touch: whether results that have not changed get a new time where a file is younger than they are, as build
            systems need it.
        cluster: a Ray cluster, whose machines bake: "auto" for the one that this machine belongs to, HOST:PORT of its
            head, or ray://HOST:PORT; None for this machine alone.
        shard: the part of the entries that is baked, which may be empty; None for all.
    """

    recursive: bool = True
    jobs: int | None = None
    force: bool = False
    dry_run: bool = False
    memory: int | None = None
    within: tuple[Path, ...] = ()
    touch: bool = False
    cluster: str | None = None
    shard: Shard | None = None

    def __post_init__(self) -> None:
        """UsageError for values that cannot be."""
        if self.jobs is not None and self.jobs < 1:
            raise UsageError(f"the number of jobs is {self.jobs}: expected 1 or more")
        if self.force and self.dry_run:
            raise UsageError("force bakes everything and a dry run nothing: expected one of the two")

    @property
    def which(self) -> Which:
        """What is baked of what is found."""
        return "none" if self.dry_run else "all" if self.force else "changed"


def bake_library(
    sources: PathLike | Sequence[PathLike],
    out: PathLike,
    options: BakeOptions | None = None,
    load: LoadOptions | None = None,
    batch: BatchOptions | None = None,
    listener: BatchListener = BatchListener(),  # noqa: B008
    choose: Choose | None = None,
    **overrides: Any,
) -> Summary:
    """Bakes everything below folders, in several processes. What has not changed since the last time is left.

        summary = mipbake.bake_library("textures", "baked", preset="unreal")
        print(summary.baked, summary.unchanged, [str(each.error) for each in summary.failures])

    A result says itself what it was made from: its sources, how they were read, options, weights and version. Where all
    of that is as it was, the result is left. Sizes and times of files, which are kept in `OUT/.mipbake`, tell that
    without a look at what is in them. A process or a machine may end at any time: each result is there as a whole or
    not at all, and the next call goes on with what is missing.

    Args:
        sources: folders, or what `mipbake.load_all` takes. out: the folder of all results.
        options: how they are baked and written. load: how they are read. None for the defaults.
        batch: how they are gone through; None for the defaults.
        listener: hears what happens meanwhile.
        choose: gives options for each entry by its label, in place of `options` and `load`, as the method `chosen` of a
            project file does: `mipbake.library.read_project("mipbake.toml").chosen`.
        overrides: single fields of `BakeOptions`, on top of `options`.

    Returns:
        What became of every entry. An entry that fails, as where the folder of all results cannot be written, keeps no
        other from being baked.

    Raises:
        UsageError: an option has a value that it cannot have, or there is no such cluster; nothing is baked then.
        InputError: none of the sources is there, or nothing below them can be baked.
        OutputError: a cluster is to write where this machine cannot.
    """
    how = batch or BatchOptions()
    run = Batch(
        Path(out), _chooser(options, load, choose, overrides), how, States(Path(out), not how.dry_run), listener
    )
    library = run.find(sources)
    plan = run.plan(library)
    if not plan.tasks:
        run.tell(library, plan, 0)
        return plan.summary({})
    with _pool(how, Path(out), len(plan.tasks)) as pool:
        run.tell(library, plan, pool.processes(len(plan.tasks)))
        return run.bake(plan, pool)


def watch_library(
    sources: PathLike | Sequence[PathLike],
    out: PathLike,
    options: BakeOptions | None = None,
    load: LoadOptions | None = None,
    batch: BatchOptions | None = None,
    listener: BatchListener = BatchListener(),  # noqa: B008
    choose: Choose | None = None,
    **overrides: Any,
) -> Iterator[Summary]:
    """The same again and again: after each change below the sources, what has changed is baked. There is no end to it.

    Args:
        sources, out, options, load, batch, listener, choose, overrides: as for `bake_library`. A dry run cannot be
            watched.

    Yields:
        What each pass came to; the first is about the whole library, the others are about what has changed.

    Raises:
        UsageError: as `bake_library`; or the extra `watch` is not installed.
        InputError: as `bake_library`; or the system cannot watch so many files.
    """
    how = batch or BatchOptions()
    if how.dry_run:
        raise UsageError("a dry run bakes nothing, so there is nothing to watch for: expected one of the two")
    check_extra("watch", "--watch")
    run = Batch(Path(out), _chooser(options, load, choose, overrides), how, States(Path(out)), listener)
    library = run.find(sources)
    given = [sources] if isinstance(sources, (str, os.PathLike)) else sources
    folders = watched(expand([os.fspath(each) for each in given]))
    with _pool(how, run.out) as pool:
        plan = run.plan(library)
        run.tell(library, plan, pool.processes(len(plan.tasks)))
        yield run.bake(plan, pool)
        run = replace(run, how=replace(how, force=False))  # once is enough
        for paths in changes(folders, run.out):
            library, part = touched(library, paths, run.states, lambda: run.find(sources))
            plan = run.plan(part)
            if plan.tasks:
                yield run.bake(plan, pool)


@contextmanager
def _pool(how: BatchOptions, out: Path, most: int | None = None) -> Iterator[Workers | Cluster]:
    """What does the tasks; there are no more of them than `most`. A dry run, which writes nothing, is done here."""
    if how.cluster is not None and not how.dry_run:
        with cluster(how.cluster, how.jobs, how.memory, out) as there:
            yield there
        return
    jobs = min(how.jobs or 1, most or how.jobs or 1)
    limit = memory.default() if how.memory is None else how.memory
    with workers(jobs, Share.of(jobs, threads(), limit)) as here:
        yield here


def _chooser(
    options: BakeOptions | None, load: LoadOptions | None, choose: Choose | None, overrides: Mapping[str, Any]
) -> Choose:
    """What gives options for each entry. UsageError, before anything is made, for options that cannot be."""
    same = Chosen(with_overrides(options or BakeOptions(), overrides), load or LoadOptions())
    same.options.plan()
    return choose or (lambda _label: same)


_ERRORS: Mapping[int, type[MipbakeError]] = {e.exit_code: e for e in (InputError, UsageError, WorkerError)}
"""Errors about files, and defects in results, which are told again while the files are as they were."""


@dataclass(frozen=True)
class Plan:
    """What is to be done with a library.

    Args:
        entries: of the library. left: what is said of those that are left. tasks: for the others.
    """

    entries: Sequence[Entry]
    left: Mapping[str, EntryResult]
    tasks: Sequence[Task]

    def summary(self, done: Mapping[str, EntryResult]) -> Summary:
        """What the library came to."""
        every = {**self.left, **done}
        return Summary(tuple(every[entry.label] for entry in self.entries))


@dataclass(frozen=True)
class Batch:
    """Passes over a library. See `bake_library`."""

    out: Path
    choose: Choose
    how: BatchOptions
    states: States
    listener: BatchListener

    def find(self, sources: PathLike | Sequence[PathLike]) -> Library:
        """What can be baked. See `found_library`."""
        how = self.how
        return found_library(
            sources, self.out, lambda label: self.choose(label).load, how.recursive, how.within, how.shard
        )

    def plan(self, library: Library) -> Plan:
        """What is to be done, as far as sizes and times of files tell. UsageError for options that cannot be."""
        ingredients: dict[BakeOptions, Ingredients] = {}
        planned: dict[str, EntryResult | Task] = {}
        self._tidy(library)
        for entry in library.entries:
            chosen = self.choose(entry.label)
            if chosen.options not in ingredients:
                ingredients[chosen.options] = Ingredients.of(chosen.options.plan())
            own = ingredients[chosen.options]
            recipe = recipe_of(__version__, own.options, own.weights, asdict(chosen.load), str(entry.place))
            planned[entry.label] = self._planned(entry, chosen, recipe)
        left = {label: each for label, each in planned.items() if isinstance(each, EntryResult)}
        return Plan(library.entries, left, [each for each in planned.values() if isinstance(each, Task)])

    def _planned(self, entry: Entry, chosen: Chosen, recipe: str) -> EntryResult | Task:
        """What is said of an entry that is left, or the task to bake it."""
        if entry.rival is not None:
            return EntryResult(entry, (NotBaked(entry.source, _in_the_way(entry, self.out)),))
        record = self.states.records.get(entry.label)
        mine = record if record is not None and record.is_of(entry) else None
        same = mine is not None and mine.recipe == recipe and not self.how.force and sources_are_same(mine, entry)
        if mine is not None and same and results_are_same(mine, self.out):
            return self._left(mine, entry)
        if self.how.dry_run and record is not None and (same or remains(record, self.out)):
            return EntryResult(entry, (_planned_again(entry, record, self.out),))
        which = "all" if same else self.how.which  # a result that somebody changed is no result
        for folder in (each for each in (entry.place, *entry.place.parents) if each.parts):
            if manifests(self.out / folder):  # as a bake of the source alone writes it
                error = OutputError(
                    f"cannot write to {self.out / entry.result}: {self.out / folder} holds a stack itself, remove it "
                    "or choose another folder"
                )
                return EntryResult(entry, (NotBaked(entry.source, error),))
        known = record is not None and (mine is not None or not os.path.lexists(record.source))
        known = known and not (entry.name and holds_stacks(self.out / entry.result))
        # Nothing else has the folder of a path below the library, so what lies there is of the same source.
        by_name = record is None and bool(entry.place.parts)
        return Task(entry, self.out, chosen.options, chosen.load, recipe, which, known, by_name, self.how.touch)

    def _tidy(self, library: Library) -> None:
        """Removes what killed processes left beside results, and gives results that they moved aside their names back:
        no bake looks at the places of those that have not changed."""
        labels = () if self.how.dry_run else (entry.label for entry in library.entries)
        records = (self.states.records[label] for label in labels if label in self.states.records)
        tidy(*(place for record in records for place in places_of(record, self.out)))

    def _left(self, record: Record, entry: Entry) -> EntryResult:
        """What is said of an entry that has not changed; its result gets a new time where a build system needs it."""
        if self.how.touch and record.results:
            with suppress(OSError):  # somebody removes something just now: the next time will see it
                record = self._touched(record, entry.source)
        faults = tuple(NotBaked(entry.source, _ERRORS[code](message)) for message, code in record.faults)
        return EntryResult(entry, faults, record.count, record=record)

    def _touched(self, record: Record, source: Path) -> Record:
        folders = [source.parent, *([source] if source.is_dir() else [])]
        files = [self.out / file.path for file in record.results if declares(PurePath(file.path))]
        latest = max(*(path.stat().st_mtime_ns for path in folders), *(file.modified for file in record.files))
        if all(file.stat().st_mtime_ns > latest for file in files):
            return record
        for file in files:
            os.utime(file)
        results = tuple(state_of(self.out / file.path, self.out, ours=True) for file in record.results)
        record = replace(record, results=results)
        self.states.remember(record)
        return record

    def tell(self, library: Library, plan: Plan, jobs: int) -> None:
        """Tells the listener of what is going to be baked in so many processes, and of what is left."""
        self.listener.found(library.entries, (*library.notes, *self._without_source(library)), jobs)
        for each in plan.left.values():
            self.listener.left(each)

    def _without_source(self, library: Library) -> list[str]:
        """A sentence on results whose sources are gone. A part of a library says nothing of the others."""
        if self.how.within or self.how.shard is not None:
            return []
        labels = {entry.label for entry in library.entries}
        gone = (each for label, each in sorted(self.states.records.items()) if label not in labels)
        files = [self.out / file.path for each in gone if each.is_without_source() for file in each.results]
        declaring = [file for file in files if declares(file) and file.exists()]
        found = list(dict.fromkeys(file.parent if is_manifest(file.name) else file for file in declaring))
        if not found:
            return []
        what = f"{len(found)} results, such as {found[0]}, have" if len(found) > 1 else f"the result {found[0]} has"
        return [f"{what} no source any more, and nothing is baked there: remove what nobody needs"]

    def bake(self, plan: Plan, pool: Workers | Cluster) -> Summary:
        """Does the tasks of a plan."""
        done: dict[str, EntryResult] = {}
        self._clear(plan.tasks)
        clock = _Clock(plan.tasks)
        for result in pool.done(plan.tasks):
            if result.record is not None:
                self.states.remember(result.record)
            done[result.entry.label] = result
            progress = Progress(len(plan.left) + len(done), len(plan.entries), clock.left_after(result))
            self.listener.done(result, progress)
        return plan.summary(done)

    def _clear(self, tasks: Iterable[Task]) -> None:
        """Removes what is left of results that are baked anew because their `stack.json` is gone."""
        for task in () if self.how.dry_run else tasks:
            record = self.states.records.get(task.entry.label)
            for file in remains(record, self.out) if record is not None else ():
                with suppress(OSError):  # the bake will say so
                    file.unlink()


def _in_the_way(entry: Entry, out: Path) -> OutputError:
    return OutputError(
        f"cannot write to {out / entry.result}: the result of {entry.rival} lies there as well, or in it, or around "
        "it; rename one of the two, or bake it into another folder"
    )


def _planned_again(entry: Entry, record: Record, out: Path) -> Planned | NotBaked:
    """What a dry run says of an entry whose result somebody changed or removed in part."""
    place = out / entry.result
    try:
        if entry.name and not remains(record, out):  # which a bake would remove
            check_output(place)
    except OutputError as error:
        return NotBaked(entry.source, error)
    return Planned(entry.source, place, "its result changed")


_ENTRY = 300_000
"""Bytes of files that take as long as what an entry takes besides."""


class _Clock:
    """An estimate of the time that is left: entries take time as their files have bytes."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._begun = time.monotonic()
        self._sizes = {
            task.entry.label: _ENTRY + sum(max(0, file.size) for file in states(task.entry)) for task in tasks
        }
        self._ahead, self._baked = sum(self._sizes.values()), 0

    def left_after(self, done: EntryResult) -> float | None:
        """Seconds that are left after an entry is done, too. None before one was baked: others take no time."""
        size = self._sizes[done.entry.label]
        self._ahead -= size
        if any(isinstance(each, (BakedSet, BakedDocument)) for each in done.results):
            self._baked += size
        return (time.monotonic() - self._begun) * self._ahead / self._baked if self._baked else None
