"""What a step is trained on, drawn beside the training, and the loss of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from mipbake.models.network import Network
from mipbake.training.balanced_loss import BalancedBatch, balanced_loss, draw_balanced
from mipbake.training.baseline import Trainable
from mipbake.training.config import BalancedLossConfig, LossConfig, TrainingConfig
from mipbake.training.data import Materials, draw_crops, step_generator
from mipbake.training.drawing import Drawer
from mipbake.training.loss import TORUS, Views, draw_target, draw_views, look_up, render_loss

_KEPT = 8  # batches that are kept for another use
_REUSE = 2**62 + 1  # random numbers of their own, apart from every batch's


@dataclass(frozen=True)
class Batch:
    """Everything of one step that does not depend on the network."""

    source: str
    """Material model of the patches."""
    patches: Tensor
    views: Views
    target: Tensor
    independent: Tensor | None
    """A second noisy reference, where the loss needs one."""


def draw_batch(materials: Materials, config: TrainingConfig, index: int) -> AnyBatch:
    """Batch 0, 1, ...: a pure function of the materials, the configuration and the index.

    Encoders take turns, and the noisy reference is rendered in the model that is read (section 3.5).
    """
    rng, loss = step_generator(config.run.seed, index), config.loss
    source = config.network.encoders[index % len(config.network.encoders)]
    patches = torch.from_numpy(draw_crops(materials, loss.crops, loss.crop_size, source, rng, config.data))
    if isinstance(loss, BalancedLossConfig):
        return draw_balanced(patches, loss, rng)
    views = draw_views(loss, rng)
    target, *independent = (
        draw_target(patches, views, source, loss.pixel_filter, loss.target_samples, rng)
        for _ in range(2 if loss.weighting == "error" else 1)
    )
    return Batch(source, patches, views, target, independent[0] if independent else None)


def batch_of(step: int, config: TrainingConfig) -> int:
    """Index of the batch that a step is trained on: a new one, or one of the last few where each has several uses."""
    newest, rest = divmod(step, config.run.uses)
    if not rest:
        return newest
    return newest - int(np.random.default_rng([config.run.seed, _REUSE, step]).integers(min(_KEPT, newest + 1)))


def batches(materials: Materials, config: TrainingConfig, first: int) -> Iterator[AnyBatch]:
    """The batches of steps `first` to the last; new ones are drawn while others are trained on."""
    kept: dict[int, AnyBatch] = {}
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


AnyBatch = Batch | BalancedBatch


def batch_loss(network: Trainable, batch: AnyBatch, config: TrainingConfig) -> Tensor:
    """Predicts, renders and compares: the scalar loss of one batch, the mean over the models that are made."""
    if isinstance(batch, BalancedBatch):
        assert not isinstance(network, Network) and isinstance(config.loss, BalancedLossConfig)
        return balanced_loss(network, batch, config.loss)
    assert isinstance(network, Network) and isinstance(config.loss, LossConfig)
    stacks = network.stacks(batch.patches, TORUS, batch.source)
    losses = [
        render_loss(
            look_up(levels, batch.views), model, batch.views, batch.target, batch.independent, config.loss.mirror_pairs
        )
        for model, levels in stacks.items()
    ]
    return torch.stack(losses).mean() if len(losses) > 1 else losses[0]
