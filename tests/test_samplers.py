"""How engines look stacks up: each sampler against a plain loop, or against the mean that it draws from."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.material.aim import ANISOTROPIC, LOOKUPS, SAMPLERS, Sampler, sampler_from, sampler_named, sampler_of
from mipbake.quality.samplers import (
    RENDER_SAMPLERS,
    frames_at,
    in_frames,
    jitter,
    look_up,
    mean_of_frames,
    render_sampler,
)

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


@pytest.mark.parametrize("bias", [0.0, -1.0, 0.7])
@pytest.mark.parametrize("most", LOOKUPS)
def test_a_lookup_is_the_mean_of_lookups_along_the_longer_side(most: int, bias: float) -> None:
    stack, (uv, uv_da) = levels(), footprints()
    expected, taps = [], set()
    for at, da in zip(uv, uv_da, strict=True):
        a, b, along = sides(da)
        n = min(math.ceil(a / b - 1e-3), most)
        steps = [((index + 0.5) / n - 0.5) * a * along / [SIZE[1], SIZE[0]] for index in range(n)]
        lod = math.log2(a / n) + bias
        expected.append(np.mean([trilinear(stack, *(at + step), lod) for step in steps], 0))
        taps.add(n)
    assert {1, most} <= taps and max(taps) == most
    np.testing.assert_allclose(look_up(stack, uv, uv_da, WRAP, Sampler(most, bias)), expected, atol=2e-4)


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


@pytest.mark.parametrize(
    ("sampler", "name"),
    [
        (Sampler(), "trilinear"),
        (Sampler(4), "anisotropic 4x"),
        (ANISOTROPIC, "anisotropic"),
        (Sampler(bias=-0.3), "trilinear, bias -0.3"),
        (Sampler(bias=-1, frames=8), "accumulated, bias -1"),
        (Sampler(16, -1.58, 8), "accumulated, anisotropic, bias -1.58"),
    ],
)
def test_a_sampler_is_read_from_what_it_is_called_and_from_its_record(sampler: Sampler, name: str) -> None:
    assert str(sampler) == name and sampler_named(name) == sampler and sampler_of(name) == sampler
    assert sampler_from(json.loads(json.dumps(dataclasses.asdict(sampler)))) == sampler_from(name) == sampler
    assert sampler_of(sampler, 0.5) == dataclasses.replace(sampler, bias=0.5)


@pytest.mark.parametrize(
    "name",
    ["point", "", "anisotropic 1x", "anisotropic 16x", "anisotropic 3x", "bias -1", "trilinear, bias 9",
     "bias -1, accumulated", "trilinear, bias nan", "trilinear, bias 0", "trilinear, accumulated", "trilinear,bias 1",
     "trilinear, bias -1.0"],
)  # fmt: skip
def test_what_no_sampler_is_called_is_refused(name: str) -> None:
    with pytest.raises(UsageError, match=r"unknown sampler .*trilinear, anisotropic, accumulated"):
        sampler_named(name)
    with pytest.raises(ValueError, match="unknown sampler"):
        sampler_from(name)


@pytest.mark.parametrize(
    "wrong", [{"lookups": 3}, {"lookups": True}, {"frames": 2}, {"bias": math.nan}, {"bias": 5}, {"bias": "1"}]
)
def test_a_sampler_that_no_engine_has_is_refused(wrong: dict[str, Any]) -> None:
    (name,) = wrong
    with pytest.raises(UsageError, match=f"the sampler has .*{name}.*expected"):
        Sampler(**wrong)
    for content in ({**dataclasses.asdict(Sampler()), **wrong}, {"lookups": 1}, 5):
        with pytest.raises(ValueError, match="expected"):
            sampler_from(content)


def test_renders_have_one_sampler_more() -> None:
    assert [render_sampler(name) for name in RENDER_SAMPLERS] == [*SAMPLERS.values(), "stochastic"]
    assert render_sampler("anisotropic", -1.0) == Sampler(16, -1.0)
    with pytest.raises(UsageError, match="takes no MIP bias"):
        render_sampler("stochastic", -1.0)


def test_frames_show_points_of_a_pixel_evenly() -> None:
    offsets = jitter(8)
    assert offsets.shape == (8, 2) and (np.abs(offsets) < 0.5).all() and not jitter(1).any()
    for axis, base in ((0, 2), (1, 3)):
        # A Halton sequence puts a point into every interval of a width of 1 / base.
        assert set(np.floor((offsets[:, axis] + 0.5) * base)) == set(range(base))
    np.testing.assert_allclose(offsets[:3, 0], [0.0, -0.25, 0.25])
    uv, axes = np.array([[0.1, 0.2], [0.5, 0.7]]), np.array([[[0.1, 0.0], [0.0, 0.2]], [[0.0, 0.3], [-0.1, 0.0]]])
    expected = [at + x * axis[0] + y * axis[1] for at, axis in zip(uv, axes, strict=True) for x, y in offsets]
    np.testing.assert_allclose(frames_at(uv, axes, 8), expected)
    radiance = np.random.default_rng(0).random((2, 3 * 8, 3)).astype(np.float32)
    mean = mean_of_frames(radiance, 8)
    np.testing.assert_allclose(mean, radiance.reshape(2, 3, 8, 3).mean(2), rtol=1e-6)
    np.testing.assert_allclose(in_frames(mean, 8).reshape(2, 3, 8, 3), (mean / 8)[:, :, None].repeat(8, 2), rtol=1e-6)
