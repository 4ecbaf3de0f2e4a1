"""Many small texture sets baked in one process: what the process holds, and what time of processors each bake takes.

    python benchmarks/soak.py --results build/soak.json [--methods linear=500 neural=500 auto=100]

A bake by `auto` takes some thirty times as long as the others, so it bakes fewer sets. Methods that the results hold
already are not measured again: a run that was stopped goes on with the others.

The sets are generated anew for each bake (library_sets.py), of all sizes in turn, and the folder of each is removed
after it. What lies in memory is what Linux counts as the process's own: file-backed pages, which come and go as the
system likes, are not part of it. The first bakes load code, weights and caches; the rest must hold what these left.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from library_sets import SIZES, maps_of, write
from timing import cpu_name, keep

WINDOWS = 10
"""Parts of a run that are told apart."""


@dataclass(frozen=True)
class Window:
    """A part of a run.

    Args:
        bakes: so far. seconds: of processors, median of the bakes in it, over all sizes. Other programs change the
            clock on the wall more than a slow-down would. memory: anonymous bytes at its end.
        handles, threads: at its end.
    """

    bakes: int
    seconds: float
    memory: int
    handles: int
    threads: int


def held() -> tuple[int, int, int]:
    """Anonymous bytes, open files and threads of this process."""
    gc.collect()
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    memory = int(status["RssAnon"].split()[0]) * 1024
    return memory, len(os.listdir("/proc/self/fd")), int(status["Threads"])  # noqa: PTH208


def soak(method: str, sets: int) -> list[Window]:
    """Bakes so many sets in this process, one after the other."""
    import mipbake

    rng, windows, seconds = np.random.default_rng(3), list[Window](), list[float]()
    with tempfile.TemporaryDirectory() as folder:
        for index in range(sets):
            source, out = Path(folder) / f"set{index}", Path(folder) / "out"
            write(source, maps_of(rng, SIZES[index % len(SIZES)]))
            begun = time.process_time()
            mipbake.bake_all(source, out, method=method)
            seconds.append(time.process_time() - begun)
            shutil.rmtree(source)
            shutil.rmtree(out)
            if (index + 1) % max(1, sets // WINDOWS) == 0:
                memory, handles, threads = held()
                windows.append(Window(index + 1, statistics.median(seconds), memory, handles, threads))
                seconds.clear()
    return windows


def _asked(text: str) -> tuple[str, int]:
    """A method, and how many sets it bakes."""
    method, sets = text.split("=")
    return method, int(sets)


def in_a_process_of_its_own(asked: str) -> list[dict[str, Any]]:
    """The windows of a run that nothing ran before."""
    command = [sys.executable, __file__, "--alone", asked]
    found: list[dict[str, Any]] = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path)
    parser.add_argument("--methods", nargs="+", default=["linear=500", "neural=500", "auto=100"], metavar="NAME=SETS")
    parser.add_argument("--alone", metavar="NAME=SETS", help="one method in this process; prints JSON")
    options = parser.parse_args()
    if options.alone:
        print(json.dumps([asdict(window) for window in soak(*_asked(options.alone))]))
        return
    found: dict[str, Any] = {"machine": cpu_name(), "methods": {}}
    if options.results is not None and options.results.exists():
        before = json.loads(options.results.read_text(encoding="utf-8"))
        found = before if before["machine"] == found["machine"] else found
    for each in options.methods:
        method, sets = _asked(each)
        if [window["bakes"] for window in found["methods"].get(method, ())][-1:] != [sets]:
            found["methods"][method] = in_a_process_of_its_own(each)
            keep(found, options.results)


if __name__ == "__main__":
    main()
