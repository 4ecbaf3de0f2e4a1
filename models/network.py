"""Encoder and decoder (section 3.3 of Kemppinen et al. 2023).

The encoder sees the texture extended beyond its borders by its wrap mode, `halo` texels on every side, and consumes
that halo with convolutions that pad nothing. So a tile with its halo gives what the whole image gives.

An untrained network is linear prefiltering: the first latents carry the whitened input, the decoder's last layer reads
them alone, and un-whitening undoes whitening. Training starts from there.

A residual network (`NetworkConfig.residual`) keeps that baseline instead of only starting from it. The first P latents
*are* the pixel-filtered whitened parameters and one more is the filtered sum of their squares, so that any level knows
mean and variance of what it covers. The output is the mean plus the decoder's correction times v / (v + c), v the
variance: where a material is constant the result is exactly the average, and where it hardly varies it hardly differs.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from mipbake.models.config import NetworkConfig
from mipbake.models.latent import downsample, pixel_taps
from mipbake.models.parameters import to_parameters, to_stored
from mipbake.prefilter.pixel_filter import Wrap, level_sizes

_SLOPE = 0.1  # of the leaky rectifier below zero: no unit dies, and it costs what a plain rectifier does

_GATE = 0.01
"""c: variance, in whitened units and summed over parameters, at which half of the correction is applied."""

_STEP = 0.1
"""Scale of the correction: it bounds what one step of Adam, which knows no scale, does to glossy highlights."""

_VARIANCE_FLOOR = 1e-3
"""Added to the variances before whitening: a channel that is constant in the sample (metallic, often) stays finite."""


class Whitening(nn.Module):
    """Affine map that gives the training set's parameters zero mean and unit covariance, and its inverse."""

    mean: Tensor
    whiten: Tensor
    unwhiten: Tensor

    def __init__(self, parameters: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(parameters))
        self.register_buffer("whiten", torch.eye(parameters))
        self.register_buffer("unwhiten", torch.eye(parameters))

    def fit(self, samples: Tensor) -> None:
        """Takes mean and covariance from (N, P) parameters. Symmetric (ZCA): every channel stays recognisable."""
        samples = samples.double()
        covariance = torch.cov(samples.T) + _VARIANCE_FLOOR * torch.eye(samples.shape[1], dtype=torch.float64)
        values, vectors = torch.linalg.eigh(covariance)
        self.mean.copy_(samples.mean(0))
        self.whiten.copy_(vectors @ torch.diag(values.rsqrt()) @ vectors.T)
        self.unwhiten.copy_(vectors @ torch.diag(values.sqrt()) @ vectors.T)

    def forward(self, parameters: Tensor) -> Tensor:
        """(..., P) parameters to (..., P) whitened."""
        return functional.linear(parameters - self.mean, self.whiten)

    def inverse(self, whitened: Tensor) -> Tensor:
        """(..., P) whitened to (..., P) parameters."""
        return functional.linear(whitened, self.unwhiten, self.mean)


