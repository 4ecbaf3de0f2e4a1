"""Measures every method on examples/knurled_plate, which none can show: the table of examples/README.md.

    python docs/make_failure_table.py [--points 8192] [--samples 64] [--set FOLDER] OUT

`python docs/remake.py --measure failure` runs it and writes the table.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import mipbake
from mipbake.baking.methods import METHODS
from mipbake.comparing.validate import BAKED
from mipbake.quality.figures import SCALES
from mipbake.quality.metrics import PAIR_SETS

ROOT = Path(__file__).resolve().parent.parent
LODS = {scale: sum(lods) / 2 for scale, lods in SCALES.items()}
METHOD = "neural"


def measured(folder: Path, points: int, samples: int) -> dict[str, dict[str, dict[str, float]]]:
    """SNR in dB of the network and of every closed form, with both of its averaging kernels, by pair set and scale."""
    texture_set = mipbake.load(folder)
    forms = [(name, kernel) for name in METHODS if METHODS[name].averages for kernel in ("box", None)]
    stack = mipbake.bake(texture_set, method=METHOD)
    lods = tuple(LODS.values())
    result = mipbake.validate(texture_set, stack, lods, points=points, samples=samples, baselines=forms)
    last = result.lods[-1]
    return {
        METHOD if name == BAKED else name: {
            pairs: {scale: result.snr(name, pairs, min(lod, last)) for scale, lod in LODS.items()}
            for pairs in PAIR_SETS
        }
        for name in result.methods
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="the table of the set that no method can show")
    parser.add_argument("out", type=Path, help="a .json file of what was measured")
    parser.add_argument("--set", type=Path, default=ROOT / "examples" / "knurled_plate", help="a texture set")
    parser.add_argument("--points", type=int, default=8192, help="pixels per level of detail")
    parser.add_argument("--samples", type=int, default=64, help="samples per pixel in each estimate of the reference")
    options = parser.parse_args()
    found = measured(options.set, options.points, options.samples)
    about = {"set": options.set.name, "points": options.points, "samples": options.samples, "lods": LODS}
    options.out.write_text(json.dumps(about | {"methods": found}), encoding="utf-8")


if __name__ == "__main__":
    main()
