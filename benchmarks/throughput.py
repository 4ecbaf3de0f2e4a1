"""How many texture sets an hour are baked, by size, method, format and number of processes, beside maketx.

    python benchmarks/throughput.py [--results FILE] [--sizes 512 1024 2048] [--methods linear lean neural auto]
    python benchmarks/throughput.py [--results FILE] --sizes 4096 --parts

The sets are generated (examples/generate.py), and written by every method as half floats with all levels: `exr:half`
of mipbake, and `.exr` of maketx, which comes with OpenImageIO. maketx makes plain MIP maps of single files, and is
called once for each map, so many at once as mipbake has processes. Its time is the floor: it filters each map for
itself, and measures nothing. One size is baked into other formats as well. With `--parts` the parts of one set of the
largest size are told: what its phases take, the processor's time, the peak of memory, and bytes read and written; and
the same where mipbake is held to less memory.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

from bake import ENVIRONMENT, generator
from timing import cpu_name, keep

COMMAND = [sys.executable, "-c", "from mipbake.cli.main import run; run()", "bake"]
JOBS = (1, 2)
FORMATS = ("exr:half", "png", "ktx2:bc", "ktx2:uastc")
FORMATS_SIZE = 1024

SETS = {512: 8, 1024: 6, 2048: 4}
"""Sets of each size, of the examples in turn."""

LARGE, LARGE_SETS = "hammered_copper", 2
"""Of all other sizes there are so many sets, all of this example: two processes then have as much to do each."""

HELD = "2G"
"""What a bake is held to, as many processes on a small machine are."""

_LOOK = 0.02  # seconds between two looks at the memory of a process


def make(root: Path, size: int, count: int) -> None:
    """So many sets of one size."""
    made = root.with_name(f"{root.name}-examples")
    module = generator()
    for name in module.SETS if size in SETS else (LARGE,):
        module.write(name, made / name, size, size)
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
    return timed([[*COMMAND, str(library), *options]], 1)


def rates(library: Path, sets: int, program: str, container: str = FORMATS[0]) -> dict[str, float]:
    """Sets an hour, by the number of processes."""
    found = {}
    for jobs in JOBS:
        out = library.with_name("out")
        seconds = maketx(library, out, jobs) if program == "maketx" else bake(library, out, program, jobs, container)
        shutil.rmtree(out)
        found[str(jobs)] = round(3600 * sets / seconds, 1)
    return found


def peak_of(process: subprocess.Popen[str]) -> int:
    """The most memory in bytes that a process has held, as Linux tells it until the process ends.

    `ru_maxrss` is no peak of its own: it begins with what the process held that started it.
    """
    peak = 0
    while process.poll() is None:
        with suppress(OSError):
            lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
            peak = max(peak, *(int(line.split()[1]) << 10 for line in lines if line.startswith("VmHWM")), 0)
        time.sleep(_LOOK)
    return peak


def parts(source: Path, method: str, memory: str | None = None) -> dict[str, Any]:
    """What one bake by one process takes, and what of it goes where; `memory`: what it is held to."""
    out = source.parent.with_name("out")
    command = [*COMMAND, str(source), "-o", str(out), "--method", method, "--format", FORMATS[0], "--json"]
    command += [] if memory is None else ["--memory", memory]
    before = os.times()
    begun = time.perf_counter()
    with tempfile.TemporaryFile("w+") as printed:
        process = subprocess.Popen(command, stdout=printed, stderr=subprocess.DEVNULL, env=ENVIRONMENT, text=True)
        peak = peak_of(process)
        seconds, after = time.perf_counter() - begun, os.times()
        assert process.returncode == 0, method
        printed.seek(0)
        told = json.load(printed)
    found = {
        "seconds": round(seconds, 2),
        "processor": round(
            after.children_user + after.children_system - before.children_user - before.children_system, 2
        ),
        "phases": {name: round(value, 2) for name, value in told["results"][0]["seconds"].items()},
        "memory": peak,
        "read": sum(file.stat().st_size for file in source.iterdir()),
        "written": told["results"][0]["bytes"],
    }
    shutil.rmtree(out)
    return found


def measured(folder: Path, sizes: Sequence[int], methods: Sequence[str], with_parts: bool) -> dict[str, Any]:
    """Everything."""
    found: dict[str, Any] = {"machine": cpu_name(), "cores": os.cpu_count(), "sizes": {}, "formats": {}, "parts": {}}
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
        for method in methods if with_parts and size == max(sizes) else ():
            found["parts"][method] = parts(library / "set00", method)
            found["parts"][method]["held"] = parts(library / "set00", method, HELD)
            print(size, method, found["parts"][method], flush=True)
        shutil.rmtree(library)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path)
    parser.add_argument("--sizes", type=int, nargs="+", default=[512, 1024, 2048])
    parser.add_argument("--parts", action="store_true", help="what a set of the largest size takes, part by part")
    parser.add_argument("--methods", nargs="+", default=["linear", "lean", "neural", "auto"])
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        found = measured(Path(name), options.sizes, options.methods, options.parts)
    keep(found, options.results)


if __name__ == "__main__":
    main()
