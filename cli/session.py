"""What the commands share while they run: where they print, how they show progress, how a run ends."""

from __future__ import annotations

import json
import math
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mipbake.base.errors import MipbakeError, RendererError, shortened
from mipbake.base.progress import ProgressLine
from mipbake.base.timings import Timings
from mipbake.base.version import __version__

if TYPE_CHECKING:
    from rich.console import Console

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
        verbose: whether figures and all that was found are printed.
        line: of progress, while there is one.
        given: names of the command's parameters that the user gave.
    """

    debug: bool = False
    quiet: bool = False
    verbose: bool = False
    json: bool = False
    line: ProgressLine | None = None
    in_files: bool = False
    kept: Path | None = None
    exit_code: int = 0
    given: frozenset[str] = frozenset()

    def configure(self, quiet: bool, json: bool, verbose: bool = False) -> None:
        """Takes over the options of a command."""
        self.quiet, self.json, self.verbose = quiet, json, verbose

    @property
    def talks(self) -> bool:
        """Whether a person reads stdout."""
        return not (self.quiet or self.json)

    def print(self, *things: Any) -> None:
        """Prints for a person, on stdout: strings as they are, or rich's tables."""
        if self.talks and things:
            with self.aside():
                for thing in things:
                    if isinstance(thing, str):
                        sys.stdout.write(_in_lines(thing) + "\n")
                    else:
                        console(sys.stdout).print(thing)

    def details(self, *things: Any) -> None:
        """`print` of what most people need not know."""
        if self.verbose:
            self.print(*things)

    def aside(self) -> AbstractContextManager[None]:
        """No line of progress is in the way of what the block prints."""
        return nullcontext() if self.line is None else self.line.aside()

    def dump(self, content: Mapping[str, Any]) -> None:
        """Prints the JSON object of --json, which begins with the version."""
        if self.json:
            whole = {"version": __version__, **content}
            with self.aside():
                sys.stdout.write(json.dumps(plain(whole), indent=2, allow_nan=False) + "\n")

    def results(self, results: Sequence[Mapping[str, Any]]) -> None:
        """`dump` for what was done with each source."""
        self.dump({"exit_code": self.exit_code, "results": results})

    def fail(self, message: str, exit_code: int, printed: Sequence[str] = ()) -> int:
        """Prints one sentence on stderr and returns the exit code of the run, the highest of all failures so far.

        Lines that another program printed follow it as they are.
        """
        one_line = shortened(" ".join(message.split()))
        with self.aside():
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


def succeeded(source: Path, /, **about: Any) -> dict[str, Any]:
    """What was done with a source, for JSON."""
    return {"source": source, "ok": True, "exit_code": 0, **about}


def failed(source: Path, error: MipbakeError) -> dict[str, Any]:
    """What went wrong with a source, for JSON."""
    return {"source": source, "ok": False, "exit_code": error.exit_code, "error": str(error)}


def _in_lines(text: str) -> str:
    """A sentence in lines that break between words where a terminal shows it; paths stay whole."""
    columns = shutil.get_terminal_size().columns
    if not sys.stdout.isatty() or any(len(word) > columns for word in text.split()):
        return text
    return textwrap.fill(text, columns, break_long_words=False, break_on_hyphens=False, replace_whitespace=False)


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
def progress_line(session: Session, label: str, parts: Mapping[str, float] | None = None) -> Iterator[ProgressLine]:
    """The line of progress on stderr, unless the user has asked for quiet; see `ProgressLine`."""
    line = ProgressLine(sys.stderr, label, parts)
    if session.quiet:
        yield line
        return
    with line:
        session.line = line
        try:
            yield line
        finally:
            session.line = None


@contextmanager
def timings(session: Session, label: str, parts: Mapping[str, float] | None = None) -> Iterator[Timings]:
    """Timings with the line of progress, which has notes in decibels where these are wanted."""
    with progress_line(session, label, parts) as line:
        yield Timings(line.show, line.note if session.verbose else lambda _: None)
