"""Baking with the weights of a LatentNetwork in the native core, without torch.

`mipbake.models.latent_inference` is the twin of it in torch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake import _native, material
from mipbake.base import memory
from mipbake.base.device import PROCESSOR
from mipbake.material import directions, model_named
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.pixel_filter import Wrap, level_sizes
from mipbake.models import native
from mipbake.models.architecture import Baker
from mipbake.models.latent_config import LatentConfig
from mipbake.models.latent_filter import latent_weights
from mipbake.models.level_filter import checked_filter
from mipbake.models.native import Axis, Layer, Sink, Tensors, Top


@dataclass(frozen=True, eq=False)
class LatentBaker(Baker):
    """Weights of a LatentNetwork, ready for bakes.

    Args:
        config: the architecture. pixel_filters: that the weights were trained for; () where nothing says so.
        tensors: by the names that the network's state has.
        device: where it runs, as `native.bake` takes it.
    """

    config: LatentConfig
    pixel_filters: tuple[str, ...]
    tensors: Tensors
    device: str = PROCESSOR

    @classmethod
    def of(
        cls, config: LatentConfig, pixel_filters: tuple[str, ...], tensors: Tensors, device: str = PROCESSOR
    ) -> LatentBaker:
        """Raises KeyError or ValueError where the tensors do not fit the architecture."""
        out = cls(config, pixel_filters, tensors, device)
        for read in config.encoders:
            for made in config.decoders:
                out.packed(read, made)
        return out

    def bake(
        self,
        stored: NDArray[np.float32],
        source: str,
        target: str,
        pixel_filter: str,
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
        sampler: Sampler = DEFAULT_SAMPLER,  # noqa: ARG002
    ) -> list[NDArray[np.float32]]:
        """See Baker. Latent networks do not take the sampler."""
        checked_filter(self.config, self.pixel_filters, source, pixel_filter)
        read, made = self.config.read_as(source), self.config.made_from(target)
        levels = self.levels(material.convert(stored, source, read), read, made, wrap, progress)
        if made != target:
            levels = directions.agreeing([material.convert(level, made, target) for level in levels], target, wrap)
        return [material.regularise(level, target) for level in levels]

    def levels(
        self,
        stored: NDArray[np.float32],
        read: str,
        made: str,
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
    ) -> list[NDArray[np.float32]]:
        """Every level of the stack of a material, down to 1 x 1.

        Args:
            stored: (H, W, R) float32 stored channels of the model that is read, any size.
            read, made: models of the encoder and of the decoder.
            wrap: wrap mode along u and along v.
            progress: called with the finished share, from 0 to 1.

        Returns:
            (H_L, W_L, C) float32 stored channels of the model that is made, of every level.
        """
        sizes, kernel = level_sizes(*stored.shape[:2]), self.config.latent_filter
        out = [memory.empty((*size, model_named(made).channels)) for size in sizes]
        packed, biases = self.packed(read, made)
        sinks = []
        for level in range(1, len(sizes)):
            axes = [
                latent_weights(sizes[level - 1][axis], sizes[level][axis], kernel, wrap[1 - axis], level == 1)
                for axis in (0, 1)
            ]
            rows, columns = (Axis(index.astype(np.int32), weights, weights) for index, weights in axes)
            sinks.append(Sink(level - 2, rows, columns, out[level], biases))
        one, none = np.ones(1, np.float32), np.zeros(0, np.float32)
        native.bake(packed, stored, wrap, Top(one, none, out[0], biases), sinks, progress, self.device)
        return directions.agreeing(out, made, wrap)

    def packed(self, read: str, made: str) -> tuple[_native.Network, NDArray[np.float32]]:
        """An encoder and a decoder as the native core has them, and the decoder's biases one after the other."""
        encoder, decoder = f"encoders.{read}", f"decoders.{made}"
        given, wanted = f"whitening.{read}", f"whitening.{made}"
        whiten, mean = self.tensors[f"{given}.whiten"], self.tensors[f"{given}.mean"]
        before: Layer = (np.ascontiguousarray(whiten), np.ascontiguousarray(-(whiten @ mean)))
        first = [self._layer(f"{encoder}.layers.{i}") for i in range(self.config.encoder_layers)]
        last = [self._layer(f"{decoder}.layers.{i}") for i in range(self.config.decoder_layers)]
        (weight, bias), undo = self._layer(f"{decoder}.output"), self.tensors[f"{wanted}.unwhiten"]
        after: Layer = (
            np.ascontiguousarray(undo @ weight),
            np.ascontiguousarray(undo @ bias + self.tensors[f"{wanted}.mean"]),
        )
        models = model_named(read), model_named(made)
        layers = [*last, after]
        packed = native.network("latents", *models, before, first, self._layer(f"{encoder}.project"), layers)
        return packed, np.concatenate([each for _, each in layers])

    def _layer(self, name: str) -> Layer:
        return native.layer(self.tensors, name)
