"""The visible error of pictures: its bands, what hides errors, and its derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import dctn

from mipbake.metrics.visible import (
    COSINES,
    OPPONENT,
    SENSITIVITY,
    SIDE,
    WEIGHT,
    VisibleError,
    bands,
    bands_adjoint,
    masked,
    mean_squares,
    tiles,
    visible_error,
)

KINDS, EACH = 2, 3


UNSEEN = float(VisibleError(*np.zeros((2, 2, 3, SIDE, SIDE), np.float32), np.zeros(1)).means[0])
"""What is added to every error, which is what pictures without any have."""


def pictures(seed: int, count: int = KINDS * EACH) -> np.ndarray:
    """(N, SIDE, SIDE, 3) of noise around grey."""
    return np.random.default_rng(seed).uniform(0.2, 0.8, (count, SIDE, SIDE, 3)).astype(np.float32)


def error_of(off: np.ndarray, noise: float = 0.0) -> VisibleError:
    """Of (N, SIDE, SIDE, 3) differences of what is displayed."""
    return VisibleError(bands(off.astype(np.float32)), masked(bands(pictures(0))), np.full(KINDS, noise))


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
    share = 1e-2 * rng.normal(size=error.off.shape)
    ahead, back = (
        float(by @ replace(error, off=(error.off * np.sqrt(1 + turn * share)).astype(np.float32)).logarithms)
        for turn in (1, -1)
    )
    found = float((error.weights(by) * np.square(error.off) * share).sum(dtype=float))
    assert found == pytest.approx((ahead - back) / 2, rel=5e-3)


def test_each_kind_of_pictures_has_an_error_of_its_own() -> None:
    off = 0.1 * np.random.default_rng(5).normal(size=(KINDS * EACH, SIDE, SIDE, 3))
    off[EACH:] *= 3
    both = error_of(off)
    for kind in range(KINDS):
        some = slice(kind * EACH, (kind + 1) * EACH)
        alone = mean_squares(both.off[some], both.counts[some], 1)
        assert both.means[kind] == pytest.approx(float(alone[0]) + UNSEEN, rel=1e-5)
        np.testing.assert_array_equal(both.weights(np.eye(KINDS)[kind])[some] > 0, True)
        assert not both.weights(np.eye(KINDS)[1 - kind])[some].any()


def test_noise_of_what_is_right_is_no_error() -> None:
    off = 0.1 * np.random.default_rng(6).normal(size=(KINDS * EACH, SIDE, SIDE, 3))
    all_of_it = error_of(off).means - UNSEEN
    for share in (0.5, 0.9):
        noise = share * float(all_of_it.max())
        expected = np.maximum(all_of_it - noise, 0.1 * noise) + UNSEEN
        np.testing.assert_allclose(error_of(off, noise).means, expected, rtol=1e-5)
    # What is below the noise is chance: it counts as a part of the noise, and is never negative.
    assert (error_of(0.1 * off, float(all_of_it.max())).means > 0).all()


def test_detail_hides_errors_of_its_own_size_alone() -> None:
    rows, columns = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")

    def wave(frequency: int, size: float) -> np.ndarray:
        """Upright stripes in grey."""
        each = size * np.cos(np.pi * frequency * (columns + 0.5) / SIDE + 0 * rows)
        return np.repeat(each[None, ..., None], 3, -1)

    plain, detailed = np.full((1, SIDE, SIDE, 3), 0.5), 0.5 + wave(3, 0.3)
    for right, of_three, of_eight in ((plain, 1.0, 1.0), (detailed, 0.2, 1.0)):
        for frequency, hidden in ((3, of_three), (8, of_eight)):
            seen = visible_error(right + wave(frequency, 0.05), right)
            bare = visible_error(plain + wave(frequency, 0.05), plain)
            assert seen <= hidden * bare * 1.001
            assert hidden < 1 or seen == pytest.approx(bare, rel=1e-3)


def test_the_mean_counts_little_and_hides_nothing() -> None:
    plain = np.full((1, SIDE, SIDE, 3), 0.5)
    half = plain + 0.05 * np.where(np.arange(SIDE) < SIDE // 2, 1, -1)[:, None]
    brighter = visible_error(plain + 0.05, plain)
    assert 0 < brighter < 0.1 * visible_error(half, plain)
    assert visible_error(0.1 + 0 * plain + 0.05, 0.1 + 0 * plain) == pytest.approx(brighter, rel=1e-3)


def test_what_is_equal_has_no_error_and_double_errors_count_four_times() -> None:
    right = pictures(7)
    off = 0.01 * (pictures(8) - 0.5)
    assert visible_error(right, right) == 0
    assert visible_error(right + 2 * off, right) == pytest.approx(4 * visible_error(right + off, right), rel=1e-3)


def test_tiles_are_pieces_side_by_side_from_the_top_left() -> None:
    film = np.random.default_rng(9).random((2, 2 * SIDE + 5, 3 * SIDE + 1, 3))
    found = tiles(film)
    assert found.shape == (2 * 2 * 3, SIDE, SIDE, 3) and found.dtype == np.float32
    for index, (frame, row, column) in enumerate(np.ndindex(2, 2, 3)):
        piece = film[frame, row * SIDE : (row + 1) * SIDE, column * SIDE : (column + 1) * SIDE]
        np.testing.assert_array_equal(found[index], piece.astype(np.float32))
