"""The console script: parses, runs a command, and turns whatever happens into one sentence and an exit code."""

from __future__ import annotations

import contextlib
import gc
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Annotated, NoReturn

import typer

from mipbake.base import disk
from mipbake.base.allocator import keep_freed_memory
from mipbake.base.errors import InputError, MipbakeError, OutputError, UsageError
from mipbake.base.extras import told_of
from mipbake.base.leftovers import unfinished
from mipbake.base.messages import listed, one_line
from mipbake.base.names import unknown
from mipbake.base.version import __version__
from mipbake.cli.commands import Commands
from mipbake.cli.session import Session
from mipbake.cli.streams import lost, replace_streams

EXIT_UNEXPECTED = 1
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

_EPILOG = (
    "Exit codes: 0 done, 1 unexpected (a defect, or too little memory), 2 usage, 3 unusable input, 4 unwritable "
    "output, 5 a condition of --fail-if or of --check holds, 6 a renderer failed, 130 interrupted, 143 terminated. "
    "With several sets, the highest counts."
)

app = typer.Typer(
    name="mipbake",
    cls=Commands,
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog=_EPILOG,
)
# typer's own errors share an ancestor that is not part of its documented interface: older versions take it from click.
_PARSING_ERROR: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


class _Stopped(BaseException):
    """SIGINT or SIGTERM: unwinds, so that nothing half-written stays behind.

    Args:
        code: the exit code.
    """

    latest: int | None = None
    """Exit code of the latest signal. The code that the exception passes through may turn it into another exception, as
    a module that is being loaded does."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = _Stopped.latest = code


def _show_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write("\n".join(_versions()) + "\n")
        raise typer.Exit


def _versions() -> Iterator[str]:
    """Version, instruction set in use, CUDA or not, weights found; one line each."""
    from mipbake import _native
    from mipbake.models.registry import list_weights

    yield f"mipbake {__version__}"
    yield f"instruction set: {_native.isa()}"
    without_device = "compiled, but no device found" if _native.cuda_compiled() else "no"
    yield f"CUDA: {'yes' if _native.cuda_available() else without_device}"
    try:
        found = [f"{w.name} ({', '.join(w.targets)}; {', '.join(w.pixel_filters)})" for w in list_weights()]
    except MipbakeError as error:
        found = [f"unreadable ({error})"]
    yield f"weights: {', '.join(found) or 'none'}"


def _show_cmake_dir(wanted: bool) -> None:
    if wanted:
        from importlib.resources import files

        sys.stdout.write(f"{files('mipbake') / 'cmake'}\n")
        raise typer.Exit


@app.callback()
def _common(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show versions and exit.")
    ] = False,
    cmake_dir: Annotated[
        bool,
        typer.Option(
            "--cmake-dir",
            callback=_show_cmake_dir,
            is_eager=True,
            help="Show the folder that find_package of CMake takes, and exit.",
        ),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an unexpected error.")] = False,
) -> None:
    """Bake PBR texture sets into MIP maps that look right from near and far, for game engines and renderers."""
    from mipbake import _native

    del version, cmake_dir
    context.obj.debug = debug
    # The native core looks at its variables of the environment when it is first used, which may be after minutes.
    _native.isa()
    _native.num_threads()


def main(arguments: Sequence[str]) -> int:
    """Runs the command line and returns its exit code; prints errors and raises none."""
    session = Session()
    command = typer.main.get_command(app)
    stopped = _Stopped.latest = None
    code = EXIT_UNEXPECTED
    try:
        # Without arguments, help is what is wanted.
        result = command.main(list(arguments) or ["--help"], "mipbake", standalone_mode=False, obj=session)
        code = session.exit_code
        if result == EXIT_INTERRUPTED:  # newer versions of typer raise this for Ctrl-C
            raise KeyboardInterrupt
    except MipbakeError as error:
        code = session.raised(error)
    except _PARSING_ERROR as error:
        code = session.fail(_parsing_message(error), UsageError.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        stopped = _Stopped.latest or EXIT_INTERRUPTED  # libraries make one of any signal
    except _Stopped as error:
        stopped = error.code
    except Exception as error:
        stopped = _Stopped.latest
        if stopped is None:
            code = _unforeseen(session, error)
    if stopped is not None:  # only now have all blocks been left that the exception went through
        code = session.fail(_stopped_message(stopped, session.kept), stopped)
    reason = lost(sys.stdout)
    if reason and (session.json or not session.in_files):
        told = f"cannot print the result ({reason.strerror}): check where stdout goes"
        code = session.fail(told, OutputError.exit_code)
    return code


def _stopped_message(code: int, kept: Path | None) -> str:
    """A sentence: the run was stopped, and this is left of what it had begun.

    Args:
        kept: a file that is left on purpose, where it is there.
    """
    if unfinished():
        gc.collect()  # a block that was stopped as it was entered is left when it is collected
    left = [str(path) for path in unfinished()]
    rest = (
        f"{listed(left)} could not be removed, the next bake of the same set removes it"
        if left
        else f"the same command goes on from {kept}"
        if kept is not None and kept.exists()
        else "nothing unfinished was left behind"
    )
    return f"{'interrupted' if code == EXIT_INTERRUPTED else 'terminated'}, {rest}"


def _unforeseen(session: Session, error: Exception) -> int:
    """Says what an error that is not mipbake's own means, and returns the exit code."""
    from mipbake.base import memory

    wanting = told_of(error) if isinstance(error, ModuleNotFoundError) else None
    if wanting is not None:
        return session.fail(wanting, UsageError.exit_code)
    if memory.lacks(error):
        told = one_line(str(error)) if str(error) else "the system gives no more"
        return session.fail(
            f"there is not enough memory for this ({told}): ask for less, for "
            "example for fewer points or samples, smaller pictures or a smaller set",
            EXIT_UNEXPECTED,
        )
    if isinstance(error, OSError) and error.filename is not None:  # nothing closer to it has a sentence
        return session.fail(str(disk.refused(Path(os.fsdecode(error.filename)), error)), InputError.exit_code)
    if session.debug:
        import traceback

        traceback.print_exc()
    return session.fail(
        f"sorry, this is a defect ({type(error).__name__}: {error}); please report it with the output of "
        "`mipbake --version` and of the same command as `mipbake --debug ...`",
        EXIT_UNEXPECTED,
    )


