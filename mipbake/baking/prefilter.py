"""The interface that every prefilter implements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mipbake.base.timings import Progress
from mipbake.material.aim import Sampler
from mipbake.material.pixel_filter import Wrap
from mipbake.stack.measured import Measured


@runtime_checkable
class Notes(Protocol):
    """A Progress that also takes notes: how good the result is by now, in a few words."""

    def note(self, text: str) -> None:
        """Shows the text beside the share, in place of the last text."""


def say(progress: object, text: str) -> None:
    """Shows a text, where a progress takes notes."""
    if isinstance(progress, Notes):
        progress.note(text)


@dataclass(frozen=True)
class PrefilterResult:
    """Every level of a stack, and what the method took to make it.

    Args:
        levels: (H_L, W_L, C) float32 stored channels of the target model, level 0 to 1 x 1.
        weights: name of the trained weights; None for closed forms.
        weights_sha256: hash of the weights; None for closed forms.
        measured: of the finished levels; None for methods that measure nothing.
        sampler: that the levels are made for. aim: from 0, SNR under single lights, to 1, what people see. None for
            methods that take none.
        stopped: whether a search was stopped before it was done.
    """

    levels: list[NDArray[np.float32]]
    weights: str | None = None
    weights_sha256: str | None = None
    measured: Measured | None = None
    sampler: Sampler | None = None
    aim: float | None = None
    stopped: bool = False


class Prefilter(Protocol):
    """A method that prefilters materials. Implementations are stateless."""

    @property
    def name(self) -> str:
        """What users call it."""

    @property
    def summary(self) -> str:
        """One line for help texts."""

    @property
    def averages(self) -> bool:
        """Whether it is a closed form over averages, which then runs with any kernel in place of the pixel filter, the
        box of its origin for one; otherwise a method makes levels for the pixel filter itself."""

    @property
    def own_memory(self) -> int:
        """Bytes that it takes whatever the size of the set, beside images of that size and some rows of them."""

    def __call__(
        self, stored: NDArray[np.float32], source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """Prefilters (H, W, C) stored channels of model `source` into levels of model `target`.

        Raises UsageError for a target or pixel filter that the method does not have.
        """
