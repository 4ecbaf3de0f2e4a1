"""The line of progress: in a terminal, in a pipe, and beside what is printed."""

from __future__ import annotations

import io
import json
import os
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mipbake.base import progress
from mipbake.base.progress import ProgressLine
from mipbake.cli.session import Session

from .command_line import write_set

LONG = "a_texture_set_whose_name_is_longer_than_a_line_of_a_terminal_is_wide_2k_jpg"
PARTS = {"read": 1.0, "prefilter": 8.0, "write": 1.0}


def at(seconds: float, label: str, phase: str, share: float, monkeypatch: pytest.MonkeyPatch) -> ProgressLine:
    """A line when so much time has passed; none of its threads runs."""
    line = ProgressLine(io.StringIO(), label, PARTS)
    line.show(phase, share)
    began = time.monotonic()
    monkeypatch.setattr(progress.time, "monotonic", lambda: began + seconds)
    return line


@pytest.mark.parametrize("label", ["wood", LONG, "石" * 30])
@pytest.mark.parametrize("seconds", [0.5, 125.0, 7300.0])
def test_80_columns_hold_all_of_it(label: str, seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    line = at(seconds, label, "prefilter", 0.5, monkeypatch)
    line.note("step 12000, level 3 to 7: near the mirror 31.2 dB, over the hemisphere 35.1 dB")
    text = line.text(79)
    assert len(text) + text.count("石") <= 79
    assert "making MIP levels" in text and " #######.......  50% " in text
    assert (" left" in text) == (seconds > 3) and {0.5: " 0:00", 125.0: " 2:05,", 7300.0: " 2:01:40,"}[seconds] in text
    if label == LONG:
        assert text.startswith("a_te") and "..." in text and "jpg: making" in text


def test_a_narrow_terminal_has_words_and_times_before_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    line = at(40.0, "wood", "prefilter", 0.5, monkeypatch)
    assert line.text(59) == "wood: making MIP levels".ljust(36) + "  50% 0:40, 40 s left   "[:23]
    assert line.text(19) == "  50% 0:40, 40 s le"


def test_json_is_not_printed_into_the_line(capsys: pytest.CaptureFixture[str]) -> None:
    line, session = ProgressLine(io.StringIO()), Session(json=True)
    away: list[str] = []

    @contextmanager
    def aside() -> Iterator[None]:
        away.append(capsys.readouterr().out)
        yield
        away.append(capsys.readouterr().out)

    line.aside = aside
    session.line = line
    session.results([])
    before, printed = away
    assert not before and json.loads(printed)["results"] == []


def test_shares_are_of_all_the_work_and_never_go_back(monkeypatch: pytest.MonkeyPatch) -> None:
    line = at(40.0, "wood", "prefilter", 0.5, monkeypatch)
    assert line.text(None) == "wood: making MIP levels, 50%, 0:40, 40 s left"
    line.show("prefilter", 0.25)
    assert "50%" in line.text(None)
    line.show("a phase that is not in the list", 1.0)
    assert line.text(None).startswith("wood: a phase that is not in the list, 50%, ")
    line.show("write", 1.0)
    assert line.text(None) == "wood: writing files, 100%, 0:40"


def test_a_time_that_is_known_counts_down(monkeypatch: pytest.MonkeyPatch) -> None:
    line = ProgressLine(io.StringIO(), "library")
    line.show("baking", 0.25, 30.0)
    began = time.monotonic()
    monkeypatch.setattr(progress.time, "monotonic", lambda: began + 10.0)
    assert line.text(None) == "library: baking, 25%, 0:10, 20 s left"
    monkeypatch.setattr(progress.time, "monotonic", lambda: began + 40.0)
    assert line.text(None) == "library: baking, 25%, 0:40"
    line.show("baking", 0.5, float("inf"))
    assert line.text(None) == "library: baking, 50%, 0:40"


def test_a_pipe_gets_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "EVERY", 0.05)
    stream = io.StringIO()
    with ProgressLine(stream, "wood", PARTS) as line:
        time.sleep(0.2)
        assert stream.getvalue() == ""  # nothing has begun
        line.show("read", 0.5)
        time.sleep(0.5)
    lines = stream.getvalue().splitlines()
    assert 3 <= len(lines) <= 12 and set(lines) == {"wood: looking at the source, 5%, 0:00"}


@pytest.mark.skipif(os.name == "nt", reason="pseudo-terminals")
def test_a_terminal_shows_one_line_and_what_is_printed_stays(tmp_path: Path) -> None:
    """Of 80 columns; the line is gone in the end, and is not in the way of what is printed meanwhile."""
    import fcntl
    import pty
    import termios

    write_set(tmp_path / LONG)
    script = (
        "import sys, time\n"
        "from mipbake.cli.main import main\n"
        "from mipbake.source import jobs\n"
        "read = jobs.read\n"
        "jobs.read = lambda *given: (time.sleep(0.6), read(*given))[1]\n"
        f"sys.exit(main(['bake', {str(tmp_path / LONG)!r}, '-o', {str(tmp_path / 'out')!r}, '--method', 'linear']))\n"
    )
    terminal, other = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    running = subprocess.Popen([sys.executable, "-c", script], stdout=other, stderr=other, env=environment)
    os.close(other)
    written = b""
    try:
        while piece := os.read(terminal, 65536):
            written += piece
    except OSError:  # the terminal is closed
        pass
    assert running.wait() == 0
    rows = [row.split("\r") for row in written.decode().replace("\r\n", "\n").split("\n")]
    shown = [text for row in rows for text in row[:-1] if text.strip()]
    assert shown and all(len(text) == 79 for text in shown)
    assert any("a_te" in text and "looking at the source" in text for text in shown)
    stays = [row[-1] for row in rows]
    assert stays[0].startswith(f"{LONG}:") and any(row.startswith("wrote ") for row in stays)
    assert not any("looking at" in text for text in stays)
