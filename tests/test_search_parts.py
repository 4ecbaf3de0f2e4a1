"""What searches are made of: shares, regions, pixels, pictures, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from mipbake import material, sampling, shading
from mipbake.baking.methods import METHODS
from mipbake.baking.search import level_fit
from mipbake.baking.search.level_fit import SeenAt, columns, fit_level
from mipbake.baking.search.picture_samples import PictureChunk, picture_chunks, picture_slopes, texels_around
from mipbake.baking.search.pixel_samples import Chunk, common_pairs, estimates
from mipbake.baking.search.regions import Crop, timed_regions
from mipbake.baking.search.rounds import Drawn, Lookups, gradients_of
from mipbake.material.aim import ANISOTROPIC, TRILINEAR, Sampler
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Scores
from mipbake.quality.judging.shown import KINDS_SHOWN
from mipbake.quality.judging.terms import Weights
from mipbake.quality.metrics.pairs import LightViewPairs
from mipbake.quality.metrics.visible import WEIGHT, bands
from mipbake.quality.reference.estimate import bilinear
from mipbake.quality.reference.problem import Problem, Region, whole
from mipbake.quality.small_pictures import PIXELS
from mipbake.sampling.adjoint import scatter_linear
from mipbake.shading import shade
from mipbake.shading.adjoint import shade_adjoint

from .search_cases import EFFORT, SEEN_ALONE, SMALL, WEIGHTS, WRAP, bumpy, material_of_two

KINDS = [TRILINEAR, ANISOTROPIC, Sampler(bias=-1.0, frames=8), Sampler(4, -0.3, 8)]

COUNTS = {1: np.array([1.3, 0.7])}


def problem(sampler: Sampler = TRILINEAR, size: int = 16) -> Problem:
    return Problem(bumpy(size, size), "gltf", "gltf", "gaussian", WRAP, sampler)


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
    chunks, texels = chunks_of(problem())
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


@pytest.fixture
def to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits go on until nothing is gained."""
    monkeypatch.setattr(level_fit, "_ITERATIONS", 20)
    monkeypatch.setattr(level_fit, "_ENOUGH", 1e-4)


@pytest.mark.usefixtures("to_the_end")
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
    found = fit_level(SeenAt(0, seen[0], made), scores, judge, np.zeros(len(made)))

    def worth(theta: np.ndarray) -> float:
        """With what holds shares where the fit begins: at none."""
        texels = seen[0] + np.tensordot(theta.astype(np.float32), made, 1)
        return judge.value(scores.of(texels.astype(np.float32), 0), 0) + 0.5 * float(np.square(theta).sum())

    assert worth(found) < worth(np.zeros(4)) - 0.05 and found[0] != 0 and found[2] != 0
    for share in (0, 2):  # colour and roughness; the others change nothing
        for turn in (0.1, -0.1):
            assert worth(found + turn * np.eye(4)[share]) > worth(found) - 4e-3


@pytest.mark.usefixtures("to_the_end")
@pytest.mark.parametrize("weights", [WEIGHTS, SEEN_ALONE], ids=["all terms", "pictures"])
def test_the_fit_finds_the_blend_that_the_renders_show(weights: Weights) -> None:
    """The reference in a probe is replaced by renders of a known blend of two ingredients."""
    two = material_of_two(32)
    task = Problem(two, "gltf", "gltf", "gaussian", WRAP)
    scores = Scores(task, SMALL, 5, [1.0])
    base, other = (
        scores.looked_up(METHODS[name](two, "gltf", "gltf", "gaussian", WRAP, lambda _: None).levels[1], 0)
        for name in ("linear", "lean")
    )
    made = columns(base, [other], "gltf")
    true = np.array([0.0, 0.0, 0.6, 0.3], np.float32)  # base colour, metallic, roughness, normal
    texels = material.regularise(base + np.tensordot(true, made, 1), "gltf").astype(np.float32)
    (probe,) = scores.probes
    count = probe.uv.shape[0] * probe.uv.shape[1]
    single = texels[:count].reshape(*probe.uv.shape[:2], -1)
    shaded = shading.shade("gltf", single, probe.light, probe.view)
    radiance = probe.shown.pictures.radiance("gltf", texels[count:].reshape(-1, PIXELS, texels.shape[-1]))
    right = probe.shown.error(radiance).off + probe.shown.right
    shown = replace(probe.shown, right=right, noise=0 * probe.shown.noise)
    start = scores.of(base, 0)
    scores.probes = [replace(probe, mean=shaded, noise=0 * probe.noise, shown=shown)]
    found = fit_level(SeenAt(0, base, made), scores, Judge([Baseline.of(start)], weights), np.zeros(len(made)))
    if weights is SEEN_ALONE:
        # What is as good as right has one value: shares that hardly show may end anywhere then.
        blended = base + np.tensordot(found, made, 1)
        score = scores.of(material.regularise(blended, "gltf").astype(np.float32), 0)
        left, before = (np.exp(each.visible.mean(-1)) for each in (score, start))
        exact = np.exp(scores.of(texels, 0).visible.mean(-1))  # what nobody sees is added to all of them
        assert (left - exact < 0.1 * (before - exact)).all() and (before > 1.1 * exact).all()
        assert found[2] == pytest.approx(true[2], abs=8e-3)  # off by 3e-3: errors that nobody sees hardly count
        return
    assert found[2] == pytest.approx(true[2], abs=2e-4)  # off by 2e-5 in the mean, standard deviation 3e-5
    assert found[3] == pytest.approx(true[3], abs=0.021)  # 0.0040, standard deviation 0.0043


