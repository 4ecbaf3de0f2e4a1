"""Batches in the process of a test, and a small library for them."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.baking import BakeOptions
from mipbake.library import BatchOptions, EntryResult, Summary, bake_library
from mipbake.library import run as batch_run
from mipbake.library.task import Task, work

from .command_line import write_set

LINEAR = BakeOptions(method="linear", format="png", max_level=1)


class Inline:
    """Workers that do tasks in the process of the test, and remember which."""

    def __init__(self) -> None:
        self.labels: list[str] = []

    def processes(self, _count: int) -> int:
        return 1

    def done(self, tasks: Iterable[Task]) -> Iterator[EntryResult]:
        for task in tasks:
            self.labels.append(task.entry.label)
            yield work(task)

    @contextmanager
    def workers(self, _jobs: int, _share: object) -> Iterator[Inline]:
        self.labels.clear()
        yield self


@pytest.fixture(name="inline")
def inline_workers(monkeypatch: pytest.MonkeyPatch, unmeasured: None) -> Inline:
    made = Inline()
    monkeypatch.setattr(batch_run, "workers", made.workers)
    return made


def aged(root: Path, by: float = 10.0) -> Path:
    """A folder whose files are older, so that their times tell whether they have changed."""
    then = time.time() - by
    for path in root.rglob("*"):
        os.utime(path, (then, then))
    return root


@pytest.fixture(name="library")
def small_library(tmp_path: Path) -> Path:
    root = tmp_path / "lib"
    write_set(root / "metals" / "steel")
    write_set(root / "wood", roughness=np.full((16, 16), 90, np.uint8))
    return aged(root)


def bake(library: Path, options: BakeOptions = LINEAR, **how: Any) -> Summary:
    return bake_library(library, library.parent / "out", options, None, BatchOptions(**how))


def counts(summary: Summary) -> tuple[int, int, int]:
    return summary.baked, summary.unchanged, len(summary.failures)


def only(summary: Summary, kind: type) -> Any:
    (found,) = [each for entry in summary.entries for each in entry.results if isinstance(each, kind)]
    return found
