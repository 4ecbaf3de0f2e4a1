"""What stochastic gradients mean: their mean is the central difference, and descending them finds the solution."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from mipbake import raster, sampling, stochastic
from mipbake.stochastic import Channels

Array = NDArray[np.float64]

ERRORS = 5.0
"""Standard errors that a mean may be off by. Among 1000 means the farthest is off by more with a chance of 6e-4, were
signs drawn anew; they are always the same ones."""


@dataclass(frozen=True)
class Linear:
    """Pixels (P, 2) that are linear in the elements (N, 3) that they are made of, and the image that is wanted."""

    touched: NDArray[np.int32]
    weights: Array  # (P, K, 3, 2)
    wanted: Array
    elements: int

    @staticmethod
    def drawn(elements: int = 20, pixels: int = 90, most: int = 3) -> Linear:
        generator = np.random.default_rng(0)
        touched = np.stack([generator.permutation(elements)[:most] for _ in range(pixels)]).astype(np.int32)
        weights = generator.normal(size=(pixels, most, 3, 2))
        solution = generator.uniform(0.2, 0.8, (elements, 3))
        linear = Linear(touched, weights, np.zeros((pixels, 2)), elements)
        return Linear(touched, weights, linear.image(solution), elements)

    def image(self, values: Array) -> Array:
        return np.einsum("pkc,pkci->pi", values[self.touched], self.weights)

    def slopes(self, values: Array) -> Array:
        """(P, N, 3): the exact gradient of each pixel's squared error."""
        out = np.zeros((len(self.touched), self.elements, 3))
        of = 2 * np.einsum("pi,pkci->pkc", self.image(values) - self.wanted, self.weights)
        np.add.at(out, (np.arange(len(out))[:, None], self.touched), of)
        return out


def estimates(
    values: Array,
    channels: Channels,
    renders: Callable[[Array], tuple[Array, NDArray[np.int32]]],
    wanted: Array,
    count: int,
    whole: bool = False,
) -> Array:
    """(count, N, C): estimates with different signs.

    Args:
        renders: image (P, channels) and the elements of each pixel, (P, K).
        whole: equation 4: the whole image's error difference is credited to every element.
    """
    found = np.zeros((count, *values.shape))
    everything = stochastic.contributions(np.arange(len(values), dtype=np.int32)[None])
    for step in range(count):
        (plus, of_plus), (minus, of_minus) = (renders(side) for side in stochastic.perturb(values, channels, step, 1))
        differences = stochastic.pixel_differences(plus, minus, wanted)
        made_of = stochastic.contributions(np.concatenate([of_plus, of_minus], 1))
        if whole:
            differences, made_of = differences.sum(keepdims=True), everything
        stochastic.add_gradient(found[step], differences, made_of, channels, step, 1)
    return found


def central_differences(values: Array, channels: Channels, error: Callable[[Array], float]) -> Array:
    """Equation 3, a parameter after the other; 0 where the magnitude is."""
    found = np.zeros_like(values)
    for index in np.ndindex(values.shape):
        magnitude = channels.magnitude[index[1]]
        if magnitude > 0:
            sides = []
            for sign in (1, -1):
                moved = values.copy()
                moved[index] += sign * magnitude
                sides.append(error(moved))
            found[index] = (sides[0] - sides[1]) / (2 * magnitude)
    return found


def within_errors(found: Array, expected: Array, bias: float = 0.0) -> None:
    """The mean over the first axis is what is expected, within its standard error, as the estimates tell it."""
    error = found.std(0, ddof=1) / math.sqrt(len(found))
    off = np.abs(found.mean(0) - expected)
    assert np.all(off <= ERRORS * error + bias + 1e-9 * np.abs(expected).max()), float((off / (error + 1e-30)).max())


@pytest.mark.parametrize("whole", [False, True])
def test_the_mean_is_the_exact_gradient_of_a_quadratic_error(whole: bool) -> None:
    """The error difference of a pixel is 2 sum_j s_j epsilon_j g_j, without a rest. So the variance of an estimate is
    known: the sum, over the other parameters j, of (epsilon_j / epsilon_i times the gradient by j of the pixels that
    are credited)^2."""
    linear, channels = Linear.drawn(), Channels((0.1, 0.2, 0.05), (-9.0,) * 3, (9.0,) * 3)
    values, count = np.random.default_rng(1).uniform(0, 1, (linear.elements, 3)), 800
    found = estimates(values, channels, lambda v: (linear.image(v), linear.touched), linear.wanted, count, whole)
    slopes = linear.slopes(values)
    exact = slopes.sum(0)
    credited = np.zeros((len(slopes), linear.elements))
    np.put_along_axis(credited, linear.touched.astype(np.int64), 1, 1)
    if whole:
        credited[...] = 1
    shared = np.einsum("pe,pfc->efc", credited, slopes) * channels.magnitude  # (element, other element, its channel)
    squares = np.einsum("efc->e", shared**2)[:, None] - (exact * channels.magnitude) ** 2
    variance = squares / np.square(channels.magnitude)
    off = (found.mean(0) - exact) / np.sqrt(variance / count)
    assert np.abs(off).max() < ERRORS
    # The variance is as derived. Estimates are sums of products of signs, whose fourth moments are at most 15 times the
    # square of the second; so is the variance of the estimate of a variance, over the count.
    assert np.abs(found.var(0) / variance - 1).max() < ERRORS * math.sqrt(15 / count)


