"""Small stacks and training steps of every kind are what they were: bit by bit on the machine of the record."""

from __future__ import annotations

import pytest

from mipbake.baking.methods import METHODS

from .golden import record

EVERYTHING = record.everything()


def test_the_record_holds_every_result_and_every_method_is_among_them() -> None:
    _, wanted = record.read()
    assert list(wanted) == list(EVERYTHING)
    for method in METHODS:
        assert any(f", {method} (" in name for name in EVERYTHING)


@pytest.mark.long
@pytest.mark.parametrize("name", EVERYTHING)
def test_results_are_as_recorded(name: str) -> None:
    place, wanted = record.read()
    found = record.made(EVERYTHING[name])
    assert not wanted[name].differs(found, place == record.machine()), "python -m tests.golden says what differs"
