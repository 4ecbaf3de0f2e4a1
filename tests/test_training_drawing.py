"""Batches drawn beside the training."""

from __future__ import annotations

import os
import platform
import signal
import time
from dataclasses import dataclass

import pytest
import torch

from mipbake.base.errors import MipbakeError, UsageError
from mipbake.training.batches import batches
from mipbake.training.data import load_materials
from mipbake.training.drawing import Drawer

from .small_training import tiny


@dataclass(frozen=True)
class Batch:
    """A batch with the shape that batches of a training have."""

    source: str
    patches: torch.Tensor
    views: tuple[torch.Tensor, ...]
    independent: torch.Tensor | None


def batch(index: int) -> Batch:
    generator = torch.Generator().manual_seed(index)
    views = (torch.rand(2, 3, generator=generator), torch.arange(7, dtype=torch.int32) + index)
    return Batch("ggx", torch.rand(1, 5 + index, 4, 3, generator=generator), views, None)


def same(left: Batch, right: Batch) -> bool:
    pairs = zip((left.patches, *left.views), (right.patches, *right.views), strict=True)
    equal = all(a.dtype == b.dtype and torch.equal(a, b) for a, b in pairs)
    return equal and left.source == right.source and left.independent is right.independent is None


@pytest.mark.parametrize("system", ["Linux", "Darwin"])
def test_batches_arrive_whole_and_in_order(system: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if system == "Linux" != platform.system():
        pytest.skip("no processes are forked here")
    monkeypatch.setattr(platform, "system", lambda: system)
    kept, drawn = [], (0, 1, 800, 2)  # one is far larger than the example, as frames that are accumulated make it
    with Drawer(batch, 0) as drawer:
        for index in drawn:
            drawer.ask(index)
            kept.append(drawer.take())
    # Later batches do not overwrite those that are kept.
    assert all(same(found, batch(index)) for index, found in zip(drawn, kept, strict=True))
    kept[0].patches.add_(1)  # nor are they read-only


@pytest.mark.parametrize("system", ["Linux", "Darwin"])
def test_several_are_drawn_at_a_time(system: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if system == "Linux" != platform.system():
        pytest.skip("no processes are forked here")
    monkeypatch.setattr(platform, "system", lambda: system)
    with Drawer(late_if_even, 0, ahead=3) as drawer:
        for index in range(3):
            drawer.ask(index)
        for index in range(6):
            assert same(drawer.take(), batch(index))
            drawer.ask(index + 3)


def late_if_even(index: int) -> Batch:
    time.sleep(0.05 * (index % 2 == 0))  # the next one is there first
    return batch(index)


def fails(index: int) -> Batch:
    if index:
        raise UsageError(f"no batch {index}")
    return batch(index)


def test_what_drawing_raises_is_raised() -> None:
    with Drawer(fails, 0) as drawer:
        drawer.ask(3)
        with pytest.raises(UsageError, match="no batch 3"):
            drawer.take()
        drawer.ask(0)
        assert same(drawer.take(), batch(0))


def dies(index: int) -> Batch:
    if index:
        os.kill(os.getpid(), signal.SIGKILL)
    return batch(index)


@pytest.mark.skipif(platform.system() != "Linux", reason="no processes are forked here")
def test_the_death_of_the_process_is_told() -> None:
    with Drawer(dies, 0) as drawer:
        drawer.ask(1)
        with pytest.raises(MipbakeError, match="died"):
            drawer.take()


def test_what_is_trained_on_does_not_depend_on_how_many_are_drawn_at_a_time() -> None:
    config = tiny(run={"uses": 2})
    materials, _ = load_materials(config)
    one, several = (list(batches(materials, config, 2, ahead=ahead)) for ahead in (1, 3))
    assert len(one) == len(several) == config.run.steps - 2
    for here, there in zip(one, several, strict=True):
        assert torch.equal(here.patches, there.patches)
        assert torch.equal(here.noisy_reference, there.noisy_reference)
