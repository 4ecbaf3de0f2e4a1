"""What each process of a training does in tests: `torchrun training_ranks.py OUT STEPS ENCODERS`.

Each writes the gradient of the first step and the weights after the last one.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch

from mipbake.training import loop
from mipbake.training.batches import batches, draw_batch
from mipbake.training.data import load_materials
from mipbake.training.ranks import ranks
from tests.small_training import tiny


def main(out: Path, steps: int, encoders: list[str]) -> None:
    torch.set_num_threads(1)
    config = tiny(network={"encoders": encoders, "decoders": encoders, "latent_channels": 32}, run={"steps": steps})
    materials, _ = load_materials(config)
    with ranks("cpu") as among:
        state = loop.new_state(config)
        state.optimiser.zero_grad()
        batch = draw_batch(materials, config, 0, among)
        config.loss.value(state.network, batch).backward()
        gradients = state.optimiser.gradients(batch.source)
        among.average_(gradients)
        first = [gradient.clone() for gradient in gradients]
        for each in batches(materials, config, 0, among):
            state.advance(each, among)
        torch.save({"first": first, "weights": state.network.state_dict()}, out / f"{among.rank}.pt")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3].split(","))
