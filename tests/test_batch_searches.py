"""Searches in batches: one that was cut off goes on in the next batch."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mipbake.baking import BakeOptions, sets
from mipbake.baking.methods import LongRun, Stop
from mipbake.library import bake_library

from .batch_inline import Inline, aged, counts, inline_workers
from .command_line import bumps, write_set
from .long_searches import with_many_regions, without_pauses

__all__ = ["inline_workers"]
"""A fixture."""

REFINE = BakeOptions(method="refine", budget="best", format="png")


class CutOffError(BaseException):
    """What ends a process in the middle of its work."""


@contextmanager
def stopped_at_once() -> Iterator[Stop]:
    yield lambda: True


@pytest.fixture(name="library")
def small_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    with_many_regions(monkeypatch.setattr)
    without_pauses(monkeypatch.setattr)
    write_set(tmp_path / "lib/metals/steel", **bumps(16, 32))
    return aged(tmp_path / "lib")


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def long_runs(monkeypatch: pytest.MonkeyPatch, cut_off: bool = False, told: list[str] | None = None) -> list[LongRun]:
    """The long runs of bakes from now on.

    Args:
        cut_off: whether each is stopped when it has a checkpoint, and the process ends then.
        told: takes what they tell.
    """
    found: list[LongRun] = []
    plain = sets.bake_stoppable

    def bake_stoppable(*arguments: Any) -> Any:
        *others, long_run = arguments
        found.append(long_run)
        if cut_off:
            plain(*others, replace(long_run, descending=stopped_at_once))
            raise CutOffError
        return plain(*others, long_run if told is None else replace(long_run, note=told.append))

    monkeypatch.setattr(sets, "bake_stoppable", bake_stoppable)
    return found


@pytest.mark.long
def test_a_search_goes_on_in_the_next_batch(library: Path, inline: Inline, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, out = library.parent / "whole", library.parent / "out"
    assert counts(bake_library(library, whole, REFINE)) == (1, 0, 0)
    with monkeypatch.context() as patch:
        long_runs(patch, cut_off=True)
        with pytest.raises(CutOffError):
            bake_library(library, out, REFINE)
    kept = out / "metals/steel/.steel.search"
    assert (kept / "start.npz").is_file() and not (out / "metals/steel/steel").exists()
    told: list[str] = []
    long_runs(monkeypatch, told=told)
    assert counts(bake_library(library, out, REFINE)) == (1, 0, 0)
    assert told and told[0].startswith(f"going on from the checkpoint {kept}")
    assert content(out / "metals/steel/steel") == content(whole / "metals/steel/steel") and not kept.exists()
