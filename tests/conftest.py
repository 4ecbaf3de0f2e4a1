"""What several files of tests share as fixtures."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

# Read when torch and NumPy are loaded. Tensors of tests are small: more threads cost more than they bring.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from mipbake.base import progress

from .chromium import headless
from .command_line import write_set

progress.EVERY = 3600.0  # what tests find on stderr does not hang on how fast the machine is


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium, one for each file of tests."""
    with headless() as started:
        yield started


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A small texture set."""
    return write_set(tmp_path / "metal")


@pytest.fixture
def unmeasured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bakes in this process do not measure what their files cost, which is nine tenths of the bake of a small set."""
    from mipbake.stack.checking import Check

    for measures in (Check.files, Check.glb):
        monkeypatch.setattr(Check, measures.__name__, lambda *_: {})


@pytest.fixture
def quick_validation(monkeypatch: pytest.MonkeyPatch) -> None:
    """`mipbake validate` measures little."""
    import mipbake

    monkeypatch.setattr(mipbake, "validate", partial(mipbake.validate, lods=(0, 1), points=32, samples=8))


@pytest.fixture
def quick_comparison(monkeypatch: pytest.MonkeyPatch) -> None:
    """`mipbake compare` measures little."""
    from mipbake.comparing import comparison, plots

    monkeypatch.setattr(comparison, "MeasureEffort", partial(comparison.MeasureEffort, points=64, samples=8))
    monkeypatch.setattr(comparison, "RenderSettings", partial(comparison.RenderSettings, max_passes=32))
    monkeypatch.setattr(plots, "temporal_slice", partial(plots.temporal_slice, size=(24, 16), passes=8))
