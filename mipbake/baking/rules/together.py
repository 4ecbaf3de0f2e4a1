"""Closed forms of one image in one pass: what they read in common is read once, and averaged once for each kernel.

A closed form turns texels into what it averages, averages that under the pixel filter at every level, and turns
averages into texels. The levels up to PRE_REDUCED are filtered from level 0 itself, and all of them come from one band
of rows of level 0 while it lies in a cache. Coarser levels come from box averages, which the same band is reduced to.
The averages of every level are shown as they come. What is made of them, and of which texels, is up to who looks: all
levels of all forms need never exist.

The bits of a form hang neither on the bands, nor on the number of threads, nor on which other forms there are.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.rules import bands
from mipbake.baking.rules.bands import Array, Image, chunks
from mipbake.baking.rules.form import Form, Texels, Whole
from mipbake.base import memory
from mipbake.base.threads import on_threads
from mipbake.base.timings import Progress
from mipbake.material.pixel_filter import (
    PRE_REDUCED,
    Taps,
    Wrap,
    level_sizes,
    reduced_size,
    resample,
    resample_taps,
    resample_weights,
)

Column = tuple[Hashable, int]
"""A channel that is averaged: the key of a Part, and the channel of it."""

Take = Callable[[int, slice, Mapping[str, Image]], None]
"""Is given a level, some of its rows, and (rows, W_L, D) averages there by the names of `Together.widths`; from several
threads. The averages may be views of what is gone later."""

BLURRED = "blurred"
"""Name of what is averaged over a wider box at level 0 (form.Blur), beside the names of kernels."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A form in a pass.

    Args:
        form: the form. kernel: what it averages with.
        at: where its channels lie in the averages. blurred: where its blurred channels lie at level 0.
    """

    form: Form
    kernel: str
    at: list[int]
    blurred: list[int] | None

    def reads(self, level: int) -> list[str]:
        """Which averages it reads at a level, by their names."""
        return [self.kernel, *([BLURRED] if self.blurred is not None and level == 0 else [])]

    def made(self, planes: Mapping[str, Array], level: int) -> Array:
        """(..., C) stored channels, of (D, ...) averages at a level by their names."""
        blurred = _texels(planes[BLURRED], self.blurred) if self.blurred is not None and level == 0 else None
        return self.form.write(_texels(planes[self.kernel], self.at), blurred)


class Together:
    """A pass over an image.

    Args:
        forms: of the image, and the kernel of each: a name in `mipbake.material.pixel_filter.FILTERS`.
        wrap: addressing along u and v.
    """

    def __init__(self, whole: Whole, forms: Sequence[tuple[Form, str]], wrap: Wrap) -> None:
        self._stored, self._wrap = whole.stored, wrap
        self._sizes = level_sizes(*self._stored.shape[:2])
        self._direct = self._sizes[: PRE_REDUCED + 1]
        parts = {part.key: part for form, _ in forms for part in form.parts}
        columns = dict.fromkeys(column for form, _ in forms for column in _columns(form))
        self._reads = [(parts[key], channel) for key, channel in columns]
        self._unread = all(form.unread for form, _ in forms)
        place = {column: index for index, column in enumerate(columns)}
        kernels = dict.fromkeys(kernel for _, kernel in forms)
        level0 = self._sizes[0]
        self._axes = {name: [self._taps(level0, size, name) for size in self._direct] for name in kernels}

        widths = {form.blur.width for form, kernel in forms if kernel == "box" and form.blur is not None}
        if len(widths) > 1:
            raise AssertionError("two closed forms blur level 0 by boxes of different widths")
        self._wide = [self._taps(level0, level0, "box", width) for width in widths]
        self._blurred: list[int] = []
        self.placed = []
        for form, kernel in forms:
            at, blurred = [place[column] for column in _columns(form)], None
            if kernel == "box" and form.blur is not None:
                own = [at[channel] for channel in form.blur.channels]
                self._blurred += [index for index in own if index not in self._blurred]
                blurred = [self._blurred.index(index) for index in own]
            self.placed.append(Placed(form, kernel, at, blurred))

        # The next level comes from box averages that a band makes and forgets. Farther levels come from averages of
        # these, which are few enough to keep.
        self._halved: _Halved | None = None
        self._reduced: Image | None = None
        next_level = len(self._direct)
        if len(self._sizes) > next_level:
            halved, wanted = reduced_size(self._sizes, next_level, wrap), self._sizes[next_level]
            axes, box = {name: self._taps(halved, wanted, name) for name in kernels}, None
            if len(self._sizes) > next_level + 1:
                size = reduced_size(self._sizes, next_level + 1, wrap)
                box = self._taps(halved, size, "box")
                self._reduced = memory.empty((*size, len(self._reads)))
            self._halved = _Halved(halved[0], self._taps(level0, halved, "box"), axes, box)

    def widths(self, level: int) -> Mapping[str, int]:
        """How many channels the averages at a level have, by the names of kernels and BLURRED."""
        own = dict.fromkeys(self._axes, len(self._reads))
        return own | ({BLURRED: len(self._blurred)} if self._wide and level == 0 else {})

    def show(self, take: Take, progress: Progress = lambda _: None) -> None:
        """Shows the averages of all levels, the levels of the bands first; once.

        Args:
            progress: takes the finished share; all but a few hundredths of the work are the bands.
        """
        height, width = self._sizes[0]
        count = max(1, height // max(bands.ROWS, bands.BAND // width))
        on_threads(lambda index: self._band(index, count, take), count, progress)
        finer, self._reduced = self._reduced, None
        kept = len(self._direct) + 1
        for level in range(kept, len(self._sizes)):
            assert finer is not None
            if level > kept:
                finer = resample(finer, reduced_size(self._sizes, level, self._wrap), "box", self._wrap)
            size = self._sizes[level]
            take(level, slice(0, size[0]), {name: resample(finer, size, name, self._wrap) for name in self._axes})
        progress(1.0)

    def _taps(
        self, source: tuple[int, int], size: tuple[int, int], kernel: str, width: float = 1.0
    ) -> tuple[Taps, Taps]:
        """Of rows and of columns, from one size to another."""
        rows, columns = (
            resample_weights(source[axis], size[axis], kernel, self._wrap[1 - axis], width) for axis in (0, 1)
        )
        return rows, columns

    def _band(self, index: int, count: int, take: Take) -> None:
        def part(size: int) -> slice:
            return slice(*(size * end // count for end in (index, index + 1)))

        halved, direct = self._halved, [rows for axes in self._axes.values() for rows, _ in axes]
        read = [rows[0][part(len(rows[0]))] for rows in (*direct, *(rows for rows, _ in self._wide))]
        if halved is not None:
            own = _rows([rows[0][part(len(rows[0]))] for rows in halved.reads])
            read.append(halved.from0[0][0][own])
        rows = _rows(read)
        if self._unread:
            image, first = self._stored, np.arange(len(self._stored))
        else:
            image, first = self._read(rows), _places(rows, len(self._stored))

        def averaged(rows: Taps, columns: Taps) -> Image:
            here = part(len(rows[0]))
            if len(rows[0]) == len(first) and rows[0].shape[1] == columns[0].shape[1] == 1:
                return image[first[here.start] :][: here.stop - here.start]  # level 0 as it is
            return resample_taps(image, (first[rows[0][here]], rows[1][here]), columns)

        for level, size in enumerate(self._direct):
            here = part(size[0])
            if here.start < here.stop:
                averages = {name: averaged(*axes[level]) for name, axes in self._axes.items()}
                if self._wide and level == 0:
                    at, columns = self._wide[0]
                    blurred = np.ascontiguousarray(image[..., self._blurred])
                    averages[BLURRED] = resample_taps(blurred, (first[at[0][here]], at[1][here]), columns)
                take(level, here, averages)
        if halved is None or not len(own):
            return
        at, columns = halved.from0
        image = resample_taps(image, (first[at[0][own]], at[1][own]), columns)
        first = _places(own, halved.height)
        level = len(self._direct)
        here = part(self._sizes[level][0])
        if here.start < here.stop:
            take(level, here, {name: averaged(*axes) for name, axes in halved.axes.items()})
        if self._reduced is not None and halved.box is not None:
            here = part(len(self._reduced))
            if here.start < here.stop:
                self._reduced[here] = averaged(*halved.box)

    def _read(self, rows: NDArray[np.int64]) -> Image:
        """(R, W, D): those rows of what is averaged."""
        out = np.empty((len(rows), self._stored.shape[1], len(self._reads)), np.float32)
        ends = np.nonzero(np.diff(rows, prepend=-2, append=np.iinfo(np.int64).max) != 1)[0]
        for start, end in pairwise(ends):  # rows that lie one below the other
            for planes, some in chunks(self._stored[rows[start] : rows[start] + end - start]):
                texels, to = Texels(planes), out[start:end][some]
                for channel, (part, own) in enumerate(self._reads):
                    to[..., channel] = part.of(texels)[..., own]
        return out


@dataclass(frozen=True, eq=False)
class _Halved:
    """Box averages of level 0, as far as a band needs them.

    Args:
        height: of their image. from0: how they come from level 0.
        axes: how the next level comes from them, by kernels. box: how the next box averages do.
    """

    height: int
    from0: tuple[Taps, Taps]
    axes: Mapping[str, tuple[Taps, Taps]]
    box: tuple[Taps, Taps] | None

    @property
    def reads(self) -> list[Taps]:
        """Rows of them that are read."""
        return [rows for rows, _ in (*self.axes.values(), *([] if self.box is None else [self.box]))]


def _rows(indices: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """All of them in order, each once."""
    # np.unique would load numpy.ma.
    return np.flatnonzero(np.bincount(np.concatenate([each.ravel() for each in indices])))


def _places(rows: NDArray[np.int64], height: int) -> NDArray[np.int64]:
    """Where each row of an image lies among some of its rows."""
    place = np.zeros(height, np.int64)
    place[rows] = np.arange(len(rows))
    return place


def _texels(planes: Array, some: list[int]) -> Array:
    """Some of (D, ...) as (..., d), the same in memory: NumPy works on planes several times faster than on texels."""
    return np.moveaxis(planes if some == list(range(len(planes))) else planes[some], 0, -1)


def _columns(form: Form) -> list[Column]:
    return [(part.key, channel) for part in form.parts for channel in part.channels]
