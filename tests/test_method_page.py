"""docs/method.md prints the numbers that the code has."""

from __future__ import annotations

import re
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest

from mipbake.aim import DEFAULT_AIM
from mipbake.judging.weights import SEEN, TERMS, weights_for
from mipbake.metrics.pairs import PAIR_SETS

PAGE = (Path(__file__).resolve().parent.parent / "docs" / "method.md").read_text(encoding="utf-8")


def rows(head: str) -> list[list[str]]:
    """The cells of the table with that first line."""
    _, _, table = PAGE.partition(head + "\n")
    lines = table.partition("\n\n")[0].splitlines()[1:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


NUMBERS = rows("| what | number | place in the code | where it comes from |")


def test_the_table_of_numbers_has_rows() -> None:
    assert len(NUMBERS) > 30


@pytest.mark.parametrize(("number", "place"), [(row[1], row[2]) for row in NUMBERS])
def test_a_number_is_the_one_of_the_code(number: str, place: str) -> None:
    expected = np.ravel(resolve_name(place.strip("`"))).tolist()
    assert [float(each) for each in number.strip("`").split(",")] == expected


def test_the_weights_are_the_ones_of_the_code() -> None:
    said = {
        name: tuple(float(cell.strip("`")) for cell in row[2:])
        for row in rows("| term | error | counts | behind |")
        for name in re.findall(r"`([^`]+)`", row[0])
    }
    weights = weights_for(DEFAULT_AIM)
    assert said == {name: pytest.approx((weights.terms[name].counts, weights.terms[name].behind)) for name in TERMS}
    assert f"+ {weights.group_behind:g} sum over pair sets" in PAGE


AIMS = rows(
    "| aim | what a term of pairs counts | what a term of what is seen counts | factor of what pairs behind count "
    "| groups behind |"
)


@pytest.mark.parametrize("row", AIMS, ids=[row[0] for row in AIMS])
def test_an_aim_moves_the_weights_as_in_the_code(row: list[str]) -> None:
    aim, pairs, seen, factor, groups = (float(cell.strip("`")) for cell in row)
    weights, at_zero = weights_for(aim), weights_for(0)
    for name in TERMS:
        found, before = weights.terms[name], at_zero.terms[name]
        assert found.counts == pytest.approx(seen if name in SEEN else pairs)
        assert found.behind == pytest.approx(before.behind * (1 if name in SEEN else factor))
    assert weights.group_behind == pytest.approx(groups)


def test_what_is_said_between_the_aims_holds() -> None:
    """By the same factor with every step; evenly; and as it is up to 1/2, then evenly, nearly to the end."""
    at = [weights_for(aim) for aim in (0.0, 0.25, 0.5, 0.75, 0.95)]
    pairs, seen = (np.array([each.terms[name].counts for each in at[:4]]) for name in (next(iter(PAIR_SETS)), SEEN[0]))
    assert np.diff(np.log(pairs)) == pytest.approx(np.log(pairs[1] / pairs[0]))
    assert np.diff(seen) == pytest.approx(seen[1] - seen[0])
    groups = [each.group_behind / at[0].group_behind for each in at]
    assert groups == pytest.approx([1, 1, 1, 0.5, 0.1])
