"""The network behind `mipbake-1`: averages of moments and of learned quantities, corrected by a pointwise decoder.

    stack_L = decode(K_L * [moments(theta), encode(theta)], L, p)

The structure follows Kemppinen et al. 2023 (equation 1): everything between encoder and decoder is a linear filter. The
network differs from theirs in five ways.

- Part of the latent code is not learned (moments.py): what closed forms average.
- The latent filter K_L is the pixel filter p itself, at every level, level 0 included, sharpened for the lookup that
  will read the level (level_filter.py). The encoder need not know p: one network serves all pixel filters.
- The decoder knows the level and the filter, and its output is a change of the averages, in terms that vanish where a
  material is constant: there the result is the averaged input, exactly (corrections.py).
- The decoder also chooses how sharp a level is: it adds more or less of what sharpening added.
- Colours of diffuse light stay averages, right from every direction; colours of highlights may change.

A network may take the sampler: for each feature of it (`moment_config.FEATURES`), the decoder adds so many times
numbers of its own to what its layers sum up, which is what one more input would do.

Encoder and decoder are dense blocks (Huang et al. 2017); the encoder's first layers see 3 x 3 texels, the rest one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from mipbake.material import Kind, MaterialModel, model_named
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.pixel_filter import FILTERS, Wrap, level_sizes
from mipbake.models import surface
from mipbake.models.architecture import Levels
from mipbake.models.base import Network, Stacks
from mipbake.models.corrections import CRISP, corrected, more, output_count, output_places
from mipbake.models.dense import SLOPE, dense
from mipbake.models.direction import OUTPUTS, stretched
from mipbake.models.level_filter import Lookup
from mipbake.models.lookup_kernel import periodic_levels
from mipbake.models.moment_config import MOST_LEVEL, NAMED, MomentConfig
from mipbake.models.moment_statistics import Statistics, feature_count
from mipbake.models.moments import least_roughness, moment_count, moment_places, moments
from mipbake.models.parameters import agreeing

_STEP = 0.1
"""Scale of the outputs: it bounds what one step of Adam, which knows no scale, does to glossy highlights."""

_FIRST_GUESS = 0.7
"""Share of `to_widened` that an untrained network applies."""

_DETAIL_SCALE = 8.0  # of what sharpening added, as an input of the decoder


class MomentNetwork(Network):
    """Encoder, filtering and decoder from a material model to it, or from a round one to its anisotropic twin.

    Images are (B, H, W, channels): R of the model that is read, C of the model that is made.

    Args:
        config: the architecture.
    """

    config: MomentConfig

    def __init__(self, config: MomentConfig) -> None:
        super().__init__(config)
        (read,), (made,) = config.encoders, config.decoders
        self.read, self.made = model_named(read), model_named(made)
        growth, layers, inputs = config.growth, config.convolutions + config.pointwise, _input_count(self.read)
        self.encoder = nn.ModuleList(
            nn.Conv2d(inputs + growth * i, growth, 3 if i < config.convolutions else 1) for i in range(layers)
        )
        self.project = nn.Conv2d(inputs + growth * layers, config.latent_channels, 1)
        seen, wide = feature_count(self.read) + NAMED + len(FILTERS) + config.latent_channels, config.decoder_growth
        self.decoder = nn.ModuleList(nn.Linear(seen + wide * i, wide) for i in range(config.decoder_layers))
        self.output = nn.Linear(seen + wide * config.decoder_layers, output_count(self.made))
        # Beside the output, so that a network for anisotropic lobes can start from one for round ones.
        self.stretch = nn.Linear(seen + wide * config.decoder_layers, OUTPUTS) if config.anisotropic else None
        self.crisp = nn.Linear(seen + wide * config.decoder_layers + self.detail, CRISP)
        if config.samplers:
            self.told = nn.Parameter(torch.zeros(len(config.samplers), sum(self._sums)))
        for layer in (*self.encoder, *self.decoder):
            nn.init.kaiming_normal_(layer.weight, a=SLOPE)
            nn.init.zeros_(layer.bias)
        for last in (self.output, self.crisp, self.stretch):
            if last is not None:
                nn.init.zeros_(last.weight)
                nn.init.zeros_(last.bias)
        with torch.no_grad():
            self.output.bias[output_places(self.made).to_widened] = _FIRST_GUESS / _STEP
        # Convolutions run on channels-last memory, in which images come.
        self.encoder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def halo(self) -> int:
        """Texels around a texel that its latents depend on."""
        return self.config.convolutions

    @property
    def latent_channels(self) -> int:
        """Moments and learned channels together."""
        return moment_count(self.read) + self.config.latent_channels

    @property
    def detail(self) -> int:
        """Latents that `with_detail` adds: what sharpening added to the averages of the first moments, from the colours
        to 1 - n_z."""
        return int(moment_places(self.read).drop.stop)

    def encode_extended(self, stored: Tensor) -> Tensor:
        """(B, H + 2 halo, W + 2 halo, R) stored channels, borders included, to (B, H, W, Z), not filtered yet."""
        border = self.halo
        inside = stored[:, border : stored.shape[1] - border, border : stored.shape[2] - border]
        maps = _inputs(stored, self.read).permute(0, 3, 1, 2)
        for index, layer in enumerate(self.encoder):
            new = functional.leaky_relu(layer(maps), SLOPE)
            if index < self.config.convolutions:
                maps = maps[:, :, 1:-1, 1:-1]
            maps = torch.cat([maps, new], 1)
        learned = self.project(maps).permute(0, 2, 3, 1)
        return torch.cat([moments(inside, self.read), learned], -1)

    @property
    def _sums(self) -> list[int]:
        """How many numbers each part of the decoder sums up: its layers, the output and `crisp`."""
        return [*[self.config.decoder_growth] * self.config.decoder_layers, self.output.out_features, CRISP]

    def _added(self, sampler: Sampler | None) -> list[Tensor | float]:
        """What is added to the sums of each part of the decoder."""
        if sampler is None:
            return [0.0] * len(self._sums)
        # Of Python's numbers: a recorded step copies nothing from the processor.
        rows = [share * row for share, row in zip(self.config.features(sampler), self.told, strict=True) if share]
        return list(torch.split(torch.stack(rows).sum(0) if len(rows) > 1 else rows[0], self._sums))

    def decode(self, latent: Tensor, level: Tensor, pixel_filter: str, sampler: Sampler | None = None) -> Tensor:
        """(..., Z + detail) filtered latents to (..., C) stored channels, valid as they are; differentiable.

        Args:
            latent: filtered and sharpened, and what sharpening did (with_detail).
            level: float index of the level of each texel, (..., 1) or what broadcasts to it.
            pixel_filter: that the latents were filtered with.
            sampler: that will look the texels up; None for a network that does not take it.
        """
        *of_layers, of_output, of_crisp = self._added(sampler)
        count, width = moment_count(self.read), self.detail
        latent, detail = latent[..., :-width], latent[..., -width:].detach()
        found = Statistics(latent[..., :count].detach(), self.read)  # of the latents that are not learned
        level = level.expand(*latent.shape[:-1], 1)
        first, second = (level == 0).float(), (level == 1).float()
        named = latent.new_zeros(len(FILTERS))
        named[list(FILTERS).index(pixel_filter)].fill_(1)
        code = [first, second, (level.clamp(max=MOST_LEVEL) - 3) / 4, named.expand(*latent.shape[:-1], len(FILTERS))]
        maps = torch.cat([found.features(), *code, latent[..., count:]], -1)
        layers = [cast(nn.Linear, layer) for layer in self.decoder]
        biases = [layer.bias + each for layer, each in zip(layers, of_layers, strict=True)]
        flat = dense(maps.reshape(1, -1, maps.shape[-1]), [layer.weight for layer in layers], biases)
        maps = flat.reshape(*maps.shape[:-1], -1)
        # Not of one tensor: it would be a copy of all maps.
        by_maps, by_detail = torch.split(self.crisp.weight, [maps.shape[-1], width], 1)
        crisp = functional.linear(maps, by_maps, self.crisp.bias + of_crisp)
        crisp = crisp + functional.linear(_DETAIL_SCALE * detail, by_detail)
        added = more(detail, crisp.tanh(), self.read)
        texels = corrected(found, _STEP * (self.output(maps) + of_output), added, self.read, self.made)
        if self.stretch is not None:
            lobes = added[..., moment_places(self.read).stretch]
            out = _STEP * self.stretch(maps)
            texels = {**texels, **stretched(found, texels[Kind.ROUGHNESS], out, lobes, self.made)}
        return torch.cat([texels[part.kind] for part in self.made.parts], -1)

    def forward(self, stored: Tensor, source: str, pixel_filter: str, sampler: Sampler = DEFAULT_SAMPLER) -> Stacks:  # noqa: ARG002
        """See Network. The source is the model that is read."""
        taken = self.config.taken(sampler)
        latents, index = self._latents(stored, pixel_filter, taken)
        levels = _split(self.decode(latents, index, pixel_filter, taken), stored)
        (made,) = self.config.decoders
        return {made: agreeing(levels, made, ("wrap", "wrap"))}

    def _latents(self, stored: Tensor, pixel_filter: str, sampler: Sampler | None) -> tuple[Tensor, Tensor]:
        """(B, N, Z) filtered latents of all levels one after the other, and (N, 1) the level of each."""
        halo = self.halo
        maps = functional.pad(stored.permute(0, 3, 1, 2), (halo, halo, halo, halo), mode="circular")
        encoded = self.encode_extended(maps.permute(0, 2, 3, 1))
        sharp = periodic_levels(encoded, pixel_filter, sampler=sampler)
        plain = periodic_levels(encoded[..., : self.detail], pixel_filter, sharp=False, sampler=sampler)
        latents = [with_detail(*both) for both in zip(sharp, plain, strict=True)]
        # One pass over the texels of all levels: the small ones cost no more than their texels.
        levels = [latents[0].new_full((z.shape[1], 1), float(level)) for level, z in enumerate(latents)]
        return torch.cat(latents, 1), torch.cat(levels)

    def levels(
        self,
        stored: NDArray[np.float32],
        read: str,  # noqa: ARG002
        made: str,  # noqa: ARG002
        lookup: Lookup,
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
    ) -> Levels:
        """See Baker."""
        from mipbake.models.moment_inference import bake_levels

        return bake_levels(self, stored, lookup, wrap, progress=progress)


def with_detail(sharp: Tensor, plain: Tensor) -> Tensor:
    """(..., Z + detail) what `decode` takes: filtered latents after sharpening, (..., Z), and what sharpening added to
    the first of them, which are given before it, (..., detail)."""
    return torch.cat([sharp, sharp[..., : plain.shape[-1]] - plain], -1)


def _split(texels: Tensor, stored: Tensor) -> list[Tensor]:
    """(B, N, C) texels of all levels of (B, S, S, R) images to (B, S_L, S_L, C) each."""
    sizes = level_sizes(stored.shape[1], stored.shape[2])
    parts = torch.split(texels, [height * width for height, width in sizes], 1)
    return [part.reshape(len(stored), *size, -1) for part, size in zip(parts, sizes, strict=True)]


def _input_count(model: MaterialModel) -> int:
    """How many numbers the encoder sees of a texel."""
    return _inputs(torch.zeros(1, model.channels), model).shape[-1]


def _inputs(stored: Tensor, model: MaterialModel) -> Tensor:
    """(..., R) stored channels to numbers of about 1 for the encoder.

    Slopes come twice: as normals, and in units of the lobe's width, where they decide how a glossy surface looks.
    """
    xy, z = torch.split(surface.unit_normals(stored, model), [2, 1], -1)
    roughness = surface.round_roughness(stored, model).clamp(min=least_roughness(model))
    relative = torch.asinh(xy / z.clamp(min=0.1) / roughness.square()) / 3
    steepness = 4 * xy.square().sum(-1, keepdim=True)
    colours, shares, peak = (
        surface.maps(stored, model, kind) for kind in (Kind.REFLECTANCE, Kind.SHARE, Kind.LOG_GAMMA)
    )
    lobe = [roughness.log() + 0.8, surface.stretch(stored, model), peak]
    return torch.cat([2 * colours - 0.8, shares, *lobe, 3 * xy, relative, steepness], -1)
