"""What a fit tries before its first step, and renderers whose arrays are not what they seem."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from mipbake.fitting import Frame

from .fitting_small import SIDE, Plain, fitted, same, source_levels, spots, start, texture_set

WANTED = np.full((SIDE, SIDE, 3), 0.2)
"""What the views shall show."""


class Blind(Plain):
    """Shows the maps in some views alone."""

    def __init__(self, seeing: Callable[[str], bool]) -> None:
        super().__init__()
        self.seeing = seeing

    def render(self, levels: Any, view: Any) -> Any:
        frame = super().render(levels, view)
        return frame if self.seeing(view.name) else replace(frame, image=np.full_like(frame.image, 0.3))


def test_one_view_that_shows_nothing_is_no_fault(recwarn: pytest.WarningsRecorder) -> None:
    result = fitted(Blind(lambda name: name != spots()[0].name), steps=32)
    assert not same(result, start()) and not recwarn.list


def test_views_that_mostly_show_nothing_are_told_of() -> None:
    with pytest.warns(UserWarning, match=r"of 8 views that were tried, 7 \(spot 2 of level 0, \.\.\.\) look the same"):
        fitted(Blind(lambda name: name == spots()[0].name), steps=16)


class Coarser(Plain):
    """Looks up one level more than its frames say."""

    def render(self, levels: Any, view: Any) -> Any:
        frame = super().render(levels, view)
        return replace(frame, lod=np.maximum(np.asarray(frame.lod) - 1, 0))


def test_frames_that_name_the_wrong_level_are_told_of() -> None:
    views = spots(levels=(1, 2, 3))
    with pytest.warns(UserWarning, match=r"in 6 .* of 6 views .* texels that its frame does not name, .*: expected"):
        fitted(Coarser(), views, reference=[WANTED] * len(views), steps=8)


def test_frames_that_name_the_right_level_are_not_told_of(recwarn: pytest.WarningsRecorder) -> None:
    fitted(Plain(), steps=8)
    assert not recwarn.list


# ---- arrays that a renderer uses again


class Reusing(Plain):
    """Returns the same arrays at every render, with other numbers."""

    def render(self, levels: Any, view: Any) -> Any:
        frame = super().render(levels, view)
        if not hasattr(self, "kept"):
            self.kept = Frame(*(np.empty(np.shape(a), np.float32) for a in (frame.image, frame.uv, frame.lod)))
        for name in ("image", "uv", "lod"):
            getattr(self.kept, name)[...] = getattr(frame, name)
        return self.kept


@pytest.mark.parametrize("error", ["both", "plain"])
def test_arrays_that_are_used_again(error: str) -> None:
    assert same(fitted(Reusing(), steps=48, error=error), fitted(Plain(), steps=48, error=error))


def test_references_that_are_used_again() -> None:
    source = source_levels(texture_set())

    def reference(renderer: Any) -> Any:
        return lambda view: renderer.render(source, replace(view, level=0)).image

    settings = {"steps": 32, "error": "plain"}
    plain = fitted(Plain(), reference=reference(Plain()), **settings)
    assert same(fitted(Plain(), reference=reference(Reusing()), **settings), plain)


def test_tensors_with_gradients_are_frames() -> None:
    def as_tensors(frame: Frame, _count: int) -> Frame:
        return replace(frame, image=torch.tensor(np.asarray(frame.image, np.float32), requires_grad=True))

    assert same(fitted(Plain(as_tensors), steps=16), fitted(Plain(), steps=16))
