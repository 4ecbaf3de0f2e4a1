"""Checkpoints of fits and trainings that two processes want, that are damaged, and that cannot be written."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.checkpoints import alone_with, write_arrays
from mipbake.base.errors import InputError, OutputError, UsageError
from mipbake.training.loop import load_state, new_state

from .fitting_small import SIDE, Plain, fitted, spots
from .small_training import tiny, train

VIEWS = spots(2, (0, 1))


def fit(folder: Path, renderer: Any = None, **more: Any) -> Path:
    file = folder / "state.fit"
    grey = [np.full((SIDE, SIDE, 3), 0.2)] * len(VIEWS)
    fitted(renderer or Plain(), VIEWS, reference=grey, steps=8, checkpoint=file, **more)
    return file


@pytest.mark.skipif(os.name == "nt", reason="locks as POSIX has them")
@pytest.mark.parametrize("work", [fit, lambda folder: train(tiny(), folder, resume=True)])
@pytest.mark.parametrize("there", [b"an earlier one", None])
def test_a_second_one_is_told(work: Callable[[Path], Any], there: bytes | None, tmp_path: Path) -> None:
    files = [tmp_path / "last.npz", tmp_path / "state.fit"]
    for file in files if there else ():
        file.write_bytes(there or b"")
    with alone_with(files[0]), alone_with(files[1]):
        before = sorted(tmp_path.iterdir())
        with pytest.raises(UsageError, match=r"the checkpoint .* is in use by another process: wait until that ends"):
            work(tmp_path)
        assert sorted(tmp_path.iterdir()) == before
    assert [file.read_bytes() for file in sorted(tmp_path.iterdir())] == ([there] * 2 if there else [])


def test_a_second_fit_is_told_while_the_first_one_renders(tmp_path: Path) -> None:
    """Whatever it does meanwhile, also before there is anything to keep."""

    class Twice(Plain):
        def render(self, *given: Any) -> Any:
            if not self.log:
                with pytest.raises(UsageError, match="in use by another process"):
                    fit(tmp_path)
            return super().render(*given)

    assert [path.name for path in fit(tmp_path, Twice()).parent.iterdir()] == ["state.fit"]


def kept_training(folder: Path) -> Path:
    new_state(tiny()).save(folder / "last.npz")
    return folder / "last.npz"


@pytest.mark.parametrize(
    ("kept", "read", "said"),
    [
        (fit, fit, "delete it to begin anew"),
        (kept_training, lambda folder: load_state(folder / "last.npz"), "train anew"),
    ],
)
def test_damage_is_noticed(kept, read, said, tmp_path):
    file = kept(tmp_path)
    read(tmp_path)
    content = file.read_bytes()
    half, third = len(content) // 2, len(content) // 3
    flipped = content[:third] + bytes(each ^ 1 for each in content[third:half]) + content[half:]
    at = content.index(b"PK\1\2")  # the entry of an array: the version that it needs, its flags, and how it is packed
    entries = [content[: at + place] + b"\xff" + content[at + place + 1 :] for place in (6, 8, 10)]
    torn = content[:half], b"", bytes(len(content)), content[:half] + bytes(len(content) - half)
    for damaged in (*torn, flipped, *entries):
        file.write_bytes(damaged)
        with pytest.raises(InputError, match=said):
            read(tmp_path)


def test_an_earlier_one_stays_where_a_new_one_cannot_be_written(tmp_path, monkeypatch):
    file = fit(tmp_path)
    before = file.read_bytes()

    def full(_handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    for write in (lambda: write_arrays(file, {"a": np.zeros(3)}), lambda: new_state(tiny()).save(file)):
        with pytest.raises((OSError, OutputError), match=r"[Nn]o space|the disk is full"):
            write()
        assert [path.name for path in tmp_path.iterdir()] == ["state.fit"] and file.read_bytes() == before
