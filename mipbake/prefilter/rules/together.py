"""Many closed forms of one image in one pass: what they read in common is read once, and averaged once for each kernel.

The pass goes over level 0 in bands of rows, as bands.py does for a single form, and shows the averages of every level
as they come. What is made of them, and of which texels, is up to who looks: all levels of all forms need never exist.
The bits are the same as of a form by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mipbake.pixel_filter import (
    PRE_REDUCED,
    Taps,
    Wrap,
    level_sizes,
    reduced_size,
    resample,
    resample_taps,
    resample_weights,
)
from mipbake.prefilter.base import Progress
from mipbake.prefilter.rules import bands
from mipbake.prefilter.rules.bands import Array, Image, chunks, on_threads
from mipbake.prefilter.rules.form import Form, Part, Texels, Whole

Column = tuple[Hashable, int]
"""A channel that is averaged: the key of a Part, and the channel of it."""

Take = Callable[[int, slice, Mapping[str, Image]], None]
"""Is given a level, some of its rows, and (rows, W_L, D) averages of each kernel there; from several threads."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A form in a pass.

    Args:
        form: the form. kernel: what it averages with.
        at: where its channels lie in the averages of the kernel. blurred: where its blurred channels lie at level 0.
    """

    form: Form
    kernel: str
    at: list[int]
    blurred: list[int] | None

    def made(self, planes: Mapping[str, Array], level: int) -> Array:
        """(..., C) stored channels, of (D, ...) averages of each kernel at a level."""
        own = planes[self.kernel]
        blurred = _texels(own[self.blurred]) if self.blurred is not None and level == 0 else None
        return self.form.write(_texels(own[self.at]), blurred)


class Together:
    """A pass over an image.

    Args:
        forms: of the image, and the kernel of each: a name in `mipbake.pixel_filter.FILTERS`.
        wrap: addressing along u and v.
    """

    def __init__(self, whole: Whole, forms: Sequence[tuple[Form, str]], wrap: Wrap) -> None:
        self._stored, self._wrap = whole.stored, wrap
        self._sizes = level_sizes(*self._stored.shape[:2])
        self._direct = self._sizes[: PRE_REDUCED + 1]
        kernels = dict.fromkeys(kernel for _, kernel in forms)
        self._kernels = {name: _Kernel(self, name, [form for form, own in forms if own == name]) for name in kernels}
        self.placed = [self._kernels[kernel].placed(form) for form, kernel in forms]
        parts = {part.key: part for form, _ in forms for part in form.parts}
        # Kernels that average the same read the same band.
        self._read = {each.columns: [(parts[key], i) for key, i in each.columns] for each in self._kernels.values()}
        self._box: tuple[Taps, Taps] | None = None
        self._reduced: dict[tuple[Column, ...], Image] = {}
        if len(self._sizes) > len(self._direct):
            size = reduced_size(self._sizes, len(self._direct), wrap)
            self._box = self.taps(size, "box")
            self._reduced = {columns: np.empty((*size, len(columns)), np.float32) for columns in self._read}

    @property
    def direct(self) -> Sequence[tuple[int, int]]:
        """Sizes of the levels that are filtered from level 0 itself."""
        return self._direct

    def widths(self, level: int) -> Mapping[str, int]:
        """How many channels the averages of each kernel have at a level."""
        return {name: each.width(level) for name, each in self._kernels.items()}

    def show(self, take: Take, progress: Progress = lambda _: None) -> None:
        """Shows the averages of all levels, the levels of the bands first.

        Args:
            progress: told the finished share; all but a few hundredths of the work are the bands.
        """
        height, width = self._sizes[0]
        count = max(1, height // max(bands.ROWS, bands.BAND // width))
        on_threads(lambda index: self._band(index, count, take), count, progress)
        finer, self._reduced = self._reduced, {}
        for level in range(len(self._direct), len(self._sizes)):
            if level > len(self._direct):
                size = reduced_size(self._sizes, level, self._wrap)
                finer = {key: resample(image, size, "box", self._wrap) for key, image in finer.items()}
            size = self._sizes[level]
            averages = {
                name: resample(finer[each.columns], size, name, self._wrap) for name, each in self._kernels.items()
            }
            take(level, slice(0, size[0]), averages)
        progress(1.0)

    def taps(self, size: tuple[int, int], kernel: str, width: float = 1.0) -> tuple[Taps, Taps]:
        """Of rows and of columns, from level 0 to a size."""
        rows, columns = (
            resample_weights(self._stored.shape[axis], size[axis], kernel, self._wrap[1 - axis], width)
            for axis in (0, 1)
        )
        return rows, columns

    def _band(self, index: int, count: int, take: Take) -> None:
        def part(rows: Taps) -> tuple[slice, Taps]:
            here = slice(*(len(rows[0]) * end // count for end in (index, index + 1)))
            return here, (rows[0][here], rows[1][here])

        boxes = [] if self._box is None else [self._box[0]]
        every = [rows for each in self._kernels.values() for rows, _ in each.axes] + boxes
        read, first = self._texels(np.unique(np.concatenate([part(rows)[1][0].ravel() for rows in every])))

        def averaged(image: Image, rows: Taps, columns: Taps) -> Image:
            here, (at, weights) = part(rows)
            if len(rows[0]) == len(first) and rows[0].shape[1] == columns[0].shape[1] == 1:
                return image[first[here.start] :][: len(at)]  # level 0 as it is
            return resample_taps(image, (first[at], weights), columns)

        for level in range(len(self._direct)):
            averages = {}
            for name, each in self._kernels.items():
                image, blur = read[each.columns], each.blur
                own = averaged(image, *each.axes[level])
                if blur is not None and level == 0 and len(own):
                    wide = averaged(np.ascontiguousarray(image[..., blur.at]), *blur.axes)
                    own = np.concatenate([own, wide], -1)
                averages[name] = own
            here = part(next(iter(self._kernels.values())).axes[level][0])[0]
            if here.start < here.stop:
                take(level, here, averages)
        if self._box is not None:
            here = part(self._box[0])[0]
            for columns, image in read.items():
                if here.start < here.stop:
                    self._reduced[columns][here] = averaged(image, *self._box)

    def _texels(self, rows: NDArray[np.int64]) -> tuple[dict[tuple[Column, ...], Image], NDArray[np.int64]]:
        """Those rows of what is averaged, and where each row of level 0 lies in them."""
        place = np.arange(len(self._stored))
        place[rows] = np.arange(len(rows))
        width = self._stored.shape[1]
        out = {columns: np.empty((len(rows), width, len(columns)), np.float32) for columns in self._read}
        ends = np.nonzero(np.diff(rows, prepend=-2, append=np.iinfo(np.int64).max) != 1)[0]
        for start, end in pairwise(ends):  # rows that lie one below the other
            for planes, some in chunks(self._stored[rows[start] : rows[start] + end - start]):
                texels = Texels(planes)
                to = slice(start + some.start, start + some.start + len(planes))
                for columns, reads in self._read.items():
                    image = out[columns][to]
                    for channel, (part, own) in enumerate(reads):
                        image[..., channel] = part.of(texels)[..., own]
        return out, place


@dataclass(frozen=True, eq=False)
class _Blurred:
    """What is averaged over a wider box at level 0: which columns, and how."""

    at: list[int]
    axes: tuple[Taps, Taps]


class _Kernel:
    """What forms with one kernel average."""

    def __init__(self, together: Together, name: str, forms: Sequence[Form]) -> None:
        self._name = name
        self.columns = tuple(dict.fromkeys(column for form in forms for column in _columns(form.parts)))
        self._place = {column: index for index, column in enumerate(self.columns)}
        self.axes = [together.taps(size, name) for size in together.direct]
        blurs = [form for form in forms if form.blur is not None] if name == "box" else []
        widths = {form.blur.width for form in blurs if form.blur is not None}
        if len(widths) > 1:
            raise AssertionError("two closed forms blur level 0 by boxes of different widths")
        at = dict.fromkeys(index for form in blurs for index in self._blurred(form))
        self.blur = _Blurred(list(at), together.taps(together.direct[0], "box", *widths)) if at else None

    def width(self, level: int) -> int:
        """Channels of the averages at a level: the blurred ones come last at level 0."""
        return len(self.columns) + (len(self.blur.at) if self.blur is not None and level == 0 else 0)

    def placed(self, form: Form) -> Placed:
        """A form with its places in the averages."""
        blurred = None
        if form.blur is not None and self.blur is not None:
            blurred = [len(self.columns) + self.blur.at.index(index) for index in self._blurred(form)]
        return Placed(form, self._name, [self._place[column] for column in _columns(form.parts)], blurred)

    def _blurred(self, form: Form) -> list[int]:
        own = [self._place[column] for column in _columns(form.parts)]
        return [own[channel] for channel in (() if form.blur is None else form.blur.channels)]


def _texels(planes: Array) -> Array:
    """(D, ...) as (..., D), the same in memory: NumPy works on planes several times faster than on texels."""
    return np.moveaxis(planes, 0, -1)


def _columns(parts: Sequence[Part]) -> list[Column]:
    return [(part.key, channel) for part in parts for channel in part.channels]
