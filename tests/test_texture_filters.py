"""Levels and footprints: the mip chain, the level of detail, anisotropic filtering."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from mipbake.sampling import reference, texture, texture_construct_mip

MODES = ("linear-mipmap-nearest", "linear-mipmap-linear")


def areas(coarse: int, fine: int) -> Any:
    """(coarse, fine) weights of area averaging: how much of each coarse texel every fine one covers."""
    ends = np.arange(coarse + 1) * fine / coarse
    low, high = ends[:-1, None], ends[1:, None]
    texel = np.arange(fine)
    return np.clip(np.minimum(high, texel + 1) - np.maximum(low, texel), 0, None) * coarse / fine


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (8, 8), (7, 5), (255, 3), (12, 31), (64, 1)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_levels_average_areas(size: tuple[int, int], dtype: Any) -> None:
    tex = np.random.default_rng(1).random((2, *size, 3)).astype(dtype)
    finer, (height, width) = tex, size
    levels = texture_construct_mip(tex).levels
    for level in levels:
        shape = max(1, height // 2), max(1, width // 2)
        expected = np.einsum("yi,xj,bijc->byxc", areas(shape[0], height), areas(shape[1], width), finer)
        np.testing.assert_allclose(level, expected, rtol=1e-6 if dtype == np.float32 else 1e-12)
        assert level.dtype == dtype
        finer, (height, width) = level, shape
    assert (height, width) == (1, 1)
    assert len(texture_construct_mip(tex, 2).levels) == min(2, len(levels))
    if levels:
        np.testing.assert_allclose(levels[-1][:, 0, 0], tex.mean((1, 2)), rtol=0, atol=1e-5)


def test_the_stack_does_not_follow_the_texture() -> None:
    tex = np.zeros((1, 4, 4, 1))
    mip = texture_construct_mip(tex)
    uv, bias = np.full((1, 1, 1, 2), 0.3), np.full((1, 1, 1), 2.0)
    tex[:] = 1
    assert texture(tex, uv, mip_level_bias=bias, mip=mip).item() == 0
    assert texture(tex, uv, mip_level_bias=bias).item() == 1
    with pytest.raises(AttributeError):
        mip.levels = ()


def level_of(uv_da: Any, size: tuple[int, int] = (32, 64), bias: float | None = None, mode: str = MODES[1]) -> float:
    """The level of detail that a footprint takes: level L of the stack holds the number L."""
    levels = [np.full((1, max(1, size[0] >> n), max(1, size[1] >> n), 1), float(n)) for n in range(7)]
    given = None if bias is None else np.full((1, 1, 1), bias)
    uv_da = np.reshape(np.asarray(uv_da, float), (1, 1, 1, 4))
    out: Any = texture(levels[0], np.full((1, 1, 1, 2), 0.4), uv_da, given, levels[1:], mode)
    return float(out.item())


def test_the_level_is_the_logarithm_of_the_major_axis() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        jacobian = rng.normal(0, 1, (2, 2)) * np.exp2(rng.uniform(-1, 4))
        major = np.linalg.svd(jacobian, compute_uv=False)[0]
        uv_da = jacobian / [[64], [32]]
        bias = rng.uniform(-2, 2)
        assert level_of(uv_da, bias=bias) == pytest.approx(np.clip(np.log2(major) + bias, 0, 6), abs=1e-12)
    assert level_of([4 / 64, 0, 0, 4 / 32]) == 2
    # Not the longer column of the Jacobian, and not its longer row: both are shorter than the axis of a sheared pixel.
    assert level_of([1 / 64, 1 / 64, 1 / 32, 1 / 32]) == pytest.approx(1, abs=1e-12)


def test_levels_of_detail_clamp_and_round() -> None:
    for mode in MODES:
        assert level_of([0, 0, 0, 0], mode=mode) == 0
        assert level_of([1e-30, 0, 0, 0], mode=mode) == 0
        assert level_of([1e30, 0, 0, 0], mode=mode) == 6
        assert level_of([np.inf, 0, 0, 0], mode=mode) == level_of([np.inf, -np.inf, np.inf, np.inf], mode=mode) == 6
        assert np.isnan(level_of([np.nan, 0, 0, 0], mode=mode)) and np.isnan(level_of([0, 0, 0, np.nan], mode=mode))
        assert level_of([0, 0, 0, 0], bias=5.0, mode=mode) == 0
        assert level_of([1 / 64, 0, 0, 0], bias=np.inf, mode=mode) == 6
    nearest = [level_of([1 / 64, 0, 0, 0], bias=b, mode=MODES[0]) for b in (-3, 0.49, 0.5, 1.49, 1.5, 2.5, 5.49, 9)]
    assert nearest == [0, 0, 1, 1, 2, 3, 5, 6]


def test_auto_takes_the_best_that_the_arguments_allow() -> None:
    tex, uv = np.random.default_rng(5).random((1, 9, 7, 2)), np.random.default_rng(6).random((1, 3, 3, 2))
    uv_da, bias = np.full((1, 3, 3, 4), 0.2), np.full((1, 3, 3), 1.3)
    for arguments, mode in (((), "linear"), ((uv_da,), MODES[1]), ((None, bias), MODES[1]), ((uv_da, bias), MODES[1])):
        np.testing.assert_array_equal(texture(tex, uv, *arguments), texture(tex, uv, *arguments, filter_mode=mode))


def pink(size: int, seed: int) -> torch.Tensor:
    """(1, S, S, 3) noise with the spectrum of natural images: amplitude as 1 / frequency."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    spectrum = np.fft.fft2(rng.normal(0, 1, (3, size, size))) / np.where(frequency > 0, frequency, np.inf)
    return torch.from_numpy(np.fft.ifft2(spectrum).real.transpose(1, 2, 0)[None].copy())


def elliptical(tex: torch.Tensor, uv: torch.Tensor, uv_da: torch.Tensor, samples: int) -> torch.Tensor:
    """The average of level 0 over each footprint by dense quadrature: what anisotropic filtering approximates.

    The footprint is the image under the Jacobian of a Gaussian around the pixel with the variance of a square pixel,
    1/12 (the elliptical weighted average of Heckbert 1989), cut at three standard deviations.
    """
    deviation = (1 / 12) ** 0.5
    grid = (2 * (torch.arange(samples, dtype=torch.float64) + 0.5) / samples - 1) * 3 * deviation
    weight = torch.exp(-((grid / deviation) ** 2) / 2)
    weight = weight / weight.sum()
    jacobian, total = uv_da.reshape(*uv_da.shape[:-1], 2, 2), torch.zeros(())
    for y, row in zip(grid.tolist(), weight.tolist(), strict=True):
        for x, column in zip(grid.tolist(), weight.tolist(), strict=True):
            at = uv + x * jacobian[..., 0] + y * jacobian[..., 1]
            total = total + row * column * reference.texture(tex, at, filter_mode="linear")
    return total


def test_anisotropic_is_much_closer_to_the_ellipse_than_trilinear() -> None:
    tex = pink(64, 1)
    uv = torch.rand(1, 8, 8, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    uv_da = torch.tensor([0.02, 0.16, -0.03, 0.01], dtype=torch.float64).expand(1, 8, 8, 4)
    exact = elliptical(tex, uv, uv_da, samples=18)
    errors = {
        mode: float((texture(tex, uv, uv_da, filter_mode=mode) - exact).square().mean())
        for mode in ("anisotropic", "linear-mipmap-linear")
    }
    assert errors["anisotropic"] < errors["linear-mipmap-linear"] / 8, errors
