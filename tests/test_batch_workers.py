"""Batches in processes of their own: killed, stopped and gone on with."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import shlex
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from mipbake.baking import BakeOptions
from mipbake.base.leftovers import OLD, PARTIAL
from mipbake.cli.main import main
from mipbake.library import BatchOptions, bake_library
from mipbake.library.workers import Share

from .batch_inline import aged
from .command_line import tree, write_png, write_set

LINEAR = BakeOptions(method="linear", format="png", max_level=1)
COMMAND = [sys.executable, "-m", "mipbake.cli.main", "bake"]
needs_signals = pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")


def write_library(root: Path, count: int = 6) -> Path:
    for index in range(count):
        write_set(root / f"group{index % 2}" / f"set{index}", roughness=np.full((16, 16), 40 + index, np.uint8))
    (root / "broken").mkdir()
    write_png(root / "broken" / "normal.png", np.tile(np.uint8([128, 128, 255]), (16, 16, 1)))
    return aged(root)


def content(out: Path) -> dict[str, bytes]:
    return {name: (out / name).read_bytes() for name in tree(out) if (out / name).is_file() and ".mipbake" not in name}


def test_threads_and_memory_are_shared() -> None:
    assert Share.of(2, 8, 4000) == Share(4, 2000)
    assert Share.of(4, 2, None) == Share(1, None)


@pytest.mark.long
@needs_signals
def test_a_process_that_is_killed_costs_nothing(tmp_path: Path) -> None:
    """Its work is begun once more. Which process is killed, and when, is of no matter."""
    library = write_library(tmp_path / "lib", 3)
    killed = threading.Event()

    def kill() -> None:
        while not (found := multiprocessing.active_children()):
            time.sleep(0.01)
        os.kill(found[0].pid or 0, signal.SIGKILL)
        killed.set()

    thread = threading.Thread(target=kill)
    thread.start()
    summary = bake_library(library, tmp_path / "out", LINEAR, None, BatchOptions(jobs=2))
    thread.join()
    assert killed.is_set()
    assert (summary.baked, len(summary.failures)) == (3, 1)
    bake_library(library, tmp_path / "calm", LINEAR)
    assert content(tmp_path / "out") == content(tmp_path / "calm")


@needs_signals
def test_what_kills_a_process_twice_is_a_failure(tmp_path: Path) -> None:
    library = write_library(tmp_path / "lib", 1)
    over = threading.Event()

    def kill() -> None:
        while not over.is_set():
            for child in multiprocessing.active_children():
                os.kill(child.pid or 0, signal.SIGKILL)
            time.sleep(0.02)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        summary = bake_library(library, tmp_path / "out", LINEAR)
    finally:
        over.set()
        thread.join()
    assert summary.exit_code == 1 and len(summary.failures) == 2
    assert "ended before its work, and so did a second one" in str(summary.failures[0].error)


@pytest.mark.long
@needs_signals
def test_a_batch_that_is_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    library = write_library(tmp_path / "lib", 4)
    out, log = tmp_path / "out", tmp_path / "log.jsonl"
    command = [*COMMAND, str(library), "-r", "-o", str(out), "-j", "2", "--method", "linear", "--json-log", str(log)]
    rng, baked = random.Random(1), []

    def done() -> list[str]:
        lines = log.read_text().splitlines(keepends=True) if log.exists() else []
        told = [json.loads(line) for line in lines if line.endswith("\n")]
        return [each["entry"] for each in told if "files" in each]

    for number in (signal.SIGKILL, signal.SIGTERM):
        log.unlink(missing_ok=True)
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        before = len(baked)
        begun = time.monotonic()
        while process.poll() is None and not done() and time.monotonic() - begun < 120:
            time.sleep(0.02)  # until it has baked one, so that there is something to keep
        time.sleep(rng.uniform(0, 0.3))
        process.send_signal(number)
        _, told = process.communicate(timeout=120)
        baked += done()
        assert process.returncode in (3, -number, 128 + number), told
        # A signal that comes when all is done ends what Python does before it ends, and nothing is said of it.
        assert process.returncode in (3, -number) or "nothing unfinished" in told
        if process.returncode == 3:
            break
        assert len(baked) > before
    log.unlink(missing_ok=True)
    last = subprocess.run(command, capture_output=True, text=True, check=False)
    baked += done()
    assert last.returncode == 3 and "no roughness map" in last.stderr
    assert sorted(baked) == sorted(set(baked)), baked  # one whose line was not written any more is not baked again
    bake_library(library, tmp_path / "calm", BakeOptions(method="linear"))
    assert content(out) == content(tmp_path / "calm")
    assert not [name for name in tree(out) if name.endswith((PARTIAL, OLD))]


@pytest.mark.long
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    library, out, log = write_library(tmp_path / "lib", 2), tmp_path / "out", tmp_path / "log.jsonl"
    base = ["bake", str(library), "-r", "-o", str(out), "--method", "linear"]
    assert main([*base, "--dry-run"]) == 3
    told = capsys.readouterr()
    assert told.out.count("would be baked to") == 2 and "2 would be baked, 0 unchanged, 1 failed" in told.out
    assert not out.exists()
    assert main([*base, "--json-log", str(log)]) == 3
    told = capsys.readouterr()
    assert "found 3 sources, baking with 1 process" in told.out
    assert told.out.count(" MB in ") == 2 and "broken: failed" in told.out
    assert "2 sets baked, 0 unchanged, 1 failed" in told.out
    assert told.err.count("\n") == 1 and told.err.startswith("mipbake: broken: ")
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert {line["entry"]: line["ok"] for line in lines} == {"broken": False, "group0/set0": True, "group1/set1": True}
    assert main([*base, "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert [each.get("unchanged", False) for each in found["results"]] == [False, True, True]
    assert found["exit_code"] == 3
    assert main([*base, "--quiet", "--force"]) == 3
    told = capsys.readouterr()
    assert told.out == "" and told.err.count("\n") == 1


@needs_signals
def test_no_process_can_be_begun(tmp_path: Path) -> None:
    library = write_library(tmp_path / "lib", 1)
    command = [*COMMAND, str(library), "-r", "-o", str(tmp_path / "out"), "--method", "linear"]
    script = "ulimit -n 12 && exec " + " ".join(map(shlex.quote, command))
    run = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False, timeout=120)
    assert run.returncode != 0 and "Traceback" not in run.stderr, run.stderr
