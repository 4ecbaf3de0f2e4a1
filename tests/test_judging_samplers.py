"""Samplers with a MIP bias, and samplers that average frames, as stacks are judged and fitted for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mipbake.baking.search.pixel_samples import Chunk, common_pairs, estimates
from mipbake.baking.search.rounds import Drawn, Lookups, gradients_of
from mipbake.material.aim import TRILINEAR, Sampler
from mipbake.quality.figures import Candidate, Method
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Scores
from mipbake.quality.metrics.pairs import LightViewPairs
from mipbake.quality.reference.estimate import bilinear, estimate
from mipbake.quality.reference.lighting import GroupPairs
from mipbake.quality.reference.problem import Problem, covered
from mipbake.quality.reference.samples import Pixels
from mipbake.quality.samplers import jitter
from mipbake.quality.texture_space import MeasureEffort, measure
from mipbake.shading import shade

from .test_compare_candidates import noisy
from .test_optimum import bumpy

WRAP = ("wrap", "wrap")
TINY = ProbeEffort(groups=2, points=16, samples=64, pictures=8, picture_samples=2)


def problem(sampler: Sampler) -> Problem:
    return Problem(bumpy(16, 16, 0.5), "gltf", "gltf", "gaussian", WRAP, sampler)


@pytest.mark.parametrize("bias", [-1.0, -0.3, 0.5])
def test_what_is_right_is_what_a_pixel_covers_without_the_bias(bias: float) -> None:
    task = problem(Sampler(bias=bias))
    (probe,) = Scores(task, TINY, 0, [1.0]).probes
    assert probe.levels == (1,)
    right, other = (
        estimate(
            task.filtered, Pixels(probe.uv, lod), GroupPairs(probe.light, probe.view), 256, np.random.default_rng(1)
        )
        for lod in (1.0 - bias, 1.0)
    )
    off = [float(np.square(probe.mean - each).mean()) for each in (right, other)]
    assert off[0] < 0.3 * off[1], off


def test_level_0_is_looked_up_by_all_pixels_that_a_negative_bias_brings_there() -> None:
    lods, rng = np.array([0.0, 1.0]), np.random.default_rng(0)
    found = np.stack([covered(problem(Sampler(bias=-1.5)), lods, rng) for _ in range(50)])
    assert (found[:, 1] == 2.5).all() and 0 <= found[:, 0].min() < 0.2 and 1.3 < found[:, 0].max() <= 1.5
    assert (covered(problem(Sampler(bias=0.5)), lods, rng) == lods - 0.5).all()
    assert covered(problem(TRILINEAR), lods, rng) is lods


def test_the_judge_shades_every_frame_and_takes_their_mean() -> None:
    """Against a loop over the frames, each of which shows another point of the pixels."""
    task = problem(Sampler(bias=-0.5, frames=8))
    scores = Scores(task, TINY, 0, [1.0])
    (probe,) = scores.probes
    level = bumpy(8, 8, 0.3)
    found = scores.errors(scores.looked_up(level, 0), 0)
    groups, count = probe.uv.shape[0], probe.mean.shape[2]
    shown = np.zeros_like(probe.mean)
    centre = probe.uv.reshape(groups, count, 8, 2)[:, :, 0] - jitter(8)[0] * 2**1.5 / 16
    for offset in jitter(8):
        texels = bilinear(level, centre + offset * 2**1.5 / 16, WRAP)
        shown += shade("gltf", texels, probe.light, probe.view) / 8
    expected = np.square(shown - probe.mean).mean((2, 3)) - probe.noise
    np.testing.assert_allclose(found.squares, expected, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("sampler", [Sampler(bias=-0.5), Sampler(frames=8), Sampler(bias=-1.0, frames=8)])
def test_gradients_of_pixels_are_the_derivatives_of_what_is_minimised(sampler: Sampler) -> None:
    task, rng = problem(sampler), np.random.default_rng(0)
    pairs = LightViewPairs(*(_up(rng.normal(size=(8, 3))) for _ in range(2)))
    uv = rng.random((12, 2))
    chunks = list(common_pairs(task, pairs, 1, uv, 4, rng))
    texels = [bilinear(bumpy(16, 16, 0.5), chunk.uv, WRAP) for chunk in chunks]
    assert [len(each) for each in texels] == [sampler.frames * len(chunk.lods) for chunk in chunks]
    renders = [(chunk, estimates(task, chunk, 8, rng), np.ones(chunk.light.shape[:2], np.float32)) for chunk in chunks]
    drawn = Drawn(renders, [], {}, Lookups({}, []))

    def value(seen: list[np.ndarray]) -> float:
        total = 0.0
        for (chunk, right, _), each in zip(renders, seen, strict=True):
            total += float(np.square(_shown(chunk, each) - right).sum(dtype=float)) / 2
        return total

    along = [rng.normal(size=each.shape).astype(np.float32) for each in texels]
    step = 1e-3
    ahead, back = (
        value([each + turn * step * way for each, way in zip(texels, along, strict=True)]) for turn in (1, -1)
    )
    found = gradients_of("gltf", drawn, texels, lambda: None)
    total = sum((each * way).sum(dtype=float) for each, way in zip(found, along, strict=True))
    assert total == pytest.approx((ahead - back) / (2 * step), rel=2e-2)


def _up(directions: np.ndarray) -> np.ndarray:
    directions[:, 2] = 1.5
    return (directions / np.linalg.norm(directions, axis=-1, keepdims=True)).astype(np.float32)


def _shown(chunk: Chunk, seen: np.ndarray) -> np.ndarray:
    """(K, P, 3) means over frames, one after the other."""
    frames = [
        shade("gltf", seen[None, k :: chunk.frames], chunk.light[None], chunk.view[None])[0]
        for k in range(chunk.frames)
    ]
    return np.mean(frames, 0)


def test_a_bias_is_a_stack_whose_levels_are_shifted() -> None:
    """What is measured with bias -1 at a level of detail is what the finer level shows without a bias."""
    texture_set = noisy()
    levels = [bumpy(max(1, texture_set.height >> level), max(1, texture_set.width >> level)) for level in range(7)]
    levels = levels[: next(i for i, level in enumerate(levels) if level.shape[:2] == (1, 1)) + 1]
    method = Method("shown", "linear", "box", "gltf")
    effort = MeasureEffort(points=256, samples=4, intervals=False)

    def snr(stack: list[np.ndarray], sampler: Sampler) -> list[float]:
        given = texture_set.filtered("gaussian"), [Candidate(method, stack)], [2.0], (), effort
        return [figure.value for figure in measure(*given, sampler=sampler).curve]

    shifted = [levels[0], levels[0], levels[1], *levels[3:]]
    assert snr(levels, Sampler(bias=-1.0)) == pytest.approx(snr(shifted, TRILINEAR), rel=1e-6)
    frames = snr(levels, replace(TRILINEAR, frames=8))
    assert frames != pytest.approx(snr(levels, TRILINEAR), rel=1e-3) and np.isfinite(frames).all()