def test_crediting_pixels_alone_has_less_variance_than_the_whole_image() -> None:
    """The claim of section 4.2: with 60 parameters, of which a pixel has 9."""
    linear, channels = Linear.drawn(), Channels((0.1,) * 3, (-9.0,) * 3, (9.0,) * 3)
    values = np.random.default_rng(1).uniform(0, 1, (linear.elements, 3))
    own, whole = (
        estimates(values, channels, lambda v: (linear.image(v), linear.touched), linear.wanted, 400, each).var(0).sum()
        for each in (False, True)
    )
    assert own < 0.5 * whole


# A small renderer: a textured grid of triangles that fills the image

SIZE, GRID = 24, 4
CORNERS = np.arange((GRID + 1) ** 2).reshape(GRID + 1, GRID + 1)
TRIANGLES = np.concatenate(
    [
        np.stack([CORNERS[:-1, :-1], CORNERS[:-1, 1:], CORNERS[1:, 1:]], -1).reshape(-1, 3),
        np.stack([CORNERS[:-1, :-1], CORNERS[1:, 1:], CORNERS[1:, :-1]], -1).reshape(-1, 3),
    ]
).astype(np.int32)
PLACES = np.stack(np.meshgrid(*2 * [np.linspace(-1.02, 1.02, GRID + 1)], indexing="xy"), -1).reshape(-1, 2)
INNER = CORNERS[1:-1, 1:-1].reshape(-1).astype(np.int32)
COLOURS = np.random.default_rng(3).uniform(0, 1, (len(PLACES), 2))


def rastered(places: Array) -> tuple[Any, Any]:
    pos = np.concatenate([places, np.zeros_like(places[:, :1]), np.ones_like(places[:, :1])], 1)[None]
    return raster.rasterize(None, pos, TRIANGLES, (SIZE, SIZE))


def textured(texels: Array) -> tuple[Array, NDArray[np.int32]]:
    """(P, 3) a trilinear lookup of two levels, 6 x 6 and 3 x 3; (P, 8) which texels it is made of."""
    rast, rast_db = rastered(PLACES)
    uv, uv_da = raster.interpolate(PLACES * 0.7 + 0.6, rast, TRIANGLES, rast_db, "all")
    levels = [texels[:36].reshape(1, 6, 6, 3), texels[36:].reshape(1, 3, 3, 3)]
    uv_da = uv_da * 4  # between the levels
    image = sampling.texture(levels[0], uv, uv_da, mip=levels[1:], filter_mode="linear-mipmap-linear")
    uv, uv_da = uv.reshape(-1, 2).astype(np.float32), uv_da.reshape(-1, 4).astype(np.float32)
    return image.reshape(-1, 3), stochastic.touched_texels([(6, 6), (3, 3)], uv, None, uv_da)


def meshed(places: Array) -> tuple[Array, NDArray[np.int32]]:
    """(P, 2) interpolated colours; (P, 3) which vertices they are made of."""
    rast, _ = rastered(places)
    image, _ = raster.interpolate(COLOURS, rast, TRIANGLES)
    return image.reshape(-1, 2), stochastic.touched_vertices(rast[..., 3].reshape(-1, 1), TRIANGLES)


def test_the_mean_over_texels_is_central_differences_and_the_exact_gradient() -> None:
    generator = np.random.default_rng(4)
    texels, wanted = generator.uniform(0.2, 0.8, (45, 3)), generator.uniform(0, 1, (SIZE * SIZE, 3))
    channels = Channels((1 / 255, 1 / 255, 0.0), (0.0,) * 3, (1.0,) * 3)
    found = estimates(texels, channels, textured, wanted, 150)
    central = central_differences(texels, channels, lambda t: float(np.square(textured(t)[0] - wanted).sum()))
    within_errors(found, central)
    rast, rast_db = rastered(PLACES)
    uv, uv_da = raster.interpolate(PLACES * 0.7 + 0.6, rast, TRIANGLES, rast_db, "all")
    leaf = torch.tensor(texels, requires_grad=True)
    image = sampling.texture(
        leaf[:36].reshape(1, 6, 6, 3),
        torch.from_numpy(uv),
        torch.from_numpy(uv_da * 4),
        mip=[leaf[36:].reshape(1, 3, 3, 3)],
        filter_mode="linear-mipmap-linear",
    )
    (image.reshape(-1, 3) - torch.from_numpy(wanted)).square().sum().backward()
    np.testing.assert_allclose(central[:, :2], leaf.grad[:, :2], atol=1e-9)


def test_the_mean_over_vertices_is_central_differences() -> None:
    """Inner vertices move by 1/400 of a pixel, in an image that has no silhouettes and no jumps."""
    generator = np.random.default_rng(5)
    wanted = generator.uniform(0, 1, (SIZE * SIZE, 2))
    channels = Channels((2 / SIZE / 400,) * 2, (-2.0,) * 2, (2.0,) * 2)
    inner = PLACES[INNER] + generator.uniform(-0.1, 0.1, (len(INNER), 2))
    lookup = np.full(len(PLACES), -1, np.int32)
    lookup[INNER] = np.arange(len(INNER))

    def moved(places: Array) -> tuple[Array, NDArray[np.int32]]:
        every = PLACES.copy()
        every[INNER] = places
        image, touched = meshed(every)
        return image, lookup[touched]

    found = estimates(inner, channels, moved, wanted, 250)
    central = central_differences(inner, channels, lambda p: float(np.square(moved(p)[0] - wanted).sum()))
    assert np.abs(central).min() > 0
    # The other vertices' signs move pixels between triangles, and the central difference holds to second order.
    within_errors(found, central, bias=1e-3 * float(np.abs(central).max()))
