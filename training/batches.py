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
from mipbake.training.ranks import Ranks

_KEPT = 8  # batches that are kept for another use
_REUSE = 2**62 + 1  # random numbers of their own, apart from every batch's; a seed


def draw_batch(materials: Materials, config: TrainingConfig, index: int, among: Ranks = Ranks()) -> Batch:  # noqa: B008
    """Batch 0, 1, ...: a pure function of the materials, the configuration, the index and which process draws it.
    Encoders take turns, and all processes read with the same one."""
    rng, loss = step_generator(config.run.seed, index, among.rank), config.loss
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


def batches(
    materials: Materials,
    config: TrainingConfig,
    first: int,
    among: Ranks = Ranks(),  # noqa: B008
    ahead: int = 1,
) -> Iterator[Batch]:
    """The batches of steps `first` to the last; `ahead` new ones are drawn while others are trained on."""
    kept: dict[int, Batch] = {}
    coming = batch_of(first, config)
    draw = partial(draw_batch, materials, config, among=among)
    with Drawer(draw, coming, ahead) as drawer:
        for index in range(coming, coming + ahead):
            drawer.ask(index)
        for step in range(first, config.run.steps):
            index = batch_of(step, config)
            while index >= coming:
                kept[coming] = drawer.take()
                kept.pop(coming - _KEPT, None)
                drawer.ask(coming + ahead)
                coming += 1
            if index not in kept:  # drawn before a training was resumed
                kept[index] = draw(index)
            yield kept[index]
