"""A batch: what has changed in a library is baked, entry by entry, and the rest is left as it is."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePath
from typing import Protocol, TypeAlias

from mipbake.baking.options import BakeOptions
from mipbake.baking.recipe import Ingredients
from mipbake.baking.results import BakedDocument, BakedSet, NotBaked
from mipbake.baking.sets import Which
from mipbake.base import memory
from mipbake.base.errors import InputError, MipbakeError, UsageError
from mipbake.base.extras import check_extra
from mipbake.base.leftovers import tidy
from mipbake.base.threads import threads
from mipbake.base.version import __version__
from mipbake.library.finding import PathLike, Shard, found_library
from mipbake.library.listing import Entry, Library
from mipbake.library.moving import (
    folders_around,
    forsaken,
    in_the_way,
    may_replace,
    planned,
    remains,
    with_stacks,
    withdraw,
)
from mipbake.library.project import Chosen
from mipbake.library.results import BatchListener, EntryResult, Progress, Summary, WorkerError, declares
from mipbake.library.state import (
    Known,
    States,
    key_of,
    opened,
    places_of,
    results_are_same,
    sources_are_same,
    state_of,
    states,
)
from mipbake.library.task import Done, Task
from mipbake.library.watching import Seen, changes, touched, watched
from mipbake.library.workers import Share, workers
from mipbake.source.inputs import expand
from mipbake.source.options import LoadOptions

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
        dry_run: whether nothing is baked, and only told what would be.
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
) -> Summary:
    """Bakes everything below folders, in several processes. What has not changed since the last time is left.

        if __name__ == "__main__":  # the processes import the file that calls this
            summary = mipbake.bake_library("textures", "baked", mipbake.BakeOptions(preset="unreal"))
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

    Returns:
        What became of every entry. An entry that fails, as where the folder of all results cannot be written, keeps no
        other from being baked.

    Raises:
        UsageError: an option has a value that it cannot have, or there is no such cluster; nothing is baked then.
        InputError: none of the sources is there, or nothing below them can be baked.
        OutputError: a cluster is to write where this machine cannot.
    """
    how = batch or BatchOptions()
    choose = _chooser(options, load, choose)
    library = found_library(sources, Path(out), _reader(choose), how.recursive, how.within, how.shard)
    with opened(Path(out), _list_name(how), not how.dry_run) as states:
        run = Batch(Path(out), choose, how, states, listener)
        plan = run.plan(library)
        if not plan.tasks:
            run.tell(library, plan, 0)
            return run.ended(plan, {})
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
) -> Iterator[Summary]:
    """The same again and again: after each change below the sources, what has changed is baked. There is no end to it.

    Args:
        sources, out, options, load, batch, listener, choose: as for `bake_library`. A dry run cannot be watched.

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
    choose = _chooser(options, load, choose)
    place = Path(out)

    def find() -> Library:
        return found_library(sources, place, _reader(choose), how.recursive, how.within, how.shard)

    library = find()
    given = [sources] if isinstance(sources, (str, os.PathLike)) else sources
    folders = watched(expand([os.fspath(each) for each in given]))
    with opened(place, _list_name(how)) as states, _pool(how, place) as pool:
        run = Batch(place, choose, how, states, listener)
        plan = run.plan(library)
        run.tell(library, plan, pool.processes(len(plan.tasks)))
        yield run.bake(plan, pool)
        run, seen = replace(run, how=replace(how, force=False)), Seen(states)  # once is enough
        for paths in changes(folders, place):
            library, part = touched(library, paths, seen, find)
            plan = run.plan(part)
            if plan.tasks:
                yield run.bake(plan, pool)


def _list_name(how: BatchOptions) -> str:
    """The list of a shard is its own: shards are baked at the same time, on machines that share a disk."""
    return "batch" if how.shard is None else f"batch-{how.shard.number}-of-{how.shard.count}"


