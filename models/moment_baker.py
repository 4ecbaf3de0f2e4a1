"""Baking with the weights of a MomentNetwork in the native core, without torch.

`mipbake.models.moment_inference` is the twin of it in torch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.material import model_named
from mipbake.material.pixel_filter import FILTERS, Wrap, resample_weights
from mipbake.models import native
from mipbake.models.architecture import Levels
from mipbake.models.level_filter import FROM_TOP, Lookup, sharpening, taps_of_top
from mipbake.models.moment_config import MOST_LEVEL, NAMED, MomentConfig
from mipbake.models.native import Axis, Layer, NativeBaker, Plan, Sink, Top


@dataclass(eq=False)
class MomentBaker(NativeBaker):
    """Weights of a MomentNetwork, ready for bakes."""

    config: MomentConfig

    def __post_init__(self) -> None:
        config, (read,), (made,) = self.config, self.config.encoders, self.config.decoders
        models = model_named(read), model_named(made)
        features = native.feature_count(*models)
        self._code = slice(features, features + NAMED + len(FILTERS))
        """Where level and filter stand among the inputs of the decoder."""
        self._decoder = self._read_decoder()
        encoder = [self.layer(f"encoder.{i}") for i in range(config.convolutions + config.pointwise)]
        decoder = [(np.ascontiguousarray(np.delete(weight, self._code, 1)), bias) for weight, bias in self._decoder]
        if config.samplers and self.tensors["told"].shape[0] != len(config.samplers):
            raise ValueError("as many features of samplers as the architecture takes were expected")
        self._packed = native.network("moments", *models, None, encoder, self.layer("project"), decoder)

    def _read_decoder(self) -> list[Layer]:
        """Weights (outputs, inputs) and biases of the decoder's layers, code included; the last one has the rows of
        the output, of the sharpness and, where there is one, of the stretch."""
        layers = [self.layer(f"decoder.{i}") for i in range(self.config.decoder_layers)]
        parts = [self.layer(name) for name in ("output", "crisp", *(["stretch"] if self.config.anisotropic else []))]
        wide = parts[1][0].shape[1]
        rows = [np.pad(weight, ((0, 0), (0, wide - weight.shape[1]))) for weight, _ in parts]
        return [*layers, (np.concatenate(rows), np.concatenate([each for _, each in parts]))]

    def plan(self, out: Levels, read: str, made: str, lookup: Lookup, wrap: Wrap) -> Plan:  # noqa: ARG002
        """See NativeBaker."""
        sharp, plain = taps_of_top(lookup.kernel)
        top = Top(sharp.astype(np.float32), plain, out[0], self._biases(0, lookup))
        return self._packed, top, list(self._sinks(out, lookup, wrap))

    def _sinks(self, out: Levels, lookup: Lookup, wrap: Wrap) -> Iterator[Sink]:
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

    def _biases(self, level: int, lookup: Lookup) -> NDArray[np.float32]:
        """Biases of the decoder's layers one after the other, with what level, filter and sampler add."""
        named = [float(name == lookup.kernel) for name in FILTERS]
        code = np.array([level == 0, level == 1, (min(level, MOST_LEVEL) - 3) / 4, *named], np.float32)
        out = np.concatenate([bias + weight[:, self._code] @ code for weight, bias in self._decoder])
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
