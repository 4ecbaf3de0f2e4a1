"""Small pictures: their visible error, where they lie, how samplers look them up, and what is right in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import dctn

from mipbake import sampling
from mipbake.material.aim import ANISOTROPIC, TRILINEAR, Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import FILTERS
from mipbake.quality.environment import studio
from mipbake.quality.judging.shown import KINDS_SHOWN, draw_shown
from mipbake.quality.metrics.images import srgb_encode
from mipbake.quality.metrics.visible import (
    COSINES,
    OPPONENT,
    SENSITIVITY,
    SIDE,
    VisibleError,
    adaptation,
    bands,
    bands_adjoint,
    mean_squares,
    visible_error,
)
from mipbake.quality.reference.problem import Problem, whole
from mipbake.quality.samplers import look_up
from mipbake.quality.small_pictures import (
    PIXELS,
    SLANTS,
    SmallPictures,
    draw_slants,
    draw_small_pictures,
    exposures,
    reach,
)
from mipbake.shading import shade

from .stacks import gltf_level

KINDS, EACH = 2, 3

UNSEEN = float(VisibleError(np.zeros((1, 3, SIDE, SIDE), np.float32), np.zeros(1), 1).means[0])
"""The error of pictures that are right."""


def pictures(seed: int, count: int = KINDS * EACH) -> np.ndarray:
    """(N, SIDE, SIDE, 3) of noise around grey."""
    return np.random.default_rng(seed).uniform(0.2, 0.8, (count, SIDE, SIDE, 3)).astype(np.float32)


def error_of(off: np.ndarray, noise: float = 0.0) -> VisibleError:
    """Of (N, SIDE, SIDE, 3) differences of contrasts."""
    return VisibleError(bands(off.astype(np.float32)), np.full(len(off), noise), KINDS)


def test_bands_are_the_cosine_transform_of_opponent_colours() -> None:
    shown = pictures(1)
    opponent = np.einsum("ck,nyxk->ncyx", OPPONENT.astype(float), shown.astype(float))
    np.testing.assert_allclose(bands(shown), SENSITIVITY * dctn(opponent, axes=(2, 3), norm="ortho"), atol=1e-5)
    np.testing.assert_allclose(COSINES @ COSINES.T, np.eye(SIDE), atol=1e-6)


def test_the_adjoint_of_bands_is_their_transpose() -> None:
    rng = np.random.default_rng(2)
    shown, gradient = (rng.normal(size=each).astype(np.float32) for each in ((4, SIDE, SIDE, 3), (4, 3, SIDE, SIDE)))
    forth, back = (bands(shown) * gradient).sum(dtype=float), (shown * bands_adjoint(gradient)).sum(dtype=float)
    assert forth == pytest.approx(back, rel=1e-4)


def test_slopes_are_derivatives_of_logarithms() -> None:
    rng = np.random.default_rng(3)
    off, along = (0.1 * rng.normal(size=(KINDS * EACH, SIDE, SIDE, 3)) for _ in range(2))
    by, step = np.array([1.3, -0.4]), 1e-2
    ahead, back = (float(by @ error_of(off + turn * step * along).logarithms) for turn in (1, -1))
    found = float((error_of(off).slopes(by) * along).sum(dtype=float))
    assert found == pytest.approx((ahead - back) / (2 * step), rel=5e-3)


def test_weights_are_derivatives_by_the_squares_of_bands() -> None:
    rng = np.random.default_rng(4)
    error, by = error_of(0.1 * rng.normal(size=(KINDS * EACH, SIDE, SIDE, 3))), np.array([0.7, 1.9])
    share = 1e-2 * rng.normal(size=(len(error.off), 1, 1, 1))
    ahead, back = (
        float(by @ replace(error, off=(error.off * np.sqrt(1 + turn * share)).astype(np.float32)).logarithms)
        for turn in (1, -1)
    )
    found = float((error.weights(by)[:, None, None, None] * np.square(error.off) * share).sum(dtype=float))
    assert found == pytest.approx((ahead - back) / 2, rel=5e-3)


def test_each_kind_of_pictures_has_an_error_of_its_own() -> None:
    off = 0.1 * np.random.default_rng(5).normal(size=(KINDS * EACH, SIDE, SIDE, 3))
    off[EACH:] *= 3
    both = error_of(off)
    for kind in range(KINDS):
        some = slice(kind * EACH, (kind + 1) * EACH)
        each = np.sqrt(mean_squares(both.off[some]) + UNSEEN**2)
        assert both.means[kind] == pytest.approx(each.mean(), rel=1e-5)
        assert both.logarithms[kind] == pytest.approx(2 * np.log(each.mean()), rel=1e-5)
        assert (both.weights(np.eye(KINDS)[kind])[some] > 0).all()
        assert not both.weights(np.eye(KINDS)[1 - kind])[some].any()


def test_pseudo_values_scatter_as_errors_do_and_have_their_mean() -> None:
    off = 0.1 * np.random.default_rng(5).normal(size=(KINDS * EACH, SIDE, SIDE, 3))
    off[EACH:] *= np.array([1, 2, 4])[:, None, None, None]
    found = error_of(off).pseudo_values
    np.testing.assert_allclose(found.mean(1), error_of(off).logarithms)
    assert 10 * found[0].std() < found[1].std() and (np.diff(found[1]) > 0).all()


def test_noise_of_what_is_right_is_no_error() -> None:
    off = 0.1 * np.random.default_rng(6).normal(size=(KINDS * EACH, SIDE, SIDE, 3))
    squares = mean_squares(error_of(off).off)
    for share in (0.5, 0.9):
        noise = share * float(squares.max())
        left = np.maximum(squares - noise, 0.1 * noise) + UNSEEN**2
        np.testing.assert_allclose(error_of(off, noise).roots.reshape(-1), np.sqrt(left), rtol=1e-5)


def test_errors_count_against_the_light_that_eyes_are_adapted_to() -> None:
    """In light, not in its encoding; and a black picture has some light still."""
    bright, dark = (np.full((1, SIDE, SIDE, 3), light, np.float32) for light in (0.6, 0.0))
    assert adaptation(bright).reshape(-1) == pytest.approx(0.6, rel=0.05)
    assert 0 < float(adaptation(dark).reshape(-1)[0]) < 0.05
    stripes = np.where(np.arange(SIDE) < SIDE // 2, 1, -1)[:, None, None]

    def seen(light: float, off: float) -> float:
        """The error of stripes, to which what nobody sees adds little."""
        return visible_error(srgb_encode(light + off * stripes + 0 * bright), srgb_encode(light + 0 * bright))

    assert seen(0.4, 0.2) == pytest.approx(seen(0.2, 0.1), rel=0.1)
    assert seen(0.4, 0.2) == pytest.approx(2 * seen(0.4, 0.1), rel=0.05)


WRAP = ("wrap", "wrap")

HEIGHT, WIDTH = 24, 32

SAMPLERS = [TRILINEAR, ANISOTROPIC, Sampler(4, -0.3), Sampler(bias=-1.0, frames=8), Sampler(16, 0.5, 8)]


def drawn(sampler: Sampler, slant: list[float], lod: float = 1.0, lights: int = 4, seed: int = 0) -> SmallPictures:
    count = len(slant)
    rng = np.random.default_rng(seed)
    args = np.full(count, lod), np.array(slant), (WIDTH, HEIGHT), sampler, [studio(lights)], rng.random((count, 2))
    return draw_small_pictures(rng, *args)


def test_slants_are_spread_over_each_kind() -> None:
    each = 50
    found = draw_slants(np.random.default_rng(0), each * len(SLANTS)).reshape(len(SLANTS), each)
    for row, (low, high) in zip(found, SLANTS, strict=True):
        assert (row >= low).all() and (row <= high).all()
        places = np.sort((row - low) / (high - low) * each).astype(int)
        np.testing.assert_array_equal(places, np.arange(each))  # one in every part
        assert (np.diff(row) < 0).any()  # in no order


@pytest.mark.parametrize(("slant", "lookups"), [(1.0, 1), (0.51, 2), (0.5, 2), (0.49, 3), (0.26, 4), (0.1, 10)])
def test_anisotropic_lookups_lie_evenly_along_the_longer_side(slant: float, lookups: int) -> None:
    """n = ceil(a / b) at log2(a / n), as conventions.md has it, and trilinear ones at log2(a)."""
    lod = 1.3
    made, plain = (drawn(sampler, [slant], lod) for sampler in (ANISOTROPIC, TRILINEAR))
    assert made.lookups.tolist() == [lookups] and plain.lookups.tolist() == [1]
    size = np.array([WIDTH, HEIGHT])
    for each in (made, plain):
        a, b = np.linalg.norm(each.axes[0], axis=-1) * 2 ** each.longer[0]
        assert b / a == pytest.approx(slant, rel=1e-5)
        assert np.log2(a / each.lookups[0]) == pytest.approx(lod, abs=1e-6) and each.lod[0] == lod
        where = each.looked_up_at(slice(0, 1), int(each.lookups[0]))[0] * size  # (PIXELS, n, 2) texels
        np.testing.assert_allclose(where.mean(1), each.uv[0] * size, atol=1e-5)
        along = np.diff(where, axis=1)
        np.testing.assert_allclose(np.linalg.norm(along, axis=-1), a / each.lookups[0], rtol=1e-4)
        np.testing.assert_allclose(along @ each.axes[0, 1], 0, atol=1e-4)  # nothing across


@pytest.mark.parametrize("slant", [1.0, 0.45, 0.13])
def test_pixels_lie_side_by_side_as_the_screen_has_them(slant: float) -> None:
    made = drawn(TRILINEAR, [slant], 0.7)
    texels = made.uv[0].reshape(SIDE, SIDE, 2) * [WIDTH, HEIGHT]
    rows, columns = texels[1:] - texels[:-1], texels[:, 1:] - texels[:, :-1]
    along, across = made.axes[0] * 2**0.7
    np.testing.assert_allclose(rows, np.broadcast_to(along, rows.shape), atol=1e-5)
    np.testing.assert_allclose(columns, np.broadcast_to(across, columns.shape), atol=1e-5)
    # Rows go along the view: up in tangent space is down in v.
    view = made.view[0, 0, :2] * [1, -1]
    if slant < 1:
        np.testing.assert_allclose(along / np.linalg.norm(along), view / np.linalg.norm(view), atol=1e-4)


@pytest.mark.parametrize("slant", [0.9, 0.3])
def test_lookups_are_those_of_the_sampler(slant: float) -> None:
    """The mean of a pixel's lookups is what `samplers.look_up` finds for its footprint."""
    made = drawn(ANISOTROPIC, [slant], 0.0)
    level = gltf_level((HEIGHT, WIDTH), 0)
    axes = made.axes[0].astype(float) * 2 ** made.longer[0] / [WIDTH, HEIGHT]
    footprint = np.broadcast_to([axes[0, 0], axes[1, 0], axes[0, 1], axes[1, 1]], (PIXELS, 4))
    expected = look_up([level, level[::2, ::2]], made.uv[0], footprint, WRAP, ANISOTROPIC)
    where = made.looked_up_at(slice(0, 1), int(made.lookups[0]))[0].astype(np.float32)
    found = sampling.texture(level[None], where[None], filter_mode="linear", boundary_mode=WRAP)[0].mean(1)
    assert np.abs(found - expected).mean() < 0.02


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_no_lookup_is_beyond_the_reach(sampler: Sampler) -> None:
    slant = np.linspace(0.1, 1, 19).tolist()
    made = drawn(sampler, slant, 2.0)
    farthest = 0.0
    for index, count in enumerate(made.lookups.tolist()):
        off = made.looked_up_at(slice(index, index + 1), count)[0] - made.uv[index].mean(0)
        farthest = max(farthest, float(np.linalg.norm(off * [WIDTH, HEIGHT] / 4, axis=-1).max()))
    assert 0.8 * reach(sampler) < farthest <= reach(sampler)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_what_is_right_is_the_filtered_sum_over_all_lights(sampler: Sampler) -> None:
    """Against the midpoint rule in a loop over lights and places of pixels."""
    level = gltf_level((HEIGHT, WIDTH), 0)
    level[..., 4] = 0.5 + 0.5 * level[..., 4]
    made = drawn(sampler, [0.8, 0.3], 0.5)
    source = FilteredSource(level, "gltf", WRAP, "gaussian")
    found = made.reference(source, 1024, np.random.default_rng(0))
    assert found.shape == (2, PIXELS, 3)
    kernel = FILTERS["gaussian"]
    grid = ((np.arange(24) + 0.5) / 24 * 2 - 1) * kernel.radius
    x, y = np.meshgrid(grid, grid)
    weight = (kernel.shape(x) * kernel.shape(y)).ravel()
    weight /= weight.sum()
    for picture, pixel in ((0, 0), (0, 133), (1, 77), (1, 255)):
        places = np.stack([x.ravel(), y.ravel()], -1) @ made.axes[picture] * 2 ** made.longer[picture]
        where = (made.uv[picture, pixel] + places / [WIDTH, HEIGHT]).astype(np.float32)
        texels = sampling.texture(level[None], where[None, None], filter_mode="linear", boundary_mode=WRAP)[0, 0]
        expected = np.zeros(3)
        for light, view, power in zip(made.light[picture], made.view[picture], made.power[picture], strict=True):
            expected += weight @ shade("gltf", texels, light[None], view[None])[0] * power
        np.testing.assert_allclose(found[picture, pixel], expected, rtol=0.02, atol=2e-3)


