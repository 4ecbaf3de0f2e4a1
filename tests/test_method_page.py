"""docs/method.md prints the numbers that the code has."""

from __future__ import annotations

import re
from pathlib import Path
from pkgutil import resolve_name

import pytest

from mipbake.aim import DEFAULT_AIM
from mipbake.judging.weights import TERMS, weights_for

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
    found = resolve_name(place.strip("`"))
    expected = found if isinstance(found, tuple) else (found,)
    assert tuple(float(each) for each in number.strip("`").split(",")) == expected


def test_the_weights_are_the_ones_of_the_code() -> None:
    said = {
        name: tuple(float(cell.strip("`")) for cell in row[2:])
        for row in rows("| term | error | counts | behind |")
        for name in re.findall(r"`([^`]+)`", row[0])
    }
    weights = weights_for(DEFAULT_AIM)
    found = {name: (weights.terms[name].counts, weights.terms[name].behind) for name in TERMS}
    assert said == {name: pytest.approx(each) for name, each in found.items()}
    assert f"default [aim](#sampler-and-aim), {DEFAULT_AIM:g}" in PAGE
    assert f"+ {weights.group_behind:g} sum over pair sets" in PAGE
