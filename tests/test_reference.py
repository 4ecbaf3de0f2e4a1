"""The filtered reference, what its estimates are on average and how much they scatter; and the pairs that light it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

import mipbake
from mipbake import TextureSet, sampling, shading
from mipbake.material import convert
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import FILTERS
from mipbake.quality.metrics import PAIR_SETS, pair_set
from mipbake.quality.metrics.pairs import LightViewPairs, cosine_directions, near_mirror_lights
from mipbake.quality.reference import lobes
from mipbake.quality.reference.estimate import estimate, reference
from mipbake.quality.reference.lighting import GroupPairs, Illumination, PixelPairs, common_pairs
from mipbake.quality.reference.pair_sets import weighted_pair_set
from mipbake.quality.reference.samples import Pixels
from mipbake.quality.reference.sequences import random_points

from .stacks import gltf_level

PIXELS, PAIRS, GROUPS = 12, 3, 2

SIGNED = [name for name, each in FILTERS.items() if each.signed]


def source(pixel_filter: str) -> FilteredSource:
    level = gltf_level((24, 32), 0)
    level[..., 4] = 0.3 + 0.6 * level[..., 4]
    return FilteredSource(level, "gltf", ("wrap", "clamp"), pixel_filter)


def pairs_of(count: int, seed: int) -> LightViewPairs:
    """Pairs near the mirror, where radiance changes the most from texel to texel."""
    rng = np.random.default_rng(seed)
    view = cosine_directions(rng, count)
    return LightViewPairs(near_mirror_lights(rng, view).astype(np.float32), view.astype(np.float32))


@dataclass(frozen=True, eq=False)
class Case:
    """Pixels, what lights them, and for each group and pixel the K pairs that light it."""

    pixels: Pixels
    lighting: Illumination

    def radiance(self, model: str, texels: NDArray[np.float32], group: int, pixel: int) -> NDArray[np.float32]:
        """(K, N, 3) of (N, C) texels of one pixel."""
        lit = self.lighting
        if isinstance(lit, GroupPairs):
            return shading.shade(model, texels, lit.light[group], lit.view[group])
        return shading.shade(model, texels, lit.light[:, pixel], lit.view[:, pixel])


def cases() -> dict[str, Case]:
    """A case for every use: the measure and held-out pairs, scores, texels, small pictures, patches of training."""
    rng = np.random.default_rng(0)
    uv, lods = random_points(rng, PIXELS), rng.uniform(0, 3, PIXELS).astype(np.float32)
    many = [pairs_of(PAIRS, seed) for seed in range(GROUPS)]
    groups = GroupPairs(*(np.stack([getattr(each, name) for each in many]) for name in ("light", "view")))
    own = pairs_of(PAIRS * PIXELS, 9)
    by_pixel = PixelPairs(*(each.reshape(PAIRS, PIXELS, 3) for each in (own.light, own.view)))
    slanted = np.array([[0.8, 0.6], [-0.3, 0.4]], np.float32)
    axes = np.stack([np.eye(2, dtype=np.float32), slanted])[:, None]
    return {
        "common pairs": Case(Pixels(uv, 1.5), common_pairs(pairs_of(PAIRS, 1))),
        "pairs of groups, pixels of their own": Case(Pixels(rng.random((GROUPS, PIXELS, 2)), 2.0), groups),
        "pairs of pixels": Case(Pixels(uv, lods), by_pixel),
        "small pictures": Case(Pixels(rng.random((GROUPS, PIXELS, 2)), np.array([[0.5], [2.5]]), axes), groups),
        "groups that share pixels": Case(Pixels(uv, lods, axes), groups),
    }  # fmt: skip


def integral(case: Case, pixel_filter: str, across: int) -> NDArray[np.float64]:
    """(G, K, P, 3): equation 3 by the midpoint rule, `across` steps along each axis of a pixel."""
    what, kernel = source(pixel_filter), FILTERS[pixel_filter]
    height, width = what.stored.shape[:2]
    grid = ((np.arange(across) + 0.5) / across * 2 - 1) * kernel.radius
    x, y = np.meshgrid(grid, grid)
    weight = (kernel.shape(x) * kernel.shape(y)).ravel()
    weight /= weight.sum()
    groups, count = case.lighting.groups, case.pixels.uv.shape[-2]
    uv = np.broadcast_to(case.pixels.uv, (groups, count, 2))
    lods = np.broadcast_to(case.pixels.lod, (groups, count))
    axes = np.broadcast_to(np.eye(2) if case.pixels.axes is None else case.pixels.axes, (groups, count, 2, 2))
    out = np.empty((groups, case.lighting.renders, count, 3))
    for group, pixel in np.ndindex(groups, count):
        offset = np.stack([x.ravel(), y.ravel()], -1) @ axes[group, pixel] * 2.0 ** lods[group, pixel]
        where = uv[group, pixel].astype(np.float32) + offset / [width, height]
        texels = sampling.texture(what.stored[None], where[None, None], filter_mode="linear", boundary_mode=what.wrap)
        radiance = case.radiance(what.model, texels[0, 0], group, pixel)
        out[group, :, pixel] = np.einsum("knc,n->kc", radiance.astype(np.float64), weight)
    return out


class Stratified:
    """In place of a generator: uniform numbers, one in each cell of a square grid. Means over them are integrals."""

    def __init__(self, side: int) -> None:
        self.side, self.rng = side, np.random.default_rng(0)

    def random(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        cells = np.stack(np.divmod(np.arange(self.side**2), self.side)).reshape(shape)
        return (cells + self.rng.random(shape)) / self.side


class Fixed:
    """In place of a generator: one number for all."""

    def random(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        return np.full(shape, 0.4142)


@pytest.mark.parametrize("pixel_filter", FILTERS)
def test_the_expectation_is_the_integral_to_four_digits(pixel_filter: str) -> None:
    """The mean over all shifts of a pixel's sequence, of two samples. On this grid it is within 2e-5 at most."""
    side, uv, pairs, lod = 768, np.array([[0.31, 0.62]]), pairs_of(2, 2), 2.0
    exact = integral(Case(Pixels(uv, lod), common_pairs(pairs)), pixel_filter, 512)[0, :, 0]
    rng: np.random.Generator = Stratified(side)
    found = reference(source(pixel_filter), np.broadcast_to(uv, (side**2, 2)), lod, pairs, 2, rng)
    assert np.abs(found.mean(1, dtype=np.float64) - exact).max() < 1e-4 * exact.mean()


