"""Renderers that fail, and fits that are stopped: one sentence each, and nothing that is half done."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mipbake.base.errors import InputError, OutputError, RendererError
from mipbake.fitting import Frame, Progress

from .fitting_small import SIDE, Plain, fitted, same, spots, start

Damaged = Callable[[Frame, int], Any]

WANTED = np.full((SIDE, SIDE, 3), 0.2)
"""What the views shall show."""

VIEWS = spots(2, (0, 1))
PREPARED = len(VIEWS)
PROBED = PREPARED + 6 * (len(VIEWS) - 1)
"""Renders before the first error of a view is taken; then come one check and the steps."""


def fit_to_grey(renderer: Any, **more: Any) -> Any:
    """A fit of few steps, whose references need no render."""
    return fitted(renderer, VIEWS, reference=[WANTED] * len(VIEWS), **({"steps": 8} | more))


def at(row: int, column: int, name: str, value: Any, first: int = 0) -> Damaged:
    """Puts a value into an array of every frame from the one with number `first` on."""

    def damaged(frame: Frame, count: int) -> Frame:
        array = np.array(getattr(frame, name))
        array[row, column] = value
        return replace(frame, **{name: array}) if count >= first else frame

    return damaged


def put(**arrays: Any) -> Damaged:
    """Puts other arrays into frames."""
    return lambda frame, _count: replace(frame, **arrays)


def numbered(value: float) -> Damaged:
    """Gives frames an id, which is 1 but for one pixel."""
    numbers = np.ones((SIDE, SIDE))
    numbers[2, 3] = value
    return put(id=numbers)


class Grown:
    """Another size from the frame with number `first` on."""

    def __init__(self, first: int) -> None:
        self.first = first

    def __call__(self, frame: Frame, count: int) -> Frame:
        return replace(frame, image=np.ones((SIDE, SIDE + 1, 3))) if count >= self.first else frame


def told(error: BaseException) -> str:
    """The message, which is one sentence that says what was expected."""
    first, *more = str(error).split("\n")
    assert re.search(r": expected [^.]", first) and not first.endswith("."), first
    assert not re.search(r"[a-z]\. [A-Z]", first), first
    assert not more or more[0].startswith("What was fitted so far is kept in"), more
    return first


# ---- frames that are none


@pytest.mark.parametrize(
    ("damaged", "said"),
    [
        (at(2, 3, "image", np.nan), r"the image holds \[nan, nan, nan\] at row 2, column 3, .* in 1 pixels: .* finite"),
        (at(1, 0, "uv", np.nan), r"uv holds \[nan, nan\] at row 1, column 0, .* in 1 pixels: expected finite"),
        (at(1, 0, "uv", 1e6), r"uv is \[1000000.0, 1000000.0\] at row 1, column 0: expected texture coordinates"),
        (put(uv=None), "the frame has no uv: expected where each pixel looks the maps up"),
        (put(lod=None), "the frame has neither lod nor uv_da: expected one of the two"),
        (put(uv=np.zeros((4, 4, 2))), r"uv has shape \(4, 4, 2\): expected \(8, 8, 2\)"),
        (put(lod=np.zeros((4, 8))), r"lod has shape \(4, 8\): expected \(8, 8\)"),
        (put(lod=None, uv_da=np.zeros((8, 8, 2))), r"uv_da has shape \(8, 8, 2\): expected \(8, 8, 4\)"),
        (put(id=np.zeros((SIDE, SIDE), np.int32)), r"no pixel shows the maps \(id is 0 everywhere\): expected a view"),
        (put(id=np.zeros((SIDE, SIDE, 4))), r"id has shape \(8, 8, 4\): expected \(8, 8\)"),
        (put(image=np.zeros((SIDE, SIDE))), r"the image has shape \(8, 8\): expected \(height, width, 3\)"),
        (put(image="a picture"), "the image is a str: expected an array of real numbers"),
        (put(image=np.ones((SIDE, SIDE, 3), complex)), "the image is a ndarray: expected an array of real numbers"),
        (numbered(-1), "id is -1 at row 2, column 3: expected 0 where .*, and a whole number above 0"),
        (lambda frame, _count: None, "the renderer returned a NoneType: expected a Frame"),
    ],
)
def test_a_frame_that_is_none(damaged: Damaged, said: str, tmp_path: Path) -> None:
    file = tmp_path / "fit.checkpoint"
    with pytest.raises(RendererError, match=said) as caught:
        fit_to_grey(Plain(damaged), checkpoint=file)
    assert VIEWS[0].name in told(caught.value) and caught.value.exit_code == 6
    assert list(tmp_path.iterdir()) == []  # nothing was fitted, and nothing is left


@pytest.mark.parametrize(("first", "fitting"), [(PREPARED, fit_to_grey), (PROBED + 3, fit_to_grey), (21, fitted)])
def test_a_size_that_changes(first: int, fitting: Any) -> None:
    """The last one within a reference."""
    with pytest.raises(RendererError, match="the image measures 9 x 8 pixels: expected 8 x 8, as before") as caught:
        fitting(Plain(Grown(first)))
    told(caught.value)


# ---- pictures that do not follow the maps


@pytest.mark.parametrize("light", [0.0, 0.3])
def test_pictures_that_are_the_same_whatever_the_maps(light: float) -> None:
    with pytest.raises(
        RendererError, match=r"the picture is the same when .*: expected a renderer that looks"
    ) as caught:
        fit_to_grey(Plain(put(image=np.full((SIDE, SIDE, 3), light))))
    assert spots()[0].name[:4] in told(caught.value)


def noisy(size: float) -> Damaged:
    rng = np.random.default_rng(0)
    return lambda frame, _count: replace(frame, image=frame.image + size * rng.normal(size=frame.image.shape))


def test_noise_that_is_larger_than_perturbations() -> None:
    with pytest.raises(
        RendererError, match=r"two renders of the same maps differ more .*: expected .* turn off"
    ) as caught:
        fit_to_grey(Plain(noisy(0.5)))
    told(caught.value)


def test_a_little_noise_does_no_harm() -> None:
    progress: list[Progress] = []
    result = fitted(Plain(noisy(1e-4)), steps=160, progress=progress.append)
    assert not same(result, start())
    assert progress[-1].scores["level 1"] > progress[0].scores["level 1"]


# ---- what is tried before the first step


class Blind(Plain):
    """Shows the maps in some views alone."""

    def __init__(self, seeing: Callable[[str], bool]) -> None:
        super().__init__()
        self.seeing = seeing

    def render(self, levels: Any, view: Any) -> Any:
        frame = super().render(levels, view)
        return frame if self.seeing(view.name) else replace(frame, image=np.full_like(frame.image, 0.3))


def test_views_that_mostly_show_nothing_are_told_of() -> None:
    with pytest.warns(UserWarning, match=r"of 7 views that were tried, 6 \(spot . of level ., \.\.\.\) look the same"):
        fitted(Blind(lambda name: name == spots()[0].name), steps=16)


class Coarser(Plain):
    """Looks up one level more than its frames say."""

    def render(self, levels: Any, view: Any) -> Any:
        frame = super().render(levels, view)
        return replace(frame, lod=np.maximum(np.asarray(frame.lod) - 1, 0))


def test_frames_that_name_the_wrong_level_are_told_of() -> None:
    views = spots(levels=(1, 2, 3))
    with pytest.warns(UserWarning, match=r"in 5 .* of 5 views .* texels that its frame does not name, .*: expected"):
        fitted(Coarser(), views, reference=[WANTED] * len(views), steps=8)


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


def test_arrays_that_are_used_again() -> None:
    assert same(fitted(Reusing(), steps=48), fitted(Plain(), steps=48))


def test_tensors_with_gradients_are_frames() -> None:
    def as_tensors(frame: Frame, _count: int) -> Frame:
        return replace(frame, image=torch.tensor(np.asarray(frame.image, np.float32), requires_grad=True))

    assert same(fitted(Plain(as_tensors), steps=16), fitted(Plain(), steps=16))


# ---- renderers that fail on the way


class BrokenError(Exception):
    """An error of the user's own."""


