"""Rounds of least squares that end a fit: what they find, what stops them, and what they leave alone."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake import MipStack
from mipbake.base.errors import RendererError
from mipbake.fitting import Frame, Levels, fit, standard_views
from mipbake.fitting.kernels import TorchRenderer
from mipbake.fitting.parameters import Parameters
from mipbake.material import MODELS

from .fitting_small import REPEATS, Plain, error, fitted, levels_of, same, spots, start
from .independent_scenes import bilinear
from .viewer_scenes import material, stack_of

ROUND: dict[str, Any] = {"steps": 1, "rate": 1e-6, "rounds": 1}
"""A fit whose steps move nothing that anyone would see."""


class Sums(Plain):
    """Shows sums of maps, so that least squares are right at once."""

    def render(self, levels: Levels, view: Any) -> Frame:
        frame = super().render(levels, view)
        level = min(view.level, len(levels.sizes) - 1)
        colour, metallic, roughness = (
            bilinear(levels.maps[name][level].astype(np.float64), np.asarray(frame.uv, np.float64))
            for name in ("base_color", "metallic", "roughness")
        )
        return replace(frame, image=colour + metallic + 0.3 * roughness * [1, 0, 0] + 0.2 * np.square(roughness))


def changed(stack: MipStack, name: str, made: Any) -> MipStack:
    own = MODELS[stack.model].maps[name]
    levels = [level.copy() for level in stack.levels]
    for level in levels:
        level[..., own] = made(level[..., own])
    return replace(stack, levels=levels)


def images_of(stack: MipStack, renderer: Any) -> list[np.ndarray]:
    return [renderer.render(levels_of(stack), view).image for view in spots()]


def worst(stack: MipStack, renderer: Any, images: list[np.ndarray]) -> float:
    return max(error(stack, renderer, view, image) for view, image in zip(spots(), images, strict=True))


def inner() -> MipStack:
    """The start, with maps away from their limits."""
    return changed(changed(start(), "roughness", lambda r: 0.3 + 0.4 * r), "metallic", lambda m: 0.2 + 0.3 * m)


@pytest.mark.long
@pytest.mark.parametrize(
    "made",
    [lambda r: r + 0.1, lambda r: r.mean() + 0.6 * (r - r.mean()), lambda r: 0.2 + 0.7 * r],
    ids=["offset", "contrast", "both"],
)
def test_what_all_texels_of_a_level_share_is_found_in_one_round(made: Any) -> None:
    right = inner()
    wrong, images = changed(right, "roughness", made), images_of(right, Sums())
    before, after = (
        worst(fitted(Sums(), stack=wrong, reference=images, **(ROUND | {"rounds": rounds})), Sums(), images)
        for rounds in (0, 1)
    )
    assert after < before / 50


def test_a_level_between_two_stacks_is_found_in_one_round() -> None:
    """No offset and no contrast leads there: what differs from the start is another pattern in each stack."""
    rng = np.random.default_rng(8)
    first, second = (
        changed(inner(), "roughness", lambda r: np.clip(r + 0.1 * rng.standard_normal(r.shape), 0.1, 0.9))
        for _ in range(2)
    )
    pairs = zip(first.levels, second.levels, strict=True)
    right = replace(first, levels=[0.3 * one + 0.7 * other for one, other in pairs])
    images = images_of(right, Sums())
    alone, both = (fitted(Sums(), stack=first, others=others, reference=images, **ROUND) for others in ((), (second,)))
    assert worst(both, Sums(), images) < worst(alone, Sums(), images) / 50


def test_more_rounds_come_nearer_where_shading_is_not_linear() -> None:
    right = inner()
    wrong, images = changed(right, "roughness", lambda r: 0.8 * r), images_of(right, Plain())
    errors = [
        worst(fitted(Plain(), stack=wrong, reference=images, **(ROUND | {"rounds": n})), Plain(), images)
        for n in (0, 1, 3)
    ]
    assert errors[0] > 3 * errors[1] and errors[1] > errors[2]


def test_a_number_that_a_limit_stops_leaves_the_others_right() -> None:
    """Pictures want less metallic than 0. Base colour, which shows alike, has to make up for that."""
    right = changed(start(), "metallic", np.zeros_like)
    wrong = changed(right, "base_color", lambda c: c + 0.1)
    images = images_of(right, Sums())
    result = fitted(Sums(), stack=wrong, reference=images, **ROUND)
    assert all((level[..., 3] >= 0).all() for level in result.levels)
    assert worst(result, Sums(), images) < worst(wrong, Sums(), images) / 20


@pytest.mark.long
@pytest.mark.parametrize("model", MODELS)
def test_rounds_of_other_models_stay_within_limits_and_gain(model: str) -> None:
    stack, renderer = stack_of(material(model, 16, 16), model), TorchRenderer()
    views = standard_views((16, 16), REPEATS, each=3)
    images = [renderer.render(levels_of(stack), view).image for view in views]
    wrong = replace(stack, levels=[0.85 * level for level in stack.levels])

    def errors(of: MipStack) -> float:
        return float(np.mean([error(of, renderer, view, i) for view, i in zip(views, images, strict=True)]))

    result = fit(wrong, renderer, views, reference=images, steps=0)
    assert errors(result) < 0.7 * errors(wrong)
    parameters = Parameters.of(model, 16, 16, len(stack.levels))
    values, channels = parameters.values(list(result.levels)), parameters.channels
    assert np.isfinite(values).all()
    assert (values >= np.float32(channels.low) - 1e-6).all() and (values <= np.float32(channels.high) + 1e-6).all()


@pytest.mark.long
def test_a_budget_that_is_too_short_has_no_rounds() -> None:
    told = fitted(steps=None, budget=0.05, rounds=1).provenance.adjustments[-1]
    assert "least squares" not in told
    assert re.search(r"steps and 1 round of least squares with", fitted(rounds=1, steps=4).provenance.adjustments[-1])
    assert (
        "least squares"
        not in fitted(stack=start(), reference=images_of(start(), Plain()), **ROUND).provenance.adjustments[-1]
    )
    assert "steps and 2 rounds of" in fitted(rounds=2, steps=None, budget=60.0, rate=1e-6).provenance.adjustments[-1]


def test_a_failure_within_a_round_keeps_the_steps(tmp_path: Path) -> None:
    settings: dict[str, Any] = {"steps": 32, "rounds": 1, "reference": images_of(inner(), Plain())}
    whole = fitted(Plain(), **settings)
    counted = Plain()
    fitted(counted, **(settings | {"rounds": 0}))

    def broken(frame: Frame, count: int) -> Frame:
        return replace(frame, image=frame.image * np.nan) if count > len(counted.log) + 40 else frame

    file = tmp_path / "fit"
    with pytest.raises(RendererError, match=f"What was fitted so far is kept in {re.escape(str(file))}"):
        fitted(Plain(broken), checkpoint=file, **settings)
    assert same(fitted(Plain(), checkpoint=file, **settings), whole)