@pytest.mark.long
@pytest.mark.parametrize("name", cases())
@pytest.mark.parametrize("pixel_filter", FILTERS)
def test_estimates_scatter_around_the_integral(pixel_filter: str, name: str) -> None:
    """Biased by no more than chance allows, and calmer with more samples than independent ones would be."""
    case, runs = cases()[name], 48
    exact = integral(case, pixel_filter, 100)
    noise = {}
    for samples in (1, 32):
        found = np.stack(
            [estimate(source(pixel_filter), case.pixels, case.lighting, samples, np.random.default_rng([samples, run]))
             for run in range(runs)]
        ).astype(np.float64)  # fmt: skip
        spread = found.var(0, ddof=1)
        noise[samples] = spread.mean()
        # Squares of errors of means, in units of what they should be: 1 on average. Pixels do not know of each other;
        # renders of a pixel and its colours do.
        error = np.square(found.mean(0) - exact) / (spread / runs + 1e-12 * np.square(exact).mean())
        each = error.mean((0, 1, 3))
        assert abs(each.mean() - 1) < 4 * each.std(ddof=1) / np.sqrt(PIXELS), (samples, each)
    assert noise[32] < noise[1] / 32


@pytest.mark.parametrize("name", cases())
@pytest.mark.parametrize("pixel_filter", SIGNED)
def test_a_constant_material_has_no_noise(pixel_filter: str, name: str) -> None:
    case, what = cases()[name], source(pixel_filter)
    what = replace(what, stored=np.broadcast_to(what.stored[3, 5], what.stored.shape).copy())
    found = estimate(what, case.pixels, case.lighting, 3, np.random.default_rng(0))
    again = estimate(replace(what, pixel_filter="box"), case.pixels, case.lighting, 1, np.random.default_rng(1))
    np.testing.assert_allclose(found, again, rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("pixel_filter", ["gaussian", *SIGNED])
def test_what_is_worked_on_at_a_time_changes_nothing(pixel_filter: str) -> None:
    """More radiance than fits at a time, of groups, of pixels and of samples, against one pixel of one group alone."""
    rng: np.random.Generator = Fixed()
    what, uv = source(pixel_filter), np.random.default_rng(0).random((3, 700, 2))
    for pairs, samples in ((40, 8), (4, 20_000)):
        lit = pairs_of(3 * pairs, 5)
        lighting = GroupPairs(*(each.reshape(3, pairs, 3) for each in (lit.light, lit.view)))
        some = uv[:, : 700 if pairs == 40 else 3]
        found = estimate(what, Pixels(some, 1.0), lighting, samples, rng)
        for group, pixel in ((0, 0), (1, 2), (2, some.shape[1] - 1)):
            one = LightViewPairs(lighting.light[group], lighting.view[group])
            alone = reference(what, some[group, pixel : pixel + 1], 1.0, one, samples, rng)
            np.testing.assert_allclose(found[group, :, pixel], alone[:, 0], rtol=1e-4, atol=1e-6)


def test_groups_that_share_pixels_continue_each_others_sequence() -> None:
    rng: np.random.Generator = Fixed()
    pairs, uv = pairs_of(4, 3), np.random.default_rng(1).random((5, 2))
    three = GroupPairs(*(np.stack([each] * 3) for each in (pairs.light, pairs.view)))
    apart = estimate(source("gaussian"), Pixels(uv, 1.0), three, 8, rng)
    assert not np.allclose(apart[0], apart[1], rtol=1e-3)
    np.testing.assert_allclose(apart.mean(0), reference(source("gaussian"), uv, 1.0, pairs, 24, rng), rtol=1e-5)


def sphere(count: int) -> np.ndarray:
    """(count, 3) directions spread evenly over the upper hemisphere (Fibonacci)."""
    z = (np.arange(count) + 0.5) / count
    angle = np.arange(count) * (np.pi * (3 - 5**0.5))
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).astype(np.float32)


