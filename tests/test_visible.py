"""The visible error of pictures: its bands, what eyes are adapted to, and its derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import dctn

from mipbake.quality.metrics.images import srgb_encode
from mipbake.quality.metrics.visible import (
    COSINES,
    OPPONENT,
    SENSITIVITY,
    SIDE,
    WEIGHT,
    VisibleError,
    adaptation,
    bands,
    bands_adjoint,
    mean_squares,
    tiles,
    visible_error,
)

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


def test_fine_bands_and_colours_weigh_less() -> None:
    lightness = SENSITIVITY[0].copy()
    assert lightness[0, 0] < lightness[0, 1]  # eyes adapt to the mean
    lightness[0, 0] = 1
    assert (np.diff(lightness, axis=0) < 0).all() and (np.diff(lightness, axis=1) < 0).all()
    assert (SENSITIVITY[1:] < SENSITIVITY[0]).all()
    assert pytest.approx(float(np.square(SENSITIVITY).sum()), rel=1e-6) == WEIGHT


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


def test_one_bright_picture_does_not_decide_alone() -> None:
    """Roots of pictures are added: four times the square of one of two is 1.5 times the error of both."""
    off = np.zeros((2, SIDE, SIDE, 3))
    off[:, : SIDE // 2] = 1.0
    both = VisibleError(bands(off.astype(np.float32)), np.zeros(2), 1)
    off[1] *= 2
    more = VisibleError(bands(off.astype(np.float32)), np.zeros(2), 1)
    assert more.means[0] == pytest.approx(1.5 * both.means[0], rel=0.01)


def test_the_mean_counts_less_than_detail() -> None:
    plain = np.full((1, SIDE, SIDE, 3), 0.5)
    half = plain + 0.05 * np.where(np.arange(SIDE) < SIDE // 2, 1, -1)[:, None, None]
    brighter = visible_error(plain + 0.05, plain)
    assert 0 < brighter < 0.6 * visible_error(half, plain)


def test_what_is_equal_has_no_error() -> None:
    right = pictures(7)
    assert visible_error(right, right) == 0
    assert visible_error(right + 0.01 * (pictures(8) - 0.5), right) > 0


def test_tiles_are_pieces_side_by_side_from_the_top_left() -> None:
    film = np.random.default_rng(9).random((2, 2 * SIDE + 5, 3 * SIDE + 1, 3))
    found = tiles(film)
    assert found.shape == (2 * 2 * 3, SIDE, SIDE, 3) and found.dtype == np.float32
    for index, (frame, row, column) in enumerate(np.ndindex(2, 2, 3)):
        piece = film[frame, row * SIDE : (row + 1) * SIDE, column * SIDE : (column + 1) * SIDE]
        np.testing.assert_array_equal(found[index], piece.astype(np.float32))
