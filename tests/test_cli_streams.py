"""Closed and broken streams, signals while the program loads, and kills at random: the exit code tells the truth."""

from __future__ import annotations

import os
import select
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import mipbake
from mipbake.cli.main import main

from .command_line import tree, write_set

pytestmark = pytest.mark.skipif(os.name == "nt", reason="shells and signals as POSIX has them")

ROOT = Path(__file__).resolve().parent.parent
# The entry point as the console script calls it, from the checkout, which need not be installed.
ENTRY = "import sys; from mipbake_start import run; sys.argv[0] = 'mipbake'; run()"
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p and p != str(ROOT))}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_set(tmp_path / "set")


def shell(line: str, *arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a line of bash in which `$MIPBAKE` stands for the program and its arguments."""
    command = shlex.join([sys.executable, "-c", ENTRY, *map(str, arguments)])
    script = ["bash", "-c", "set -o pipefail\n" + line.replace("$MIPBAKE", command)]
    done = subprocess.run(script, capture_output=True, text=True, env=ENVIRONMENT, timeout=120, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.long
@pytest.mark.parametrize("line", ["$MIPBAKE | head -n 1", "$MIPBAKE >&-", "$MIPBAKE > /dev/full 2> /dev/full"])
def test_a_bake_goes_on_without_a_reader(folder: Path, tmp_path: Path, line: str) -> None:
    if "/dev/full" in line and not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    code, out, err = shell(line, "bake", folder, "-o", tmp_path / "out", "--method", "linear")
    assert (code, err) == (0, "") and out.count("\n") <= 1
    assert mipbake.open_stack(tmp_path / "out" / "set").size == (16, 16)


@pytest.mark.long
@pytest.mark.parametrize("arguments", [["inspect"], ["--help"], ["bake", "--json"]])
@pytest.mark.parametrize("line", ["$MIPBAKE > /dev/full"])
def test_a_result_that_cannot_be_printed_exits_4(folder: Path, tmp_path: Path, line: str, arguments: list[str]) -> None:
    if "/dev/full" in line and not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    command, *options = arguments
    if command == "bake":
        options += ["-o", str(tmp_path / "out"), "--method", "linear"]
    code, out, err = shell(line, command, *([folder] if command in ("bake", "inspect") else []), *options)
    assert (code, out) == (4, "") and err.startswith("mipbake: cannot print the result (") and err.count("\n") == 1
    assert (tmp_path / "out" / "set").exists() == (command == "bake")


def test_an_error_that_nobody_reads_keeps_its_exit_code(tmp_path: Path) -> None:
    code, _, _ = shell("$MIPBAKE >&- 2>&-", "bake", tmp_path / "none", "-o", tmp_path / "out")
    assert code == 3


@pytest.mark.long
def test_no_file_takes_the_place_of_a_closed_stream(folder: Path, tmp_path: Path) -> None:
    """What a library prints by the number of stdout must not go into a map."""
    code, _, _ = shell("$MIPBAKE <&- >&- 2>&-", "bake", folder, "-o", tmp_path / "closed", "--method", "linear")
    assert code == 0 and main(["bake", str(folder), "-o", str(tmp_path / "open"), "--method", "linear", "-q"]) == 0
    for name in tree(tmp_path / "open" / "set"):
        assert (tmp_path / "closed" / "set" / name).read_bytes() == (tmp_path / "open" / "set" / name).read_bytes()


@pytest.mark.long
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_while_the_program_loads_end_it_in_a_sentence(
    folder: Path, tmp_path: Path, number: int, code: int
) -> None:
    # It says when the entry point looks at its streams, which it does after it handles signals: Python itself takes a
    # moment before.
    program = (
        "import os, signal, sys, time; import mipbake_start as start; sys.argv[0] = 'mipbake'; "
        "signal.signal(signal.SIGINT, signal.default_int_handler); "  # a shell may ignore it
        "fstat = os.fstat; os.fstat = lambda number: (setattr(os, 'fstat', fstat), print(flush=True), "
        "[time.sleep(0.05) for _ in range({naps})], fstat(number))[-1]; start.run()"
    )
    for delay in (0.0, 0.1, 0.4):
        # The first signal finds the program where nothing is begun. It naps, as a signal that comes just before a sleep
        # does not end that sleep.
        waiting = program.format(naps=0 if delay else 1200)
        running = subprocess.Popen(
            [sys.executable, "-c", waiting, "bake", folder, "-o", tmp_path / "out", "--method", "linear"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=ENVIRONMENT,
        )
        assert running.stdout is not None and running.stdout.readline() == "\n"
        time.sleep(delay)
        running.send_signal(number)
        _, err = running.communicate(timeout=60)
        if running.returncode not in (0, -number):  # it was done, and may have been about to end
            assert running.returncode == code and err.count("\n") == 1 and "Traceback" not in err, err
        assert "Traceback" not in err and (delay or running.returncode == code), err


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_before_the_command_is_known_end_it_in_a_sentence(folder, tmp_path, number, code):
    program = (
        "import os, signal, sys, typer.main; from mipbake.cli.main import run; "
        "signal.signal(signal.SIGINT, signal.default_int_handler); "  # a shell may ignore it
        f"typer.main.get_command = lambda app: os.kill(os.getpid(), {int(number)}); run()"
    )
    command = [sys.executable, "-c", program, "bake", folder, "-o", tmp_path / "out", "--method", "linear"]
    done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, timeout=60, check=False)
    assert done.returncode == code
    assert done.stderr.count("\n") == 1 and "nothing unfinished was left behind" in done.stderr


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_lines_arrive_at_once_without_buffers(stream: str) -> None:
    """As in containers, where PYTHONUNBUFFERED is set and a log is read while the program runs."""
    code = (
        "import sys; from mipbake.cli.streams import replace_streams; replace_streams(); "
        f"sys.{stream}.write('a line\\n'); sys.stdin.read()"
    )
    environment = {**ENVIRONMENT, "PYTHONUNBUFFERED": "1"}
    pipes = {"stdin": subprocess.PIPE, stream: subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], env=environment, **pipes) as running:
        out = running.stdout if stream == "stdout" else running.stderr
        ready, _, _ = select.select([out], [], [], 60)
        assert ready == [out] and out is not None and os.read(out.fileno(), 99) == b"a line\n"
        running.communicate()
    assert running.returncode == 0
