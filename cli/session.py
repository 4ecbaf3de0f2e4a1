"""What the commands share while they run: where they print, how they show progress, how a run ends."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mipbake.base.errors import MipbakeError, RendererError, shortened
from mipbake.base.timings import Timings
from mipbake.base.version import __version__

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

_PIPED_WIDTH = 10_000  # columns; nothing is cut or wrapped where no terminal is


@dataclass
class Session:
    """The state of one call of the command line.

    Args:
        debug: whether defects show their traceback.
        quiet: whether only errors are printed.
        json: whether stdout is for one JSON object.
        in_files: whether the result lies in files, and what is printed only tells of it.
        kept: a file that a run leaves on purpose where it is stopped: the same command goes on from it.
        exit_code: what a command that ends normally returns.
        given: names of the command's parameters that the user gave.
    """

    debug: bool = False
    quiet: bool = False
    json: bool = False
    in_files: bool = False
    kept: Path | None = None
    exit_code: int = 0
    given: frozenset[str] = frozenset()

    def configure(self, quiet: bool, json: bool) -> None:
        """Takes over the options of a command."""
        self.quiet, self.json = quiet, json

    @property
    def talks(self) -> bool:
        """Whether a person reads stdout."""
        return not (self.quiet or self.json)

    def print(self, *things: Any) -> None:
        """Prints for a person, on stdout: strings as they are, or rich's tables."""
        if self.talks:
            for thing in things:
                console(sys.stdout).print(thing, soft_wrap=isinstance(thing, str))

    def dump(self, content: Mapping[str, Any]) -> None:
        """Prints the JSON object of --json, which begins with the version."""
        if self.json:
            whole = {"version": __version__, **content}
            sys.stdout.write(json.dumps(plain(whole), indent=2, allow_nan=False) + "\n")

    def results(self, results: Sequence[Mapping[str, Any]]) -> None:
        """`dump` for what was done with each source."""
        self.dump({"exit_code": self.exit_code, "results": results})

    def fail(self, message: str, exit_code: int, printed: Sequence[str] = ()) -> int:
        """Prints one sentence on stderr and returns the exit code of the run, the highest of all failures so far.

        Lines that another program printed follow it as they are.
        """
        one_line = shortened(" ".join(message.split()))
        sys.stderr.write("".join(f"{line}\n" for line in (f"mipbake: {one_line}", *printed)))
        self.exit_code = max(self.exit_code, exit_code)
        return self.exit_code

    def failed(self, source: Path, error: MipbakeError) -> dict[str, Any]:
        """`fail` for what was to be done with a source, which does not keep others from it; returns it for JSON."""
        self.raised(error)
        return failed(source, error)

    def raised(self, error: MipbakeError) -> int:
        """`fail` for an error. Lines that a renderer printed are kept apart."""
        if isinstance(error, RendererError):
            sentence, *printed = error.full.splitlines()
            return self.fail(sentence, error.exit_code, printed)
        return self.fail(error.full, error.exit_code)


def counted(count: int, what: str) -> str:
    """A number of things, in words."""
    return f"{count} {what}{'' if count == 1 else 'es' if what.endswith('s') else 's'}"


def failed(source: Path, error: MipbakeError) -> dict[str, Any]:
    """What went wrong with a source, for JSON."""
    return {"source": source, "ok": False, "exit_code": error.exit_code, "error": str(error)}


def console(file: Any) -> Console:
    """A console for a stream that is open now. rich leaves out colours where no terminal is, and under NO_COLOR."""
    from rich.console import Console

    width = None if file.isatty() else _PIPED_WIDTH
    # File names may hold brackets and colons: they are text, never markup.
    return Console(file=file, width=width, markup=False, highlight=False, emoji=False)


def plain(value: Any) -> Any:
    """Types that JSON knows; figures that are not finite become null."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


@contextmanager
def bar(session: Session, first: str, *others: Any) -> Iterator[Progress | None]:
    """A progress bar on stderr, where stderr is a terminal and the user has not asked for quiet."""
    if session.quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn(first), BarColumn(), *others, TimeElapsedColumn())
    with Progress(*columns, console=console(sys.stderr), transient=True) as made:
        yield made


@contextmanager
def timings(session: Session, label: str) -> Iterator[Timings]:
    """Timings with a progress bar."""
    with bar(session, "{task.description}", "{task.percentage:>3.0f}%") as shown:
        if shown is None:
            yield Timings()
            return
        tasks: dict[str, Any] = {}

        def show(phase: str, share: float) -> None:
            if phase not in tasks:
                tasks[phase] = shown.add_task(f"{label}: {phase}", total=1.0)
            shown.update(tasks[phase], completed=share)

        def note(text: str) -> None:
            phase, task = next(reversed(tasks.items()))
            shown.update(task, description=f"{label}: {phase}, {text}")

        yield Timings(show, note)
