"""What a loss makes of MIPNet: short trainings with its authors' loss and with the paper's, from the same start.

    python benchmarks/mipnet_losses.py MATERIALS [--results FILE] [--steps 300] [--rate 3e-4]

The authors compare tonemapped renders by their absolute difference, with references free of noise. Kemppinen et al.
2023 divide squared differences by the prediction's energy (equation 5), which allows references of one sample. Both
losses have references of 16 samples, and of one. All trainings see the same batches of MATERIALS, the sets that the
baseline was trained on. The tone curve, log(1 + x), is a guess. Trainings are measured on patches that they hold out.
`python docs/remake.py --measure mipnet-losses` runs it, and docs/paper-figures.md shows what came out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import torch
from mipnet_network import SingleLightsConfig, register
from stability import PAPER
from timing import BASELINES, arguments, keep
from torch import Tensor

from mipbake.models.base import Network
from mipbake.models.registry import find_weights, load_network
from mipbake.shading import shade
from mipbake.training import loop
from mipbake.training.batches import draw_batch
from mipbake.training.config import read_config
from mipbake.training.data import load_materials
from mipbake.training.loss import SingleLightsBatch, SingleLightsLossConfig, trilinear
from mipbake.training.validation import Validator

MODEL = "ggx"

SAMPLES: Mapping[str, int] = {"": 16, ", noisy references": 1}
"""Samples of a reference, by what is added to the name of a training."""


def authors(config: SingleLightsLossConfig, network: Network, batch: SingleLightsBatch) -> Tensor:
    """Mean absolute difference of tonemapped renders."""
    levels = network(batch.patches, batch.source, config.pixel_filter)[MODEL]
    texels, views = trilinear(levels, batch.views), batch.views
    shape = (*texels.shape[:3], 3)
    render = shade(MODEL, texels.flatten(1, 2), views.light, views.view)  # (B, K, S N, 3)
    seen = render.reshape(shape[0], -1, *shape[1:]).movedim(2, 1)  # as the reference
    return (seen.log1p() - batch.noisy_reference.log1p()).abs().mean()


LOSSES: Mapping[str, Callable[[SingleLightsLossConfig, Network, SingleLightsBatch], Tensor]] = {
    "its authors' loss": authors,
    "the paper's loss": SingleLightsLossConfig.value,
}


def main() -> None:
    options = arguments(__doc__, "materials", results=None, steps=300, rate=3e-4)
    torch.set_num_threads(1)
    register()
    paper = read_config(PAPER)
    config = replace(
        paper,
        network=SingleLightsConfig(target=MODEL),
        data=replace(paper.data, folder=str(options.materials)),
        loss=replace(paper.loss, pairs=16, lods=3),
        optimiser=replace(paper.optimiser, learning_rate=options.rate, fall_until=options.steps),
        run=replace(paper.run, steps=options.steps),
    )
    materials, held_out = load_materials(config)
    validator = Validator(held_out, config.network, config.loss.pixel_filter)
    baseline = load_network(find_weights(f"mipnet-{MODEL}", BASELINES))
    found: dict[str, Any] = {"of the pages": validator.score(baseline).columns()}
    for (noise, samples), (name, loss) in product(SAMPLES.items(), LOSSES.items()):
        noisy = replace(config, loss=replace(config.loss, target_samples=samples))
        state = loop.new_state(noisy)
        for step in range(options.steps):
            state.optimiser.zero_grad()
            loss(noisy.loss, state.network, draw_batch(materials, noisy, step)).backward()  # type: ignore[no-untyped-call]
            state.optimiser.step(step, MODEL)
        found[name + noise] = validator.score(state.network).columns()
        print(name + noise, found[name + noise], flush=True)
    keep({"steps": options.steps, "rate": options.rate, "snr": found}, options.results)


if __name__ == "__main__":
    main()
