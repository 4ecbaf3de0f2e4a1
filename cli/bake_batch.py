"""What `mipbake bake` says of a batch: lines for people, a summary, and the file of --json-log."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TextIO

from mipbake.baking import BakedDocument, BakedSet, BakeOptions, NotBaked
from mipbake.baking.recipe import weights_of
from mipbake.baking.results import DEFECT, Planned, Result
from mipbake.base import disk
from mipbake.base.errors import OutputError, UsageError
from mipbake.base.progress import ProgressLine
from mipbake.base.publish import reason, writing
from mipbake.cli.bake_output import told
from mipbake.cli.batch_options import BatchFlags, check_log
from mipbake.cli.session import Session, counted, plain, progress_line, succeeded
from mipbake.cli.sources import suggest_recursive
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
from mipbake.library.results import Progress
from mipbake.library.run import Choose
from mipbake.source.layout import PROJECT
from mipbake.source.options import LoadOptions
from mipbake.stack.verdict import verdict

_OUTCOMES = {"gains": "better", "same": "the same", "mixed": "better and worse", "loses": "worse"}
"""Outcome of a verdict, as few words as possible for how a stack looks beside plain MIP maps."""

EXIT_CHECK = 5
"""Exit code of --check where something would be baked."""


@dataclass(frozen=True)
class _Call:
    """What `bake_library` and `watch_library` are called with.

    Args:
        file: the project file that says so. idle: sentences on what it says of none of these labels.
    """

    sources: list[Path]
    out: Path
    how: BatchOptions
    options: BakeOptions | None = None
    load: LoadOptions | None = None
    choose: Choose | None = None
    file: Path | None = None
    idle: Callable[[Sequence[str]], Sequence[str]] | None = None


@dataclass
class JsonLog:
    """The file, which is made when a batch begins.

    Args:
        path: None where no log is asked for.
    """

    session: Session
    path: Path | None
    _file: TextIO | None = None

    def open(self) -> None:
        """Empties the file. OutputError where it cannot be written, or mipbake did not write it."""
        if self.path is None or self._file is not None:
            return
        check_log(self.path)
        with writing(f"cannot write {self.path}"):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("w", encoding="utf-8")

    def write(self, result: EntryResult) -> None:
        """Adds the lines of an entry. Where that fails, it is said, and the batch goes on without the log."""
        if self._file is None or self._file.closed:
            return
        try:
            self._file.writelines(json.dumps(plain(line), allow_nan=False) + "\n" for line in lines_of(result))
            self._file.flush()
        except OSError as error:  # the sets are more than the log
            self.session.fail(f"cannot write {self.path}: {reason(error)}", OutputError.exit_code)
            self.close()

    def close(self) -> None:
        """Closes the file where it is open."""
        if self._file is not None:
            with suppress(OSError):  # what could not be written was told
                self._file.close()


def lines_of(result: EntryResult) -> list[dict[str, Any]]:
    """What became of an entry, for JSON: an object for each set or document."""
    same = [succeeded(result.entry.source, unchanged=True)] * result.unchanged
    return [{"entry": result.entry.label, **each} for each in (*map(told, result.results), *same)]


def bake_batch(
    session: Session,
    sources: Sequence[str],
    out: Path | None,
    options: BakeOptions,
    load: LoadOptions,
    flags: BatchFlags,
    memory: int | None,
) -> None:
    """Bakes the sources, or the library of a project file, once or again and again, and says what happens."""
    how = BatchOptions(
        jobs=flags.jobs,
        force=flags.force,
        dry_run=flags.plans,
        memory=memory if "memory" in session.given else None,
        touch=flags.depfile is not None,
        cluster=flags.cluster,
        shard=None if flags.shard is None else Shard.parsed(flags.shard),
    )
    if flags.config is not None:
        call = _of_project(flags.config, sources, out, settings_of(options, load, session.given, COMMAND_LINE), how)
    else:
        assert out is not None
        call = _Call([Path(each) for each in sources], out, replace(how, recursive=flags.recursive), options, load)
    if flags.watch and session.json:
        raise UsageError("--watch goes on without end, and --json is printed at the end: use --json-log instead")
    with (
        closing(JsonLog(session, flags.json_log)) as log,
        progress_line(session, call.out.name or "library") as line,
    ):
        printer = _Printer(session, log, call, flags.depfile, line)
        arguments = (call.sources, call.out, call.options, call.load, call.how, printer, call.choose)
        if not flags.watch:
            _say(session, flags, call, bake_library(*arguments))
            return
        for summary in watch_library(*arguments):
            line.idle()
            _say(session, flags, call, summary)
            session.print("watching; Ctrl-C ends it")


def _of_project(
    file: Path, sources: Sequence[str], out: Path | None, given: Mapping[str, Any], how: BatchOptions
) -> _Call:
    """Baking the library of a project file, or the sources in it; `given`: settings of the command line."""
    project = read_project(file)
    how = replace(how, within=tuple(map(Path, sources)))
    if how.cluster is None:  # what a project file says is about one machine
        how = replace(how, jobs=how.jobs or project.jobs, memory=how.memory or project.memory)
    return _Call(
        [project.library],
        out or project.out,
        how,
        choose=lambda label: project.chosen(label, given),
        file=file / PROJECT if file.is_dir() else file,
        idle=project.idle if not how.within and how.shard is None else None,
    )


def _say(session: Session, flags: BatchFlags, call: _Call, summary: Summary) -> None:
    """Says what a batch came to."""
    if flags.depfile is not None and not summary.failures:
        write_depfile(flags.depfile, summary, call.out, call.sources, _common(call, summary))
    if flags.check and summary.planned:
        session.exit_code = max(session.exit_code, EXIT_CHECK)
    session.print(_summary_line(summary))
    if not flags.recursive and flags.config is None:
        suggest_recursive(session, [failure.source for failure in summary.failures], call.out)
    for entry in summary.entries:
        for failure in entry.failures:
            session.fail(f"{entry.entry.label}: {failure.error}", failure.error.exit_code)
    session.results([each for entry in summary.entries for each in lines_of(entry)])


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
    call: _Call
    depfile: Path | None
    line: ProgressLine
    idle: list[str] = field(default_factory=list)

    def found(self, entries: Sequence[Entry], notes: Sequence[str], jobs: int) -> None:
        """See BatchListener. UsageError where a file would lie in a result, which is replaced as a whole."""
        files = [each for each in (("depfile", self.depfile), ("log", self.log.path)) if each[1] is not None]
        for result in (self.call.out / entry.result for entry in entries if files and entry.result.parts):
            for what, file in files:
                if file is not None and disk.lies_in(file, result):
                    raise UsageError(
                        f"the {what} {file} lies in the result {result}, which is replaced as a whole: choose a place "
                        "outside of it"
                    )
        self.log.open()
        if self.call.idle is not None and not self.idle:  # later passes of --watch are about what has changed
            self.idle.extend(self.call.idle([entry.label for entry in entries]))
            notes = [*notes, *self.idle]
        processes = f", baking with {counted(jobs, 'process')}" if jobs else ", nothing has changed"
        self.session.print(*(f"note: {note}" for note in notes), f"found {counted(len(entries), 'source')}{processes}")
        self.line.show("baking", 0.0)
        self.line.note(f"0 of {len(entries)} done")

    def left(self, result: EntryResult) -> None:
        """See BatchListener."""
        self.log.write(result)

    def done(self, result: EntryResult, progress: Progress) -> None:
        """See BatchListener."""
        for each in result.results:
            self.session.print(_line(each, result, progress))
            if isinstance(each, BakedSet):
                wrote = f"wrote {each.out}: {counted(len(each.files), 'file')}"
                self.session.details(*(f"warning: {line}" for line in each.warnings), wrote)
                for defect in each.defects:
                    self.session.fail(f"{result.entry.label}: {defect}", DEFECT)
        self.log.write(result)
        self.line.show("baking", progress.done / progress.count, progress.seconds_left)
        self.line.note(f"{progress.done} of {progress.count} done")


def _line(each: Result, result: EntryResult, progress: Progress) -> str:
    """One line for one set."""
    at = f"[{progress.done}/{progress.count}]"
    if isinstance(each, Planned):
        return f"{result.entry.label}: would be baked to {each.out}, because {each.why}"
    if isinstance(each, NotBaked):
        return f"{at} {result.entry.label}: failed"
    if not isinstance(each, (BakedSet, BakedDocument)):
        return f"{at} {result.entry.label}: unchanged"
    warned = f", {counted(len(each.warnings), 'warning')}" if isinstance(each, BakedSet) and each.warnings else ""
    said = f"{_OUTCOMES[_outcome(each)]}, " if _outcome(each) else ""
    size = f"{each.bytes / 1e6:.1f} MB"
    if not each.files:  # it lies in the file of its document, whose line follows
        size = f"baked the material {each.out.name}"
    return f"{at} {result.entry.label}: {said}{size} in {result.seconds:.1f} s{warned}"


def _outcome(each: Result) -> str:
    """The outcome of the verdict on a set; "" where it has none."""
    promise = each.provenance.promise if isinstance(each, BakedSet) else None
    return "" if promise is None else verdict(promise).outcome


def _summary_line(summary: Summary) -> str:
    documents = f" and {counted(summary.documents, 'document')}" if summary.documents else ""
    planned = f"{summary.planned} would be baked, " if summary.planned else ""
    baked = f"{counted(summary.baked, 'set')}{documents} baked, "
    found = Counter(_outcome(each) for entry in summary.entries for each in entry.results)
    verdicts = ", ".join(f"{found[outcome]} {words}" for outcome, words in _OUTCOMES.items() if found[outcome])
    beside = f"; beside plain MIP maps: {verdicts}" if verdicts else ""
    return f"{planned or baked}{summary.unchanged} unchanged, {len(summary.failures)} failed{beside}"
