"""Renderers that are programs and fail: what is said, and that nothing is left."""

from __future__ import annotations

import _thread
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from mipbake.base.errors import RendererError
from mipbake.fitting.process import ProcessRenderer

from . import fitting_programs as programs
from .fitting_programs import ANY, GOOD, TALK, Write, fails, is_gone, levels_of, starts_another, view_of

script = pytest.fixture(programs.script)
before = pytest.fixture(programs.before)
pytestmark = programs.ON_LINUX

FAILURES = {
    "hangs at its start": (
        "print('loading', flush=True); time.sleep(1000)",
        "did not start and say hello within 1 sec",
    ),
    "dies at its start": ("sys.exit('no licence')", "ended with the exit code 1 and did not start and say hello"),
    "another version": (
        "asked(); answer({'answer': 'hello', 'renderer': 'x'}, 1)",
        "speaks version 1 of the protocol, and this mipbake speaks version 2",
    ),
    "no name": ("asked(); answer({'answer': 'hello'}); asked()", "did not say its name"),
    "hangs at a render": (
        "hello(); asked(); print('busy', flush=True); time.sleep(1000)",
        "did not render the corner within 1 seconds",
    ),
    "dies at a render": ("hello(); asked(); 1 / 0", "ended with the exit code 1 and did not render the corner"),
    "a signal": (
        "hello(); asked(); os.kill(os.getpid(), signal.SIGSEGV)",
        "was ended by the signal SIGSEGV and did not",
    ),
    "closes its output": (
        "hello(); asked(); os.close(1); time.sleep(1000)",
        "closed its standard output, where an answer was expected",
    ),
    "says an error": (
        "hello(); asked(); answer({'answer': 'error', 'message': 'no GPU'}); asked()",
        "an error: no GPU",
    ),
    "another answer": ("hello(); asked(); answer({'answer': 'banana'}); asked()", "gave the answer 'banana': expected"),
    "a number that JSON lacks": (
        'hello(); asked(); print(\'{"mipbake": 2, "id": NaN}\', flush=True); asked()',
        "cannot be read .NaN is not a number in JSON.: expected one JSON object on a line, and finite numbers",
    ),
    "a frame cut short": (
        "hello(); give(asked(), cut=1); asked()",
        "cut short: expected 24 bytes of lod from byte 120 on",
    ),
    "no frame": (
        "hello(); request = asked(); request['frame'] += 'x'; give(request); asked()",
        "cannot be read .No such file or directory.: expected the file",
    ),
    "no image": ("hello(); asked(); answer({'answer': 'frame', 'arrays': {}}); asked()", "with an image"),
    "no shape": (
        "hello(); r = asked(); open(r['frame'], 'w').close()\n"
        "answer({'answer': 'frame', 'arrays': {'image': [-4]}}); asked()",
        "gave image of its frame the shape .*: expected whole numbers",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("failure", FAILURES)
def test_a_failure_is_one_sentence_and_what_was_printed(failure: str, script: Write, before: None) -> None:
    said = "sys.stderr.write('a line on the error\\n'); sys.stderr.flush()\n"
    text, expected = FAILURES[failure]
    message = fails(script(f"{TALK}{said}{text}"), expected, timeout=1 if "within" in expected else 100)
    assert "last on its standard error:\n  a line on the error" in message
    for printed in ("loading", "busy"):
        assert (f"last on its standard output:\n  {printed}" in message) == (f"'{printed}'" in text)
    if failure == "dies at a render":
        assert (
            message.endswith("ZeroDivisionError: division by zero") and "Traceback (most recent call last):" in message
        )


@pytest.mark.parametrize("command", ["/nowhere/to/be/found --option", [os.curdir]])
def test_a_program_that_cannot_be_started(command: Any, before: None) -> None:
    fails(command, "cannot be started")


@pytest.mark.parametrize("when", ["start", "render"])
def test_after_a_failure_the_next_render_works(when: str, script: Write, tmp_path: Path, before: None) -> None:
    script(GOOD, name="good.py")
    again = tmp_path / "again"
    text = f"""{TALK}
if os.path.exists({str(again)!r}):
    os.execv(sys.executable, [sys.executable, {str(tmp_path / "good.py")!r}])
open({str(again)!r}, "w").close()
{"" if when == "start" else "hello(); asked()"}
sys.exit("the first time")
"""
    with ProcessRenderer(script(text)) as renderer:
        with pytest.raises(RendererError, match="exit code 1 and did not") as caught:
            renderer.render(levels_of(), view_of())
        assert "the first time" in str(caught.value)
        assert (renderer.render(levels_of(), view_of()).image != 0).all()  # all levels are new to it
        assert (renderer.render(levels_of(), view_of()).image != 0).all()


@pytest.mark.long
def test_a_program_that_does_not_end_is_ended(script: Write, tmp_path: Path, before: None) -> None:
    pids = tmp_path / "pids"
    text = starts_another(pids, "signal.signal(signal.SIGTERM, signal.SIG_IGN)").replace("asked()\n", "give(asked())\n")
    with ProcessRenderer(script(text + "time.sleep(1000)")) as renderer:
        renderer.render(levels_of(), ANY)
    assert all(is_gone(int(pid)) for pid in pids.read_text(encoding="utf-8").split())


@pytest.mark.parametrize(("number", "when"), [(signal.SIGINT, "start"), (signal.SIGTERM, "render")])
def test_nothing_is_left_after_an_interruption(
    number: signal.Signals, when: str, script: Write, tmp_path: Path, before: None
) -> None:
    """Ctrl-C, and the exception that a command makes of SIGTERM."""

    class Stopped(BaseException):
        pass

    def stop(*_: object) -> None:
        raise Stopped

    pids = tmp_path / "pids"
    text = f"{TALK}\n{'' if when == 'start' else 'hello(); asked()'}\nprint(os.getpid(), file=open({str(pids)!r}, 'w'))"
    handler = signal.signal(number, stop)
    try:

        def interrupt() -> None:
            while not (pids.exists() and pids.read_text(encoding="utf-8").endswith("\n")):
                time.sleep(0.01)
            _thread.interrupt_main(number)

        thread = threading.Thread(target=interrupt)
        thread.start()
        with ProcessRenderer(script(text + "\ntime.sleep(1000)")) as renderer, pytest.raises(Stopped):
            renderer.render(levels_of(), ANY)
        thread.join()
    finally:
        signal.signal(number, handler)
    assert is_gone(int(pids.read_text(encoding="utf-8")))


def test_what_a_killed_mipbake_leaves_is_removed_by_the_next(script: Write, tmp_path: Path, before: None) -> None:
    """Its program ends, because its standard input does."""
    told = tmp_path / "told"
    text = f"""{TALK}
print(os.getpid(), hello()["folder"], file=open({str(told)!r}, "w"))
for line in sys.stdin:
    give(json.loads(line))
"""
    command = script(text)
    killed = f"""
import numpy as np, os, signal
from mipbake.fitting.process import ProcessRenderer
from mipbake.fitting.protocol import JsonView
from mipbake.fitting.renderer import Levels, new_stamps
renderer = ProcessRenderer({command!r})
maps = {{"roughness": [np.ones((2, 2, 1), np.float32)]}}
renderer.render(Levels("gltf", maps, ("wrap", "wrap"), new_stamps([(2, 2)])), JsonView({{}}))
os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", killed], check=False).returncode == -signal.SIGKILL
    pid, folder = told.read_text(encoding="utf-8").split()
    assert is_gone(int(pid))
    ended = f"{TALK}\nhello()\ngive(asked())\nasked()"
    with ProcessRenderer(script(ended, name="next.py")) as renderer:
        renderer.render(levels_of(), ANY)
    assert not Path(folder).exists()
