"""Time and peak memory of `mipbake` as a whole process, start-up included.

    python benchmarks/bake.py [--sizes 1024 4096 8192] [--runs 3]

The sets are generated (examples/generate.py). Temporary files need 7 GB, or 25 GB for 16384. Prints a Markdown table.
Figures are medians of the runs; sets of more than 1024 x 1024 are baked once.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
from timing import arguments, cpu_name

_OFTEN = 1024
"""Texels a side of the largest set that is baked several times."""

ROOT = Path(__file__).resolve().parent.parent

ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
"""Of the processes: Python keeps what it compiled, as it does for everybody who installed a package."""


def generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate", ROOT / "examples" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["generate"] = module
    spec.loader.exec_module(module)
    return module


def run(arguments: Sequence[str]) -> tuple[float, float, float]:
    """Wall seconds, processor seconds and peak memory in GiB of one `mipbake` process."""
    start = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-c", "from mipbake.cli.main import run; run()", *arguments],
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
    import OpenImageIO as oiio  # noqa: N813

    folder.mkdir()
    part = min(size, 512)
    for name, pixels in generator().make("hammered_copper", part, part).items():
        repeats = (size // part, size // part) + (1,) * (pixels.ndim - 2)
        image = oiio.ImageBuf(np.ascontiguousarray(np.tile(pixels, repeats)))
        if not image.write(str(folder / f"{name}.png")):
            raise SystemExit(image.geterror())


def row(label: str, arguments: Sequence[str], runs: int) -> str:
    figures = [run(arguments) for _ in range(runs)]
    wall, cpu, memory = (statistics.median(column) for column in zip(*figures, strict=True))
    return f"| {label} | {wall:.2f} | {cpu:.2f} | {memory:.2f} |"


def main() -> None:
    options = arguments(__doc__, sizes=(1024, 4096, 8192), runs=3)
    print(f"{cpu_name()}, Python {platform.python_version()}\n")
    print("| process | wall s | processor s | peak GiB |\n|---|---|---|---|")
    print(row("--help", ["--help"], options.runs), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for size in options.sizes:
            source = Path(folder) / f"copper_{size}"
            write_set(source, size)
            if size == options.sizes[0]:  # loads every module once, so that each is compiled when time counts
                run(["bake", str(source), "-o", f"{folder}/out"])
            runs = options.runs if size <= _OFTEN else 1
            print(row(f"inspect, {size} x {size}", ["inspect", str(source)], runs), flush=True)
            for method in ("linear", "lean", "neural", "auto"):
                command = ["bake", str(source), "-o", f"{folder}/out", "--method", method]
                print(row(f"bake {method}, {size} x {size}", command, runs), flush=True)
            shutil.rmtree(source)


if __name__ == "__main__":
    main()
