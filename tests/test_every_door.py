"""Every door gives the same results on any number of threads and on every instruction set of this processor."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mipbake import _native

from .door_results import DOORS, Results
from .raster_scenes import threads

ROOT = Path(__file__).resolve().parents[1]


@cache
def here(door: str) -> Results:
    with threads(1):
        return DOORS[door]()


@cache
def elsewhere(isa: str) -> dict[str, np.ndarray]:
    """Results of a process that uses that instruction set, or the best below it."""
    command = [sys.executable, "-m", "tests.door_results"]
    run = subprocess.run(command, env={**os.environ, "MIPBAKE_ISA": isa}, capture_output=True, check=True, cwd=ROOT)
    return dict(np.load(io.BytesIO(run.stdout)))


@pytest.mark.parametrize("count", [3])
@pytest.mark.parametrize("door", DOORS)
def test_bits_do_not_depend_on_the_number_of_threads(door: str, count: int) -> None:
    with threads(count):
        found = DOORS[door]()
    for (array, _), (expected, _) in zip(found, here(door), strict=True):
        assert array.tobytes() == expected.tobytes()


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize("door", DOORS)
def test_every_instruction_set_agrees(door: str, isa: str) -> None:
    if isa == _native.isa():
        pytest.skip(f"{isa} is what the other tests use")
    found = elsewhere(isa)
    if str(found["isa"]) != isa:
        pytest.skip(f"this processor or build has no {isa}")
    assert sum(name.startswith(f"{door} ") for name in found) == len(here(door))
    for index, (expected, error) in enumerate(here(door)):
        array = found[f"{door} {index}"]
        if error == 0:
            assert array.tobytes() == expected.tobytes(), index
        else:
            assert np.linalg.norm(array - expected) <= error * max(np.linalg.norm(expected), 1e-30), index