def _parsing_message(error: Exception) -> str:
    """One sentence of what the parser says, with the commands where one of them was expected."""
    message = error.format_message() if hasattr(error, "format_message") else str(error)
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "mipbake"
    expected = ""
    if context and isinstance(context.command, Commands) and "command" in message.lower():
        if wrong := re.search("'([^']*)'", message):
            return f"{unknown('command', wrong[1], context.command.list_commands(context))}; see `{path} --help`"
        expected = f": expected one of {', '.join(context.command.list_commands(context))}"
    message = " ".join(message.split()).rstrip(".?")
    return f"{message[:1].lower()}{message[1:]}{expected}; see `{path} --help`"


_EXITS = {signal.SIGINT: EXIT_INTERRUPTED, signal.SIGTERM: EXIT_TERMINATED}


def _stop(number: int, _frame: FrameType | None) -> NoReturn:
    raise _Stopped(_EXITS[signal.Signals(number)])


def _handle_signals(handler: Callable[[int, FrameType | None], NoReturn] | signal.Handlers) -> None:
    for number in _EXITS:
        with contextlib.suppress(ValueError):  # not the main thread of a program that embeds us
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler)


def run() -> None:
    """Runs the command line of the process and ends it."""
    replace_streams()
    try:
        _handle_signals(_stop)
        keep_freed_memory()
        code = main(sys.argv[1:])
        _handle_signals(signal.SIG_DFL)  # all is done: what Python does before it ends leaves nothing behind
    except _Stopped as error:  # before anything was begun, or after all was done
        code = Session().fail(_stopped_message(error.code, None), error.code)
    sys.exit(code)


if __name__ == "__main__":
    run()
