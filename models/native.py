"""Networks in the native core (csrc/cpu/network.cpp, csrc/cuda/network.cu): packed weights, and a bake of every level.

On the processor it goes down level 0 in bands of rows. It encodes them, filters and decodes level 0, and adds the band
to the rows of coarser images of latents that it is a part of. A row of these that has all its parts is decoded as a row
of its level, handed on to images that are coarser still, or both. Latents of a level are never held, but for the rows
that wait for their last part. A graphics card runs csrc/network/images.h instead.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake import _native
from mipbake.base import memory
from mipbake.base.device import PROCESSOR, card_of, too_small
from mipbake.material import MODELS, MaterialModel, directions, model_named, most_roughness
from mipbake.material.pixel_filter import Wrap, level_sizes
from mipbake.models.architecture import Architecture, Baker, Levels, Tensors
from mipbake.models.level_filter import Lookup

Layer = tuple[NDArray[np.float32], NDArray[np.float32]]
"""(G, C) or (G, C, 3, 3) weights and (G,) biases."""


class Axis(NamedTuple):
    """What texels of an axis are summed from: (n, taps) each, `sharp` by the sharpened filter and `plain` by it."""

    places: NDArray[np.int32]
    sharp: NDArray[np.float32]
    plain: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Sink:
    """An image of latents that is filtered from a finer one.

    Args:
        source: index of the finer one among the sinks before it; -1 for level 0.
        rows, columns: what its texels are summed from.
        out: (H_L, W_L, C) a level that is decoded from it; None where it is there for coarser ones alone.
        biases: of the decoder's layers one after the other, for that level.
    """

    source: int
    rows: Axis
    columns: Axis
    out: NDArray[np.float32] | None = None
    biases: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class Top:
    """Level 0.

    Args:
        sharp: (n,) taps of its filter, n odd. plain: (n - 2,) the same without sharpening; (0,) where n is 1.
        out: (H, W, C). biases: of the decoder's layers one after the other.
    """

    sharp: NDArray[np.float32]
    plain: NDArray[np.float32]
    out: NDArray[np.float32]
    biases: NDArray[np.float32]


Plan: TypeAlias = tuple[_native.Network, Top, Sequence[Sink]]
"""Packed weights, and all that they are to bake: a sink comes after its source."""

_INDEX = {name: index for index, name in enumerate(MODELS)}  # as csrc/cpu/network_latents.h numbers them


def feature_count(read: MaterialModel, made: MaterialModel) -> int:
    """Numbers that csrc/network tells the decoder of a network of moments about a texel."""
    *channels, _, _, _, features, _ = _native.network_counts("moments", _INDEX[read.name], _INDEX[made.name])
    if channels != [read.channels, made.channels]:
        raise AssertionError(f"csrc/network/models.h has other channels for {read.name} or {made.name}")
    return features


def network(
    kind: str,
    read: MaterialModel,
    made: MaterialModel,
    whiten: Layer | None,
    encoder: Sequence[Layer],
    project: Layer,
    decoder: Sequence[Layer],
) -> _native.Network:
    """Packed weights; ValueError where layers do not fit."""
    least, most = float(made.least_alpha2) ** 0.25, most_roughness(made)
    limits = [least, most, math.log(least), math.log(most), least**4, most**4]
    return _native.Network(kind, _INDEX[read.name], _INDEX[made.name], limits, whiten, encoder, project, decoder)


@dataclass(eq=False)
class NativeBaker(Baker):
    """Weights in the native core.

    Args:
        config: the architecture.
        device: where they bake; a graphics card only in a core that was compiled with CUDA.

    Raises:
        KeyError, ValueError: the tensors do not fit the architecture.
    """

    config: Architecture
    pixel_filters: tuple[str, ...]
    tensors: Tensors
    device: str = PROCESSOR

    def layer(self, name: str) -> Layer:
        """A layer by its name."""
        weight = self.tensors[f"{name}.weight"]
        if weight.shape[2:] == (1, 1):
            weight = weight[..., 0, 0]
        return np.ascontiguousarray(weight), np.ascontiguousarray(self.tensors[f"{name}.bias"])

    @abstractmethod
    def plan(self, out: Levels, read: str, made: str, lookup: Lookup, wrap: Wrap) -> Plan:
        """What makes the levels of `out`, which have their shapes and no values yet."""

    def levels(
        self,
        stored: NDArray[np.float32],
        read: str,
        made: str,
        lookup: Lookup,
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
    ) -> Levels:
        """See Baker. UsageError: the memory of the graphics card is too small."""
        out = [memory.empty((*size, model_named(made).channels)) for size in level_sizes(*stored.shape[:2])]
        packed, top, sinks = self.plan(out, read, made, lookup, wrap)
        given = [(each.source, each.rows, each.columns, each.out, each.biases) for each in sinks]
        stored = np.ascontiguousarray(stored, np.float32)
        wraps = wrap[1] == "wrap", wrap[0] == "wrap"
        running = _native.NetworkBake(packed, stored, *wraps, top.sharp, top.plain, top.biases, top.out, given)
        if self.device == PROCESSOR:
            done = 0
            while done < len(stored):
                done = running.advance()
                progress(done / len(stored))
        else:
            try:
                running.run_on_card(card_of(self.device))
            except RuntimeError as error:
                if "out of memory" in str(error):
                    raise too_small(self.device) from error
                raise
            progress(1.0)
        return directions.agreeing(out, made, wrap)
