"""Fits with a budget, on a clock that nothing but a renderer moves."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import pytest

from mipbake.fitting import Levels, Progress
from mipbake.stack.stack import MipStack

from .fitting_small import Plain, Spot, fitted, same, spots, start


class Slow(Plain):
    """Each frame takes a twentieth of a second of a clock that nothing else moves."""

    now = 0.0

    def render(self, levels: Levels, view: Spot) -> Any:
        self.now += 0.05
        return super().render(levels, view)


@pytest.mark.parametrize("rounds", [0, 1])
def test_a_budget_holds_for_everything(rounds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first stack that gained is there early, and views that judge the result fit into it, too."""
    renderer, told, left = Slow(), list[Progress](), list[float | None]()
    monkeypatch.setattr("time.monotonic", lambda: renderer.now)
    first: list[MipStack] = []

    def progress(now: Progress) -> None:
        told.append(now)
        if now.share < 0.15:
            first[:] = [now.stack()]

    with warnings.catch_warnings():
        warnings.filterwarnings("error", "the budget")
        result = fitted(
            renderer, spots(40), steps=None, budget=100.0, passes=None, rounds=rounds, progress=progress,
            working=lambda _share, seconds: left.append(seconds),
        )  # fmt: skip
    assert 90 < renderer.now <= 100
    assert [each is not None and each >= 0 for each in left] == [True] * len(left)
    assert first and not same(first[0], start()) and not same(first[0], result)
    assert "views that nothing was learned from or chosen by" in result.provenance.adjustments[-1]
    assert ("of least squares" in result.provenance.adjustments[-1]) == bool(rounds)


def test_a_budget_that_is_too_short_leaves_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    renderer = Slow()
    monkeypatch.setattr("time.monotonic", lambda: renderer.now)
    with pytest.warns(UserWarning, match=r"the budget of 1 s left no time for a step in test, because views are"):
        assert same(fitted(renderer, steps=None, budget=1.0), start())


def test_a_fit_that_was_stopped_late_in_its_budget_goes_on_without_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopped(Slow):
        def render(self, levels: Levels, view: Spot) -> Any:
            if self.now > 60:
                raise KeyboardInterrupt
            return super().render(levels, view)

    renderer, told = Stopped(), list[Progress]()
    monkeypatch.setattr("time.monotonic", lambda: renderer.now)
    settings: dict[str, Any] = {"passes": None, "checkpoint": tmp_path / "fit", "progress": told.append}
    with pytest.raises(KeyboardInterrupt):
        fitted(renderer, spots(40), steps=400, budget=100.0, **settings)
    before = told[-1].step
    fitted(Slow(), spots(40), steps=400, budget=None, **settings)
    assert 0 < before < 400 and told[-1].step == 400
