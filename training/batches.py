"""What steps are trained on, drawn beside the training."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import torch

from mipbake.training.base import Batch
from mipbake.training.config import TrainingConfig
from mipbake.training.data import Materials, draw_crops, step_generator
from mipbake.training.drawing import Drawer

_KEPT = 8  # batches that are kept for another use; a guess
_REUSE = 2**62 + 1  # random numbers of their own, apart from every batch's; a seed


def draw_batch(materials: Materials, config: TrainingConfig, index: int) -> Batch:
    """Batch 0, 1, ...: a pure function of the materials, the configuration and the index. Encoders take turns."""
    rng, loss = step_generator(config.run.seed, index), config.loss
    source = config.network.encoders[index % len(config.network.encoders)]
    patches = torch.from_numpy(draw_crops(materials, loss.crops, loss.crop_size, source, rng, config.data))
    batch: Batch = loss.draw(patches, source, rng)
    return batch


def batch_of(step: int, config: TrainingConfig) -> int:
    """Index of the batch that a step is trained on: a new one, or one of the last few where each has several uses."""
    newest, rest = divmod(step, config.run.uses)
    if not rest:
        return newest
    return newest - int(np.random.default_rng([config.run.seed, _REUSE, step]).integers(min(_KEPT, newest + 1)))


def batches(materials: Materials, config: TrainingConfig, first: int) -> Iterator[Batch]:
    """The batches of steps `first` to the last; new ones are drawn while others are trained on."""
    kept: dict[int, Batch] = {}
    coming = batch_of(first, config)
    with Drawer(partial(draw_batch, materials, config), coming) as drawer:
        drawer.ask(coming)
        for step in range(first, config.run.steps):
            index = batch_of(step, config)
            while index >= coming:
                kept[coming] = drawer.take()
                kept.pop(coming - _KEPT, None)
                coming += 1
                drawer.ask(coming)
            if index not in kept:  # drawn before a training was resumed
                kept[index] = draw_batch(materials, config, index)
            yield kept[index]
