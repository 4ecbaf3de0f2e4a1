"""How many texture sets an hour are baked, by size, method, format and number of processes, beside maketx.

    python benchmarks/throughput.py [--results FILE] [--sizes 512 1024 2048] [--methods linear lean neural auto]

The sets are generated (examples/generate.py), and written by every method as half floats with all levels: `exr:half`
of mipbake, and `.exr` of maketx, which comes with OpenImageIO. maketx makes plain MIP maps of single files, and is
called once for each map, so many at once as mipbake has processes. Its time is the floor: it filters each map for
itself, and measures nothing. One size is baked into other formats as well.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bake import ENVIRONMENT, generate
from timing import MIPBAKE, arguments, keep

JOBS = (1, 2)
FORMATS = ("exr:half", "png", "ktx2:bc", "ktx2:uastc")
FORMATS_SIZE = 1024

SETS = {512: 8, 1024: 6, 2048: 4}
"""Sets of each size, of the examples in turn."""

LARGE, LARGE_SETS = "hammered_copper", 2
"""Of all other sizes there are so many sets, all of this example: two processes then have as much to do each."""


def make(root: Path, size: int, count: int) -> None:
    """So many sets of one size."""
    made = root.with_name(f"{root.name}-examples")
    for name in generate.SETS if size in SETS else (LARGE,):
        generate.write(name, made / name, size, size)
    examples = sorted(path for path in made.iterdir() if path.is_dir())
    for index in range(count):
        shutil.copytree(examples[index % len(examples)], root / f"set{index:02}")
    shutil.rmtree(made)


def timed(commands: Sequence[Sequence[str]], at_once: int) -> float:
    """Seconds of the wall clock until all commands are done."""

    def run(command: Sequence[str]) -> None:
        subprocess.run(command, check=True, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    begun = time.perf_counter()
    with ThreadPoolExecutor(at_once) as pool:
        list(pool.map(run, commands))
    return time.perf_counter() - begun


def maketx(library: Path, out: Path, jobs: int) -> float:
    """Seconds that maketx takes for all maps."""
    program = shutil.which("maketx") or str(Path(sys.executable).with_name("maketx"))
    out.mkdir(parents=True)
    maps = sorted(library.rglob("*.png"))
    options = ["-d", "half", "--threads", str(max(1, (os.cpu_count() or 1) // jobs))]
    commands = [[program, str(file), *options, "-o", str(out / f"{index}.exr")] for index, file in enumerate(maps)]
    return timed(commands, jobs)


def bake(library: Path, out: Path, method: str, jobs: int, container: str = FORMATS[0]) -> float:
    """Seconds that a batch takes."""
    options = ["-r", "-o", str(out), "-j", str(jobs), "--method", method, "--format", container, "--quiet"]
    return timed([[*MIPBAKE, "bake", str(library), *options]], 1)


def rates(library: Path, sets: int, program: str, container: str = FORMATS[0]) -> dict[str, float]:
    """Sets an hour, by the number of processes."""
    found = {}
    for jobs in JOBS:
        out = library.with_name("out")
        seconds = maketx(library, out, jobs) if program == "maketx" else bake(library, out, program, jobs, container)
        shutil.rmtree(out)
        found[str(jobs)] = round(3600 * sets / seconds, 1)
    return found


def measured(folder: Path, sizes: Sequence[int], methods: Sequence[str]) -> dict[str, Any]:
    """Everything."""
    found: dict[str, Any] = {"sizes": {}, "formats": {}}
    for size in sizes:
        library, sets = folder / f"library{size}", SETS.get(size, LARGE_SETS)
        make(library, size, sets)
        row = found["sizes"][str(size)] = {"sets": sets}
        for program in ("maketx", *methods):
            row[program] = rates(library, sets, program)
            print(size, program, row[program], flush=True)
        if size == FORMATS_SIZE:
            for container in FORMATS:
                found["formats"][container] = rates(library, sets, methods[0], container)
                print(size, container, found["formats"][container], flush=True)
        shutil.rmtree(library)
    return found


def main() -> None:
    options = arguments(__doc__, results=None, sizes=(512, 1024, 2048), methods=("linear", "lean", "neural", "auto"))
    with tempfile.TemporaryDirectory() as name:
        found = measured(Path(name), options.sizes, options.methods)
    keep(found, options.results)


if __name__ == "__main__":
    main()
