"""Rounds of least squares that end a fit: what they find, what stops them, and what they leave alone."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake import MipStack
from mipbake.base.errors import RendererError, UsageError
from mipbake.fitting import Frame, Levels, fit, standard_views
from mipbake.fitting.kernels import TorchRenderer
from mipbake.fitting.loop import FitSettings
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.shared import Rounds, SharedNumbers
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


def test_levels_that_gain_nothing_stay_bit_for_bit() -> None:
    stack = start()
    assert same(fitted(stack=stack, reference=images_of(stack, Plain()), **ROUND), stack)
    one = replace(stack, levels=[*stack.levels[:1], 0.9 * stack.levels[1], *stack.levels[2:]])
    result = fitted(stack=one, reference=images_of(stack, Plain()), **ROUND)
    kept = [a.tobytes() == b.tobytes() for a, b in zip(result.levels, one.levels, strict=True)]
    assert kept == [True, False, True, True]


@pytest.mark.long
@pytest.mark.parametrize("model", MODELS)
def test_rounds_of_other_models_stay_within_limits_and_gain(model: str) -> None:
    stack, renderer = stack_of(material(model, 16, 16), model), TorchRenderer()
    views = standard_views((16, 16), REPEATS, each=3)
    images = [renderer.render(levels_of(stack), view).image for view in views]
    wrong = replace(stack, levels=[0.85 * level for level in stack.levels])

    def errors(of: MipStack) -> float:
        return float(np.mean([error(of, renderer, view, i) for view, i in zip(views, images, strict=True)]))

    result = fit(wrong, renderer, views, reference=images, **ROUND)
    assert errors(result) < 0.5 * errors(wrong)
    parameters = Parameters.of(model, 16, 16, len(stack.levels))
    values, channels = parameters.values(list(result.levels)), parameters.channels
    assert np.isfinite(values).all()
    assert (values >= np.float32(channels.low) - 1e-6).all() and (values <= np.float32(channels.high) + 1e-6).all()


def test_numbers_move_one_map_each_by_two_steps_of_8_bits() -> None:
    parameters = Parameters.of("gltf", 8, 8, 4)
    values, shared = parameters.values(list(inner().levels)), SharedNumbers(parameters)
    steps = np.asarray(parameters.channels.magnitude)
    for level in range(3):
        numbers = shared.of(values, level)
        assert len(numbers) == 7 + 4  # channels whose values are free, and maps
        for number in numbers:
            maps = parameters.model.maps.values()
            assert sum(bool(set(number.channels) & set(range(own.start, own.stop))) for own in maps) == 1
            own = slice(*parameters.starts[level : level + 2])
            by = (shared.moved(values, level, [number], [1.0]) - values[own])[:, number.channels]
            sizes = np.square(by / steps[list(number.channels)]).sum(-1)
            assert np.sqrt(sizes.mean()) == pytest.approx(2, rel=1e-3)
    assert len(shared.of(values, 3)) == 7  # one texel has no contrast
    others = [parameters.values(list(start().levels)), values]  # metallic and roughness of `start` are others
    towards = [number for number in SharedNumbers(parameters, others).of(values, 1) if number.other is not None]
    assert [(number.other, number.channels) for number in towards] == [(0, (3,)), (0, (4,))]
    whole = [1 / number.factor for number in towards]
    moved = SharedNumbers(parameters, others).moved(values, 1, towards, whole)
    assert moved[:, :5] == pytest.approx(others[0][slice(*parameters.starts[1:3]), :5], abs=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("name", ["metallic", "roughness"])
def test_what_lies_at_a_limit_can_leave_it(name: str) -> None:
    for limit, wanted in ((1.0, 0.9), (0.0, 0.1)):
        right = changed(inner(), name, lambda a, wanted=wanted: np.full_like(a, wanted))
        wrong = changed(right, name, lambda a, limit=limit: np.full_like(a, limit))
        images = images_of(right, Plain())
        result = fitted(Plain(), stack=wrong, reference=images, **(ROUND | {"rounds": 3}))
        found = [abs(float(level[..., MODELS["gltf"].maps[name]].mean()) - limit) for level in result.levels]
        assert min(found) > 0.01  # other maps do much of the same
        assert worst(result, Plain(), images) < worst(wrong, Plain(), images) / 8


def test_short_budgets_learn_from_some_views_of_each_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    """A render takes a hundredth of a second, and a round of 16 views 444 renders: 192 to learn, and 252 to judge."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])

    @dataclass(frozen=True)
    class Rendering:
        parameters: Parameters

        def errors(self, _values: Any, views: Any) -> None:
            now[0] += 0.01 * len(views)

    @dataclass(frozen=True, eq=False)
    class View:
        scale: str
        shares: np.ndarray

    parameters = Parameters.of("gltf", 8, 8, 4)
    values, shares = parameters.values(list(inner().levels)), np.array([1.0, 0.0, 0.0, 0.0])
    views: Any = [View(scale, shares) for scale in "aabaaabaaabaaaab"]
    counts = []
    for budget in (20.0, 8.8, 7.5):
        settings = FitSettings(budget=budget)
        planned = Rounds.planned(Rendering(parameters), values, (views, views[:2]), range(4), settings)  # type: ignore[arg-type]
        counts.append((planned.count, "".join(sorted(view.scale for view in planned.learning))))  # type: ignore[attr-defined]
    assert counts == [(1, "a" * 12 + "b" * 4), (1, "aaab"), (0, "a" * 12 + "b" * 4)]
    # Steps move levels away from the stack that they start from, so that each map can move back: 64 renders more.
    moved = [
        Rounds.planned(Rendering(parameters), values, (views, views[:2]), range(4), settings, [values]).seconds  # type: ignore[arg-type]
        for settings in (FitSettings(steps=0, budget=60.0), FitSettings(budget=60.0))
    ]
    assert moved[1] - moved[0] == pytest.approx(0.01 * 16 * 4)


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


def test_rounds_that_make_no_sense() -> None:
    with pytest.raises(UsageError, match="rounds is -1: expected 0 or more"):
        fitted(rounds=-1)
