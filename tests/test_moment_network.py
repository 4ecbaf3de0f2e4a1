"""Networks that correct averages: what stays exact, what an untrained one is, tiling, filters, the lookup's kernel."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from mipbake.errors import UsageError
from mipbake.material import MIN_ROUGHNESS, lift_normal
from mipbake.metrics import PAIR_SETS, pair_set, snr_db
from mipbake.models.config import MomentConfig
from mipbake.models.lookup_kernel import periodic_levels, periodic_matrices, sharpened, sharpening
from mipbake.models.moment_inference import bake
from mipbake.models.moment_network import MomentNetwork
from mipbake.models.moments import COUNT, FEATURES, moments, statistics
from mipbake.prefilter.lean import Lean
from mipbake.prefilter.linear import Linear
from mipbake.prefilter.pixel_filter import FILTERS, Wrap, filtered_levels, level_sizes
from mipbake.prefilter.unreal import UNREAL
from mipbake.render import candidate, random_points, reference

torch.set_num_threads(1)

TORUS: Wrap = ("wrap", "wrap")
SMALL = MomentConfig(latent_channels=6, convolutions=2, pointwise=1, growth=5, decoder_layers=2, decoder_growth=6)


def bumpy(height: int, width: int, seed: int = 0) -> NDArray[np.float32]:
    """Valid stored channels of `gltf`, with colours that are exactly 0 and 1 among them."""
    rng = np.random.default_rng(seed)
    colour = np.clip(rng.uniform(-0.3, 1.3, (height, width, 4)), 0, 1)
    roughness = rng.uniform(MIN_ROUGHNESS, 1, (height, width, 1))
    normal = lift_normal(rng.uniform(-0.5, 0.5, (height, width, 2)))
    return np.concatenate([colour, roughness, normal], -1).astype(np.float32)


def trained_like(config: MomentConfig = SMALL) -> MomentNetwork:
    """Every unit has its say."""
    torch.manual_seed(3)
    network = MomentNetwork(config)
    with torch.no_grad():
        network.output.weight.normal_(0, 1.5)
        network.output.bias.normal_(0, 1.5)
    return network.eval().requires_grad_(False)


@pytest.mark.parametrize("wrap", [TORUS, ("clamp", "wrap")])
@pytest.mark.parametrize(
    "texel",
    [
        (1.0, 0.0, 0.5, 1.0, 0.3, 0.0, 0.0),
        (0.0, 1.0, 0.25, 0.0, 1.0, 0.3, -0.2),
        (0.7, 0.7, 0.7, 0.0, 0.02, 0.0, 0.1),
    ],
)
def test_a_constant_material_stays_as_it_is(texel: tuple[float, ...], wrap: Wrap) -> None:
    xy = np.array(texel[5:])
    stored = np.concatenate([texel[:5], xy, [np.sqrt(1 - xy @ xy)]]).astype(np.float32)
    levels = bake(trained_like(), np.tile(stored, (20, 12, 1)), "gltf", "gltf", "gaussian", wrap, lambda _: None)
    for level in levels:
        np.testing.assert_allclose(level, np.broadcast_to(stored, level.shape), atol=1e-3)  # a quarter of an 8-bit step
        for channel in range(4):
            if stored[channel] in (0, 1):
                assert abs(level[..., channel] - stored[channel]).max() < 1e-6


def test_colours_of_a_flat_dielectric_are_averages() -> None:
    stored = bumpy(32, 32)
    stored[..., 3], stored[..., 4], stored[..., 5:8] = 0, 0.4, (0, 0, 1)
    levels = bake(trained_like(), stored, "gltf", "gltf", "box", TORUS, lambda _: None)
    averages = filtered_levels(stored, "box", TORUS)
    for index, (level, average) in enumerate(zip(levels, averages, strict=True)):
        expected = sharpened(torch.from_numpy(average), index, TORUS).numpy()[..., :4].clip(0, 1)
        np.testing.assert_allclose(level[..., :4], expected, atol=1e-5)
        np.testing.assert_allclose(level[..., 4], 0.4, atol=1e-5)


@pytest.mark.parametrize("pixel_filter", list(FILTERS))
@pytest.mark.parametrize(("height", "width"), [(40, 25), (16, 1), (33, 64)])
def test_tiles_do_not_show(height: int, width: int, pixel_filter: str) -> None:
    network, stored = trained_like(), bumpy(height, width)
    whole, tiled = (
        bake(network, stored, "gltf", "gltf", pixel_filter, ("clamp", "wrap"), lambda _: None, tile)
        for tile in (128, 7)
    )
    assert [level.shape[:2] for level in whole] == level_sizes(height, width)
    for left, right in zip(whole, tiled, strict=True):
        np.testing.assert_allclose(left, right, atol=1e-4)


@pytest.mark.parametrize("pixel_filter", list(FILTERS))
def test_training_and_baking_agree(pixel_filter: str) -> None:
    """Up to level 3, which both filter from level 0; coarser ones are baked from box averages."""
    network, stored = trained_like(), bumpy(16, 16)
    baked = network.bake(stored, "gltf", "gltf", pixel_filter, TORUS)
    trained = network(torch.from_numpy(stored)[None], pixel_filter)
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


def test_closed_forms_beside_the_network_are_theirs() -> None:
    """Level 0 is sharpened; on a material that is the same everywhere but for its normals the rest follows."""
    stored = bumpy(16, 16, 6)
    stored[..., :3], stored[..., 3], stored[..., 4] = 0.5, 0, 0.3
    network = trained_like()
    levels, (linear, unreal) = network.beside_closed_forms(torch.from_numpy(stored)[None], "box")
    for own, again in zip(levels, network(torch.from_numpy(stored)[None], "box"), strict=True):
        torch.testing.assert_close(own, again)
    expected = UNREAL(stored, "gltf", "gltf", "box", TORUS, lambda _: None).levels
    for level in (3, 4):
        np.testing.assert_allclose(linear[level][..., 4], 0.3, atol=1e-5)
        np.testing.assert_allclose(unreal[level][0, ..., 4], expected[level][..., 4], rtol=0.05)
    assert not linear[0].requires_grad


def test_statistics_are_those_of_closed_forms() -> None:
    """`lean` and `unreal` follow from the same averages."""
    stored = bumpy(16, 16, 4)
    stored[..., 5:7] *= 0.5
    stored[..., 7] = np.sqrt(1 - np.square(stored[..., 5:7]).sum(-1))
    means = filtered_levels(moments(torch.from_numpy(stored)).numpy(), "gaussian", TORUS)
    lean = Lean()(stored, "gltf", "gltf", "gaussian", TORUS, lambda _: None).levels
    for level, mean in enumerate(means):
        found = statistics(torch.from_numpy(mean))
        roughness = (found.log_roughness + found.to_lean).exp().numpy()[..., 0]
        np.testing.assert_allclose(roughness, lean[level][..., 4], rtol=2e-4)
        normal = (found.normal + found.lean_normal).numpy()
        np.testing.assert_allclose(normal, lean[level][..., 5:7], atol=1e-5)
        assert found.features().shape[-1] == FEATURES
        assert found.freedom.min() >= 0 and found.freedom.max() < 1


def test_moments_of_glossy_normals_do_not_cancel() -> None:
    """The spread of normals a thousandth of a degree apart is seen in float32."""
    tilt = 2e-5
    stored = np.zeros((2, 8), np.float32)
    stored[:, 4], stored[:, 5], stored[:, 7] = 0.1, (tilt, -tilt), 1
    found = statistics(moments(torch.from_numpy(stored)).mean(0))
    assert float(found.spread) == pytest.approx(tilt**2, rel=1e-3)
    assert float(found.slopes) == pytest.approx(tilt**2, rel=1e-3)


def test_sharpening_undoes_the_lookups_blur() -> None:
    """A cosine keeps its amplitude to second order of its frequency when it is sharpened and looked up bilinearly."""
    size = 64
    for waves, tolerance in ((2, 1e-4), (4, 2e-3), (8, 2e-2)):
        angle = 2 * np.pi * waves / size
        image = torch.cos(angle * (torch.arange(size) + 0.5)).expand(size, size)[..., None]
        ready = sharpened(image, 20, TORUS)[0, :, 0].double()
        fine = np.interp(np.linspace(8, 40, 4097), np.arange(size) + 0.5, ready.numpy())
        wave = np.cos(angle * np.linspace(8, 40, 4097))
        kept = (fine * wave).mean() / np.square(wave).mean()
        assert kept == pytest.approx(1, abs=tolerance)
    assert sharpening(0) == pytest.approx(1 / 24)
    assert torch.equal(sharpened(torch.ones(1, 1, 3), 2, TORUS), torch.ones(1, 1, 3))


def test_periodic_levels_are_the_filtered_and_sharpened_ones() -> None:
    image = torch.rand(1, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    expected = filtered_levels(image[0].numpy(), "tent", TORUS)
    for level, (found, filtered) in enumerate(zip(periodic_levels(image, "tent"), expected, strict=True)):
        ready = sharpened(torch.from_numpy(filtered), level, TORUS)
        np.testing.assert_allclose(found[0].reshape(ready.shape), ready, atol=1e-6)


def test_sharper_levels_are_nearer_to_the_reference() -> None:
    """What sharpening is for: averages of a diffuse material, looked up and shaded."""
    stored = bumpy(64, 64, 7)
    stored[..., 3], stored[..., 4], stored[..., 5:8] = 0, 1, (0, 0, 1)
    stored = filtered_levels(stored, "tent", TORUS)[0]  # what is finer than texels no kernel saves
    plain = filtered_levels(stored, "gaussian", TORUS)
    sharp = [sharpened(torch.from_numpy(level), i, TORUS).numpy() for i, level in enumerate(plain)]
    pairs = pair_set(next(iter(PAIR_SETS)), 0, 8)
    for lod in (0.5, 1.0, 2.0):
        rng = np.random.default_rng(1)
        uv = random_points(rng, 2048)
        halves = [reference(stored, "gltf", TORUS, uv, lod, "gaussian", pairs, 64, rng) for _ in range(2)]
        before, after = (snr_db(candidate(levels, "gltf", TORUS, uv, lod, pairs), *halves) for levels in (plain, sharp))
        assert after > before + 0.5, lod


def test_gradients_reach_every_parameter() -> None:
    network = trained_like().requires_grad_(True)
    levels = network(torch.from_numpy(bumpy(8, 8))[None], "gaussian")
    torch.stack([level.square().mean() for level in levels]).sum().backward()  # type: ignore[no-untyped-call]
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None and torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() > 0, name
    assert moments(torch.zeros(1, 8)).shape[-1] == COUNT


def test_bakes_other_than_trained_for_are_refused() -> None:
    network, stored = trained_like(), bumpy(4, 4)
    with pytest.raises(UsageError, match="make gltf, not 'ggx'"):
        network.bake(stored, "gltf", "ggx", "gaussian", TORUS)
    network.pixel_filters = ("gaussian",)
    with pytest.raises(UsageError, match=r"gaussian, not for 'tent'"):
        network.bake(stored, "gltf", "gltf", "tent", TORUS)
    with pytest.raises(UsageError, match="whole number"):
        MomentConfig(growth=0)


def test_kernels_first_asked_for_by_validation_serve_training_too() -> None:
    periodic_matrices.cache_clear()
    image = torch.ones(1, 4, 4, 2)
    with torch.inference_mode():
        periodic_levels(image, "box")
    again = image.clone().requires_grad_()
    sum(level.sum() for level in periodic_levels(again, "box")).backward()  # type: ignore[union-attr]
    assert again.grad is not None