@pytest.mark.parametrize(("height", "alpha"), [(1.0, 0.2), (0.6, 0.3), (0.3, 0.3), (0.6, 0.9)])
@pytest.mark.parametrize("cosine", [0.95, 0.4])
def test_densities_of_lobes_integrate_to_what_is_drawn(height: float, alpha: float, cosine: float) -> None:
    """Lights above the horizon: the share of those drawn is the integral of the density, tilted lobes included."""
    rng = np.random.default_rng(0)
    lobe = np.array([[(1 - height**2) ** 0.5, 0.0, height, alpha]], np.float32)
    view = np.array([-((1 - cosine**2) ** 0.5), 0.0, cosine], np.float32)
    count = 200_000
    u, v = rng.random((count, 1), np.float32), rng.random((count, 1), np.float32)
    drawn = lobes.reflected(np.broadcast_to(view, (count, 1, 3)), lobes.half_vectors(lobe, u, v))
    assert drawn.dtype == np.float32
    share = float((drawn[..., 2] > 0).mean())
    even = sphere(200_000)[:, None]
    integral = float(lobes.lobe_density(lobe, even, np.broadcast_to(view, even.shape)).mean()) * 2 * np.pi
    assert integral == pytest.approx(share, rel=0.02, abs=2e-3)
    # Not only the whole: also the part near the plane of the view.
    part = float(((drawn[..., 2] > 0) & (np.abs(drawn[..., 1]) < 0.2)).mean())
    some = lobes.lobe_density(lobe, even, np.broadcast_to(view, even.shape)) * (np.abs(even[..., 1]) < 0.2)
    assert float(some.mean()) * 2 * np.pi == pytest.approx(part, rel=0.03, abs=2e-3)