def test_scattering_is_the_adjoint_of_looking_up() -> None:
    boundary = "clamp", "wrap"
    rng = np.random.default_rng(2)
    level, uv = rng.normal(size=(5, 7, 3)).astype(np.float32), rng.uniform(-0.2, 1.2, (40, 2)).astype(np.float32)
    values = rng.normal(size=(40, 3)).astype(np.float32)
    seen = sampling.texture(level[None], uv[None, None], filter_mode="linear", boundary_mode=boundary)[0, 0]
    back = scatter_linear((5, 7), uv, values, boundary)
    assert (seen * values).sum(dtype=float) == pytest.approx((back * level).sum(dtype=float), rel=1e-4)


@pytest.mark.parametrize("wrap", [("wrap", "wrap"), ("clamp", "wrap"), ("clamp", "clamp")])
@pytest.mark.parametrize("size", [(40, 24), (33, 17)])
def test_windows_cover_every_texel_once_and_see_their_neighbours(wrap, size) -> None:
    levels = [bumpy(*s) for s in level_sizes(*size)]
    task = Problem(levels[0], "gltf", "gltf", "gaussian", wrap)
    regions = [timed.region for timed in timed_regions(task, 8, coarse=8)]
    counts = [np.zeros(level.shape[:2], int) for level in levels]
    rng = np.random.default_rng(0)
    for region in regions:
        for index in region.levels:
            part = Crop(levels[index], region, task, True, 4)
            counts[index][part.window] += 1
            uv = part.pixels(1, rng)
            every = Crop(levels[index], whole(task), task, False, 4)
            inside = (uv >= region.origin).all(1) & (uv <= region.origin + region.extent).all(1)
            assert inside.any()
            assert part.bilinear(uv[inside]) == pytest.approx(every.bilinear(uv[inside]), abs=1e-4)
    assert all((count == 1).all() for count in counts)


@pytest.mark.parametrize("sampler", KINDS)
def test_pictures_of_a_window_see_the_texels_around_it(sampler: Sampler) -> None:
    """Pictures are larger than windows may be, and what is looked up beside a window is looked up all the same."""
    task = problem(sampler, 64)
    levels = [bumpy(*size) for size in task.sizes]
    rng = np.random.default_rng(0)
    for level in (0, 1):
        region = Region(0.5, 0.75, 0.25, 0.5, range(level, level + 1))
        for chunk in picture_chunks(task, region, level, 64, 1, rng):
            for index, _ in chunk.seen:
                around = texels_around(task, region, index)
                crop = Crop(levels[index], region, task, True, around)
                np.testing.assert_allclose(crop.bilinear(chunk.uv), bilinear(levels[index], chunk.uv, WRAP), atol=2e-3)


def test_probes_of_a_region_lie_inside_it() -> None:
    region = Region(0.5, 1, 0, 0.25, range(1))
    (probe,) = Scores(problem(), EFFORT, 0, [0.0], region).probes
    centres = probe.shown.pictures.uv.mean(1)  # pictures are as large as they are
    for uv in (probe.uv.reshape(-1, 2), centres):
        assert (uv >= [0, 0.5]).all() and (uv <= [0.25, 1]).all()


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


@pytest.mark.parametrize("model", material.MODELS)
def test_the_adjoint_of_shading_is_the_gradient_of_the_op(model: str) -> None:
    rng = np.random.default_rng(1)
    gltf = material_of_two(4).reshape(2, 8, 8)
    texels = material.convert(gltf, "gltf", model).astype(np.float32)
    light, view = (rng.normal(size=(2, 5, 8, 3)) + np.array([0, 0, 3]) for _ in range(2))
    light, view = ((d / np.linalg.norm(d, axis=-1, keepdims=True)).astype(np.float32) for d in (light, view))
    weight = rng.normal(size=(2, 5, 8, 3)).astype(np.float32)
    leaf = torch.from_numpy(texels).requires_grad_()
    (shade(model, leaf, torch.from_numpy(light), torch.from_numpy(view)) * torch.from_numpy(weight)).sum().backward()
    assert np.array_equal(shade_adjoint(model, texels, light, view, weight), leaf.grad.numpy())