class Fails:
    """Raises an error at one render."""

    def __init__(self, number: int, error: Exception) -> None:
        self.number, self.error = number, error

    def __call__(self, frame: Frame, count: int) -> Frame:
        if count == self.number:
            raise self.error
        return frame


MIDDLE = PROBED + 1 + 2 * 4 + 1  # within a step: the fifth, of which one render is there


def test_an_error_of_the_renderers_own_within_a_step(tmp_path: Path) -> None:
    error, file, stack = BrokenError("out of memory"), tmp_path / "deeper" / "fit", start()
    with pytest.raises(BrokenError) as caught:
        fit_to_grey(Plain(Fails(MIDDLE, error)), checkpoint=file, stack=stack)
    assert caught.value is error and str(error) == "out of memory" and caught.value.__cause__ is None
    assert [path.name for path in file.parent.iterdir()] == ["fit"]
    assert same(stack, start())


@pytest.mark.parametrize("checkpoint", [True, False])
def test_a_renderer_error_says_what_is_kept(checkpoint: bool, tmp_path: Path) -> None:
    file = tmp_path / "fit"
    damaged = at(0, 0, "image", np.nan, MIDDLE)
    with pytest.raises(RendererError, match="the image holds") as caught:
        fit_to_grey(Plain(damaged), checkpoint=file if checkpoint else None)
    told(caught.value)
    assert (f"What was fitted so far is kept in {file}." in str(caught.value)) == checkpoint == file.exists()