class Network(nn.Module):
    """Encoder, latent downsampling and decoder of one material model. Images are (B, H, W, channels)."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        parameters, growth = config.parameters, config.growth
        encoder_out = parameters + growth * config.encoder_layers
        decoder_out = config.latent_channels + growth * config.decoder_layers
        self.whitening = Whitening(parameters)
        self.encoder = nn.ModuleList(
            nn.Conv2d(parameters + growth * i, growth, 3) for i in range(config.encoder_layers)
        )
        self.project = nn.Linear(encoder_out, config.latent_channels - config.fixed_latents)
        self.decoder = nn.ModuleList(
            nn.Linear(config.latent_channels + growth * i, growth) for i in range(config.decoder_layers)
        )
        self.output = nn.Linear(decoder_out, parameters)
        self._initialise()

    def _initialise(self) -> None:
        for layer in (*self.encoder, *self.decoder):
            nn.init.kaiming_normal_(layer.weight, a=_SLOPE)
            nn.init.zeros_(layer.bias)
        p = self.config.parameters
        with torch.no_grad():
            nn.init.kaiming_normal_(self.project.weight, nonlinearity="linear")
            nn.init.zeros_(self.project.bias)
            if self.config.residual:
                nn.init.zeros_(self.output.weight)
            else:
                self.project.weight[:p] = torch.eye(p, self.project.in_features)
                self.output.weight.copy_(torch.eye(p, self.output.in_features))
            nn.init.zeros_(self.output.bias)
            # Convolutions run on channels-last memory, in which images come.
            self.encoder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def halo(self) -> int:
        """Texels around an output texel that it depends on."""
        return self.config.encoder_layers

    def encode(self, stored: Tensor, wrap: Wrap) -> Tensor:
        """(B, H, W, C) stored channels to (B, H, W, Z) latents, any size."""
        return self.encode_extended(extend(stored, self.halo, wrap))

    def encode_extended(self, stored: Tensor) -> Tensor:
        """(B, H + 2 halo, W + 2 halo, C) stored channels, borders included, to (B, H, W, Z) latents."""
        whitened = self.whitening(to_parameters(stored, self.config.model))
        fixed = [self._moments(whitened)] if self.config.residual else []
        maps = whitened.permute(0, 3, 1, 2)
        for layer in self.encoder:
            new = functional.leaky_relu(layer(maps), _SLOPE)
            maps = torch.cat([maps[:, :, 1:-1, 1:-1], new], 1)
        latent: Tensor = self.project(maps.permute(0, 2, 3, 1))
        return torch.cat([*fixed, latent], -1) if fixed else latent

    def _moments(self, whitened: Tensor) -> Tensor:
        """(B, H + 2 halo, W + 2 halo, P) to (B, H, W, P + 1): filtered parameters, filtered sum of their squares."""
        taps = pixel_taps(self.config.latent_filter)
        border = self.halo - len(taps) // 2
        moments = torch.cat([whitened, whitened.square().sum(-1, keepdim=True)], -1)
        moments = moments[:, border : moments.shape[1] - border, border : moments.shape[2] - border]
        for axis in (1, 2):
            size = moments.shape[axis] - len(taps) + 1
            moments = torch.stack([w * moments.narrow(axis, i, size) for i, w in enumerate(taps)]).sum(0)
        return moments

    def decode(self, latent: Tensor) -> Tensor:
        """(..., Z) latents of any level to (..., C) stored channels, valid as they are; differentiable."""
        # Every layer reads all maps before it. So each group of maps is multiplied once, by the weights that all later
        # layers have for it, and their sums wait: few large products in place of many small ones and of copies.
        layers = [*self.decoder, self.output]
        channels, growth = self.config.latent_channels, self.config.growth
        weights = [layer.weight for layer in layers]
        sums = functional.linear(
            latent, torch.cat([w[:, :channels] for w in weights]), torch.cat([layer.bias for layer in layers])
        )
        for i in range(len(self.decoder)):
            first = channels + growth * i
            later = torch.cat([w[:, first : first + growth] for w in weights[i + 1 :]])
            new = functional.leaky_relu(sums[..., :growth], _SLOPE)
            sums = sums[..., growth:] + functional.linear(new, later)
        if self.config.residual:
            p = self.config.parameters
            mean = latent[..., :p]
            variance = (latent[..., p : p + 1] - mean.square().sum(-1, keepdim=True)).clamp(min=0)
            sums = mean + _STEP * variance / (variance + _GATE) * sums
        return to_stored(self.whitening.inverse(sums), self.config.model)

    def forward(self, stored: Tensor, wrap: Wrap) -> list[Tensor]:
        """(B, H, W, C) stored channels to every level of the stack, (B, H_L, W_L, C) each, down to 1 x 1."""
        latent = self.encode(stored, wrap)
        latents = [latent]
        for level, size in enumerate(level_sizes(*stored.shape[1:3])[1:], 1):
            first = level == 1 and not self.config.residual
            latents.append(downsample(latents[-1], size, self.config.latent_filter, wrap, first))
        # One pass over the texels of all levels: the small ones cost no more than their texels.
        flat = [z.reshape(len(z), -1, z.shape[-1]) for z in latents]
        decoded = torch.split(self.decode(torch.cat(flat, 1)), [z.shape[1] for z in flat], 1)
        return [d.reshape(*z.shape[:3], -1) for d, z in zip(decoded, latents, strict=True)]


def extend(image: Tensor, border: int, wrap: Wrap) -> Tensor:
    """(B, H, W, C) to (B, H + 2 border, W + 2 border, C), the outside filled by the wrap mode of each axis."""
    rows = border_indices(-border, image.shape[1] + border, image.shape[1], wrap[1])
    columns = border_indices(-border, image.shape[2] + border, image.shape[2], wrap[0])
    return image[:, rows][:, :, columns]


def border_indices(start: int, stop: int, size: int, wrap: str) -> Tensor:
    """Texel that stands at each of start, ..., stop - 1 on an axis of that size and wrap mode."""
    index = torch.arange(start, stop)
    return index % size if wrap == "wrap" else index.clamp(0, size - 1)
