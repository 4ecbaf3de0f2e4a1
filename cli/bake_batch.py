"""What `mipbake bake` says of a batch: a line for each set, how far it has come, and a summary in the end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import mipbake
from mipbake.baking import BakedDocument, BakedSet, BakeOptions, NotBaked
from mipbake.baking.recipe import weights_of
from mipbake.baking.results import DEFECT, Planned, Result
from mipbake.base import disk
from mipbake.base.errors import MipbakeError, UsageError
from mipbake.cli.batch_options import BatchFlags
from mipbake.cli.json_log import JsonLog, json_log, lines_of
from mipbake.cli.session import Session, console
from mipbake.library import (
    COMMAND_LINE,
    BatchListener,
    BatchOptions,
    Entry,
    EntryResult,
    Shard,
    Summary,
    bake_library,
    read_project,
    settings_of,
    watch_library,
)
from mipbake.library.depfile import write_depfile
from mipbake.library.listing import found_library
from mipbake.library.results import Progress
from mipbake.library.run import Choose
from mipbake.source.layout import PROJECT
from mipbake.source.options import LoadOptions

EXIT_CHECK = 5
"""Exit code of --check where something would be baked."""

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID


def bake_batch(
    session: Session,
    sources: Sequence[str],
    out: Path,
    options: BakeOptions,
    load: LoadOptions,
    flags: BatchFlags,
    memory: int | None,
) -> None:
    """Bakes a batch, and says what happens."""
    how = replace(_how(session, flags, memory), recursive=flags.recursive)
    _bake(session, flags, _Call([Path(each) for each in sources], out, options, load, how))


def suggest_recursive(session: Session, failures: Sequence[NotBaked], out: Path) -> None:
    """Says what lies below folders that hold no maps themselves, for who forgot to ask for it."""
    for folder in dict.fromkeys(each.source for each in failures):
        with suppress(MipbakeError):  # why it cannot be read was said
            if not disk.is_dir(folder):
                continue
            found = found_library([folder], out, lambda _: LoadOptions())
            below = [entry for entry in found.entries if entry.source != folder]
            if below:
                session.print(f"note: --recursive bakes what lies below {folder}: {_counted(len(below), 'source')}")


def bake_project(
    session: Session,
    sources: Sequence[str],
    out: Path | None,
    options: BakeOptions,
    load: LoadOptions,
    flags: BatchFlags,
    memory: int | None,
) -> None:
    """Bakes the library of a project file, and says what happens."""
    file = flags.config or Path(PROJECT)
    project = read_project(file)
    given = settings_of(options, load, session.given, COMMAND_LINE)
    how = replace(_how(session, flags, memory), within=tuple(map(Path, sources)))
    if how.cluster is None:  # what a project file says is about one machine
        how = replace(how, jobs=how.jobs or project.jobs, memory=how.memory or project.memory)
    place = out or project.out
    whole = not how.within and how.shard is None
    call = _Call(
        [project.library],
        place,
        how=how,
        choose=lambda label: project.chosen(label, given),
        file=file / PROJECT if file.is_dir() else file,
        idle=project.idle if whole else None,
    )
    _bake(session, flags, call)


def _how(session: Session, flags: BatchFlags, memory: int | None) -> BatchOptions:
    return BatchOptions(
        jobs=flags.jobs,
        force=flags.force,
        dry_run=flags.plans,
        memory=memory if "memory" in session.given else None,
        touch=flags.depfile is not None,
        cluster=flags.cluster,
        shard=None if flags.shard is None else Shard.parsed(flags.shard),
    )


@dataclass(frozen=True)
class _Call:
    """What `bake_library` and `watch_library` are called with.

    Args:
        file: the project file that says so. idle: sentences on what it says of none of these labels.
    """

    sources: list[Path]
    out: Path
    options: BakeOptions | None = None
    load: LoadOptions | None = None
    how: BatchOptions | None = None
    choose: Choose | None = None
    file: Path | None = None
    idle: Callable[[Sequence[str]], Sequence[str]] | None = None


def _bake(session: Session, flags: BatchFlags, call: _Call) -> None:
    """Bakes once, or again and again."""
    if flags.watch and session.json:
        raise UsageError("--watch goes on without end, and --json is printed at the end: use --json-log instead")
    with _printer(session, flags, call) as printer:
        arguments = (call.sources, call.out, call.options, call.load, call.how, printer, call.choose)
        if not flags.watch:
            _tell(session, flags, call, bake_library(*arguments))
            return
        for summary in watch_library(*arguments):
            _tell(session, flags, call, summary)
            session.print("watching; Ctrl-C ends it")


@contextmanager
def _printer(session: Session, flags: BatchFlags, call: _Call) -> Iterator[_Printer]:
    with json_log(session, flags.json_log) as log, _bar(session) as bar:
        yield _Printer(session, log, bar, call, flags.depfile)


def _tell(session: Session, flags: BatchFlags, call: _Call, summary: Summary) -> None:
    """Says what a batch came to."""
    if flags.depfile is not None and not summary.failures:
        write_depfile(flags.depfile, summary, call.out, call.sources, _common(call, summary))
    if flags.check and summary.planned:
        session.exit_code = max(session.exit_code, EXIT_CHECK)
    session.print(_summary_line(summary))
    if not flags.recursive and flags.config is None:
        suggest_recursive(session, summary.failures, call.out)
    for entry in summary.entries:
        for failure in entry.failures:
            session.fail(f"{entry.entry.label}: {failure.error}", failure.error.exit_code)
    results = [each for entry in summary.entries for each in lines_of(entry)]
    session.dump({"version": mipbake.__version__, "exit_code": session.exit_code, "results": results})


def _common(call: _Call, summary: Summary) -> list[Path]:
    """Files that say how everything is made: the project file, and weights that a bake may take."""
    options = {call.options or BakeOptions()}
    if call.choose is not None:
        options = {call.choose(each.entry.label).options for each in summary.entries}
    weights = sorted({info.tensors for each in options for info in weights_of(each)})
    return weights if call.file is None else [call.file, *weights]


@dataclass(frozen=True)
class _Printer(BatchListener):
    """Prints what happens: for a person on stdout, failures on stderr, lines of JSON into a file."""

    session: Session
    log: JsonLog
    bar: tuple[Bar, TaskID] | None
    call: _Call
    depfile: Path | None
    idle: list[str] = field(default_factory=list)

    def found(self, entries: Sequence[Entry], notes: Sequence[str], jobs: int) -> None:
        """See BatchListener. UsageError where a file would lie in a result, which is replaced as a whole."""
        beside = [
            (what, file) for what, file in (("depfile", self.depfile), ("log", self.log.path)) if file is not None
        ]
        for result in (self.call.out / entry.result for entry in entries if beside and entry.result.parts):
            for what, file in beside:
                if disk.lies_in(file, result):
                    raise UsageError(
                        f"the {what} {file} lies in the result {result}, which is replaced as a whole: choose a place "
                        "outside of it"
                    )
        self.log.open()
        if self.call.idle is not None and not self.idle:  # later passes of --watch are about what has changed
            self.idle.extend(self.call.idle([entry.label for entry in entries]))
            notes = [*notes, *self.idle]
        processes = f", baking with {_counted(jobs, 'process')}" if jobs else ", nothing has changed"
        self.session.print(*(f"note: {note}" for note in notes), f"found {_counted(len(entries), 'source')}{processes}")
        if self.bar:
            self.bar[0].update(self.bar[1], total=len(entries))

    def left(self, result: EntryResult) -> None:
        """See BatchListener."""
        self.log.write(result)

    def done(self, result: EntryResult, progress: Progress) -> None:
        """See BatchListener."""
        for each in result.results:
            self.session.print(_line(each, result, progress))
            for defect in each.defects if isinstance(each, BakedSet) else ():
                self.session.fail(f"{result.entry.label}: {defect}", DEFECT)
        self.log.write(result)
        if self.bar:
            self.bar[0].update(self.bar[1], completed=progress.done, left=_remaining(progress.seconds_left))


def _line(each: Result, result: EntryResult, progress: Progress) -> str:
    """One line for one set."""
    at = f"[{progress.done}/{progress.count}]"
    left = "" if progress.seconds_left is None or progress.done == progress.count else _remaining(progress.seconds_left)
    if isinstance(each, Planned):
        return f"{result.entry.label}: would be baked to {each.out}, because {each.why}"
    if isinstance(each, NotBaked):
        return f"{at} {result.entry.label}: failed{left}"
    if not isinstance(each, (BakedSet, BakedDocument)):
        return f"{at} {result.entry.label}: unchanged{left}"
    warned = f", {_counted(len(each.warnings), 'warning')}" if isinstance(each, BakedSet) and each.warnings else ""
    size = f"wrote {each.out}, {_counted(len(each.files), 'file')}, {each.bytes / 1e6:.2f} MB"
    if not each.files:  # it lies in the file of its document, whose line follows
        size = f"baked the material {each.out.name}"
    return f"{at} {result.entry.label}: {size} in {result.seconds:.1f} s{warned}{left}"


def _remaining(seconds: float | None) -> str:
    """What is left, as the end of a line."""
    if seconds is None:
        return ""
    minutes = round(seconds / 60)
    time = f"{round(seconds)} s" if seconds < 90 else f"{minutes} min" if minutes < 90 else f"{seconds / 3600:.1f} h"
    return f", about {time} left"


def _summary_line(summary: Summary) -> str:
    documents = f" and {_counted(summary.documents, 'document')}" if summary.documents else ""
    planned = f"{summary.planned} would be baked, " if summary.planned else ""
    baked = f"{_counted(summary.baked, 'set')}{documents} baked, "
    return f"{planned or baked}{summary.unchanged} unchanged, {len(summary.failures)} failed"


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 'es' if what.endswith('s') else 's'}"


@contextmanager
def _bar(session: Session) -> Iterator[tuple[Bar, TaskID] | None]:
    """A progress bar on stderr, where stderr is a terminal and the user has not asked for quiet."""
    if session.quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as RichProgress

    columns = (
        TextColumn("baking"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with RichProgress(*columns, console=console(sys.stderr), transient=True) as bar:
        yield bar, bar.add_task("baking", total=None, left="")
