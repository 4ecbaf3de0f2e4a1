"""The stacks that the levels of a fit may start from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.renderer import Array
from mipbake.stack.stack import MipStack


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
