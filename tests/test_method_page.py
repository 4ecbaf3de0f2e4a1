"""docs/method.md prints the numbers that the code has."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mipbake.material.aim import DEFAULT_AIM
from mipbake.quality.judging.terms import PICTURES, TERMS, weights_for

PAGE = (Path(__file__).resolve().parent.parent / "docs" / "method.md").read_text(encoding="utf-8")


def rows(head: str) -> list[list[str]]:
    """The cells of the table with that first line."""
    _, _, table = PAGE.partition(head + "\n")
    lines = table.partition("\n\n")[0].splitlines()[1:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_weights_are_the_ones_of_the_code() -> None:
    said = {
        name: tuple(float(cell.strip("`")) for cell in row[2:])
        for row in rows("| term | error | counts | behind |")
        for name in re.findall(r"`([^`]+)`", row[0])
    }
    weights = weights_for(DEFAULT_AIM)
    assert said == {name: pytest.approx((weights.terms[name].counts, weights.terms[name].behind)) for name in TERMS}
    assert f"+ {weights.group_behind:g} sum over pair sets" in PAGE
    ties = {each.tie: None for each in weights.terms.values()}
    pairs, pictures = ties
    assert f"allowed = {pairs:g} + half the standard error" in PAGE
    assert f"{pictures:g} in place of {pairs:g} for visible errors" in PAGE
    assert f"/ aim, that is {weights.looks_worse:g} at the default aim" in " ".join(PAGE.split())


AIMS = rows("| aim | counts, pairs | counts, seen | behind, pairs | behind, seen | groups | allowed, pairs |")


@pytest.mark.parametrize("row", AIMS, ids=[row[0] for row in AIMS])
def test_an_aim_moves_the_weights_as_in_the_code(row: list[str]) -> None:
    aim, pairs, seen, factor, behind, groups, allowed = (float(cell.strip("`")) for cell in row)
    weights, at_zero = weights_for(aim), weights_for(0)

    def expected(value: float) -> object:
        return pytest.approx(value, rel=2e-3)

    for name, found in weights.terms.items():
        assert found.counts == expected(seen if name in PICTURES else pairs)
        assert found.behind == expected(behind if name in PICTURES else at_zero.terms[name].behind * factor)
    tie = weights.terms["near-mirror"].tie
    assert (weights.group_behind, tie) == (expected(groups), expected(allowed))
