"""What a long search says is ahead: held against descents whose rounds take a known time, on a clock of the test."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from mipbake.baking.search import forecast
from mipbake.baking.search.forecast import FEWEST, Forecast, cost_of_round
from mipbake.baking.search.methods import REFINING
from mipbake.baking.search.regions import timed_regions
from mipbake.base.messages import time_text
from mipbake.quality.reference.problem import Problem

PROBLEM = Problem(np.zeros((2048, 1024, 8), np.float32), "gltf", "gltf", "gaussian", ("wrap", "wrap"))
REGIONS = list(timed_regions(PROBLEM, REFINING.window, REFINING.coarse))
COSTS = [cost_of_round(PROBLEM, timed, REFINING) for timed in REGIONS]
PACE = 7e-7
ALL = (REFINING.rounds + 1) * sum(COSTS) * PACE
"""Seconds of all rounds, where what comes before a region takes as long as a round."""


class Clock:
    now = 0.0

    def monotonic(self) -> float:
        return self.now


def descended(monkeypatch: pytest.MonkeyPatch, seconds: float, before: float = 0.0, slower: float = 1.0):
    """Sentences with their times, rounds of each window of level 0, and when it ended.

    Args:
        before: seconds before the descent. slower: factor of the time of rounds of level 0.
    """
    clock, notes, reached = Clock(), list[tuple[float, str]](), list[int]()
    monkeypatch.setattr(forecast, "time", clock)
    clock.now = before
    made = Forecast(
        PROBLEM,
        REFINING,
        REGIONS,
        range(len(REGIONS)),
        0.0,
        seconds,
        seconds,
        lambda each: notes.append((clock.now, each)),
    )
    for index, timed in enumerate(REGIONS):
        finest = timed.region.levels.start == 0
        one = COSTS[index] * PACE * (slower if finest else 1)
        share = timed.share / sum(each.share for each in REGIONS[index:])
        until = clock.now + max(0.0, seconds - clock.now) * share if math.isfinite(seconds) else math.inf
        rounds = 0
        if until - clock.now > FEWEST * made.round_seconds(index):
            made.begun(index, until)
            clock.now += one
            while rounds < REFINING.rounds and clock.now + one / 2 <= until:
                rounds, clock.now = rounds + 1, clock.now + one
                made.worked(rounds, range(index + 1, len(REGIONS)))
        reached += [rounds] if finest else []
    return notes, reached, clock.now


def test_without_a_limit_the_most_that_it_takes_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    notes, _, end = descended(monkeypatch, math.inf)
    assert end == pytest.approx(ALL)
    ((when, sentence),) = notes
    assert 10 <= when < 20
    assert sentence == (
        f"all 60 rounds of every level would take about {time_text(end - when)} from now: the search takes at most "
        "so long, and less where nothing moves any more"
    )


@pytest.mark.parametrize("part", [0.03, 0.3, 0.7])
def test_it_is_said_how_far_the_budget_reaches(monkeypatch: pytest.MonkeyPatch, part: float) -> None:
    notes, reached, _ = descended(monkeypatch, part * ALL + 5, before=5.0)
    when, sentence = notes[0]
    assert when <= 20 and len(notes) == 1
    found = re.fullmatch(
        r"the budget reaches (no|about (\d+) of 60) rounds of level 0: all 60 rounds of every level would take a "
        r"budget of about (.+)",
        sentence,
    )
    assert found and abs(int(found[2] or 0) - np.mean(reached)) <= 0.1 * np.mean(reached) + 1, (sentence, reached)
    assert found[3] in {time_text(ALL + 5 + more) for more in np.linspace(-0.03, 0.03, 31) * ALL}


def test_a_budget_that_is_enough_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    notes, reached, end = descended(monkeypatch, 4 * ALL)
    ((when, sentence),) = notes
    assert set(reached) == {60}
    assert sentence.startswith("the budget reaches all 60 rounds of every level, which take at most about ")
    assert sentence.endswith(f" {time_text(end - when)} from now")


def test_a_forecast_that_turns_out_to_be_wrong_is_said_again(monkeypatch: pytest.MonkeyPatch) -> None:
    notes, _, end = descended(monkeypatch, math.inf, slower=4.0)
    assert 1 < len(notes) < 5
    left = re.search(r"about (.+) h from now", notes[-1][1])
    minutes = re.search(r"about (.+) min from now", notes[-1][1])
    seconds = float(left[1]) * 3600 if left else float(minutes[1]) * 60 if minutes else 0.0
    assert abs(seconds - (end - notes[-1][0])) < 0.5 * end


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "0 s"), (9.96, "10 s"), (59.9, "1 min"), (45, "45 s"), (725, "12 min"), (5400, "1.5 h"), (50_000, "14 h")],
)
def test_times_are_told_in_two_digits(seconds: float, text: str) -> None:
    assert time_text(seconds) == text