# ---- fits that go on


SETTINGS: dict[str, Any] = {"steps": 60, "rate": 0.5, "seed": 4, "renders": 2}


@pytest.mark.long
@pytest.mark.parametrize("number", [104, 137, 245, 330])
def test_a_fit_that_goes_on_ends_as_one_that_was_not_stopped(number: int, tmp_path: Path) -> None:
    """Wherever it was stopped: in the first round, at its check, in a later round, or at the very end."""
    whole = fitted(Plain(), reference=[WANTED] * 20, **SETTINGS)
    settings = SETTINGS | {"reference": [WANTED] * 20, "checkpoint": tmp_path / "fit"}
    with pytest.raises(BrokenError):
        fitted(Plain(Fails(number, BrokenError())), **settings)
    renderer = Plain()
    told_of: list[Progress] = []
    assert same(fitted(renderer, progress=told_of.append, **settings), whole)
    if number > 200:
        assert len(renderer.log) < 20 + 4 * 60 and all(now.step > 32 for now in told_of)
    assert not same(whole, start())


def test_a_fit_that_is_done_is_not_done_again(tmp_path: Path) -> None:
    settings = SETTINGS | {"checkpoint": tmp_path / "fit"}
    first = fit_to_grey(Plain(), **settings)
    renderer = Plain()
    assert same(fit_to_grey(renderer, **settings), first)
    # Views are prepared, levels that changed are left out one by one, and what was reached is told.
    assert len(renderer.log) <= PREPARED + 1 + 5


@pytest.mark.parametrize(
    "other",
    [
        {"seed": 1},
        {"stack": replace(start(), levels=[0.5 * each for each in start().levels])},
        {"views": [replace(view, name=f"other {view.name}") for view in VIEWS]},
        {"held_out": [VIEWS[1]], "reference": [WANTED] * 5},
    ],
)
def test_a_checkpoint_of_another_fit(other: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "fit"
    fit_to_grey(Plain(), checkpoint=file)
    before = file.read_bytes()
    settings = {"views": VIEWS, "reference": [WANTED] * 4, "steps": 8, "checkpoint": file} | other
    with pytest.raises(
        InputError, match=r"the checkpoint .*fit is of another fit .*: delete it, or choose another file"
    ):
        fitted(Plain(), **settings)
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    "other",
    [
        {"renderer": Plain(lambda frame, _count: replace(frame, image=frame.image**3))},
        {"reference": [np.full((SIDE, SIDE, 3), 0.4)] * len(VIEWS)},
    ],
)
def test_a_checkpoint_of_another_renderer_or_reference(other: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "fit"
    fit_to_grey(Plain(), checkpoint=file)
    before = file.read_bytes()
    settings = {"renderer": Plain(), "reference": [WANTED] * len(VIEWS)} | other
    with pytest.raises(
        InputError, match=r"of another fit: .*\(level 1\) showed its start with .* dB now, .*: delete it, or choose"
    ):
        fitted(views=VIEWS, steps=8, checkpoint=file, **settings)
    assert file.read_bytes() == before


def archive(path: Path, **arrays: Any) -> None:
    with path.open("wb") as file:
        np.savez(file, **arrays)


def one_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 0xFF
    path.write_bytes(content)


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:-100]),
        one_byte,
        lambda path: archive(path, nothing=np.zeros(3)),
        lambda path: archive(path, about=np.array(object())),
    ],
)
def test_a_broken_checkpoint(damage: Callable[[Path], Any], tmp_path: Path) -> None:
    file = tmp_path / "fit"
    fit_to_grey(Plain(), checkpoint=file)
    damage(file)
    with pytest.raises(InputError, match=r"the checkpoint .*fit (cannot be read .*: delete it|is of another fit)"):
        fit_to_grey(Plain(), checkpoint=file)


def test_a_checkpoint_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"the checkpoint .*fit cannot be written: "):
        fit_to_grey(Plain(), checkpoint=tmp_path / "file" / "fit")
    folder = tmp_path / "folder"
    (folder / "inside").mkdir(parents=True)
    with pytest.raises((OutputError, InputError), match=r"the checkpoint .*folder cannot be"):
        fit_to_grey(Plain(), checkpoint=folder)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]
