"""A library under watch."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mipbake.baking import BakeOptions
from mipbake.cli.main import main
from mipbake.library import BatchOptions, Library, bake_library, entries_below
from mipbake.library.state import States
from mipbake.library.watching import touched, watched

from .command_line import fails, write_png, write_set

LINEAR = BakeOptions(method="linear", format="png", max_level=1)


def until(holds: Callable[[], bool], seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if holds():
            return True
        time.sleep(0.05)
    return False


def baked(log: Path) -> list[str]:
    """Entries that were baked, by a log of JSON that is being written."""
    lines = [line for line in read(log).splitlines(keepends=True) if line.endswith("\n")]
    return [each["entry"] for each in map(json.loads, lines) if "files" in each]


def read(each: Path) -> str:
    return each.read_text() if each.exists() else ""


@pytest.mark.long
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")
def test_what_is_saved_is_baked(tmp_path: Path) -> None:
    library, out, log = tmp_path / "lib", tmp_path / "lib" / "out", tmp_path / "log.jsonl"
    write_set(library / "wood")
    write_set(library / "iron")
    command = [sys.executable, "-m", "mipbake.cli.main", "bake", str(library), "-r", "-o", str(out), "--watch"]
    command += ["--method", "linear", "--json-log", str(log)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert until(lambda: read(log).count("\n") == 2)
        time.sleep(1.5)  # the watch has begun; what is saved before is found, too, but not as a single file
        write_png(library / "wood" / "roughness.png", np.full((16, 16), 200, np.uint8))
        assert until(lambda: len([each for each in baked(log) if each == "wood"]) == 2), read(log)
        write_set(library / "new" / "gold")
        assert until(lambda: "new/gold" in baked(log)), read(log)
        time.sleep(1.0)
    finally:
        process.send_signal(signal.SIGTERM)  # shells have what they run in the background ignore SIGINT
        told, errors = process.communicate(timeout=60)
    done = baked(log)
    assert sorted(done[:2]) == ["iron", "wood"] and done[2:] == ["wood", "new/gold"], done
    assert process.returncode == 143 and "terminated" in errors
    assert told.count("watching") >= 3


@pytest.mark.long
def test_entries_that_changed_files_belong_to(tmp_path: Path) -> None:
    root, out = tmp_path / "lib", tmp_path / "out"
    for name in ("a", "b"):
        write_set(root / name)
    bake_library(root, out, LINEAR, None, BatchOptions())
    library = entries_below([root], out)
    looked: list[int] = []

    def find() -> Library:
        looked.append(1)
        return entries_below([root], out)

    states = States(out, write=False)
    whole, part = touched(library, {root / "a" / "normal.png"}, states, find)
    assert whole is library and [each.label for each in part.entries] == ["a"] and not looked
    # A program may save into a file of another name, and then give it the name.
    both = {root / "a" / "normal.png", root / "a" / "normal.png.saving"}
    whole, part = touched(library, both, states, find)
    assert whole is library and [each.label for each in part.entries] == ["a"] and not looked
    assert not touched(library, {root / "a" / "normal.png.saving"}, states, find)[1].entries and not looked
    write_set(root / "c")
    whole, part = touched(library, {root / "c" / "normal.png"}, states, find)
    assert [each.label for each in whole.entries] == [each.label for each in part.entries] == ["a", "b", "c"]
    (root / "a" / "normal.png").unlink()
    touched(library, {root / "a" / "normal.png"}, states, find)
    touched(library, None, states, find)
    assert len(looked) == 3


def test_folders_that_are_watched(tmp_path: Path) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "c.zip").touch()
    assert watched([tmp_path / "a", tmp_path / "a" / "b"]) == [tmp_path / "a"]
    assert watched([tmp_path / "a", tmp_path / "c.zip"]) == [tmp_path]


def test_options_that_do_not_go_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["bake", write_set(tmp_path / "s"), "-o", tmp_path / "out", "--watch"]
    assert "dry run bakes nothing" in fails(capsys, 2, *base, "--dry-run")
    assert "--watch goes on without end" in fails(capsys, 2, *base, "--depfile", tmp_path / "d")
    assert "use --json-log" in fails(capsys, 2, *base, "--json")
    assert not (tmp_path / "out").exists()
    assert main(["bake", str(base[1]), "-o", str(tmp_path / "out"), "--method", "linear", "--check"]) == 5
