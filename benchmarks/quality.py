"""Bakes and validates every texture set in a folder and prints the tables of mean SNR, as Markdown.

    python benchmarks/quality.py SETS_FOLDER [--json results.json] [--method neural]

Every sub-folder of SETS_FOLDER is one texture set. Every closed form is measured beside the method, with the box and
with the pixel filter.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import mipbake
from mipbake.bake import DEFAULT_FILTER
from mipbake.compare.candidates import closed_forms
from mipbake.metrics import PAIR_SETS
from mipbake.validate import BAKED, DEFAULT_LODS, Validation


def measure(folder: Path, method: str, seed: int) -> Validation:
    texture_set = mipbake.load(folder)
    start = time.perf_counter()
    stack = mipbake.bake(texture_set, method=method)
    baked = time.perf_counter()
    result = mipbake.validate(texture_set, stack, seed=seed, baselines=closed_forms(DEFAULT_FILTER))
    print(f"{folder.name}: bake {baked - start:.1f} s, validate {time.perf_counter() - baked:.1f} s", flush=True)
    return result


def mean_table(results: Sequence[Validation], method: str) -> str:
    lines = []
    for pairs in PAIR_SETS:
        lods = [lod for lod in DEFAULT_LODS if all(lod in r.lods for r in results)]
        lines += [
            f"| {pairs} | " + " | ".join(f"{lod:g}" for lod in lods) + " | mean |",
            "|---" * (len(lods) + 2) + "|",
        ]
        for name in results[0].methods:
            figures = np.array([[r.snr(name, pairs, lod) for lod in lods] for r in results]).mean(0)
            label = method if name == BAKED else name
            lines.append(f"| {label} | " + " | ".join(f"{f:.1f}" for f in figures) + f" | {figures.mean():.1f} |")
        lines.append("")
    return "\n".join(lines)


def gain_table(results: Sequence[Validation], baseline: str) -> str:
    """Per set: SNR of the baked stack minus that of a baseline, in dB."""
    lines = []
    for pairs in PAIR_SETS:
        lines += [f"| {pairs}, over {baseline} | " + " | ".join(f"{lod:g}" for lod in DEFAULT_LODS) + " |"]
        lines += ["|---" * (len(DEFAULT_LODS) + 1) + "|"]
        for r in results:
            gains = [r.snr(BAKED, pairs, lod) - r.snr(baseline, pairs, lod) for lod in r.lods]
            lines.append(f"| {r.name} | " + " | ".join(f"{g:+.1f}" for g in gains) + " |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", default="neural")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    folders = sorted(path for path in options.folder.iterdir() if path.is_dir())
    results = [measure(folder, options.method, options.seed) for folder in folders]
    print(f"\nMean SNR in dB over {len(results)} sets\n\n{mean_table(results, options.method)}")
    print(gain_table(results, "linear (box)"))
    if options.json:
        options.json.write_text(json.dumps([r.to_dict() for r in results], indent=1))


if __name__ == "__main__":
    main()
