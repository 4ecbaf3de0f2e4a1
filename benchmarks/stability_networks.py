"""Three networks of the paper's size, which differ in how levels come about: for benchmarks/stability.py.

- `linear`: the paper's. One encoding of level 0, averages of its latents, and a decoding of each (equation 1 of
  Kemppinen et al. 2023).
- `autoregressive`: what the paper sets it against (section 1): the same encoder and decoder make one level at a time,
  each from the box average of the level that they made before.
- `residual`: as `linear`, with residual layers in place of dense ones (section 3.3 says that they do alike).

All start as plain averages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from mipbake.material.pixel_filter import Wrap, level_sizes
from mipbake.models.dense import SLOPE
from mipbake.models.latent_config import PARAMETERS, LatentConfig
from mipbake.models.latent_network import LatentNetwork, downsample
from mipbake.models.parameters import agreeing, to_parameters, to_stored

_TORUS: Wrap = ("wrap", "wrap")
_WIDTH = 32
"""Maps of residual layers: they have a tenth more weights than the dense layers."""


class LinearNetwork(LatentNetwork):
    """The paper's network. Images are (B, H, W, C) and repeat."""

    def whitened(self, stored: Tensor, source: str) -> list[Tensor]:
        """(B, H_L, W_L, P) whitened parameters of every level that the decoder makes."""
        latents = [self.encode(stored, _TORUS, source)]
        for level, size in enumerate(level_sizes(*stored.shape[1:3])[1:], 1):
            latents.append(downsample(latents[-1], size, self.config.latent_filter, _TORUS, first=level == 1))
        return [self.decoder_of(source)(latent) for latent in latents]

    def stacks(self, stored: Tensor, wrap: Wrap, source: str) -> dict[str, list[Tensor]]:
        """See LatentNetwork."""
        inverse = self.whitening_of(source).inverse
        levels = [to_stored(inverse(each), source) for each in self.whitened(stored, source)]
        return {source: agreeing(levels, source, wrap)}


class AutoregressiveNetwork(LinearNetwork):
    """Encoder and decoder, applied again to the average of what they made."""

    def whitened(self, stored: Tensor, source: str) -> list[Tensor]:
        """See LinearNetwork."""
        image, levels = self.whitening_of(source)(to_parameters(stored, source)), []
        encoder, decoder = self.encoder_of(source), self.decoder_of(source)
        sizes = level_sizes(*stored.shape[1:3])
        for level, following in enumerate([*sizes[1:], None], 1):
            levels.append(decoder(encoder.periodic(image)))
            if following is not None:
                image = downsample(levels[-1], following, self.config.latent_filter, _TORUS, first=level == 1)
        return levels


class _Residual(nn.Module):
    """Layers that add to their input, between two projections; the first outputs pass the first inputs through."""

    def __init__(self, inputs: int, outputs: int, layers: int, side: int, width: int) -> None:
        super().__init__()
        self.enter, self.project = nn.Linear(inputs, width), nn.Linear(width, outputs)
        self.layers = nn.ModuleList(nn.Conv2d(width, width, side) for _ in range(layers))
        self.side, self.through = side, min(inputs, outputs)
        nn.init.zeros_(self.project.weight)
        nn.init.zeros_(self.project.bias)

    def forward(self, maps: Tensor) -> Tensor:
        """(B, H, W, inputs) that repeat to (B, H, W, outputs)."""
        inside = self.enter(maps).permute(0, 3, 1, 2)
        border = self.side // 2
        for layer in self.layers:
            seen = functional.pad(inside, (border,) * 4, mode="circular") if border else inside
            inside = inside + functional.leaky_relu(layer(seen), SLOPE)
        made: Tensor = self.project(inside.permute(0, 2, 3, 1))
        return made + functional.pad(maps[..., : self.through], (0, made.shape[-1] - self.through))

    periodic = forward


class ResidualNetwork(LinearNetwork):
    """Residual layers in place of dense ones."""

    def __init__(self, config: LatentConfig) -> None:
        super().__init__(config)
        (source,) = config.encoders
        count, latents = PARAMETERS[source], config.latent_channels
        self.encoders = nn.ModuleDict({source: _Residual(count, latents, config.encoder_layers, 3, _WIDTH)})
        self.decoders = nn.ModuleDict({source: _Residual(latents, count, config.decoder_layers, 1, _WIDTH)})

    def _start_linear(self, samples: Mapping[str, Mapping[str, Tensor]]) -> None:
        """It starts as averages as it is."""


KINDS: Mapping[str, type[LinearNetwork]] = {
    "linear": LinearNetwork,
    "autoregressive": AutoregressiveNetwork,
    "residual": ResidualNetwork,
}


@dataclass(frozen=True)
class StabilityConfig(LatentConfig):
    """One of the networks, for one material model."""

    architecture: ClassVar[str] = "stability"
    kind: str = "linear"

    def build(self) -> LinearNetwork:
        """See Architecture."""
        return KINDS[self.kind](self)


def growth(network: LinearNetwork, stored: Tensor, source: str) -> list[float]:
    """Of each level, the root mean square of its whitened parameters over that of plain averages; 1 is no growth."""
    with torch.inference_mode():
        average = network.whitening_of(source)(to_parameters(stored, source))
        ratios = []
        for level, made in enumerate(network.whitened(stored, source)):
            if level:
                average = downsample(average, made.shape[1:3], network.config.latent_filter, _TORUS, first=level == 1)
            ratios.append(float((made.square().mean() / average.square().mean()).sqrt()))
    return ratios
