"""Encoders and decoders (sections 3.3 and 3.5 of Kemppinen et al. 2023).

Each material model that is read has an encoder, and each material model that is made has a decoder. All share one
latent code. The usual network has one encoder and one decoder. An encoder sees the texture extended beyond its borders
by its wrap mode, `halo` texels on every side, and consumes that halo with convolutions that pad nothing. So a tile with
its halo gives what the whole image gives.

An untrained network is linear prefiltering: the first latents carry the whitened input, a decoder's last layer reads
them alone, and un-whitening undoes whitening. Training starts from there. Between two material models the linear map
nearest to their conversion stands in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from mipbake.base.errors import UsageError
from mipbake.material import convert
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.pixel_filter import Wrap, level_sizes
from mipbake.models.architecture import Levels
from mipbake.models.base import Network, Patches, Stacks
from mipbake.models.dense import SLOPE, dense
from mipbake.models.latent_config import PARAMETERS, LatentConfig
from mipbake.models.latent_filter import latent_weights
from mipbake.models.level_filter import Lookup
from mipbake.models.parameters import agreeing, to_parameters, to_stored
from mipbake.models.tiles import extend

_VARIANCE_FLOOR = 1e-3
"""Added to the variances before whitening: a channel that is constant in the sample (metallic, often) stays finite."""

_PERIODIC = ("wrap", "wrap")


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


class Encoder(nn.Module):
    """Dense 3 x 3 layers and the projection to latents."""

    def __init__(self, config: LatentConfig, model: str) -> None:
        super().__init__()
        inputs, growth = PARAMETERS[model], config.growth
        self.layers = nn.ModuleList(nn.Conv2d(inputs + growth * i, growth, 3) for i in range(config.encoder_layers))
        self.project = nn.Linear(inputs + growth * config.encoder_layers, config.latent_channels)
        _initialise(self.layers)
        nn.init.kaiming_normal_(self.project.weight, nonlinearity="linear")
        nn.init.zeros_(self.project.bias)
        # Convolutions run on channels-last memory, in which images come.
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, whitened: Tensor) -> Tensor:
        """(B, H + 2 halo, W + 2 halo, P) whitened parameters, borders included, to (B, H, W, Z) latents."""
        maps = whitened.permute(0, 3, 1, 2)
        for layer in self.layers:
            new = functional.leaky_relu(layer(maps), SLOPE)
            maps = torch.cat([maps[:, :, 1:-1, 1:-1], new], 1)
        latent: Tensor = self.project(maps.permute(0, 2, 3, 1))
        return latent

    def periodic(self, whitened: Tensor) -> Tensor:
        """(B, H, W, P) whitened parameters of images that repeat to (B, H, W, Z) latents; the faster in training."""
        maps = dense(whitened.flatten(1, 2), *_parameters(self.layers), (whitened.shape[1], whitened.shape[2]))
        latent: Tensor = self.project(maps)
        return latent.reshape(*whitened.shape[:3], -1)


class Decoder(nn.Module):
    """Dense 1 x 1 layers and the projection to whitened parameters."""

    def __init__(self, config: LatentConfig, model: str) -> None:
        super().__init__()
        channels, growth = config.latent_channels, config.growth
        self.layers = nn.ModuleList(nn.Linear(channels + growth * i, growth) for i in range(config.decoder_layers))
        self.output = nn.Linear(channels + growth * config.decoder_layers, PARAMETERS[model])
        _initialise(self.layers)
        nn.init.zeros_(self.output.weight)
        nn.init.zeros_(self.output.bias)

    def forward(self, latent: Tensor) -> Tensor:
        """(..., Z) latents to (..., P) whitened parameters."""
        maps = dense(latent.reshape(1, -1, latent.shape[-1]), *_parameters(self.layers))
        out: Tensor = self.output(maps)
        return out.reshape(*latent.shape[:-1], -1)


def _initialise(layers: nn.ModuleList) -> None:
    for weight, bias in zip(*_parameters(layers), strict=True):
        nn.init.kaiming_normal_(weight, SLOPE, nonlinearity="leaky_relu")
        nn.init.zeros_(bias)


def _parameters(layers: nn.ModuleList) -> tuple[list[Tensor], list[Tensor]]:
    """Weights and biases of each layer."""
    known = [cast("nn.Linear | nn.Conv2d", layer) for layer in layers]
    return [layer.weight for layer in known], [cast(Tensor, layer.bias) for layer in known]


@lru_cache(maxsize=64)
def _matrix(n_in: int, n_out: int, latent_filter: str, wrap: str, first: bool, device: torch.device) -> Tensor:
    index, weights = latent_weights(n_in, n_out, latent_filter, wrap, first)
    matrix = np.zeros((n_out, n_in), np.float32)
    np.add.at(matrix, (np.arange(n_out)[:, None], index), weights)
    with torch.inference_mode(False):  # whoever asks first, training may ask later
        return torch.from_numpy(matrix).to(device)


def downsample(latent: Tensor, size: tuple[int, int], latent_filter: str, wrap: Wrap, first: bool) -> Tensor:
    """(B, H, W, Z) latents of a level to (B, size[0], size[1], Z) of the next; linear, differentiable."""
    batch, height, width, channels = latent.shape
    down_rows = _matrix(height, size[0], latent_filter, wrap[1], first, latent.device).to(latent)
    down_columns = _matrix(width, size[1], latent_filter, wrap[0], first, latent.device).to(latent)
    rows = torch.matmul(down_rows, latent.reshape(batch, height, width * channels))
    columns = torch.matmul(down_columns, rows.reshape(batch * size[0], width, channels))
    return columns.reshape(batch, *size, channels)


class LatentNetwork(Network):
    """Encoders, latent downsampling and decoders."""

    config: LatentConfig

    def __init__(self, config: LatentConfig) -> None:
        super().__init__(config)
        self.whitening = nn.ModuleDict({model: Whitening(PARAMETERS[model]) for model in config.models})
        self.encoders = nn.ModuleDict({model: Encoder(config, model) for model in config.encoders})
        self.decoders = nn.ModuleDict({model: Decoder(config, model) for model in config.decoders})
        self._pass_through()

    def only_of(self, parameter: str) -> str:
        """See Network. An encoder is trained with what it reads."""
        part, model, *_ = parameter.split(".")
        return model if part == "encoders" else ""

    def _pass_through(self) -> None:
        """Has the first latents carry what an encoder is given, and decoders read them alone."""
        with torch.no_grad():
            for source in self.config.encoders:
                project, inputs = self.encoder_of(source).project, PARAMETERS[source]
                project.weight[:inputs] = torch.eye(inputs, project.in_features)
            for target in self.config.decoders:
                weight = self.decoder_of(target).output.weight
                weight.copy_(torch.eye(*weight.shape))

    def whitening_of(self, model: str) -> Whitening:
        """The whitening of a model that is read or made."""
        return cast(Whitening, self.whitening[model])

    def encoder_of(self, source: str) -> Encoder:
        """The encoder of a model that is read."""
        return cast(Encoder, self.encoders[source])

    def decoder_of(self, target: str) -> Decoder:
        """The decoder of a model that is made."""
        return cast(Decoder, self.decoders[target])

    @property
    def halo(self) -> int:
        """Texels around an output texel that it depends on."""
        return self.config.encoder_layers

    def fit(self, patches: Patches) -> None:
        """Takes the whitening from patches of each encoder's model, and starts the network at linear prefiltering.

        The first latents are the whitened parameters of every model that is read, one after the other: the parameters
        of the encoder's own model as they are, the parameters of the other models as what is linearly nearest. A
        decoder reads the parameters of its own model, or what is linearly nearest to the parameters of the first.
        """
        samples = {source: self._parameters_of(patches(source), source) for source in self.config.encoders}
        encoders, first = self.config.encoders, self.config.encoders[0]
        for model in self.config.models:
            self.whitening_of(model).fit(samples[model if model in encoders else first][model])
        self._start_linear(samples)

    def _parameters_of(self, patches: NDArray[np.float32], source: str) -> dict[str, Tensor]:
        """(N, P) parameters of the texels of patches of a model, in every model of the network."""
        stored = {model: torch.from_numpy(convert(patches, source, model)) for model in self.config.models}
        return {model: to_parameters(each, model).flatten(0, 2) for model, each in stored.items()}

    def _start_linear(self, samples: Mapping[str, Mapping[str, Tensor]]) -> None:
        """Linear prefiltering, from the parameters of the same materials in every model, for each encoder's model."""
        encoders, first = self.config.encoders, self.config.encoders[0]
        counts = [PARAMETERS[model] for model in encoders]
        slots = {m: slice(sum(counts[:i]), sum(counts[: i + 1])) for i, m in enumerate(encoders)}
        with torch.no_grad():
            for source in encoders:
                encoder = self.encoder_of(source)
                for model, slot in slots.items():
                    matrix, offset = self._linear_map(samples[source], source, model)
                    encoder.project.weight[slot] = 0
                    encoder.project.weight[slot, : PARAMETERS[source]] = matrix
                    encoder.project.bias[slot] = offset
            for model in self.config.decoders:
                decoder = self.decoder_of(model)
                source = model if model in encoders else first
                matrix, offset = self._linear_map(samples[source], source, model)
                decoder.output.weight.zero_()
                decoder.output.weight[:, slots[source]] = matrix
                decoder.output.bias.copy_(offset)

    def _linear_map(self, samples: Mapping[str, Tensor], source: str, target: str) -> tuple[Tensor, Tensor]:
        """Matrix (Q, P) and offset (Q,) of the least-squares map between whitened parameters of two models."""
        if source == target:
            return torch.eye(PARAMETERS[source]), torch.zeros(PARAMETERS[source])
        inputs, outputs = (self.whitening_of(m)(samples[m]).double() for m in (source, target))
        inputs = torch.cat([inputs, torch.ones_like(inputs[:, :1])], 1)
        # A ridge: channels that are constant in the sample say nothing, and are to be ignored rather than extrapolated.
        gram = inputs.T @ inputs / len(inputs) + 1e-6 * torch.eye(inputs.shape[1], dtype=torch.float64)
        solution = torch.linalg.solve(gram, inputs.T @ outputs / len(inputs)).float()
        return solution[:-1].T, solution[-1]

    def encode(self, stored: Tensor, wrap: Wrap, source: str | None = None) -> Tensor:
        """(B, H, W, C) stored channels of a source (default: the only one) to (B, H, W, Z) latents, any size."""
        source = source or self._only("encoders")
        if wrap == _PERIODIC:  # faster
            return self.encoder_of(source).periodic(self.whitening_of(source)(to_parameters(stored, source)))
        return self.encode_extended(extend(stored, self.halo, wrap), source)

    def encode_extended(self, stored: Tensor, source: str | None = None) -> Tensor:
        """(B, H + 2 halo, W + 2 halo, C) stored channels, borders included, to (B, H, W, Z) latents."""
        source = source or self._only("encoders")
        latent: Tensor = self.encoder_of(source)(self.whitening_of(source)(to_parameters(stored, source)))
        return latent

    def decode(self, latent: Tensor, target: str | None = None) -> Tensor:
        """(..., Z) latents of any level to (..., C) stored channels of a target, valid as they are; differentiable."""
        target = target or self._only("decoders")
        return to_stored(self.whitening_of(target).inverse(self.decoder_of(target)(latent)), target)

    def forward(
        self,
        stored: Tensor,
        source: str,
        pixel_filter: str,  # noqa: ARG002
        sampler: Sampler = DEFAULT_SAMPLER,  # noqa: ARG002
    ) -> Stacks:
        """See Network. The pixel filter is the one that the network is trained for; it does not take the sampler."""
        return self.stacks(stored, _PERIODIC, source)

    def stacks(self, stored: Tensor, wrap: Wrap, source: str) -> dict[str, list[Tensor]]:
        """(B, H, W, C) stored channels of a source to the levels of every target, (B, H_L, W_L, C) each, to 1 x 1."""
        latent = self.encode(stored, wrap, source)
        latents = [latent]
        for level, size in enumerate(level_sizes(*stored.shape[1:3])[1:], 1):
            latents.append(downsample(latents[-1], size, self.config.latent_filter, wrap, first=level == 1))
        # One pass over the texels of all levels: the small ones cost no more than their texels.
        flat = [z.reshape(len(z), -1, z.shape[-1]) for z in latents]
        texels, counts = torch.cat(flat, 1), [z.shape[1] for z in flat]
        stacks = {}
        for target in self.config.decoders:
            decoded = torch.split(self.decode(texels, target), counts, 1)
            levels = [d.reshape(*z.shape[:3], -1) for d, z in zip(decoded, latents, strict=True)]
            stacks[target] = agreeing(levels, target, wrap)
        return stacks

    def levels(
        self,
        stored: NDArray[np.float32],
        read: str,
        made: str,
        lookup: Lookup,  # noqa: ARG002
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
    ) -> Levels:
        """See Baker."""
        from mipbake.models.latent_inference import bake_levels

        return bake_levels(self, stored, wrap, progress=progress, source=read, target=made)

    def _only(self, kind: str) -> str:
        models: tuple[str, ...] = getattr(self.config, kind)
        if len(models) > 1:
            raise UsageError(f"a network with the {kind} {', '.join(models)} needs one of them named")
        return models[0]