class Pool(Protocol):
    """What does the tasks of a batch: processes of this machine, or of a cluster."""

    def processes(self, count: int) -> int:
        """How many processes there are for so many tasks."""

    def done(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Done]]:
        """Tasks with what was done, in the order in which they end."""


@contextmanager
def _pool(how: BatchOptions, out: Path, most: int | None = None) -> Iterator[Pool]:
    """What does the tasks; there are no more of them than `most`. A dry run, which writes nothing, is done here."""
    if how.cluster is not None and not how.dry_run:
        from mipbake.library.cluster import cluster

        with cluster(how.cluster, how.jobs, how.memory, out) as there:
            yield there
        return
    jobs = min(how.jobs or 1, most or how.jobs or 1)
    limit = memory.default() if how.memory is None else how.memory
    with workers(jobs, Share.of(jobs, threads(), limit)) as here:
        yield here


def _chooser(options: BakeOptions | None, load: LoadOptions | None, choose: Choose | None) -> Choose:
    """What gives options for each entry. UsageError, before anything is made, for options that cannot be."""
    same = Chosen(options or BakeOptions(), load or LoadOptions())
    same.options.asked()
    return choose or (lambda _label: same)


def _reader(choose: Choose) -> Callable[[str], LoadOptions]:
    return lambda label: choose(label).load


_ERRORS: Mapping[int, type[MipbakeError]] = {e.exit_code: e for e in (InputError, UsageError, WorkerError)}
"""Errors about files, and defects in results, which are told again while the files are as they were."""


