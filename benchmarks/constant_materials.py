"""What networks make of materials that are the same everywhere, where nothing is to be filtered.

    python benchmarks/constant_materials.py SETS_FOLDER --results FILE [--texels 512]

Every level of such a texture is the material itself. What a network makes of it is off by what the network loses when
it encodes and decodes, and by nothing else. The materials are texels drawn from real sets, converted to the paper's
material models, and from generated sets of Beckmann lobes. `python docs/remake.py --measure constant-materials` runs
it, and docs/paper-figures.md shows what came out.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from mipnet_network import register
from numpy.typing import NDArray
from results_sets import captured, folder_sets, in_model
from timing import BASELINES, arguments, keep

from mipbake.baking.pipeline import DEFAULT_FILTER
from mipbake.models.registry import WEIGHTS_FOLDER, WeightsInfo, default_weights, find_weights, load_network
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.metrics.snr import snr_from_sums, snr_sums
from mipbake.quality.reference.pair_sets import weighted_pair_set
from mipbake.shading import shade
from mipbake.training.captured import MODEL as CAPTURED

MODELS = ("ggx", "beckmann")
GENERATED, GENERATED_SIZE = 8, 512
SIDE = 4
"""Of an image of one material, in texels: enough for every kind of level that MIPNet makes."""

Array = NDArray[np.float32]


def networks(model: str) -> dict[str, WeightsInfo]:
    """The networks of a material model that docs/paper-figures.md compares."""
    default = default_weights(model, DEFAULT_FILTER, source=model)
    return {
        f"mipnet-{model}": find_weights(f"mipnet-{model}", BASELINES),
        f"paper-{model}": find_weights(f"paper-{model}", WEIGHTS_FOLDER),
        default.name: default,
    }


def drawn(sets: Path, model: str, texels: int) -> Iterator[tuple[str, str, Array]]:
    """Kind and name of each set, and (N, C) stored channels of texels of it."""
    for name, load in folder_sets(sets).items():
        yield "plain", name, _some(in_model(load(), model).stored, texels)
    for seed in range(GENERATED if model == CAPTURED else 0):
        found = captured(seed, GENERATED_SIZE)
        yield "captured", found.name, _some(found.stored, texels)


def _some(stored: Array, count: int) -> Array:
    flat = stored.reshape(-1, stored.shape[-1])
    return flat[np.random.default_rng(0).choice(len(flat), min(count, len(flat)), replace=False)]


def made(info: WeightsInfo, model: str, materials: Array) -> Array:
    """(N, C) what the coarsest level holds of images of one material each."""
    images = torch.from_numpy(materials)[:, None, None].expand(-1, SIDE, SIDE, -1).contiguous()
    with torch.no_grad():
        levels = load_network(info)(images, model, DEFAULT_FILTER)[model]
    return np.ascontiguousarray(levels[-1][:, 0, 0].numpy())


def main() -> None:
    options = arguments(__doc__, "sets", results=None, texels=512)
    register()
    rows = []
    for model in MODELS:
        known = networks(model)
        for kind, name, materials in drawn(options.sets, model, options.texels):
            after = {network: made(info, model, materials) for network, info in known.items()}
            for pairs in PAIR_SETS:
                directions = weighted_pair_set(pairs, 0, materials[None], model)
                light, view, weights = directions.light, directions.view, directions.weights[:, None]
                true = shade(model, materials, light, view)
                for network, each in after.items():
                    seen = shade(model, each, light, view)
                    found = {"model": model, "kind": kind, "set": name, "network": network, "pairs": pairs}
                    snr = float(snr_from_sums((weights * snr_sums(seen, true, true)).sum(0)))
                    rows.append({**found, "snr": snr})
            print(f"{model} {name}", flush=True)
    keep({"texels": options.texels, "rows": rows}, options.results)


if __name__ == "__main__":
    main()
