"""The balanced loss: pairs that stand for both pair sets, noisy references, when it is nothing, batches used again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from mipbake.base.errors import UsageError
from mipbake.material import convert
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import FILTERS
from mipbake.models import registry
from mipbake.models.moment_config import MADE
from mipbake.models.moment_network import MomentNetwork
from mipbake.quality.metrics import LightViewPairs
from mipbake.quality.metrics.pairs import cosine_directions, near_mirror_lights
from mipbake.quality.reference.estimate import reference
from mipbake.training import batches, loop
from mipbake.training.balanced_loss import (
    BANDS,
    BalancedBatch,
    BalancedLossConfig,
    own_errors,
    rendered,
    room_error,
    seen_groups,
)
from mipbake.training.balanced_pairs import draw_pairs
from mipbake.training.config import config_from
from mipbake.training.data import Materials, draw_crops, load_materials
from mipbake.training.export import export_weights

from .moment_cases import TORUS, bumpy
from .small_training import tiny_balanced as tiny
from .small_training import train

SETTINGS = BalancedLossConfig(crops=2, crop_size=16)


def patches_of(seed: int, count: int = 2) -> torch.Tensor:
    return torch.from_numpy(np.stack([bumpy(16, 16, seed + i) for i in range(count)]))


@pytest.mark.long
def test_weighted_pairs_stand_for_both_pair_sets() -> None:
    """Means of functions that live on rare pairs, against plain draws by the hundred thousand."""

    def values(light: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
        half = torch.nn.functional.normalize(light + view, dim=-1)
        highlight = (half[..., 2] > 0.995).float()
        grazing = ((view[..., 2] < 0.2) & (light[..., 2] < 0.3)).float()
        return torch.stack([torch.ones_like(highlight), light[..., 2], highlight, grazing], -1)

    rng = np.random.default_rng(0)
    view = cosine_directions(rng, 400_000)
    expected = []
    for light in (near_mirror_lights(rng, view), cosine_directions(rng, len(view))):
        expected.append(values(torch.from_numpy(light), torch.from_numpy(view)).double().mean(0))
    sums = []
    for index in range(1500):
        pairs = draw_pairs(patches_of(index), "gltf", SETTINGS, np.random.default_rng([1, index]))
        single = pairs.weights.shape[2]
        assert torch.allclose(pairs.light.norm(dim=-1), torch.ones(()), atol=1e-4)
        assert (pairs.light[..., 2] >= 0).all() and (pairs.view[..., 2] > 0).all()
        found = values(pairs.light[:, :single], pairs.view[:, :single])
        sums.append((pairs.weights[..., None] * found).sum(2).mean(1))
    for found, right in zip(torch.stack(sums).double().mean(0), expected, strict=True):
        # Weights are cut: a hundredth of the whole is missing at most.
        np.testing.assert_allclose(found, right, rtol=0.06, atol=2e-4)


def test_pairs_are_drawn_around_the_lobes_of_any_model() -> None:
    """The same surface in another model has the same lobes, so the same pairs."""
    patches = patches_of(0)
    tensors = torch.from_numpy(convert(patches.numpy(), "gltf", "ggx"))
    given, found = (
        draw_pairs(each, model, SETTINGS, np.random.default_rng(0))
        for each, model in ((patches, "gltf"), (tensors, "ggx"))
    )
    torch.testing.assert_close(found.light, given.light, atol=1e-3, rtol=0)
    torch.testing.assert_close(found.weights, given.weights, atol=1e-3, rtol=1e-2)


def test_rooms_are_seen_at_their_slant() -> None:
    """Stripes across the view: a room's pixels blur them as the filter does; along it, only as much as its cosine."""
    settings = BalancedLossConfig(crops=2, crop_size=32, any_filter=0.0, rooms=1, room_lights=1)
    batch = settings.draw(patches_of(2, 2), "gltf", np.random.default_rng(0))
    single, (light, view, slanted) = seen_groups(batch.pairs, BANDS[0])
    assert single.axes is None and slanted is not None and light.shape == (2, 1, 1, 3)
    along, across = slanted.unbind(-2)
    right_and_down = view[:, :, 0, :2] * torch.tensor([1.0, -1.0])  # texture coordinates: v runs down, y up
    torch.testing.assert_close(along, right_and_down / right_and_down.norm(dim=-1, keepdim=True))
    torch.testing.assert_close(across.norm(dim=-1), view[:, :, 0, 2])
    torch.testing.assert_close((along * across).sum(-1), torch.zeros(2, 1))


