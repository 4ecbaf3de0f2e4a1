"""Measuring records, whole or a sample: each by its command, in a process of its own."""

from __future__ import annotations

import importlib
import importlib.util
import json
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mipbake import _native
from records import films, fits, results
from records.code import ROOT, hashes, together
from records.known import MATERIALS, OUT, WORK, Known
from records.record import Confirmed, Difference, Measured, Record, confirmed, drawn, rounded
from records.scripts import script

Run = Callable[[str, Known, "Path | None", Path, Sequence[str], Path], Any]
"""A function with the arguments of `run`."""

FILMS = "films"
"""The record of films, whose sets have files of their own as results have."""

FIT = "fit"
"""The record of fits, whose sets lie below renderers."""

DIGITS = 6
"""Significant ones of figures in records; results of many methods and sets have four."""


def measure(name: str, known: Known, materials: Path | None, on: str, root: Path = ROOT) -> Record:
    """A new record. What a stopped run has measured with the same code stays in build/records, below the root."""
    check_built(root)
    now = hashes(known.entry) if known.entry else {}
    work = root / "build" / "records" / f"{name}-{together(now)}"
    work.mkdir(parents=True, exist_ok=True)
    before = _processor_seconds()
    data = run(name, known, materials, work, (), root)
    seconds = _processor_seconds() - before
    for picture in (each for each in work.iterdir() if known.pictures and each.suffix in (".png", ".webp")):
        shutil.move(picture, root / known.pictures / picture.name)
    if name.startswith("results-"):
        seconds = sum(file["processor_seconds"] for file in results.read_files(work / _kind(name)))
    elif name == FILMS:  # parts of it may have been measured before
        seconds = sum(each["processor_seconds"] for each in data["sets"].values())
    shutil.rmtree(work)
    return Record(name, Measured(on, _machine(), float(f"{seconds:.3g}"), together(now)), now, data)


def confirm(
    record: Record, known: Known, materials: Path, on: str, root: Path = ROOT, measured: Run | None = None
) -> tuple[Record | None, list[str]]:
    """The record with the code of today, where a sample agrees with it, and lines about the sample.

    Args:
        measured: measures the sample; None for `run`.
    """
    check_built(root)
    now = hashes(known.entry) if known.entry else {}
    every = fits.sets(record.data) if record.name == FIT else list(record.data["sets"])
    names = drawn(every, known.sample, now)
    with tempfile.TemporaryDirectory() as scratch:
        sample = (measured or run)(record.name, known, materials, Path(scratch), ("--plans", *names), root)
    compared = {FILMS: films.differences, FIT: fits.differences}.get(record.name, results.differences)
    found = compared(record.data, sample)
    lines = [f"{record.name}: {', '.join(names)} measured again, {len(found)} figures"]
    wrong = [each for each in found if each.share > 1]
    lines += [_line(each) for each in sorted(wrong, key=lambda each: -each.share)[:20]]
    if wrong or not found:
        return None, [*lines, f"{len(wrong)} figures disagree: the record is stale until it is measured again"]
    stamped = confirmed(record, now, on, f"{', '.join(names)}, all figures", found)
    return stamped, [*lines, f"all agree, the farthest with {_share(stamped.confirmed)} of what is tolerated"]


def check_built(root: Path = ROOT) -> None:
    """A record of an older native core would be stamped with sources that it never saw.

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


def spent(seconds: float) -> str:
    """`12 s` or `34 min`."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def run(name: str, known: Known, materials: Path | None, work: Path, more: Sequence[str], root: Path) -> Any:
    """What the command of a record measures, as the `data` of a record.

    Args:
        work: folder for what the command writes. more: further arguments of the command. root: where it runs.
    """
    out = work / "out.json"
    places = {MATERIALS: str(materials), OUT: str(out), WORK: str(work)}
    command = [sys.executable]
    for each in known.command:
        for place, path in places.items():
            each = each.replace(place, path)  # noqa: PLW2901
        command.append(each)
    command += more
    printed = subprocess.run(
        command, cwd=root, check=True, text=True, stdout=None if _writes(name, known) else subprocess.PIPE
    )
    if name.startswith("results-"):
        return results.pack(results.read_files(work / _kind(name)))
    if name.startswith("fitting-"):
        script = Path(known.command[0]).stem
        return rounded(json.loads((work / f"{script}.json").read_text(encoding="utf-8")), DIGITS)
    if OUT in known.command:
        return rounded(json.loads(out.read_text(encoding="utf-8")), DIGITS)
    return {"printed": printed.stdout.strip().splitlines()}


def _writes(name: str, known: Known) -> bool:
    return OUT in known.command or name.startswith(("results-", "fitting-"))


def _kind(name: str) -> str:
    return name.removeprefix("results-")


def _line(each: Difference) -> str:
    return (
        f"  {each.name}: {each.record:g} in the record, {each.sample:g} now, {each.share:.1f} times what is tolerated"
    )


def _share(about: Confirmed | None) -> str:
    return f"{about.largest:.0%}" if about else ""


def _machine() -> str:
    return f"{script('benchmarks', 'timing').cpu_name()}, {_native.isa()}"


def _processor_seconds() -> float:
    """Processor time of this process and of the processes that it has started and seen end."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)
