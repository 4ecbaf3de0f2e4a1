"""How many texture sets an hour are baked, by size, method and number of processes, beside maketx on the same maps.

    python benchmarks/throughput.py [--sizes 512 1024 2048] [--sets 4] [--methods linear lean neural auto]

The sets are generated (examples/generate.py), and written by every method as half floats with all levels: `exr:half`
of mipbake, and `.exr` of maketx, which comes with OpenImageIO. maketx makes plain MIP maps of single files, and is
called once for each map, so many at once as mipbake has processes. Its time is the floor: it filters each map for
itself, and measures nothing. Prints a Markdown table and the facts about the machine.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from bake import ENVIRONMENT, generator
from timing import cpu_name

COMMAND = [sys.executable, "-c", "from mipbake.cli.main import run; run()", "bake"]
JOBS = (1, 2)


def make(root: Path, size: int, count: int) -> None:
    """So many sets of one size: the examples in turn."""
    made = root.with_name(f"{root.name}-examples")
    module = generator()
    if not made.exists():
        for name in module.SETS:
            module.write(name, made / name, size, size)
    examples = sorted(path for path in made.iterdir() if path.is_dir())
    for index in range(count):
        shutil.copytree(examples[index % len(examples)], root / f"set{index:02}")


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


def bake(library: Path, out: Path, method: str, jobs: int) -> float:
    """Seconds that a batch takes."""
    options = ["-r", "-o", str(out), "-j", str(jobs), "--method", method, "--format", "exr:half", "--quiet"]
    return timed([[*COMMAND, str(library), *options]], 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[512, 1024, 2048])
    parser.add_argument("--sets", type=int, default=4)
    parser.add_argument("--methods", nargs="+", default=["linear", "lean", "neural", "auto"])
    options = parser.parse_args()
    print(f"{cpu_name()}, {platform.system()}, Python {platform.python_version()}; {options.sets} sets of each size\n")
    print("| size | program | sets an hour, 1 process | 2 processes | gain | of maketx, 1 process |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for size in options.sizes:
            library = Path(name) / f"library{size}"
            make(library, size, options.sets)
            floor = 0.0
            for program in ("maketx", *options.methods):
                rates = []
                for jobs in JOBS:
                    out = Path(name) / "out"
                    seconds = maketx(library, out, jobs) if program == "maketx" else bake(library, out, program, jobs)
                    shutil.rmtree(out)
                    rates.append(3600 * options.sets / seconds)
                floor = floor or rates[0]
                told = [f"{rate:.0f}" for rate in rates] + [f"{rates[1] / rates[0]:.2f}", f"{rates[0] / floor:.2f}"]
                print(f"| {size} | {program} | {' | '.join(told)} |", flush=True)


if __name__ == "__main__":
    main()
