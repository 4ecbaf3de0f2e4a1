"""The filtered reference: what estimates are on average, and how much they scatter (docs/conventions.md, section 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mipbake import sampling, shading
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import FILTERS
from mipbake.quality.metrics.pairs import LightViewPairs, cosine_directions, near_mirror_lights
from mipbake.quality.reference.estimate import estimate, reference
from mipbake.quality.reference.lighting import GroupPairs, Illumination, PixelPairs, common_pairs
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
        assert isinstance(lit, PixelPairs)
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
    rng: np.random.Generator = Stratified(side)  # type: ignore[assignment]
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
    rng: np.random.Generator = Fixed()  # type: ignore[assignment]
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
    rng: np.random.Generator = Fixed()  # type: ignore[assignment]
    pairs, uv = pairs_of(4, 3), np.random.default_rng(1).random((5, 2))
    three = GroupPairs(*(np.stack([each] * 3) for each in (pairs.light, pairs.view)))
    apart = estimate(source("gaussian"), Pixels(uv, 1.0), three, 8, rng)
    assert not np.allclose(apart[0], apart[1], rtol=1e-3)
    np.testing.assert_allclose(apart.mean(0), reference(source("gaussian"), uv, 1.0, pairs, 24, rng), rtol=1e-5)


def test_results_go_where_they_are_wanted_and_are_functions_of_the_generator() -> None:
    case, out = cases()["pairs of pixels"], np.empty((1, PAIRS, PIXELS, 3), np.float32)
    first, again, other = (
        estimate(source("tent"), case.pixels, case.lighting, 4, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert estimate(source("tent"), case.pixels, case.lighting, 4, np.random.default_rng(1), out) is out
    assert np.array_equal(first, again) and np.array_equal(first, out) and not np.array_equal(first, other)


def test_generators_of_groups_draw_what_they_draw_alone() -> None:
    what, uv = source("mitchell"), np.random.default_rng(0).random((3, 50, 2))
    pairs = pairs_of(12, 3)
    groups = GroupPairs(*(each.reshape(3, 4, 3) for each in (pairs.light, pairs.view)))
    together = estimate(what, Pixels(uv, 1.5), groups, 8, [np.random.default_rng(group) for group in range(3)])
    for group, found in enumerate(together):
        one = LightViewPairs(groups.light[group], groups.view[group])
        alone = reference(what, uv[group], 1.5, one, 8, np.random.default_rng(group))
        np.testing.assert_allclose(found, alone, rtol=1e-5, atol=1e-7)
