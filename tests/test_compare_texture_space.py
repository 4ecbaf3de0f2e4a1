"""Measures of many candidates at once: against the metrics, against computations on paper, against themselves."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mipbake import TextureSet, UsageError, shading
from mipbake.baking.pipeline import Recipe
from mipbake.comparing.candidates import bake_all
from mipbake.quality import texture_space
from mipbake.quality.figures import Candidate, Figure, Method
from mipbake.quality.metrics import MEASURES, PAIR_SETS, snr_from_sums, snr_interval, snr_sums, tonemapped_error
from mipbake.quality.reference.estimate import reference
from mipbake.quality.reference.pair_sets import weighted_pair_set
from mipbake.quality.reference.sequences import random_points
from mipbake.quality.round_lookups import candidate
from mipbake.quality.texture_space import MeasureEffort, TextureSpace, curve_lods, measure, scale_lods

from .test_validate import bumpy, flat


def measured(
    texture_set: TextureSet, names: list[str], pixel_filter: str = "gaussian", **settings: Any
) -> TextureSpace:
    with bake_all(texture_set, Recipe(target="gltf", pixel_filter=pixel_filter), names) as candidates:
        numbers = "seed", "points", "samples"
        effort = MeasureEffort(**{name: settings.pop(name) for name in numbers if name in settings})
        return measure(texture_set.filtered(pixel_filter), candidates, effort=effort, **settings)


def figure(found: TextureSpace, method: str, measure_name: str, view: str, scale: str) -> Figure:
    (only,) = (
        f for f in found.figures if (f.method, f.measure, f.view, f.scale) == (method, measure_name, view, scale)
    )
    return only


def test_the_snr_is_that_of_the_metrics_for_the_same_renders() -> None:
    """Every block of 64 pairs has points of its own, and all blocks count in one figure."""
    texture_set = bumpy(32)
    source = texture_set.filtered("tent")
    sets = {name: weighted_pair_set(name, 3, source.stored, "gltf") for name in PAIR_SETS}
    with bake_all(
        texture_set, Recipe(target="gltf", pixel_filter="tent"), ["lean (tent)", "linear (box)"]
    ) as candidates:
        found = measure(source, candidates, (1.5, 0.25), (), MeasureEffort(3, 160, 8))
        for index, lod in enumerate((1.5, 0.25)):
            lit = {}
            for name in PAIR_SETS:
                sums: dict[str, list[np.ndarray]] = {each.name: [] for each in candidates}
                for block in range(16):
                    rng = np.random.default_rng([3, index, block])
                    uv = random_points(rng, 10)
                    pairs = sets[name][64 * block : 64 * (block + 1)]
                    first, second = (reference(source, uv, lod, pairs, 8, rng) for _ in range(2))
                    for each in candidates:
                        shown = candidate(each.levels, "gltf", texture_set.wrap, uv, lod, pairs)
                        sums[each.name].append(pairs.weights[:, None] * snr_sums(shown, first, second))
                lit |= {(each, name): snr_interval(np.concatenate(rows)) for each, rows in sums.items()}
            for point in (each for each in found.curve if each.lod == lod):
                expected = lit[point.method, point.view]
                assert point.value == pytest.approx(expected.estimate, abs=1e-3)
                assert (point.low, point.high) == pytest.approx((expected.low, expected.high), abs=1e-3)
    assert len(found.curve) == 8
    assert found.figures == ()


def test_flicker_of_a_checker_of_two_texels_matches_the_computation_on_paper() -> None:
    """Base colour 0 and 1 in a 2 x 1 texture; radiance is linear in base colour, and nothing changes along v.

    x in texels from the centre of the black one: a lookup gives t(x) = |x|, the box filter of one texel
    g(x) = x^2 + 1/4 for |x| < 1/2 and 3/4 - (1 - |x|)^2 up to 1. Over half a texel, t changes by 1/2 for x in
    [0, 1/2] and by 3/2 - 2 x in [1/2, 1], whose mean square is 1/6. g changes by 3/8 - 2 (x - 1/4)^2 and by 3/4 - x:
    1/15. Their difference, 1/8 + 2 (x - 1/4)^2 and 3/4 - x, has the mean square 1/40.
    """
    checker = flat(1, 2, np.array([[[0.0], [1.0]]]))
    found = measured(checker, ["linear"], "box", lods=(0,), scales=("near",), points=2048, samples=32)
    for view in PAIR_SETS:
        flicker = figure(found, "linear (box)", "flicker", view, "near")
        assert flicker.value == pytest.approx((1 / 6) / (1 / 15), rel=0.03)
        assert flicker.low <= flicker.value <= flicker.high < 1.1 * flicker.low
        change = figure(found, "linear (box)", "flicker-snr", view, "near")
        assert change.value == pytest.approx(10 * math.log10(40 / 15), abs=0.15)


@pytest.mark.long
@pytest.mark.parametrize("view", PAIR_SETS)
def test_noise_of_the_reference_biases_neither_flicker_nor_its_snr(view: str) -> None:
    """Few samples leave noise of several times the change: did both estimates share any of it, figures would move."""
    samples = {"near-mirror": 8, "hemisphere": 4}[view]
    name = "toksvig (gaussian)"
    few, many = (measured(bumpy(), [name], scales=("near",), lods=(0,), points=4096, samples=n) for n in (samples, 128))
    flicker, change = (
        [figure(f, name, m, view, "near").value for f in (few, many)] for m in ("flicker", "flicker-snr")
    )
    assert flicker[0] == pytest.approx(flicker[1], rel=0.1)
    assert change[0] == pytest.approx(change[1], abs=0.5)


def test_nothing_flickers_on_a_constant_material() -> None:
    told: list[tuple[str, float]] = []
    found = measured(flat(8, 8), ["lean (box)"], points=64, samples=16, progress=lambda *args: told.append(args))
    for each in found.figures:
        if each.measure in ("snr", "tonemapped"):
            assert each.value > 60 if each.measure == "snr" else each.value < 1e-5
    assert {math.isnan(f.value) for f in found.figures if f.measure == "flicker" and f.scale == "far"} == {True}
    assert "flicker has no figure at near (near-mirror), " in found.notes[-1]
    shares = [share for _, share in told]
    assert {phase for phase, _ in told} == {"texture space"} and shares == sorted(shares)
    assert 0 < shares[0] < shares[-1] == pytest.approx(1.0) and shares.count(shares[-1]) == 1


def test_the_tonemapped_error_is_that_of_the_metrics() -> None:
    source, other = flat(4, 4, 0.5), flat(4, 4, 0.2)
    wrong = Candidate(Method("wrong", "linear", "box", "gltf"), [other.material("gltf")])
    found = measure(source.filtered("gaussian"), [wrong], (0,), ("near",), MeasureEffort(points=8, samples=16))
    for view in PAIR_SETS:
        pairs = weighted_pair_set(view, 0, source.material("gltf"), "gltf")
        p, r = (
            shading.shade("gltf", each.material("gltf")[0, :1], pairs.light, pairs.view) for each in (other, source)
        )
        error = figure(found, "wrong", "tonemapped", view, "near")
        each = tonemapped_error(p, r).per_pixel.reshape(-1)
        assert error.value == pytest.approx(np.average(each, weights=pairs.weights), rel=1e-4)
        assert 0 < error.low < error.value < error.high


def test_a_scale_pools_the_sums_of_its_levels_of_detail() -> None:
    names = ["linear (box)", "linear (gaussian)"]
    found = measured(bumpy(16), names, points=64, samples=8)
    assert {f.scale: f.lod for f in found.figures} == {"near": 0.0, "1:1": 0.5, "middle": 3.0, "far": 4.0}
    for view in PAIR_SETS:
        pooled = figure(found, "linear (box)", "snr", view, "1:1")
        rows = sum(found.sums["linear (box)", view, lod] for lod in (0.0, 0.25, 0.5, 0.75, 1.0))
        assert pooled.value == pytest.approx(float(snr_from_sums(np.sum(rows, 0))))
        at_3 = next(f for f in found.curve if (f.method, f.view, f.lod) == ("linear (box)", view, 3.0))
        assert figure(found, "linear (box)", "snr", view, "middle").value == at_3.value
        for where in (0.0, 2.0, "1:1"):  # gains are over the same pairs
            a, b = (snr_from_sums(found.sums[name, view, where].sum(0)) for name in names)
            gain = found.gain(*names, view, where)
            assert gain.estimate == pytest.approx(float(a - b)) and gain.low <= gain.estimate <= gain.high
    with pytest.raises(KeyError):
        found.gain("linear (box)", "lean (box)", "hemisphere", 0.0)
    assert {f.measure for f in found.figures} == {"snr", "tonemapped", "flicker", "flicker-snr"} <= set(MEASURES)
    assert len(found.figures) == 2 * 2 * 4 * 4


def test_every_level_of_detail_counts_alike_in_the_flicker_of_a_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    """Levels count alike, whatever number of points each takes: a set of few pixels takes fewer at coarse levels."""

    def pooled(fine: int, coarse: int) -> list[float]:
        drawn = {32 * 32.0: (fine, 16), 16 * 16.0: (coarse, 16)}
        monkeypatch.setattr(texture_space, "_change_draws", lambda pixels, *_: drawn.get(pixels, (64, 16)))
        effort = {"points": 64, "samples": 8}
        found = measured(bumpy(32), ["linear (box)"], lods=(0.0,), scales=("1:1",), **effort)
        return [figure(found, "linear (box)", "flicker", view, "1:1").value for view in PAIR_SETS]

    # Off by 0.056 in the mean of 8 seeds, standard deviation 0.040; by 0.39 where points count, not levels.
    assert pooled(2048, 128) == pytest.approx(pooled(128, 2048), rel=0.22)


def test_curves_run_to_the_far_scale_or_to_the_last_level() -> None:
    assert curve_lods((2, 1024)) == tuple(n / 4 for n in range(29))
    assert curve_lods((3, 5)) == (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
    assert curve_lods((1, 1)) == (0.0,)
    assert [scale_lods((3, 5), scale) for scale in ("near", "middle", "far")] == [(0.0,), (2.0,), (2.0,)]
    assert scale_lods((64, 64), "1:1") == (0.0, 0.25, 0.5, 0.75, 1.0)
    assert scale_lods((1, 1), "1:1") == (0.0,)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"lods": (-1,)}, "lods must be"),
        ({"lods": ()}, "lods must be"),
        ({"lods": (math.nan,)}, "lods must be"),
        ({"points": 0}, "points and samples must be"),
        ({"samples": 0}, "points and samples must be"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, object], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        measured(flat(2, 2), ["linear (box)"], **settings)
