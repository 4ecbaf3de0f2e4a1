"""Measuring records: each by its command, in a process of its own."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from datetime import date
from pathlib import Path
from typing import Any

from mipbake import __version__, _native
from records import results
from records.known import EXAMPLES, MATERIALS, OUT, WORK, Known
from records.record import ROOT, Measured, Record, goldens, rounded
from records.scripts import script

DIGITS = 6
"""Significant ones of figures in records; results of many methods and sets have four."""


def measure(name: str, known: Known, materials: Path | None, root: Path = ROOT) -> Record:
    """A new record. What a stopped run has measured stays in build/records, below the root, until the run ends."""
    check_built(root)
    work = root / "build" / "records" / name
    work.mkdir(parents=True, exist_ok=True)
    clock = script("benchmarks", "results").processor_seconds
    before = clock()
    data = _run(name, known, materials, work, root)
    seconds = clock() - before
    for picture in (each for each in work.iterdir() if known.pictures and each.suffix in (".png", ".webp")):
        shutil.move(picture, root / known.pictures / picture.name)
    if name.startswith("results-"):
        seconds = sum(file["processor_seconds"] for file in results.read_files(work / _kind(name)))
    elif name == "films":  # parts of it may have been measured before
        seconds = sum(each["processor_seconds"] for each in data["sets"].values())
    shutil.rmtree(work)
    machine = f"{script('benchmarks', 'timing').cpu_name()}, {_native.isa()}"
    digests = goldens() if known.golden else {}
    return Record(
        name, Measured(date.today().isoformat(), machine, float(f"{seconds:.3g}"), __version__, digests), data
    )


def check_built(root: Path = ROOT) -> None:
    """A record of an older native core would be taken for a record of today's.

    Args:
        root: folder of the checkout.

    Raises:
        SystemExit: a C++ source is newer than the native core that is installed.
    """
    found = importlib.util.find_spec("mipbake._native")
    built = Path(found.origin).resolve() if found and found.origin else None
    newest = max((root / "csrc").rglob("*.*"), key=lambda path: path.stat().st_mtime, default=None)
    if built is None or (newest is not None and newest.stat().st_mtime > built.stat().st_mtime):
        raise SystemExit(f"{newest} is newer than the native core {built}: build it, then measure")


def _run(name: str, known: Known, materials: Path | None, work: Path, root: Path) -> Any:
    """What the command of a record measures, as the `data` of a record.

    Args:
        work: folder for what the command writes. root: where it runs.
    """
    out = work / "out.json"
    places = {MATERIALS: str(materials), OUT: str(out), WORK: str(work)}
    command = [sys.executable]
    for each in known.command:
        for place, path in places.items():
            each = each.replace(place, path)  # noqa: PLW2901
        command.append(each)
    folder, _, file = name.partition("-")
    example = folder in EXAMPLES
    writes = OUT in known.command or example or name.startswith("results-")
    printed = subprocess.run(command, cwd=root, check=True, text=True, stdout=None if writes else subprocess.PIPE)
    if name.startswith("results-"):
        return results.pack(results.read_files(work / _kind(name)))
    if example:
        out = work / f"{file}.json"
    if writes:
        return rounded(json.loads(out.read_text(encoding="utf-8")), DIGITS)
    return {"printed": printed.stdout.strip().splitlines()}


def _kind(name: str) -> str:
    return name.removeprefix("results-")