def test_brightness_counts_apart() -> None:
    """A room that is too bright everywhere by as much as another is off pixel by pixel has more to answer for."""
    rng = np.random.default_rng(0)
    target = torch.ones(1, 1, 256, 3)
    noise = torch.from_numpy(rng.choice([-0.1, 0.1], (1, 1, 256, 3)).astype(np.float32))
    before, even = room_error(noise, noise, target, 1, 1, 0.0), room_error(noise, noise, target, 1, None, 4e-4)
    brighter = noise + 0.1
    assert before == pytest.approx(1, abs=1e-3)  # its own error over itself
    assert even < 0.5  # what averages out is no brightness
    assert room_error(brighter, brighter, target, 1, None, 4e-4) > 0.9


@pytest.mark.parametrize(("pixel_filter", "model"), [("gaussian", "gltf"), ("box", "gltf"), ("gaussian", "ggx")])
def test_targets_are_the_reference(pixel_filter: str, model: str) -> None:
    """Targets are nearer to it than to the reference of another pixel filter, even at pixels smaller than a texel."""
    settings = BalancedLossConfig(crops=1, crop_size=16, pixel_filter=pixel_filter, any_filter=0.0, below=1.0)
    patches = patches_of(3, 1)
    patches[..., 4] = 0.5 + 0.5 * patches[..., 4]  # narrow lobes would drown all in noise
    patches = torch.from_numpy(convert(patches.numpy(), "gltf", model))
    signal, errors = 0.0, {"gaussian": 0.0, "box": 0.0}
    for seed in range(4):
        batch = settings.draw(patches, model, np.random.default_rng(seed))
        assert batch.pixel_filter == pixel_filter
        single = batch.pairs.weights.shape[2]  # rooms are seen at a slant
        pairs = LightViewPairs(batch.pairs.light[0, :single].numpy(), batch.pairs.view[0, :single].numpy())
        for band, seen in zip(BANDS, batch.seen, strict=True):
            for index in range(seen.lods):
                some = slice(index * band.side**2, index * band.side**2 + 64)
                uv, lod = seen.uv[0, some].numpy().astype(float), float(seen.lod[0, some.start])
                found = (seen.noisy_reference[0, :single, some] + seen.independent[0, :single, some]).numpy() / 2
                for name in errors:
                    rng = np.random.default_rng(5)
                    source = FilteredSource(patches[0].numpy(), model, TORUS, name)
                    right = reference(source, uv, lod, pairs, 256, rng)
                    # Means of pixels side by side: the noise of single samples averages out.
                    difference = (found - right).reshape(len(found), -1, 4, 3).mean(2)
                    errors[name] += float(np.square(difference).sum())
                    signal += float(np.square(right.reshape(len(found), -1, 4, 3).mean(2)).sum()) / len(errors)
    assert errors[pixel_filter] < 0.05 * signal
    assert errors[pixel_filter] == min(errors.values())


@pytest.mark.parametrize("model", ["gltf", "ggx", "beckmann"])
def test_a_constant_material_costs_nothing(model: str) -> None:
    patches = patches_of(0)
    patches[:] = torch.tensor([0.5, 0.2, 0.1, 0.0, 0.4, 0.0, 0.0, 1.0])
    batch = SETTINGS.draw(torch.from_numpy(convert(patches.numpy(), "gltf", model)), model, np.random.default_rng(0))
    network = MomentNetwork(tiny(network={"decoders": [model]}).network)
    assert float(SETTINGS.value(network, batch).detach()) < 1e-3


@pytest.mark.long
@pytest.mark.parametrize("model", MADE)
def test_training_moves_every_parameter_and_lowers_the_error(model: str) -> None:
    """The error of the bands of batches that no step saw, without the noise of their references: it falls in most.

    Were it chance, it would fall in 1/2 of the 48, with a standard deviation of 0.07. With three seeds of the
    anisotropic model it fell in 0.65 to 0.96 of them.
    """
    config = tiny(run={"steps": 160}, network={"decoders": [model]}, optimiser={"learning_rate": 3e-3})
    materials = Materials([bumpy(32, 32, 5).astype(np.float16)], "gltf")
    state = loop.new_state(config)
    held = [batches.draw_batch(materials, config, 1000 + i) for i in range(16)]

    def errors() -> torch.Tensor:
        """The squared error of each batch and band: the product of its differences to two estimates of the reference,
        every pair relative to its signal."""
        found = []
        for batch in held:
            with torch.no_grad():
                levels = state.network(batch.patches, batch.source, batch.pixel_filter)[model]
                for seen in batch.seen:
                    shaded = rendered(levels, seen, batch.pairs.light, batch.pairs.view, model)
                    signal = (seen.noisy_reference * seen.independent).mean((0, 2, 3), keepdim=True).clamp_min(1e-4)
                    product = (shaded - seen.noisy_reference) * (shaded - seen.independent)
                    found.append((product / signal).mean())
        return torch.stack(found)

    before, start = errors(), [p.detach().clone() for p in state.network.parameters()]
    losses = [float(state.advance(batch)) for batch in batches.batches(materials, config, 0)]
    assert np.isfinite(losses).all()
    assert all(not torch.equal(a, b) for a, b in zip(start, state.network.parameters(), strict=True))
    assert (errors() < before).float().mean() > 0.6


