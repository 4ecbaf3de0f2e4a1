"""What small pictures say of texels: slopes, and curvature that no change exceeds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mipbake.baking.search.level_fit import SeenAt, columns, fit_level
from mipbake.baking.search.picture_samples import PictureChunk, picture_chunks, picture_slopes
from mipbake.material.aim import ANISOTROPIC, TRILINEAR, Sampler
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Scores
from mipbake.quality.judging.shown import KINDS_SHOWN
from mipbake.quality.judging.terms import PICTURES, TERMS, Weight
from mipbake.quality.judging.weights import Weights
from mipbake.quality.metrics.visible import WEIGHT, bands
from mipbake.quality.reference.estimate import bilinear
from mipbake.quality.reference.problem import Problem, whole
from mipbake.quality.small_pictures import PIXELS

from .test_optimum import bumpy

WRAP = ("wrap", "wrap")
KINDS = [TRILINEAR, ANISOTROPIC, Sampler(bias=-1.0, frames=8), Sampler(4, -0.3, 8)]
COUNTS = {1: np.array([1.3, 0.7])}
SEEN_ALONE = Weights({name: Weight(float(name in PICTURES), 0.0) for name in TERMS}, group_behind=0.0)


def problem(sampler: Sampler) -> Problem:
    return Problem(bumpy(16, 16), "gltf", "gltf", "gaussian", WRAP, sampler)


def chunks_of(task: Problem) -> tuple[list[PictureChunk], list[np.ndarray]]:
    """Chunks of level 1, and what they look up in levels of every second texel."""
    chunks = list(picture_chunks(task, whole(task), 1, 16, 32, np.random.default_rng(0)))
    levels = [task.stored[:: 2**level, :: 2**level].copy() for level in range(task.last + 1)]
    for level in levels:
        level[..., 4] = 0.6
    seen = []
    for chunk in chunks:
        parts = [
            bilinear(levels[level], chunk.uv, WRAP) * (1 if share is None else share[:, None])
            for level, share in chunk.seen
        ]
        seen.append(np.sum(parts, 0).astype(np.float32))
    return chunks, seen


def radiance_of(chunk: PictureChunk, seen: np.ndarray) -> np.ndarray:
    """(N, PIXELS, 3) of (P, C) lookups."""
    return chunk.shown.part(chunk.some).pictures.radiance("gltf", chunk.pixels(seen))


def value(chunks: list[PictureChunk], texels: list[np.ndarray]) -> float:
    """What is minimised: twice the visible error of each kind, times what it counts."""
    total, many = np.zeros(KINDS_SHOWN), np.zeros(KINDS_SHOWN)
    for chunk, seen in zip(chunks, texels, strict=True):
        error = chunk.shown.part(chunk.some).error(radiance_of(chunk, seen))
        np.add.at(total, chunk.kinds, 2 * error.roots[0])
        np.add.at(many, chunk.kinds, 1)
    return float(COUNTS[1] @ (total / many))


@pytest.mark.parametrize("sampler", KINDS)
def test_chunks_hold_pictures_of_both_kinds_with_equal_lookups(sampler: Sampler) -> None:
    chunks, _ = chunks_of(problem(sampler))
    for chunk in chunks:
        assert (
            len(chunk.uv)
            == len(chunk.some) * PIXELS * chunk.lookups * sampler.frames
            == len(chunk.some) * PIXELS * chunk.parts
        )
        assert (chunk.shown.pictures.lookups[chunk.some] == chunk.lookups).all()
    kinds = np.bincount(np.concatenate([chunk.kinds for chunk in chunks]))
    assert len(kinds) == KINDS_SHOWN and len(set(kinds.tolist())) == 1
    assert 1 <= max(chunk.lookups for chunk in chunks) <= sampler.lookups


@pytest.mark.parametrize("sampler", KINDS)
def test_slopes_are_half_the_derivatives_of_what_is_minimised(sampler: Sampler) -> None:
    chunks, texels = chunks_of(problem(sampler))
    rng = np.random.default_rng(1)
    found = picture_slopes(chunks, texels, "gltf", COUNTS)
    gradients = [
        chunk.adjoint("gltf", seen, slopes.by_radiance)
        for chunk, seen, slopes in zip(chunks, texels, found, strict=True)
    ]
    # Uphill: ways without a direction meet kinks of the radiance and hardly any slope.
    along = [(np.sign(each) * rng.random(each.shape)).astype(np.float32) for each in gradients]
    step = 2e-4
    ahead, back = (
        value(chunks, [each + turn * step * way for each, way in zip(texels, along, strict=True)]) for turn in (1, -1)
    )
    by_texel = sum((each * way).sum(dtype=float) for each, way in zip(gradients, along, strict=True))
    assert by_texel == pytest.approx((ahead - back) / (4 * step), rel=2e-2)


def test_no_change_of_pixels_has_more_curvature_than_its_bound() -> None:
    """Neither one pixel's change nor one of all pixels together, of any colour; and the bound is no idle one."""
    chunks, texels = chunks_of(problem(TRILINEAR))
    rng = np.random.default_rng(2)
    rows, columns_ = np.divmod(np.arange(PIXELS), 16)
    waves = np.cos(np.pi * (rows + 0.5) / 16)[:, None] * np.cos(2 * np.pi * (columns_ + 0.5) / 16)[:, None]
    ways: list[Callable[[], np.ndarray]] = [
        lambda: np.ones((PIXELS, 1)) * [1, 1, 1],
        lambda: waves * [1, 1, 1],
        lambda: waves * [1, -1, 0],
        lambda: rng.normal(size=(PIXELS, 3)),
        lambda: np.eye(PIXELS)[:, [77]] * [0, 0, 1],
    ]
    most = 0.0
    (chunk, *_), (slopes, *_) = chunks, picture_slopes(chunks, texels, "gltf", COUNTS)
    many = sum((each.kinds == 0).sum() for each in chunks), sum((each.kinds == 1).sum() for each in chunks)
    roots = chunk.shown.part(chunk.some).error(radiance_of(chunk, texels[0])).roots[0]
    weight = ((COUNTS[1] / many / WEIGHT)[chunk.kinds] / roots)[:, None, None, None]
    drawn = np.stack([slopes.combinations(rng) for _ in range(400)])
    for way in ways:
        radiance = np.broadcast_to(way(), slopes.shown.shape).astype(np.float32)
        own = (weight * np.square(bands((radiance * slopes.shown).reshape(-1, 16, 16, 3)))).sum((1, 2, 3))
        bound = np.square((drawn * radiance).sum(-1)).sum(-1).mean(0)  # of every pixel by itself
        assert (own <= 1.1 * bound).all()
        most = max(most, float((own / bound).max()))
    assert most > 0.1


