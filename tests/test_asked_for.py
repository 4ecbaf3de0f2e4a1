"""What a blend is held against: closed forms that look fine, by single lights, and every ingredient in what is seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mipbake.baking.search.blending import gathered
from mipbake.baking.search.ingredients import closed_forms, ingredient
from mipbake.baking.search.methods import Auto
from mipbake.quality.judging.terms import PICTURES, POOLED, TERMS
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.reference.problem import Problem

from .test_auto import SEEN_ALONE, SHORT, TINY, WEIGHTS, WRAP, material_of_two


@pytest.mark.parametrize("looks_worse", [0.5, math.inf])
def test_forms_that_look_worse_ask_for_no_snr(looks_worse: float) -> None:
    task = Problem(material_of_two(32), "gltf", "gltf", "gaussian", WRAP)
    better = Auto(effort=TINY, descent=SHORT, judged_by=SEEN_ALONE)
    bench = gathered(task, [*closed_forms(task), ingredient(task, better, "gaussian")], TINY, WEIGHTS).bench
    left_out, ahead = 0, 0
    for index, scores in enumerate(bench.judged):
        values = (baseline := bench.baseline(1, index, looks_worse)).values
        least = np.array([values[name].mean() for name in PICTURES])
        lead = np.min([score.visible.mean(-1) for score in scores.values()], 0) - least
        assert (lead >= 0).all()
        ahead += int((lead > 0).any())
        fine = {
            name: score
            for name, score in scores.items()
            if name.startswith("linear ") or (score.visible.mean(-1) - least).max() <= looks_worse
        }
        left_out += len(scores) - len(fine)
        every = np.min([score.log_errors.mean(-1) for score in fine.values()], 0)
        np.testing.assert_allclose([values[name].mean() for name in PAIR_SETS], every)
        plain = [score for name, score in fine.items() if name.startswith(("linear ", "lean "))]
        np.testing.assert_allclose(baseline.plain, np.min([score.log_errors for score in plain], 0))
        bright = [values[name].mean() for name, term in TERMS.items() if term.array == POOLED]
        np.testing.assert_allclose(bright, np.min([score.pooled.mean(-1) for score in plain], 0))
    assert (left_out == 0) == math.isinf(looks_worse)
    assert ahead > 0  # what is no closed form looks best somewhere
