"""The parameters of a fit: all channels of all levels, as files hold them, in one array."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.base.srgb import linear_to_srgb, srgb_to_linear
from mipbake.fitting.renderer import Array, Levels, firsts_of, new_stamps
from mipbake.material import MAX_LOG_ALPHA2, MIN_LOG_ALPHA2, Kind, MaterialModel, model_named
from mipbake.material.kinds import COLOUR, LOG, SIGNED
from mipbake.material.model import with_unit_length
from mipbake.material.pixel_filter import level_sizes
from mipbake.stochastic import Channels, Contributions

_STEP = 1 / 255
"""The quantisation step of files of 8 bits, which is what a perturbation is (section 4.3)."""

_LOG_STEP = (MAX_LOG_ALPHA2 - MIN_LOG_ALPHA2) * _STEP
"""Of logarithms, which no file of 8 bits holds: the step that such a file would have over the range of materials."""


@dataclass(frozen=True, eq=False)
class Parameters:
    """What stored channels are as parameters: colours sRGB-encoded, vectors as (x + 1) / 2, the others as they are.

    Args:
        model: the material model.
        sizes: (height, width) of each level, finest first.
    """

    model: MaterialModel
    sizes: tuple[tuple[int, int], ...]

    @staticmethod
    def of(model: str, height: int, width: int, levels: int) -> Parameters:
        """Those of so many levels below, and with, a level 0 of this size."""
        return Parameters(model_named(model), tuple(level_sizes(height, width)[:levels]))

    @cached_property
    def starts(self) -> tuple[int, ...]:
        """Number of the first texel of each level, and the number of all texels."""
        return tuple(firsts_of(self.sizes))

    @cached_property
    def channels(self) -> Channels:
        """How far channels are perturbed, and between which limits: steps and ranges of files of 8 bits."""
        magnitude, low, high, lifted = [], [], [], None
        for each in self.model.stored:
            facts = each.facts
            for index in range(facts.channels):
                is_height = each.kind is Kind.NORMAL and index == 2
                magnitude.append(0.0 if is_height else _LOG_STEP if facts.encoding == LOG else _STEP)
                low.append(facts.limits[0] if facts.encoding == LOG else 0.0)
                high.append(facts.limits[1] if facts.encoding == LOG else 1.0)
            if each.kind is Kind.NORMAL:
                lifted = self.model.maps[each.name].start
        return Channels(tuple(magnitude), tuple(low), tuple(high), lifted)

    def values(self, levels: list[Array]) -> Array:
        """(texels of all levels, channels) of stored channels (H_L, W_L, C).

        Raises:
            UsageError: levels of other sizes.
        """
        if [level.shape[:2] for level in levels] != list(self.sizes):
            raise UsageError(f"levels have sizes {[level.shape[:2] for level in levels]}: expected {list(self.sizes)}")
        joined = np.concatenate([level.reshape(-1, self.model.channels) for level in levels]).astype(np.float32)
        for each in self.model.stored:
            own = joined[:, self.model.maps[each.name]]
            if each.facts.encoding == COLOUR:
                own[...] = linear_to_srgb(np.clip(own.astype(np.float64), 0, 1))
            elif each.facts.encoding == SIGNED:
                own[...] = (own + 1) / 2
        return joined

    def stored(self, values: Array) -> list[Array]:
        """The levels of such values: the inverse of `values`, with vectors of unit length."""
        decoded = values.copy()
        for each in self.model.stored:
            own = decoded[:, self.model.maps[each.name]]
            if each.facts.encoding == COLOUR:
                own[...] = srgb_to_linear(own)
            elif each.facts.encoding == SIGNED:
                own[...] = 2 * own - 1
            if each.kind is Kind.NORMAL:
                own[...] = with_unit_length(own)
            elif each.facts.unit_axis is not None:
                length = np.linalg.norm(own, axis=-1, keepdims=True)
                own[...] = np.where(length > 1e-6, own / np.maximum(length, 1e-6), np.eye(2, dtype=np.float32)[0])
        return [level.copy() for level in self._cut(decoded)]

    def levels(
        self, values: Array, wrap: tuple[str, str], stamps: tuple[NDArray[np.int64], ...] | None = None
    ) -> Levels:
        """What a renderer gets: views of the values, which it cannot write to. Without stamps, all tiles are new."""
        values = values.view()
        values.flags.writeable = False
        maps = {name: [level[..., own] for level in self._cut(values)] for name, own in self.model.maps.items()}
        return Levels(self.model.name, maps, wrap, stamps or new_stamps(self.sizes))

    def texels(self, level: int) -> slice:
        """The texels of a level."""
        return slice(self.starts[level], self.starts[level + 1])

    def _cut(self, values: Array) -> list[Array]:
        return [values[self.texels(level)].reshape(*size, -1) for level, size in enumerate(self.sizes)]

    def joined(self, variants: Sequence[Array], numbers: NDArray[np.integer]) -> Array:
        """(texels, channels) values, each level of the variant of its number."""
        return np.concatenate([variants[number][self.texels(level)] for level, number in enumerate(numbers)])

    def shares(self, read: Contributions) -> NDArray[np.float64]:
        """(levels,) how much of what pixels read lies in each level, as shares of 1."""
        bounds = np.searchsorted(read.elements, self.starts)
        counts = np.diff(np.asarray(read.starts)[bounds])
        return np.asarray(counts / max(counts.sum(), 1), np.float64)