def test_densities_of_the_pair_sets_integrate_to_one() -> None:
    even = sphere(100_000)
    for cosine in (0.98, 0.5, 0.1):
        view = np.broadcast_to(np.array([(1 - cosine**2) ** 0.5, 0.0, cosine], np.float32), even.shape)
        assert float(lobes.near_mirror_density(even, view).mean()) * 2 * np.pi == pytest.approx(1, abs=0.01)
    assert float(lobes.hemisphere_density(even).mean()) * 2 * np.pi == pytest.approx(1, abs=1e-3)
    rng = np.random.default_rng(0)
    views = cosine_directions(rng, 20_000)
    lights = near_mirror_lights(rng, views)
    found = lobes.near_mirror_density(lights.astype(np.float32), views.astype(np.float32))
    assert found.dtype == np.float32 and np.isfinite(found).all() and np.median(found) > 1


def glossy(size: int = 16) -> TextureSet:
    """Polished metal with bumps, some of which are steep."""
    rng = np.random.default_rng(4)
    slopes = rng.standard_normal((size, size, 2)) * np.where(rng.random((size, size, 1)) < 0.1, 0.6, 0.1)
    return TextureSet.from_arrays(
        "glossy",
        base_color=0.2 + 0.7 * rng.random((size, size, 3)),
        normal=np.concatenate([slopes, np.ones((size, size, 1))], -1),
        roughness=0.15 + 0.1 * rng.random((size, size)),
        metallic=np.ones((size, size)),
    )


def texels_of(model: str) -> np.ndarray:
    """(H, W, C) texels, stretched ones where the model knows them."""
    stored = convert(glossy().material("gltf"), "gltf", model)
    if model == "gltf-anisotropic":
        stored[..., 8:] = 0.6, 0.8, 0.5
    return stored


def values(pairs: LightViewPairs) -> np.ndarray:
    """(K, 5) of functions that live on few pairs, and of others."""
    light, view = pairs.light.astype(float), pairs.view.astype(float)
    half = light + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    grazing = (view[:, 2] < 0.2) & (light[:, 2] < 0.3)
    return np.stack([np.ones(len(light)), light[:, 2], half[:, 2] > 0.995, grazing, light[:, 0] > view[:, 1]], -1)


@pytest.mark.parametrize("name", PAIR_SETS)
@pytest.mark.parametrize("model", ["gltf", "gltf-anisotropic", "beckmann"])
def test_weighted_means_are_those_of_the_law(name: str, model: str) -> None:
    expected = values(pair_set(name, 1, 100_000)).mean(0)
    texels = texels_of(model)
    sets = [weighted_pair_set(name, seed, texels, model, 128) for seed in range(20)]
    found = np.stack([(each.weights[:, None] * values(each)).mean(0) for each in sets])
    error = found.std(0, ddof=1) / np.sqrt(len(found))
    assert (np.abs(found.mean(0) - expected) < 4 * error + 0.01 * expected).all()


@pytest.mark.parametrize("name", PAIR_SETS)
def test_sets_are_fixed_by_the_seed(name: str) -> None:
    texels = texels_of("gltf")
    pairs, same, other = (weighted_pair_set(name, seed, texels, "gltf", 128) for seed in (5, 5, 6))
    for directions in (pairs.light, pairs.view):
        assert directions.shape == (128, 3) and directions.dtype == np.float32
        assert np.linalg.norm(directions, axis=-1) == pytest.approx(1, abs=1e-5)
        assert directions[:, 2].min() > 0
    assert pairs.weights.min() > 0 and pairs.weights.max() < 2.5
    assert (pairs.light == same.light).all() and (pairs.weights == same.weights).all()
    assert not np.allclose(pairs.light, other.light)


def test_figures_of_a_glossy_set_hang_on_the_seed_far_less_than_by_the_law() -> None:
    """By the law alone the standard deviation is 0.16 dB for both pair sets."""
    texture_set = glossy()
    stack = mipbake.bake(texture_set, method="lean")
    found = [mipbake.validate(texture_set, stack, (2,), seed, 512, 32, baselines=()) for seed in range(6)]
    for name in PAIR_SETS:
        assert np.std([each.snr("baked", name, 2.0) for each in found], ddof=1) < 0.07