def test_the_adjoint_is_the_derivative_by_texels() -> None:
    rng = np.random.default_rng(3)
    made = drawn(TRILINEAR, [0.9, 0.4])
    texels = gltf_level((2, PIXELS), 1)
    texels[..., 4] = 0.4 + 0.4 * texels[..., 4]
    gradient = rng.normal(size=(2, PIXELS, 3)).astype(np.float32)
    along = (0.1 * rng.normal(size=texels.shape)).astype(np.float32)
    step = 5e-3
    ahead, back = (
        float((made.radiance("gltf", texels + turn * step * along) * gradient).sum(dtype=float)) for turn in (1, -1)
    )
    found = float((made.adjoint("gltf", texels, gradient) * along).sum(dtype=float))
    assert found == pytest.approx((ahead - back) / (2 * step), rel=1e-2)


def test_parts_are_the_same_pictures() -> None:
    made = drawn(ANISOTROPIC, [0.9, 0.4, 0.2])
    texels = gltf_level((3, PIXELS), 2)
    some = np.array([2, 0])
    np.testing.assert_array_equal(made.part(some).radiance("gltf", texels[some]), made.radiance("gltf", texels)[some])


def test_exposures_lie_between_the_median_of_a_picture_and_of_all() -> None:
    radiance = np.repeat(np.array([0.1, 0.4, 1.6], np.float32), PIXELS * 3).reshape(3, PIXELS, 3)
    np.testing.assert_allclose(
        exposures(radiance)[:, 0, 0], 0.6 / np.sqrt([0.1 * 0.4, 0.4 * 0.4, 1.6 * 0.4]), rtol=1e-5
    )
    radiance[0] = 0  # what is black is exposed for a sixteenth of the median
    assert exposures(radiance)[0, 0, 0] == pytest.approx(4 * exposures(radiance)[1, 0, 0])
    assert np.isfinite(exposures(np.zeros((2, PIXELS, 3), np.float32))).all()


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_a_stack_that_is_right_is_only_off_by_noise(sampler: Sampler) -> None:
    """On a material whose reference is its level 0 everywhere, and with a wrong colour it is not."""
    level = np.broadcast_to(np.array([0.5, 0.3, 0.2, 0, 0.5, 0, 0, 1], np.float32), (16, 16, 8)).copy()
    task = Problem(level, "gltf", "gltf", "gaussian", WRAP, sampler)
    shown = draw_shown(task, whole(task), 1.0, 12, 4, np.random.default_rng(0))
    count = len(shown.pictures.lod)
    assert count % KINDS_SHOWN == 0 and 1 <= shown.pictures.lookups.max() <= sampler.lookups
    texels = np.broadcast_to(level[0, 0], (count, shown.pictures.points, 8))
    right = shown.error(shown.pictures.radiance("gltf", texels))
    other = texels.copy()
    other[..., 2] = 0.6
    wrong = shown.error(shown.pictures.radiance("gltf", other))
    assert (right.logarithms < wrong.logarithms - 1).all()
    assert right.roots == pytest.approx(UNSEEN, rel=1e-4)


def test_the_slope_of_contrasts_is_their_derivative() -> None:
    task = Problem(gltf_level((16, 16), 0), "gltf", "gltf", "gaussian", WRAP)
    shown = draw_shown(task, whole(task), 1.0, 8, 4, np.random.default_rng(0))
    radiance = np.random.default_rng(1).uniform(0.05, 2, (len(shown.exposure), PIXELS, 3)).astype(np.float32)
    step = np.float32(1e-3) * radiance
    ahead, back = (shown.error(radiance + turn * step).off for turn in (1, -1))
    expected = bands((shown.slope(radiance) * 2 * step).reshape(-1, SIDE, SIDE, 3))
    np.testing.assert_allclose(ahead - back, expected, atol=2e-3 * float(np.abs(expected).max()))
