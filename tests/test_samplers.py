"""How engines look stacks up: each sampler against a plain loop, or against the mean that it draws from."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from mipbake.errors import UsageError
from mipbake.render.samplers import SAMPLERS, look_up, sampler_named

Array = NDArray[np.float64]
WRAP = ("wrap", "clamp")
SIZE = (16, 32)  # rows, columns of level 0


def levels() -> list[NDArray[np.float32]]:
    """Random levels, which nothing but their place in the stack ties together."""
    rng = np.random.default_rng(1)
    return [rng.random((max(1, SIZE[0] >> i), max(1, SIZE[1] >> i), 3)).astype(np.float32) for i in range(6)]


def footprints(count: int = 24) -> tuple[Array, Array]:
    """(P, 2) uv and (P, 4) derivatives: round and long footprints at all angles, some beyond the last level."""
    rng = np.random.default_rng(2)
    uv = rng.uniform(-0.5, 1.5, (count, 2))
    longer = 2 ** rng.uniform(-1, 6, count)
    shorter = longer / 2 ** rng.uniform(-1, 5, count).clip(0)
    turns, across = rng.uniform(0, 2 * math.pi, (2, count))
    out = []
    for a, b, turn, other in zip(longer, shorter, turns, across, strict=True):
        axes = _turn(turn) @ np.diag([a, b]) @ _turn(other)  # texels per pixel: columns are screen axes
        out.append([*(axes[0] / SIZE[1]), *(axes[1] / SIZE[0])])
    return uv, np.array(out)


def _turn(angle: float) -> Array:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def bilinear(level: NDArray[np.float32], u: float, v: float) -> Array:
    """Wrapped along u, clamped along v."""
    height, width = level.shape[:2]
    x, y = u * width - 0.5, v * height - 0.5
    left, top = math.floor(x), math.floor(y)
    found = np.zeros(level.shape[2])
    for i, j in itertools.product((0, 1), (0, 1)):
        weight = abs(1 - j - (x - left)) * abs(1 - i - (y - top))
        found += weight * level[min(max(top + i, 0), height - 1), (left + j) % width]
    return found


def trilinear(stack: list[NDArray[np.float32]], u: float, v: float, lod: float) -> Array:
    lod = min(max(lod, 0.0), len(stack) - 1.0)
    fine = math.floor(lod)
    coarse = min(fine + 1, len(stack) - 1)
    return (1 - lod + fine) * bilinear(stack[fine], u, v) + (lod - fine) * bilinear(stack[coarse], u, v)


def sides(uv_da: Array) -> tuple[float, float, Array]:
    """Longer and shorter side in texels of level 0, and the direction of the longer one, of length 1 in texels."""
    jacobian = uv_da.reshape(2, 2) * [[SIZE[1]], [SIZE[0]]]
    directions, (a, b), _ = np.linalg.svd(jacobian)
    return float(a), float(b), directions[:, 0]


def test_a_trilinear_lookup_takes_the_level_of_the_longer_side() -> None:
    stack, (uv, uv_da) = levels(), footprints()
    expected = [trilinear(stack, *at, math.log2(sides(da)[0])) for at, da in zip(uv, uv_da, strict=True)]
    np.testing.assert_allclose(look_up(stack, uv, uv_da, WRAP), expected, atol=2e-5)


def test_an_anisotropic_lookup_is_the_mean_of_lookups_along_the_longer_side() -> None:
    stack, (uv, uv_da) = levels(), footprints()
    expected, taps = [], set()
    for at, da in zip(uv, uv_da, strict=True):
        a, b, along = sides(da)
        n = min(math.ceil(a / b - 1e-3), 16)
        steps = [((index + 0.5) / n - 0.5) * a * along / [SIZE[1], SIZE[0]] for index in range(n)]
        expected.append(np.mean([trilinear(stack, *(at + step), math.log2(a / n)) for step in steps], 0))
        taps.add(n)
    assert {1, 16} < taps and len(taps) > 5
    np.testing.assert_allclose(look_up(stack, uv, uv_da, WRAP, "anisotropic"), expected, atol=2e-4)


def test_a_stochastic_lookup_is_one_texel_and_trilinear_in_the_mean() -> None:
    stack, (uv, uv_da) = levels(), footprints(6)
    many = 20_000
    rng = np.random.default_rng(3)
    drawn = look_up(stack, uv.repeat(many, 0), uv_da.repeat(many, 0), WRAP, "stochastic", rng)
    texels = {tuple(texel) for level in stack for texel in level.reshape(-1, 3)}
    assert {tuple(each) for each in drawn} <= texels
    # A texel is between 0 and 1, so the mean of so many is off by at most 0.5 / sqrt(many), one deviation.
    mean = drawn.reshape(6, many, 3).mean(1)
    np.testing.assert_allclose(mean, look_up(stack, uv, uv_da, WRAP), atol=4 * 0.5 / math.sqrt(many))


def test_samplers_have_names() -> None:
    assert [sampler_named(name) for name in SAMPLERS] == ["trilinear", "anisotropic", "stochastic"]
    with pytest.raises(UsageError, match=r"'point'.*trilinear, anisotropic or stochastic"):
        sampler_named("point")
    with pytest.raises(UsageError, match="expected rng"):
        look_up(levels(), *footprints(1), WRAP, "stochastic")
