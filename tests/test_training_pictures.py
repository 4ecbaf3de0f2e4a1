"""Small pictures in training: their loss, its gradient, and released weights that a training starts from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from mipbake.material.aim import ANISOTROPIC, TRILINEAR, Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.models.moment_config import FEATURES
from mipbake.training import batches, loop
from mipbake.training.balanced_loss import OTHER_SAMPLERS, BalancedBatch
from mipbake.training.data import Materials
from mipbake.training.picture_loss import SeenPictures, draw_pictures, plain_levels

from .moment_cases import TORUS, bumpy
from .small_training import tiny_balanced as tiny

KINDS = [TRILINEAR, ANISOTROPIC, Sampler(4, -1.0, 8)]
PATCHES = np.stack([bumpy(16, 16, seed) for seed in (1, 2, 3)])


def drawn(sampler: Sampler, lod: float = 1.2, seed: int = 0, patches: np.ndarray = PATCHES) -> SeenPictures:
    sources = [FilteredSource(patch, "gltf", TORUS, "gaussian") for patch in patches]
    return draw_pictures(sources, np.full(len(patches), lod, np.float32), sampler, np.random.default_rng(seed))


def tensors(levels: list[np.ndarray]) -> list[torch.Tensor]:
    return [torch.from_numpy(each) for each in levels]


@pytest.mark.parametrize("sampler", KINDS)
def test_the_exact_stack_is_off_by_noise_alone(sampler: Sampler) -> None:
    """Constant patches are their own stacks. Where the colour is wrong, they are off by far more."""
    flat = np.broadcast_to(np.array([0.6, 0.4, 0.3, 0, 0.5, 0, 0, 1], np.float32), PATCHES.shape).copy()
    pictures = drawn(sampler, patches=flat)
    levels = tensors(plain_levels(flat, "gltf"))
    assert float(pictures.errors(levels, "gltf").abs().max()) < 1e-6
    assert float(pictures.value(levels, "gltf")) < 1e-3
    wrong = [each.clone() for each in levels]
    for each in wrong:
        each[..., 2] = 0.6
    assert float(pictures.errors(wrong, "gltf").max()) > 1e-2  # some pictures are turned away from all lights


@pytest.mark.parametrize("sampler", KINDS)
def test_plain_averages_have_their_own_error_and_a_loss_near_one(sampler: Sampler) -> None:
    pictures = drawn(sampler)
    levels = tensors(plain_levels(PATCHES, "gltf"))
    torch.testing.assert_close(pictures.errors(levels, "gltf").clamp(min=0), pictures.plain)
    # Four times as much, where nothing is gained: being behind counts three times in addition.
    value = float(pictures.value(levels, "gltf"))
    assert 1 < value <= 7  # estimates are noisy
    ahead = replace(pictures, plain=4 * pictures.plain)
    assert float(ahead.value(levels, "gltf")) < value / 4


@pytest.mark.parametrize("sampler", KINDS)
def test_the_gradient_is_the_derivative_of_what_is_off(sampler: Sampler) -> None:
    """What errors are divided by is taken as it is: for one estimate, the loss is a quotient of two squares."""
    pictures = drawn(sampler, patches=PATCHES[:1])
    pictures = replace(pictures, second=pictures.first)
    levels = tensors(plain_levels(PATCHES[:1], "gltf"))
    for each in levels:
        each[..., 4] = 0.6
    leaves = [each.clone().requires_grad_() for each in levels]
    pictures.value(leaves, "gltf").backward()
    rng = np.random.default_rng(1)
    along = [torch.from_numpy(rng.normal(size=each.shape).astype(np.float32)) for each in levels]
    step = 1e-3
    ahead, back = (
        float(pictures.errors([each + turn * step * way for each, way in zip(levels, along, strict=True)], "gltf"))
        for turn in (1, -1)
    )
    here = float(pictures.errors(levels, "gltf"))
    expected = (ahead - back) / (2 * step) * float(pictures.value(levels, "gltf")) / here
    found = sum(
        float((leaf.grad * way).sum()) for leaf, way in zip(leaves, along, strict=True) if leaf.grad is not None
    )
    assert found == pytest.approx(expected, rel=2e-2)


def test_steps_draw_pictures_for_samplers_as_often_as_is_asked() -> None:
    settings = {"crops": 1, "crop_size": 16, "rooms": 0, "pictures": 2}
    materials = Materials([bumpy(32, 32, 5).astype(np.float16)], "gltf")
    for share, others, samplers in (
        (0.0, 0.0, {TRILINEAR}),
        (1.0, 0.0, {ANISOTROPIC}),
        (0.5, 0.0, {TRILINEAR, ANISOTROPIC}),
        (0.0, 1.0, set(OTHER_SAMPLERS)),
    ):
        loss = {**settings, "anisotropic": share, "other_samplers": others}
        config = tiny(loss=loss, network={"samplers": list(FEATURES)})
        found = [batches.draw_batch(materials, config, index) for index in range(8)]
        assert all(isinstance(each, BalancedBatch) and len(each.pictures) == 6 for each in found)
        drawn = {each.sampler for each in found if isinstance(each, BalancedBatch)}
        assert drawn == samplers if len(samplers) < 3 else len(drawn) > 2 and drawn <= samplers


@pytest.mark.long
def test_training_on_pictures_moves_every_parameter_and_makes_them_right() -> None:
    """The error of pictures that no step saw falls, relative to plain averages."""
    config = tiny(
        run={"steps": 60},
        network={"samplers": list(FEATURES[:2])},
        loss={"rooms": 0, "pictures": 2, "picture_weight": 3.0, "anisotropic": 0.5},
        optimiser={"learning_rate": 3e-3},
    )
    materials = Materials([bumpy(32, 32, 5).astype(np.float16)], "gltf")
    state = loop.new_state(config)
    held = [batches.draw_batch(materials, config, 1000 + index) for index in range(6)]

    def error() -> float:
        found = []
        for batch in held:
            with torch.no_grad():
                levels = state.network(batch.patches, batch.source, batch.pixel_filter, batch.sampler)["gltf"]
                found += [float((each.errors(levels, "gltf") / (each.plain + 0.05)).mean()) for each in batch.pictures]
        return float(np.mean(found))

    before, start = error(), [each.detach().clone() for each in state.network.parameters()]
    losses = [float(state.advance(batch)) for batch in batches.batches(materials, config, 0)]
    assert np.isfinite(losses).all()
    assert all(not torch.equal(a, b) for a, b in zip(start, state.network.parameters(), strict=True))
    assert error() < 0.95 * before


def test_a_training_starts_from_released_weights(tmp_path: Path) -> None:
    network = loop.new_state(tiny(run={"seed": 7})).network
    given = {name: value.contiguous() for name, value in network.state_dict().items()}
    path = tmp_path / "tiny.safetensors"
    save_file(given, path)
    state = loop.new_state(tiny(network={"samplers": list(FEATURES[:2])}))
    new = loop.start_from(state, path)
    own = state.network.state_dict()
    assert new and not set(new) & set(given) and set(new) | set(given) == set(own)
    assert all(torch.equal(own[name], value) for name, value in given.items())
