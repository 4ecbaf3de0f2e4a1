"""Measures every method on examples/knurled_plate, which none can show, and writes the table into examples/README.md.

    python docs/make_failure_table.py [--points 8192] [--samples 64] [--optimum] [--set FOLDER] [PAGE]

`--optimum` adds the per-material optimum, which takes minutes.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

import mipbake
from mipbake.compare.result import SCALES
from mipbake.metrics import PAIR_SETS
from mipbake.prefilter import METHODS
from mipbake.validate import BAKED, Validation

ROOT = Path(__file__).resolve().parent.parent
MARKED = re.compile(r"(<!-- failure -->\n).*?(<!-- end failure -->)", re.DOTALL)
LODS = tuple(sum(lods) / 2 for lods in SCALES.values())


def measured(folder: Path, methods: Sequence[str], points: int, samples: int) -> dict[str, Validation]:
    """A validation for each method; those of closed forms hold the rows of both of their averaging kernels."""
    texture_set = mipbake.load(folder)
    forms = [(name, kernel) for name in METHODS if METHODS[name].averages for kernel in ("box", None)]
    found = {}
    for index, name in enumerate(methods):
        stack = mipbake.bake(texture_set, method=name)
        baselines = forms if index == 0 else []
        found[name] = mipbake.validate(texture_set, stack, LODS, points=points, samples=samples, baselines=baselines)
    return found


def table(results: dict[str, Validation]) -> str:
    heads = [f"{pairs}, {scale}" for pairs in PAIR_SETS for scale in SCALES]
    lines = ["| | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for method, result in results.items():
        for name in result.methods:
            figures = [result.snr(name, pairs, min(lod, result.lods[-1])) for pairs in PAIR_SETS for lod in LODS]
            label = method if name == BAKED else name
            lines.append(f"| {label} | " + " | ".join(f"{figure:.1f}" for figure in figures) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="the table of the set that no method can show")
    parser.add_argument("page", type=Path, nargs="?", default=ROOT / "examples" / "README.md")
    parser.add_argument("--set", type=Path, default=ROOT / "examples" / "knurled_plate", help="a texture set")
    parser.add_argument("--points", type=int, default=8192, help="pixels per level of detail")
    parser.add_argument("--samples", type=int, default=64, help="samples per pixel in each estimate of the reference")
    parser.add_argument("--optimum", action="store_true", help="add the per-material optimum")
    options = parser.parse_args()
    methods = ("neural", "optimum") if options.optimum else ("neural",)
    made = table(measured(options.set, methods, options.points, options.samples))
    page = options.page.read_text(encoding="utf-8")
    if not MARKED.search(page):
        parser.error(f"{options.page} has no lines `<!-- failure -->` and `<!-- end failure -->`")
    options.page.write_text(MARKED.sub(lambda found: f"{found[1]}\n{made}\n\n{found[2]}", page), encoding="utf-8")
    print(made)


if __name__ == "__main__":
    main()
