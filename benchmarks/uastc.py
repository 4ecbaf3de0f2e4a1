"""What the textures of a GLB lose of the shaded result, set by set, and what prevents it.

    python docs/remake.py --measure uastc --materials MATERIALS    measures, and makes the table of docs/files.md
    python benchmarks/uastc.py MATERIALS [--only SET SET]          measures some sets, and prints the table of them

MATERIALS is a folder of texture sets. Losses are in dB of SNR, in the mean of the levels of detail that `mipbake bake`
measures, near the mirror and over the hemisphere.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from results_sets import folder_sets
from timing import arguments, keep, table

import mipbake
from mipbake import TextureSet
from mipbake.stack.compression import chosen, losses
from mipbake.stack.file_levels import stored_channels
from mipbake.stack.gltf.glb import encoded, output
from mipbake.stack.gltf.ranges import Ranges
from mipbake.stack.output import GLB_TEXELS
from mipbake.stack.ranges import chosen_ranges
from mipbake.stack.written import opened

Losses = Mapping[str, Mapping[str, float]]
"""Kind of file to pair set to dB."""


def main() -> None:
    options = arguments(__doc__, "materials", results=None, only=())
    rows = []
    for name, read in folder_sets(options.materials).items():
        if not options.only or name in options.only:
            rows.append({"set": name, "losses": measured(read())})
            print(name, file=sys.stderr, flush=True)
    if options.results:
        keep({"whole": rows}, options.results)
    else:
        print(summarised({"whole": rows}))


def measured(texture_set: TextureSet) -> Losses:
    """UASTC with values as they are; stretched; and stretched, with 8 bits where blocks cost too much."""
    stack = mipbake.bake(texture_set, "neural", "gltf")
    finer = chosen_ranges(texture_set, stack, texels=GLB_TEXELS[-1])
    texels = chosen(texture_set, stack, output(GLB_TEXELS[1:]), ranges=finer).texels
    made = {
        "plain": encoded(stack, ranges=Ranges()),
        "glb": encoded(stack, ranges=chosen_ranges(texture_set, stack)),
        f"glb:{GLB_TEXELS[1]}": encoded(stack, ranges=finer, texels=texels),
    }
    variants: dict[str, list[NDArray[np.float32]]] = {
        name: stored_channels([each.ranges.shown(file) for file in each.files], stack) for name, each in made.items()
    }
    return losses(texture_set, opened(stack), variants)


def summarised(data: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Markdown of what `main` writes: by kind of file, how many sets are within which loss."""
    worst: dict[str, dict[str, float]] = {}
    for row in data["whole"]:
        for column, loss in row["losses"].items():
            worst.setdefault(column, {})[row["set"]] = max(loss.values())
    lines = []
    for column, of in worst.items():
        within = (f"{sum(value <= limit for value in of.values())} of {len(of)}" for limit in (0.5, 1.5))
        lines.append([f"`{column}`", *within, f"{np.mean([*of.values()]):.2f} dB", f"{max(of.values()):.2f} dB"])
    return table(["files", "sets of at most 0.5 dB", "at most 1.5 dB", "mean", "most"], lines)


if __name__ == "__main__":
    main()