@dataclass(frozen=True)
class Plan:
    """What is to be done with a library.

    Args:
        entries: of the library. left: what is said of those that are left. tasks: for the others.
        keys: label to the key of what is asked for.
        moved: folders with stacks, relative to the folder of all results, which several results share by now.
    """

    entries: Sequence[Entry]
    left: Mapping[str, EntryResult]
    tasks: Sequence[Task]
    keys: Mapping[str, str]
    moved: frozenset[PurePath] = frozenset()

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

    def plan(self, library: Library) -> Plan:
        """What is to be done, as far as sizes and times of files tell. UsageError for options that cannot be."""
        ingredients: dict[BakeOptions, Ingredients] = {}
        left: dict[str, EntryResult] = {}
        tasks: list[Task] = []
        keys: dict[str, str] = {}
        self._tidy(library)
        places = self.states.places(entry.source for entry in library.entries)
        stacks = with_stacks({each for entry in library.entries for each in folders_around(entry.home)}, self.out)
        foreign = {folder for folder in stacks if folder.as_posix() not in (places or ())}
        for entry in library.entries:
            for folder in sorted(foreign & folders_around(entry.home))[:1]:
                failure = NotBaked(entry.source, in_the_way(folder, self.out, entry.home))
                left[entry.label] = EntryResult(entry, (failure,))
            if entry.label in left:
                continue
            chosen = self.choose(entry.label)
            if chosen.options not in ingredients:
                ingredients[chosen.options] = Ingredients.of(chosen.options.asked())
            keys[entry.label] = key = _key(ingredients[chosen.options], chosen.load, entry)
            known = self.states.known(entry.label, entry.source, key)
            same = known is not None and not self.how.force and sources_are_same(known, entry)
            if known is not None and same and results_are_same(known, self.out):
                left[entry.label] = self._left(entry, known, key)
                continue
            last = self.states.last(entry.label) if self.how.dry_run else None
            if last is not None and (same or remains(last, self.out)):
                left[entry.label] = EntryResult(entry, (planned(entry, last, self.out),))
                continue
            which = "all" if same else self.how.which  # a result that somebody changed is no result
            own = places is not None and may_replace(entry.home, self.out, places)
            options = (chosen.options, chosen.load, which, own, places is None, self.how.touch)
            tasks.append(Task(entry, self.out, *options))
        return Plan(library.entries, left, tasks, keys, frozenset(stacks - foreign))

    def _tidy(self, library: Library) -> None:
        """Removes what killed processes left beside results, and gives results that they moved aside their names back:
        no bake looks at the places of those that have not changed."""
        lasts = (self.states.last(entry.label) for entry in (() if self.how.dry_run else library.entries))
        tidy(*(place for known in lasts if known is not None for place in places_of(known, self.out)))

    def _left(self, entry: Entry, known: Known, key: str) -> EntryResult:
        """What is said of an entry that has not changed; its result gets a new time where a build system needs it."""
        if self.how.touch and known.results:
            with suppress(OSError):  # somebody removes something just now: the next time will see it
                known = self._touched(entry, known, key)
        faults = tuple(NotBaked(entry.source, _ERRORS[code](message)) for message, code in known.faults)
        return EntryResult(entry, faults, known.count, known=known)

    def _touched(self, entry: Entry, known: Known, key: str) -> Known:
        folders = [entry.source.parent, *([entry.source] if entry.source.is_dir() else [])]
        files = [self.out / file.path for file in known.results if declares(PurePath(file.path))]
        latest = max(*(path.stat().st_mtime_ns for path in folders), *(file.modified for file in known.files))
        if all(file.stat().st_mtime_ns > latest for file in files):
            return known
        for file in files:
            os.utime(file)
        results = tuple(state_of(self.out / file.path, self.out, ours=True) for file in known.results)
        known = replace(known, results=results)
        self.states.remember(entry.label, entry.source, key, known)
        return known

    def tell(self, library: Library, plan: Plan, jobs: int) -> None:
        """Tells the listener of what is going to be baked in so many processes, and of what is left."""
        self.listener.found(library.entries, (*library.notes, *self._forsaken(library)), jobs)
        for each in plan.left.values():
            self.listener.left(each)

    def _forsaken(self, library: Library) -> list[str]:
        """A sentence on results whose sources are gone. A part of a library says nothing of the others."""
        if self.how.within or self.how.shard is not None:
            return []
        gone = self.states.without_source({entry.label for entry in library.entries})
        found = forsaken(gone, (entry.home for entry in library.entries), self.out)
        if not found:
            return []
        what = f"{len(found)} results, such as {found[0]}, have" if len(found) > 1 else f"the result {found[0]} has"
        return [f"{what} no source any more, and nothing is baked there: remove what nobody needs"]

    def bake(self, plan: Plan, pool: Pool) -> Summary:
        """Does the tasks of a plan."""
        done: dict[str, EntryResult] = {}
        self._clear(plan.tasks)
        clock = _Clock(plan.tasks)
        for task, result in pool.done(plan.tasks):
            entry = task.entry
            if result.known is not None:
                self.states.remember(entry.label, entry.source, plan.keys[entry.label], result.known)
            done[entry.label] = EntryResult(entry, result.results, seconds=result.seconds, known=result.known)
            left = clock.left_after(done[entry.label])
            self.listener.done(done[entry.label], Progress(len(plan.left) + len(done), len(plan.entries), left))
        return self.ended(plan, done)

    def _clear(self, tasks: Iterable[Task]) -> None:
        """Removes what is left of results that are baked anew because their `stack.json` is gone."""
        for known in () if self.how.dry_run else filter(None, (self.states.last(t.entry.label) for t in tasks)):
            for file in remains(known, self.out):
                with suppress(OSError):  # the bake will say so
                    file.unlink()

    def ended(self, plan: Plan, done: Mapping[str, EntryResult]) -> Summary:
        """What a plan came to. A stack that has moved leaves its former place as soon as a result lies in there."""
        summary = plan.summary(done)
        for each in () if self.how.dry_run else summary.entries:
            for folder in set() if each.failures else plan.moved & folders_around(each.entry.home):
                with suppress(OSError):  # the next call finds it again
                    withdraw(self.out / folder)
        return summary


def _key(ingredients: Ingredients, load: LoadOptions, entry: Entry) -> str:
    """Equal where an entry is asked for in the same way."""
    return key_of(__version__, ingredients.options, ingredients.weights, asdict(load), str(entry.home))


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
