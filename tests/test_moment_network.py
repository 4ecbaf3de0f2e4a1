"""Networks that correct averages: what stays exact, what an untrained one is, tiling, filters, the lookup's kernel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mipbake.baking.rules.linear import Linear
from mipbake.baking.rules.unreal import UNREAL
from mipbake.base.errors import UsageError
from mipbake.material import MODELS, Kind, convert
from mipbake.material.aim import Sampler
from mipbake.material.pixel_filter import FILTERS, filtered_levels, level_sizes
from mipbake.models.level_filter import width_of
from mipbake.models.lookup_kernel import periodic_levels, sharpened, sharpening
from mipbake.models.moment_config import FEATURES, MomentConfig
from mipbake.models.moment_inference import Lookup, bake_levels
from mipbake.models.moment_network import MomentNetwork

from .moment_cases import ANISOTROPIC, READ, SMALL, TORUS, bumpy, config_of, of_model, trained_like


@pytest.mark.parametrize("model", READ)
@pytest.mark.parametrize("seed", range(4))
def test_a_constant_texel_of_any_model_stays_as_it_is(model: str, seed: int) -> None:
    texel = of_model(model, 1, 1, seed)
    levels = trained_like(config_of(model)).bake(np.tile(texel, (20, 12, 1)), model, model, "gaussian", TORUS)
    for level in levels:
        np.testing.assert_allclose(level, np.broadcast_to(texel, level.shape), atol=2e-3)
        for colours in MODELS[model].of(Kind.REFLECTANCE, Kind.SHARE):
            whole = (texel[0, 0, colours] == 0) | (texel[0, 0, colours] == 1)
            assert abs(level[..., colours] - texel[..., colours])[..., whole].max(initial=0) < 1e-5


def test_diffuse_light_is_averaged() -> None:
    """The diffuse albedo is, whatever else varies; sharpness apart, which is its own."""
    stored = of_model("ggx", 32, 32)
    stored[..., :3] = 0.3
    for level in trained_like(config_of("ggx")).bake(stored, "ggx", "ggx", "box", TORUS):
        np.testing.assert_allclose(level[..., :3], 0.3, atol=1e-5)


def test_colours_of_a_flat_dielectric_are_averages() -> None:
    stored = bumpy(32, 32)
    stored[..., 3], stored[..., 4], stored[..., 5:8] = 0, 0.4, (0, 0, 1)
    levels = trained_like().bake(stored, "gltf", "gltf", "box", TORUS)
    averages = filtered_levels(stored, "box", TORUS)
    for index, (level, average) in enumerate(zip(levels, averages, strict=True)):
        expected = sharpened(torch.from_numpy(average), index, TORUS).numpy()[..., :4].clip(0, 1)
        np.testing.assert_allclose(level[..., :4], expected, atol=1e-5)
        np.testing.assert_allclose(level[..., 4], 0.4, atol=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("model", ["gltf", "ggx"])
@pytest.mark.parametrize("pixel_filter", list(FILTERS))
@pytest.mark.parametrize(("height", "width"), [(40, 25), (16, 1), (33, 64)])
def test_tiles_do_not_show(height: int, width: int, pixel_filter: str, model: str) -> None:
    network, stored = trained_like(config_of(model)), of_model(model, height, width)
    whole, tiled = (bake_levels(network, stored, Lookup(pixel_filter), ("clamp", "wrap"), tile) for tile in (128, 7))
    assert [level.shape[:2] for level in whole] == level_sizes(height, width)
    for left, right in zip(whole, tiled, strict=True):
        np.testing.assert_allclose(left, right, atol=1e-4)


@pytest.mark.parametrize("model", READ)
@pytest.mark.parametrize("pixel_filter", list(FILTERS))
def test_training_and_baking_agree(pixel_filter: str, model: str) -> None:
    """Up to level 3, which both filter from level 0; coarser ones are baked from box averages."""
    network, stored = trained_like(config_of(model)), of_model(model, 16, 16)
    baked = network.bake(stored, model, model, pixel_filter, TORUS)
    trained = network(torch.from_numpy(stored)[None], model, pixel_filter)[model]
    for level, (left, right) in enumerate(zip(baked, trained, strict=True)):
        if level <= 3:
            np.testing.assert_allclose(left, right[0].numpy(), atol=5e-4)


def test_an_untrained_network_is_near_a_closed_form() -> None:
    stored = bumpy(32, 32)
    stored[..., 4] = 0.2
    torch.manual_seed(0)
    network = MomentNetwork(SMALL).requires_grad_(False)
    baked = network.bake(stored, "gltf", "gltf", "gaussian", TORUS)
    wider = UNREAL(stored, "gltf", "gltf", "gaussian", TORUS, lambda _: None).levels
    narrow = Linear()(stored, "gltf", "gltf", "gaussian", TORUS, lambda _: None).levels
    for level in (1, 2, 3):
        roughness = baked[level][..., 4].mean()
        assert narrow[level][..., 4].mean() < roughness < 1.1 * wider[level][..., 4].mean()


def test_sharpening_undoes_the_lookups_blur() -> None:
    """A cosine sharpened and looked up bilinearly has what levels are sharper by on purpose, and no more, to second
    order of its frequency."""
    size = 64
    for waves, tolerance in ((2, 1e-4), (4, 2e-3), (8, 2e-2)):
        angle = 2 * np.pi * waves / size
        image = torch.cos(angle * (torch.arange(size) + 0.5)).expand(size, size)[..., None]
        ready = sharpened(image, 20, TORUS)[0, :, 0].double()
        fine = np.interp(np.linspace(8, 40, 4097), np.arange(size) + 0.5, ready.numpy())
        wave = np.cos(angle * np.linspace(8, 40, 4097))
        kept = (fine * wave).mean() / np.square(wave).mean()
        assert kept == pytest.approx(1 + angle**2 / 60, abs=tolerance)
    assert sharpening(0) == pytest.approx(1 / 24 + 1 / 60)
    assert torch.equal(sharpened(torch.ones(1, 1, 3), 2, TORUS), torch.ones(1, 1, 3))


def test_periodic_levels_are_the_filtered_and_sharpened_ones() -> None:
    image = torch.rand(1, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    expected = filtered_levels(image[0].numpy(), "tent", TORUS)
    for level, (found, filtered) in enumerate(zip(periodic_levels(image, "tent"), expected, strict=True)):
        ready = sharpened(torch.from_numpy(filtered), level, TORUS)
        np.testing.assert_allclose(found[0].reshape(ready.shape), ready, atol=1e-6)


@pytest.mark.parametrize("model", READ)
def test_gradients_reach_every_parameter(model: str) -> None:
    network = trained_like(config_of(model)).requires_grad_(True)
    levels = network(torch.from_numpy(of_model(model, 8, 8))[None], model, "gaussian")[model]
    torch.stack([level.square().mean() for level in levels]).sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None and torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() > 0, name


def test_bakes_other_than_trained_for_are_refused() -> None:
    network, stored = trained_like(), bumpy(4, 4)
    with pytest.raises(UsageError, match="make gltf, not 'ggx'"):
        network.bake(stored, "gltf", "ggx", "gaussian", TORUS)
    network.pixel_filters = ("gaussian",)
    with pytest.raises(UsageError, match=r"gaussian, not for 'tent'"):
        network.bake(stored, "gltf", "gltf", "tent", TORUS)
    with pytest.raises(UsageError, match="whole number"):
        MomentConfig(growth=0)
    with pytest.raises(UsageError, match=r"network\.decoders must be one of gltf,"):
        MomentConfig(decoders=("gltf", "ggx"))
    with pytest.raises(UsageError, match="read gltf and would lose what ggx says"):
        trained_like(ANISOTROPIC).bake(of_model("ggx", 4, 4), "ggx", "gltf-anisotropic", "gaussian", TORUS)


@pytest.mark.parametrize("source", MODELS)
def test_directions_are_made_of_tensors(source: str) -> None:
    """Whose lobes are stretched already, a network that reads tensors bakes."""
    stored = np.asarray(convert(of_model("ggx", 16, 16), "ggx", source))
    network = trained_like(config_of("ggx"))
    tensors = network.bake(stored, source, "ggx", "gaussian", TORUS)
    lines = network.bake(stored, source, "gltf-anisotropic", "gaussian", TORUS)
    for level, given in zip(lines, tensors, strict=True):
        assert level.shape[-1] == 11 and (np.linalg.norm(level[..., 8:10], axis=-1) > 0.99).all()
        again = convert(level, "gltf-anisotropic", "ggx")
        narrow = given[..., 8] + given[..., 9] < -4  # neither axis beyond what directions can say
        np.testing.assert_allclose(again[narrow][..., 6:8], given[narrow][..., 6:8], atol=1e-3)


def test_an_anisotropic_constant_stays_round() -> None:
    for roughness in (0.05, 0.5, 1.0):
        stored = np.broadcast_to(np.float32([0.5, 0.2, 0.1, 1.0, roughness, 0.3, 0.0, np.sqrt(0.91)]), (8, 8, 8))
        stack = trained_like(ANISOTROPIC).bake(stored, "gltf", "gltf-anisotropic", "gaussian", TORUS)
        for level in stack:
            assert level.shape[-1] == 11
            np.testing.assert_allclose(level[..., :8], np.broadcast_to(stored[0, 0], level[..., :8].shape), atol=1e-3)
            assert level[..., 10].max() < 0.5 / 255


@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0, 150.0])
def test_lobes_are_wider_across_brushing(angle: float) -> None:
    """Slopes along one axis alone: an untrained network turns the lobe's wide axis to it."""
    stored, turn = bumpy(16, 16, 9), np.deg2rad(angle)
    slope = np.random.default_rng(0).normal(0, 0.15, (16, 16, 1)) * [np.cos(turn), np.sin(turn)]
    stored[..., 4], stored[..., 5:8] = 0.3, np.concatenate([slope, np.ones((16, 16, 1))], -1)
    stored[..., 5:8] /= np.linalg.norm(stored[..., 5:8], axis=-1, keepdims=True)
    level = MomentNetwork(ANISOTROPIC).eval().requires_grad_(False)
    top = level.bake(stored, "gltf", "gltf-anisotropic", "gaussian", TORUS)[-1][0, 0]
    assert abs(top[8:10] @ [np.cos(turn), np.sin(turn)]) > 0.99
    across, along = top[4] ** 2, top[4] ** 2 + (1 - top[4] ** 2) * top[10] ** 2
    assert 1.2 < along / across < 4