@pytest.mark.parametrize("sampler", KINDS)
def test_shares_are_fitted_to_what_is_seen(sampler: Sampler) -> None:
    """The value falls to where no share, changed alone, makes it less: its slope by the shares is right."""
    task = problem(sampler)
    effort = ProbeEffort(groups=2, points=16, samples=4, pictures=16, picture_samples=8)
    scores = Scores(task, effort, 0, [1.0])
    size = task.stored.shape[0] // 2
    base = task.stored.reshape(size, 2, size, 2, -1).mean((1, 3))
    other = base.copy()
    other[..., 4] += 0.3
    other[..., :3] *= 0.5
    seen = [scores.looked_up(each.astype(np.float32), 0) for each in (base, other)]
    made = columns(seen[0], [seen[1]], "gltf")
    judge = Judge([Baseline.of(scores.of(seen[0], 0))], SEEN_ALONE)
    found = fit_level([SeenAt(0, 1.0, None, seen[0], made)], scores, judge)

    def worth(theta: np.ndarray) -> float:
        """With what holds shares where the fit begins: at none."""
        texels = seen[0] + np.tensordot(theta.astype(np.float32), made, 1)
        return judge.value(scores.of(texels.astype(np.float32), 0), 0) + 0.3 * float(np.square(theta).sum())

    assert worth(found) < worth(np.zeros(4)) - 0.05 and found[0] != 0 and found[2] != 0
    for share in (0, 2):  # colour and roughness; the others change nothing
        for turn in (0.1, -0.1):
            assert worth(found + turn * np.eye(4)[share]) > worth(found) - 4e-3
