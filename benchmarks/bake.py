"""Time and peak memory of `mipbake` as a whole process, start-up included.

    python benchmarks/bake.py [--sizes 1024 4096 8192] [--runs 3]

The sets are generated (examples/generate.py). Temporary files need 7 GB, or 25 GB for 16384. Prints a Markdown table.
Figures are medians of the runs; sets of more than 1024 x 1024 are baked once.
"""

from __future__ import annotations

import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from timing import MIPBAKE, ROOT, arguments, cpu_name, show

sys.path.append(str(ROOT / "examples"))
import generate

_OFTEN = 1024
"""Texels a side of the largest set that is baked several times."""

ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
"""Of the processes: Python keeps what it compiled, as it does for everybody who installed a package."""


def run(arguments: Sequence[str]) -> tuple[float, float, float]:
    """Wall seconds, processor seconds and peak memory in GiB of one `mipbake` process."""
    start = time.perf_counter()
    process = subprocess.Popen(
        [*MIPBAKE, *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        cwd=tempfile.gettempdir(),
        env=ENVIRONMENT,
    )
    assert process.stderr is not None
    message = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(message.decode())
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20


def write_set(folder: Path, size: int) -> None:
    """hammered_copper, which is periodic, repeated to fill (size, size)."""
    part = min(size, 512)
    maps = generate.make("hammered_copper", part, part)
    repeats = size // part
    generate.store({name: np.tile(each, (repeats, repeats, 1)[: each.ndim]) for name, each in maps.items()}, folder)


def row(label: str, arguments: Sequence[str], runs: int) -> list[str]:
    figures = [run(arguments) for _ in range(runs)]
    return [label, *(f"{statistics.median(column):.2f}" for column in zip(*figures, strict=True))]


def rows(sizes: Sequence[int], often: int) -> Iterator[list[str]]:
    """Every process, those of small sets so often."""
    yield row("--help", ["--help"], often)
    with tempfile.TemporaryDirectory() as folder:
        for size in sizes:
            source = Path(folder) / f"copper_{size}"
            write_set(source, size)
            if size == sizes[0]:  # loads every module once, so that each is compiled when time counts
                run(["bake", str(source), "-o", f"{folder}/out"])
            runs = often if size <= _OFTEN else 1
            yield row(f"inspect, {size} x {size}", ["inspect", str(source)], runs)
            for method in ("linear", "lean", "neural", "auto"):
                command = ["bake", str(source), "-o", f"{folder}/out", "--method", method]
                yield row(f"bake {method}, {size} x {size}", command, runs)
            shutil.rmtree(source)


def main() -> None:
    options = arguments(__doc__, sizes=(1024, 4096, 8192), runs=3)
    print(f"{cpu_name()}, Python {platform.python_version()}\n")
    show(["process", "wall s", "processor s", "peak GiB"], rows(options.sizes, options.runs))


if __name__ == "__main__":
    main()
