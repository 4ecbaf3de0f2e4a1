"""Time of plain pyramids, and the share of the memory's bandwidth that they reach.

    python benchmarks/pyramid.py [--size N] [--rounds N]

The least that a pyramid moves is level 0, read once, and every level, written once: 7/3 of level 0. What a copy of
level 0 moves in its time, read and written, is the bandwidth that there is. `averages` are the filtered levels alone;
`linear` also makes their texels valid, which is done in NumPy. With the Gaussian filter, each of the first four levels
is a filter of level 0 of its own. Everything runs on as many threads as mipbake uses, the copy too.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from timing import cpu_name, measure

from mipbake import _native
from mipbake.baking.rules import RULES
from mipbake.material.pixel_filter import filtered_levels

_MOVED = {"copy": 2.0, "averages (box)": 4 / 3}
"""What is moved at least, in units of level 0, where it is not 7 / 3. Averages of boxes leave level 0 as it is."""
WRAP = ("wrap", "wrap")


def copied(pool: ThreadPoolExecutor, source: NDArray[np.float32], to: NDArray[np.float32]) -> None:
    """A copy, a part of the rows on each thread."""
    parts = np.array_split(np.arange(len(source)), _native.num_threads())
    list(pool.map(lambda rows: np.copyto(to[rows[0] : rows[-1] + 1], source[rows[0] : rows[-1] + 1]), parts))


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description="Times plain pyramids beside a copy.")
    parser.add_argument("--size", type=int, default=4096, help="texels a side")
    parser.add_argument("--rounds", type=int, default=5, help="times that each is measured")
    options = parser.parse_args()
    size = options.size
    stored = np.random.default_rng(0).random((size, size, 8), np.float32)
    to = np.zeros_like(stored)

    def linear(kernel: str) -> Callable[[], object]:
        return lambda: RULES["linear"](stored, "gltf", "gltf", kernel, WRAP, lambda _: None)

    def averages(kernel: str) -> Callable[[], object]:
        return lambda: filtered_levels(stored, kernel, WRAP)

    with ThreadPoolExecutor(_native.num_threads()) as pool:
        candidates: dict[str, Callable[[], object]] = {"copy": lambda: copied(pool, stored, to)}
        for kernel in ("box", "gaussian"):
            candidates |= {f"averages ({kernel})": averages(kernel), f"linear ({kernel})": linear(kernel)}
        found = measure(candidates, options.rounds)
    print(f"{cpu_name()}; {_native.num_threads()} threads, {_native.isa()}; {size} x {size} texels of 8 channels\n")
    print("| what | time | GB/s | share of the bandwidth |\n|---|---|---|---|")
    bandwidth = 2 * stored.nbytes / found["copy"].median / 1e9
    for name in candidates:
        rate = _MOVED.get(name, 7 / 3) * stored.nbytes / found[name].median / 1e9
        print(f"| {name} | {found[name].text(size * size)} | {rate:.1f} | {rate / bandwidth:.0%} |")


if __name__ == "__main__":
    main()
