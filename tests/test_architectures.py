"""Every architecture and every loss of the lists keeps its interface."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from mipbake import material
from mipbake.material.pixel_filter import level_sizes
from mipbake.models import registry
from mipbake.models.architectures import ARCHITECTURES
from mipbake.training import loop
from mipbake.training.batches import draw_batch
from mipbake.training.config import RunConfig, TrainingConfig, config_from, plain
from mipbake.training.data import Materials
from mipbake.training.losses import LOSSES

from .moment_cases import TORUS, bumpy

KINDS = sorted(ARCHITECTURES)


def training_of(architecture: str) -> TrainingConfig:
    """With the settings that it has by default, and small patches."""
    network = ARCHITECTURES[architecture]()
    loss = LOSSES[network.trained_with](crop_size=16)
    return TrainingConfig(network=network, loss=loss, run=RunConfig(steps=2))


@pytest.mark.parametrize("architecture", KINDS)
def test_forward_gives_every_level_of_every_model_and_bake_gives_the_same(architecture: str) -> None:
    config = ARCHITECTURES[architecture]()
    torch.manual_seed(0)
    network = config.build().eval().requires_grad_(False)
    source = config.encoders[0]
    stored = np.ascontiguousarray(material.convert(bumpy(16, 16), "gltf", source))
    stacks = network(torch.from_numpy(stored)[None], source, "gaussian")
    assert tuple(stacks) == config.decoders and set(config.decoders) <= set(config.targets)
    for made, levels in stacks.items():
        assert [tuple(level.shape[1:3]) for level in levels] == level_sizes(16, 16)
        shares: list[float] = []
        baked = network.bake(stored, source, made, "gaussian", TORUS, shares.append)
        assert shares == sorted(shares) and shares[-1] == 1
        for level, other in zip(levels, baked, strict=True):
            np.testing.assert_allclose(level[0].numpy(), other, atol=1e-3)  # a quarter of an 8-bit step
            np.testing.assert_allclose(material.regularise(other, made), other, atol=1e-6)


@pytest.mark.parametrize("architecture", KINDS)
def test_a_description_and_a_configuration_hold_all_of_it(architecture: str, tmp_path: Path) -> None:
    config = training_of(architecture)
    assert config_from(plain(config)) == config
    info = registry.WeightsInfo(
        name="tiny", network=config.network, pixel_filters=config.loss.pixel_filters, default=False, steps=1,
        commit="c", data="d", data_licence="CC0-1.0", licence="CC0-1.0", sha256="0", folder=tmp_path,
    )  # fmt: skip
    (tmp_path / "tiny.json").write_text(info.to_json())
    assert registry.list_weights(tmp_path) == [info]
    described = config.network.describe()
    assert described is None or all(dataclasses.astuple(described))


@pytest.mark.parametrize("architecture", KINDS)
def test_the_loss_that_it_names_trains_all_of_it(architecture: str) -> None:
    """Each parameter moves in a step of a source that trains it; some start where their gradient vanishes."""
    config = training_of(architecture)
    materials = Materials([bumpy(32, 32, 5).astype(np.float16)], "gltf")
    state = loop.new_state(config)
    loop.fit_whitening(state.network, materials, config)
    start = {name: value.detach().clone() for name, value in state.network.named_parameters()}
    for step in range(2):
        batch = draw_batch(materials, config, step)
        assert batch.source in config.network.encoders
        assert torch.isfinite(state.advance(batch))
    own = {state.network.only_of(name) for name in start}
    assert own <= {"", *config.network.encoders}
    assert all(not torch.equal(start[name], value) for name, value in state.network.named_parameters())


@pytest.mark.parametrize("kind", sorted(LOSSES))
def test_a_loss_says_what_it_draws(kind: str) -> None:
    loss = LOSSES[kind]()
    assert loss.pixel_filters[0] == loss.pixel_filter and loss.pairs > 0 and loss.drawn
    assert loss.max_lod == len(level_sizes(loss.crop_size, loss.crop_size)) - 1