def test_batches_serve_twice_and_a_resumed_training_sees_the_same() -> None:
    config = tiny(run={"steps": 12})
    materials, _ = load_materials(config)
    indices = [batches.batch_of(step, config) for step in range(12)]
    assert indices[::2] == list(range(6)) and all(
        old <= new for old, new in zip(indices[1::2], indices[::2], strict=True)
    )
    drawn = list(batches.batches(materials, config, 0))
    resumed = list(batches.batches(materials, config, 7))
    for left, right in zip(drawn[7:], resumed, strict=True):
        assert isinstance(left, BalancedBatch) and isinstance(right, BalancedBatch)
        assert torch.equal(left.patches, right.patches)
        assert torch.equal(left.seen[0].noisy_reference, right.seen[0].noisy_reference)


def test_plain_and_strided_patches_are_materials_of_the_data() -> None:
    config = tiny(data={"plain": 1.0, "strided": 1.0})
    image = bumpy(128, 128, 2)
    image[..., :3] = np.sort(image[..., :3], -1)  # the order of colours is drawn, too
    materials = Materials([image.astype(np.float16)], "gltf")
    patches = draw_crops(materials, 4, 16, "gltf", np.random.default_rng(0), config.data)
    texels = {tuple(t) for t in image.astype(np.float16).astype(np.float32)[..., :5].reshape(-1, 5)}
    for patch in patches:
        assert all((*sorted(t[:3]), t[3], t[4]) in texels for t in patch[..., :5].reshape(-1, 5).tolist())


def test_training_resumes_and_exports_for_every_pixel_filter(tmp_path: Path) -> None:
    train(tiny(run={"steps": 1}), tmp_path / "run", resume=False)
    again = train(tiny(run={"steps": 2}), tmp_path / "run", resume=True)
    assert again.step == 2
    info = export_weights(tmp_path / "run" / loop.LAST, "tiny", tmp_path, default=True)
    assert set(info.pixel_filters) == set(FILTERS) and info.targets == ("gltf",)
    assert registry.list_weights(tmp_path) == [info]
    assert "moments, filtered with the pixel filter" in (tmp_path / "tiny.md").read_text()
    network = registry.load_network(info)
    stored = bumpy(20, 12)
    for pixel_filter in FILTERS:
        levels = network.bake(stored, "gltf", "gltf", pixel_filter, TORUS)
        assert all(np.isfinite(level).all() for level in levels)


def test_a_training_starts_from_another_ones_weights(tmp_path: Path) -> None:
    """Round lobes first, then two widths: what both networks have is taken over, the rest is new."""
    first = train(tiny(run={"steps": 1}), tmp_path / "round", resume=False)
    stretched = tiny(network={"decoders": ["gltf-anisotropic"]}, run={"steps": 1})
    state = loop.new_state(stretched)
    assert loop.start_from(state, tmp_path / "round" / loop.LAST) == ["stretch.weight", "stretch.bias"]
    own, given = state.network.state_dict(), first.average.state_dict()
    assert all(torch.equal(own[name], value) for name, value in given.items()) and len(own) == len(given) + 2
    said: list[str] = []
    train(stretched, tmp_path / "stretched", False, say=said.append, start=tmp_path / "round" / loop.LAST)
    assert any("stretch.weight, stretch.bias" in line for line in said)
    with pytest.raises(UsageError, match="--start"):
        train(stretched, tmp_path / "stretched", True, start=tmp_path / "round" / loop.LAST)
    other = loop.new_state(config_from({"network": {"latent_channels": 20}}))
    with pytest.raises(UsageError, match="no weights of this architecture"):
        loop.start_from(other, tmp_path / "round" / loop.LAST)


def test_own_errors_know_no_noise() -> None:
    """The mean square of a difference is error and noise; the product of two independent ones is the error."""
    rng = np.random.default_rng(4)
    error = torch.full((1, 2, 2 * 4096, 3), 0.05)
    first, second = (error + torch.from_numpy(rng.normal(0, 0.1, error.shape).astype(np.float32)) for _ in range(2))
    own = own_errors(first, second, 2)
    np.testing.assert_allclose(own.numpy(), 0.0025, rtol=0.2)
    assert float(second.square().mean()) > 4 * 0.0025
    # Where chance makes the product small or negative, part of the square holds.
    held = own_errors(first, -first, 2)
    torch.testing.assert_close(held, 0.1 * first.square().reshape(1, 2, 2, -1).mean(-1))
