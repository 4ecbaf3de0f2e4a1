"""The stacks that the levels of a fit may start from."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import UsageError
from mipbake.fitting.loop import Loop
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import Prepared, scores_of_levels
from mipbake.fitting.renderer import Array
from mipbake.stack import MipStack


@dataclass(frozen=True, eq=False)
class Starts:
    """Stacks of one model and one size, and their values.

    Args:
        stacks: the stack that is fitted, and others.
        parameters: of each of them.
        values: of each of them, (texels, channels).
    """

    stacks: tuple[MipStack, ...]
    parameters: Parameters
    values: tuple[Array, ...]

    @staticmethod
    def of(stack: MipStack, others: Sequence[MipStack]) -> Starts:
        """A stack and others.

        Raises:
            UsageError: stacks of different models or sizes.
        """
        for other in others:
            if (other.model, other.size, len(other.levels)) != (stack.model, stack.size, len(stack.levels)):
                raise UsageError(
                    f"the fit starts from {_told(stack)}, and others hold {_told(other)}: expected stacks of one "
                    "material model and one size"
                )
        every = (stack, *others)
        parameters = Parameters.of(stack.model, *stack.size, len(stack.levels))
        return Starts(every, parameters, tuple(parameters.values(list(each.levels)) for each in every))

    def chosen(self, loop: Loop, views: Sequence[Prepared]) -> NDArray[np.int64]:
        """(levels,) number of the stack that each level starts from.

        It is the stack that the views gain most with, in the part that gains least, as for the levels of a fit. It is
        the first one where the views lose by the others, beside the levels that were chosen.
        """
        found = [scores_of_levels(views, loop.errors(each, views)) for each in self.values]
        gains = np.stack([(each - found[0]).min(-1) for each in found])  # NaN where no view shows a level
        origins = np.argmax(np.nan_to_num(gains), 0)
        settled = loop.settled(self.joined(origins), self.values[0], views)
        return np.where([self._same(settled, 0, level) for level in range(len(origins))], 0, origins).astype(np.int64)

    def joined(self, origins: NDArray[np.integer]) -> Array:
        """(texels, channels) values, each level of the stack of its number."""
        cuts = itertools.pairwise(self.parameters.starts)
        return np.concatenate([self.values[n][first:last] for n, (first, last) in zip(origins, cuts, strict=True)])

    def levels(self, values: Array) -> list[Array]:
        """Stored channels of each level. Where the values are a stack's own, it is the stack's level, bit for bit."""
        stored = self.parameters.stored(values)
        for level in range(len(stored)):
            same = next((n for n in range(len(self.stacks)) if self._same(values, n, level)), None)
            if same is not None:
                stored[level] = self.stacks[same].levels[level]
        return stored

    def told(self, origins: NDArray[np.integer]) -> str:
        """Which levels started from which of the other stacks; empty where none did."""
        parts = []
        for number, stack in enumerate(self.stacks[1:], 1):
            levels = [str(level) for level in np.flatnonzero(origins == number)]
            if levels:
                parts.append(f"level {', '.join(levels)} from {stack.provenance.method}")
        return f" (starting with {' and '.join(parts)})" if parts else ""

    def _same(self, values: Array, number: int, level: int) -> bool:
        own = slice(*self.parameters.starts[level : level + 2])
        return np.array_equal(values[own], self.values[number][own])


def _told(stack: MipStack) -> str:
    height, width = stack.size
    return f"{len(stack.levels)} levels of {stack.model} from {width} x {height}"
