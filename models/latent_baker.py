"""Baking with the weights of a LatentNetwork in the native core, without torch.

`mipbake.models.latent_inference` is the twin of it in torch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake import _native
from mipbake.material import model_named
from mipbake.material.pixel_filter import Wrap
from mipbake.models import native
from mipbake.models.architecture import Levels
from mipbake.models.latent_config import LatentConfig
from mipbake.models.latent_filter import latent_weights
from mipbake.models.level_filter import Lookup
from mipbake.models.native import Axis, Layer, NativeBaker, Plan, Sink, Top


@dataclass(eq=False)
class LatentBaker(NativeBaker):
    """Weights of a LatentNetwork, ready for bakes."""

    config: LatentConfig

    def __post_init__(self) -> None:
        for read in self.config.encoders:
            for made in self.config.decoders:
                self._packed(read, made)

    def plan(self, out: Levels, read: str, made: str, lookup: Lookup, wrap: Wrap) -> Plan:  # noqa: ARG002
        """See NativeBaker."""
        packed, biases = self._packed(read, made)
        sinks = []
        for level in range(1, len(out)):
            axes = [
                latent_weights(finer, size, self.config.latent_filter, mode, level == 1)
                for finer, size, mode in zip(out[level - 1].shape, out[level].shape, reversed(wrap), strict=False)
            ]
            rows, columns = (Axis(index.astype(np.int32), weights, weights) for index, weights in axes)
            sinks.append(Sink(level - 2, rows, columns, out[level], biases))
        return packed, Top(np.ones(1, np.float32), np.zeros(0, np.float32), out[0], biases), sinks

    def _packed(self, read: str, made: str) -> tuple[_native.Network, NDArray[np.float32]]:
        """An encoder and a decoder as the native core has them, and the decoder's biases one after the other."""
        encoder, decoder = f"encoders.{read}", f"decoders.{made}"
        given, wanted = f"whitening.{read}", f"whitening.{made}"
        whiten, mean = self.tensors[f"{given}.whiten"], self.tensors[f"{given}.mean"]
        before: Layer = (np.ascontiguousarray(whiten), np.ascontiguousarray(-(whiten @ mean)))
        first = [self.layer(f"{encoder}.layers.{i}") for i in range(self.config.encoder_layers)]
        last = [self.layer(f"{decoder}.layers.{i}") for i in range(self.config.decoder_layers)]
        (weight, bias), undo = self.layer(f"{decoder}.output"), self.tensors[f"{wanted}.unwhiten"]
        after: Layer = (
            np.ascontiguousarray(undo @ weight),
            np.ascontiguousarray(undo @ bias + self.tensors[f"{wanted}.mean"]),
        )
        models = model_named(read), model_named(made)
        layers = [*last, after]
        packed = native.network("latents", *models, before, first, self.layer(f"{encoder}.project"), layers)
        return packed, np.concatenate([each for _, each in layers])
