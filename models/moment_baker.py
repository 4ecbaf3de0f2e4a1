"""Baking with the weights of a MomentNetwork in the native core, without torch.

`mipbake.models.moment_inference` is the twin of it in torch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake import _native, material
from mipbake.base import memory
from mipbake.base.device import PROCESSOR
from mipbake.material import MaterialModel, directions, model_named
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.pixel_filter import FILTERS, Wrap, level_sizes, resample_weights
from mipbake.models import native
from mipbake.models.architecture import Baker
from mipbake.models.level_filter import FROM_TOP, Lookup, checked_filter, sharpening
from mipbake.models.moment_config import MomentConfig
from mipbake.models.native import Axis, Layer, Sink, Tensors, Top

_MOST_LEVEL = 8  # that the decoder distinguishes. Not tuned: MomentNetwork.decode has the same
_NAMED = 3  # numbers of the code that come before the pixel filter's. Not tuned: there are so many


@dataclass(frozen=True, eq=False)
class MomentBaker(Baker):
    """Weights of a MomentNetwork, ready for bakes.

    Args:
        config: the architecture. pixel_filters: that the weights were trained for; () where nothing says so.
        tensors: by the names that the network's state has.
        device: where it runs, as `native.bake` takes it.
    """

    config: MomentConfig
    pixel_filters: tuple[str, ...]
    tensors: Tensors
    device: str = PROCESSOR

    @classmethod
    def of(
        cls, config: MomentConfig, pixel_filters: tuple[str, ...], tensors: Tensors, device: str = PROCESSOR
    ) -> MomentBaker:
        """Raises KeyError or ValueError where the tensors do not fit the architecture."""
        out = cls(config, pixel_filters, tensors, device)
        assert out.packed is not None
        return out

    def bake(
        self,
        stored: NDArray[np.float32],
        source: str,
        target: str,
        pixel_filter: str,
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
        sampler: Sampler = DEFAULT_SAMPLER,
    ) -> list[NDArray[np.float32]]:
        """See Baker."""
        lookup = Lookup(
            checked_filter(self.config, self.pixel_filters, source, pixel_filter), self.config.taken(sampler)
        )
        made, (read,) = self.config.made_from(target), self.config.encoders
        levels = self.levels(material.convert(stored, source, read), lookup, wrap, progress)
        if made == target:
            return levels
        converted = [material.regularise(material.convert(level, made, target), target) for level in levels]
        return directions.agreeing(converted, target, wrap)

    def levels(
        self,
        stored: NDArray[np.float32],
        lookup: Lookup,
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
    ) -> list[NDArray[np.float32]]:
        """Every level of the stack of a material, down to 1 x 1.

        Args:
            stored: (H, W, R) float32 stored channels of the model that is read, any size.
            lookup: what the levels are for. wrap: wrap mode along u and along v.
            progress: called with the finished share, from 0 to 1.

        Returns:
            (H_L, W_L, C) float32 stored channels of the model that the network makes, of every level.
        """
        (made,) = self.config.decoders
        sizes = level_sizes(*stored.shape[:2])
        out = [memory.empty((*size, model_named(made).channels)) for size in sizes]
        plain = resample_weights(16, 16, lookup.kernel, "wrap")[1][0]  # the same for every texel of a level 0
        a = sharpening(0)
        top = Top(np.convolve(plain, [-a, 1 + 2 * a, -a]).astype(np.float32), plain, out[0], self._biases(0, lookup))
        native.bake(self.packed, stored, wrap, top, list(self._sinks(out, lookup, wrap)), progress, self.device)
        return directions.agreeing(out, made, wrap)

    def _sinks(self, out: list[NDArray[np.float32]], lookup: Lookup, wrap: Wrap) -> Iterator[Sink]:
        """What is filtered from level 0, or from box averages of it."""
        sizes = [level.shape[:2] for level in out]
        boxes: dict[int, int] = {}  # the place among the sinks of box averages as fine as a level
        count = 0
        for level in range(1, len(sizes)):
            finer = max(0, level - FROM_TOP)
            if finer:
                rows, columns = (_box(sizes[finer - 1], sizes[finer], axis, wrap) for axis in (0, 1))
                yield Sink(boxes.get(finer - 1, -1), rows, columns)
                boxes[finer] = count
                count += 1
            rows, columns = (_axis(sizes[finer], sizes[level], axis, lookup, level, wrap) for axis in (0, 1))
            yield Sink(boxes.get(finer, -1), rows, columns, out[level], self._biases(level, lookup))
            count += 1

    @property
    def _read(self) -> MaterialModel:
        return model_named(self.config.encoders[0])

    @cached_property
    def _counts(self) -> native.Counts:
        return native.counts("moments", self._read, model_named(self.config.decoders[0]))

    @cached_property
    def _decoder(self) -> list[Layer]:
        """Weights (outputs, inputs) and biases of the decoder's layers, code included; the last one has the rows of
        the output, of the sharpness and, where there is one, of the stretch."""
        layers = [self._layer(f"decoder.{i}") for i in range(self.config.decoder_layers)]
        (output, bias), (crisp, crisp_bias) = self._layer("output"), self._layer("crisp")
        parts = [(output, bias), (crisp, crisp_bias)]
        if self.config.anisotropic:
            parts.append(self._layer("stretch"))
        wide = crisp.shape[1]
        rows = [np.pad(weight, ((0, 0), (0, wide - weight.shape[1]))) for weight, _ in parts]
        return [*layers, (np.concatenate(rows), np.concatenate([each for _, each in parts]))]

    @cached_property
    def packed(self) -> _native.Network:
        """The weights as the native core has them; KeyError or ValueError where they do not fit the architecture."""
        config, made = self.config, model_named(self.config.decoders[0])
        encoder = [self._layer(f"encoder.{i}") for i in range(config.convolutions + config.pointwise)]
        decoder = [(np.ascontiguousarray(np.delete(weight, self._code, 1)), bias) for weight, bias in self._decoder]
        if config.samplers and self.tensors["told"].shape[0] != len(config.samplers):
            raise ValueError("as many features of samplers as the architecture takes were expected")
        return native.network("moments", self._read, made, None, encoder, self._layer("project"), decoder)

    def _layer(self, name: str) -> Layer:
        return native.layer(self.tensors, name)

    @property
    def _code(self) -> slice:
        """Where the level and the filter stand among the inputs of the decoder."""
        return slice(self._counts.features, self._counts.features + _NAMED + len(FILTERS))

    def _biases(self, level: int, lookup: Lookup) -> NDArray[np.float32]:
        """Biases of the decoder's layers one after the other, with what level, filter and sampler add."""
        named = [float(name == lookup.kernel) for name in FILTERS]
        code = np.array([level == 0, level == 1, (min(level, _MOST_LEVEL) - 3) / 4, *named], np.float32)
        sums = [bias + weight[:, self._code] @ code for weight, bias in self._decoder]
        out = np.concatenate(sums)
        if lookup.sampler is not None:
            added = np.array(self.config.features(lookup.sampler), np.float32) @ self.tensors["told"]
            out[: len(added)] += added
        return np.ascontiguousarray(out, np.float32)