def test_gradients_of_lobes_are_finite_where_they_are_round() -> None:
    stored = torch.from_numpy(bumpy(8, 8, 5))[None]
    stored[:, :4] = stored[:, :1, :1]  # constant, but for its border
    network = MomentNetwork(ANISOTROPIC)
    levels = network(stored, "gltf", "box")["gltf-anisotropic"]
    loss = torch.stack([level.square().sum() for level in levels]).sum()
    loss.backward()
    assert all(p.grad is not None and bool(p.grad.isfinite().all()) for p in network.parameters())
    assert float(network.stretch.weight.grad.abs().max()) > 0


@pytest.mark.parametrize("count", [2, 4])
def test_what_is_told_of_samplers_changes_all_levels_and_what_is_trained_is_what_is_baked(count: int) -> None:
    network = trained_like(replace(config_of("gltf"), samplers=FEATURES[:count]))
    with torch.no_grad():
        network.told.normal_(0, 0.3, generator=torch.Generator().manual_seed(0))
    stored = of_model("gltf", 32, 32)
    kinds = [Sampler(), Sampler(16), Sampler(4, -0.5, 8)]
    baked = {each: network.bake(stored, "gltf", "gltf", "gaussian", TORUS, sampler=each) for each in kinds}
    for sampler, levels in baked.items():
        trained = network(torch.from_numpy(stored)[None], "gltf", "gaussian", sampler)["gltf"]
        for made, expected in list(zip(levels, trained, strict=True))[:4]:  # coarser ones come from box averages
            np.testing.assert_allclose(made, expected[0].detach().numpy(), atol=5e-4)
    for level, (first, *others) in enumerate(zip(*baked.values(), strict=True)):
        assert all(np.abs(first - other).max() > 1e-3 for other in others), level


def test_the_rows_of_two_features_are_those_of_the_two_samplers() -> None:
    """Weights that were trained for these two alone make the same as ever; samplers between them are mixtures."""
    kinds = Sampler(), Sampler(16), Sampler(4, frames=8)
    assert [MomentConfig(samplers=FEATURES[:2]).features(each) for each in kinds] == [(1, 0), (0, 1), (0.5, 0.5)]
    assert [width_of(2, each) for each in kinds[:2]] == [0.8, 1.0]
    assert width_of(2, Sampler(16, -1.0)) == pytest.approx(2**0.5)
    assert width_of(2, Sampler(16, -1.0, 8)) == width_of(2, Sampler(frames=8)) == 0.8
    assert width_of(0, Sampler(bias=-1.0)) == 1
    for wrong in (FEATURES[:1], FEATURES[:3], ("anisotropic", "trilinear")):
        with pytest.raises(UsageError, match=r"network\.samplers must be"):
            replace(config_of("gltf"), samplers=wrong)