def _box(finer: tuple[int, ...], size: tuple[int, ...], axis: int, wrap: Wrap) -> Axis:
    """Box averages along an axis."""
    index, weights = resample_weights(finer[axis], size[axis], "box", wrap[1 - axis])
    return Axis(index.astype(np.int32), weights, weights)


def _axis(finer: tuple[int, ...], size: tuple[int, ...], axis: int, lookup: Lookup, level: int, wrap: Wrap) -> Axis:
    """The latents of a level along an axis."""
    found = resample_weights(finer[axis], size[axis], lookup.kernel, wrap[1 - axis], lookup.width(level))
    return _sharpened(*found, sharpening(level), wrap[1 - axis])


def _sharpened(index: NDArray[np.int64], weights: NDArray[np.float32], a: float, wrap: str) -> Axis:
    """A filter with (-a, 1 + 2 a, -a) after it, in one; an axis of one texel stays as it is."""
    count, taps = index.shape
    if count == 1:
        return Axis(index.astype(np.int32), weights, weights)
    row = np.arange(count)
    before, after = row - 1, row + 1
    before, after = (each % count if wrap == "wrap" else each.clip(0, count - 1) for each in (before, after))
    places = np.concatenate([index, index[before], index[after]], 1)
    sharp = np.concatenate([(1 + 2 * a) * weights, -a * weights[before], -a * weights[after]], 1)
    plain = np.concatenate([weights, np.zeros((count, 2 * taps), np.float32)], 1)
    # Taps of one texel become one.
    order = np.argsort(places, 1, kind="stable")
    places, sharp, plain = (np.take_along_axis(each, order, 1) for each in (places, sharp, plain))
    fresh = np.diff(places, axis=1, prepend=-1) != 0
    place = np.cumsum(fresh, 1) - 1
    wide = int(place[:, -1].max()) + 1
    flat = (row[:, None] * wide + place).reshape(-1)
    merged = [
        np.bincount(flat, each.reshape(-1), count * wide).reshape(count, wide).astype(np.float32)
        for each in (sharp, plain)
    ]
    kept = np.zeros((count, wide), np.int32)
    kept[row[:, None].repeat(places.shape[1], 1)[fresh], place[fresh]] = places[fresh]
    return Axis(kept, *merged)
