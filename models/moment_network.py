"""The network behind `mipbake-1`: averages of moments and of learned quantities, corrected by a pointwise decoder.

    stack_L = decode(K_L * [moments(theta), encode(theta)], L, p)

The structure follows Kemppinen et al. 2023 (equation 1): everything between encoder and decoder is a linear filter. The
network differs from theirs in five ways.

- Part of the latent code is not learned (moments.py): what closed forms average.
- The latent filter K_L is the pixel filter p itself, at every level, level 0 included, sharpened for the lookup that
  will read the level (lookup_kernel.py). The encoder need not know p: one network serves all pixel filters.
- The decoder knows the level and the filter, and its output is a change of the averages, in terms that vanish where a
  material is constant: there the result is the averaged input, exactly.
- The decoder also chooses how sharp a level is: it adds more or less of what sharpening added.
- Colours of dielectrics stay averages, whose diffuse light is right from every direction; colours of metals may change.

Encoder and decoder are dense blocks (Huang et al. 2017); the encoder's first layers see 3 x 3 texels, the rest one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from mipbake.material import MIN_ROUGHNESS
from mipbake.models.base import Network, Stacks
from mipbake.models.channels import channels, count, parts, places
from mipbake.models.dense import SLOPE, dense
from mipbake.models.direction import OUTPUTS, stretched
from mipbake.models.lookup_kernel import periodic_levels
from mipbake.models.moment_config import MomentConfig
from mipbake.models.moments import COUNT, FEATURES, PLACES, Statistics, moments, statistics
from mipbake.models.parameters import settled
from mipbake.pixel_filter import FILTERS, Wrap, level_sizes

T = TypeVar("T")

_INPUTS = 10
_CODE = 3 + len(FILTERS)

DETAIL = PLACES.drop.stop
"""Latents that `with_detail` adds: what sharpening added to the averages of the first moments, from base colour to
1 - n_z."""


@dataclass(frozen=True)
class _Outputs(Generic[T]):
    """What the decoder says of a texel.

    Args:
        to_lean, to_widened, to_geometric, to_quartic: shares of these changes of ln roughness.
        roughness: of what may change freely. gain: of a metal's colour, freely.
        metallic_colour, metallic_variance: shares of these changes of base colour and of metallic.
        lean_normal: share of this change of the normal. tilt: how much more the normal leans. normal: freely.
        choice: of the texels that the lobe stands for.
    """

    to_lean: T = field(metadata=channels(1))
    to_widened: T = field(metadata=channels(1))
    to_geometric: T = field(metadata=channels(1))
    to_quartic: T = field(metadata=channels(1))
    roughness: T = field(metadata=channels(1))
    gain: T = field(metadata=channels(3))
    metallic_colour: T = field(metadata=channels(1))
    metallic_variance: T = field(metadata=channels(1))
    lean_normal: T = field(metadata=channels(1))
    tilt: T = field(metadata=channels(1))
    normal: T = field(metadata=channels(2))
    choice: T = field(metadata=channels(2))


_SAID: _Outputs[slice] = places(_Outputs)
_OUTPUTS = count(_Outputs)

_STEP = 0.1
"""Scale of the outputs: it bounds what one step of Adam, which knows no scale, does to glossy highlights."""

_FIRST_GUESS = 0.7
"""Share of `to_widened` that an untrained network applies."""

_CAUTION = 2.0  # logarithm of how much an untrained network prefers all texels to the bright ones
_DECISION = 5.0

_MOST_GAIN = 0.5  # of a metal's colour, as a logarithm
_MOST_CHANGE = 3.0  # of ln roughness
_NARROWER = 0.1  # ln of roughness: how much narrower a lobe may be than the lobes that it stands for
_FARTHEST = 0.5  # share of a lobe's alpha by which its normal may move freely
_CRISP = 3  # how much more sharpening there is of colours, of roughness, and of normals: -1 for none, to 1 for twice
_DETAIL_SCALE = 8.0
_MAX_LENGTH2, _MIN_HEIGHT2 = 0.999, 1e-4  # of baked normals: the derivative of sqrt(1 - x^2) has no bound


class MomentNetwork(Network):
    """Encoder, filtering and decoder from the material model `gltf` to it, or to `gltf-anisotropic`.

    Images are (B, H, W, channels), those that are made have C = 8 or 11.

    Args:
        config: the architecture.
    """

    config: MomentConfig

    def __init__(self, config: MomentConfig) -> None:
        super().__init__(config)
        growth, layers = config.growth, config.convolutions + config.pointwise
        self.encoder = nn.ModuleList(
            nn.Conv2d(_INPUTS + growth * i, growth, 3 if i < config.convolutions else 1) for i in range(layers)
        )
        self.project = nn.Conv2d(_INPUTS + growth * layers, config.latent_channels, 1)
        seen, wide = FEATURES + _CODE + config.latent_channels, config.decoder_growth
        self.decoder = nn.ModuleList(nn.Linear(seen + wide * i, wide) for i in range(config.decoder_layers))
        self.output = nn.Linear(seen + wide * config.decoder_layers, _OUTPUTS)
        # Beside the output, so that a network for anisotropic lobes can start from one for round ones.
        self.stretch = nn.Linear(seen + wide * config.decoder_layers, OUTPUTS) if config.anisotropic else None
        self.crisp = nn.Linear(seen + wide * config.decoder_layers + DETAIL, _CRISP)
        for layer in (*self.encoder, *self.decoder):
            nn.init.kaiming_normal_(layer.weight, a=SLOPE)
            nn.init.zeros_(layer.bias)
        for last in (self.output, self.crisp, self.stretch):
            if last is not None:
                nn.init.zeros_(last.weight)
                nn.init.zeros_(last.bias)
        with torch.no_grad():
            self.output.bias[_SAID.to_widened] = _FIRST_GUESS / _STEP
        # Convolutions run on channels-last memory, in which images come.
        self.encoder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def halo(self) -> int:
        """Texels around a texel that its latents depend on."""
        return self.config.convolutions

    @property
    def latent_channels(self) -> int:
        """Moments and learned channels together."""
        return COUNT + self.config.latent_channels

    def encode_extended(self, stored: Tensor) -> Tensor:
        """(B, H + 2 halo, W + 2 halo, 8) stored channels, borders included, to (B, H, W, Z), not filtered yet."""
        border = self.halo
        inside = stored[:, border : stored.shape[1] - border, border : stored.shape[2] - border]
        maps = _inputs(stored).permute(0, 3, 1, 2)
        for index, layer in enumerate(self.encoder):
            new = functional.leaky_relu(layer(maps), SLOPE)
            if index < self.config.convolutions:
                maps = maps[:, :, 1:-1, 1:-1]
            maps = torch.cat([maps, new], 1)
        learned = self.project(maps).permute(0, 2, 3, 1)
        return torch.cat([moments(inside), learned], -1)

    def decode(self, latent: Tensor, level: Tensor, pixel_filter: str) -> Tensor:
        """(..., Z + DETAIL) filtered latents to (..., C) stored channels, valid as they are; differentiable.

        Args:
            latent: filtered and sharpened, and what sharpening did (with_detail).
            level: float index of the level of each texel, (..., 1) or what broadcasts to it.
            pixel_filter: that the latents were filtered with.
        """
        latent, detail = latent[..., :-DETAIL], latent[..., -DETAIL:].detach()
        found = statistics(latent[..., :COUNT].detach())  # statistics of the latents that are not learned
        level = level.expand(*latent.shape[:-1], 1)
        first, second = (level == 0).float(), (level == 1).float()
        named = latent.new_zeros(len(FILTERS))
        named[list(FILTERS).index(pixel_filter)] = 1
        code = [first, second, (level.clamp(max=8) - 3) / 4, named.expand(*latent.shape[:-1], len(FILTERS))]
        maps = torch.cat([found.features(), *code, latent[..., COUNT:]], -1)
        layers = [cast(nn.Linear, layer) for layer in self.decoder]
        flat = dense(maps.reshape(1, -1, maps.shape[-1]), [x.weight for x in layers], [x.bias for x in layers])
        maps = flat.reshape(*maps.shape[:-1], -1)
        # Not of one tensor: it would be a copy of all maps.
        by_maps, by_detail = torch.split(self.crisp.weight, [maps.shape[-1], DETAIL], 1)
        crisp = functional.linear(maps, by_maps, self.crisp.bias) + functional.linear(_DETAIL_SCALE * detail, by_detail)
        crisp = crisp.tanh()
        texels = _changed(found, _STEP * self.output(maps), _more(detail, crisp))
        if self.stretch is None:
            return texels
        roughness, lobe = stretched(found, texels[..., 4:5], _STEP * self.stretch(maps))
        return torch.cat([texels[..., :4], roughness, texels[..., 5:], lobe], -1)

    def forward(self, stored: Tensor, source: str, pixel_filter: str) -> Stacks:  # noqa: ARG002
        """See Network. The source is `gltf`."""
        latents, index = self._latents(stored, pixel_filter)
        levels = _split(self.decode(latents, index, pixel_filter), stored)
        (made,) = self.config.decoders
        return {made: settled(levels, made, ("wrap", "wrap"))}

    def _latents(self, stored: Tensor, pixel_filter: str) -> tuple[Tensor, Tensor]:
        """(B, N, Z) filtered latents of all levels one after the other, and (N, 1) the level of each."""
        halo = self.halo
        maps = functional.pad(stored.permute(0, 3, 1, 2), (halo, halo, halo, halo), mode="circular")
        encoded = self.encode_extended(maps.permute(0, 2, 3, 1))
        plain = periodic_levels(encoded[..., :DETAIL], pixel_filter, sharp=False)
        latents = [
            with_detail(sharp, each) for sharp, each in zip(periodic_levels(encoded, pixel_filter), plain, strict=True)
        ]
        # One pass over the texels of all levels: the small ones cost no more than their texels.
        levels = [latents[0].new_full((z.shape[1], 1), float(level)) for level, z in enumerate(latents)]
        return torch.cat(latents, 1), torch.cat(levels)

    def bake(
        self,
        stored: NDArray[np.float32],
        source: str,
        target: str,
        pixel_filter: str,
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
    ) -> list[NDArray[np.float32]]:
        """See Network."""
        from mipbake.models.moment_inference import bake

        return bake(self, stored, source, target, pixel_filter, wrap, progress)


def with_detail(sharp: Tensor, plain: Tensor) -> Tensor:
    """(..., Z + DETAIL) what `decode` takes, of filtered latents after and before sharpening."""
    return torch.cat([sharp, sharp[..., :DETAIL] - plain[..., :DETAIL]], -1)


def _split(texels: Tensor, stored: Tensor) -> list[Tensor]:
    """(B, N, C) texels of all levels of (B, S, S, 8) images to (B, S_L, S_L, C) each."""
    sizes = level_sizes(stored.shape[1], stored.shape[2])
    parts = torch.split(texels, [height * width for height, width in sizes], 1)
    return [part.reshape(len(stored), *size, -1) for part, size in zip(parts, sizes, strict=True)]


def _inputs(stored: Tensor) -> Tensor:
    """(..., 8) stored channels to (..., _INPUTS) numbers of about 1 for the encoder.

    Slopes come twice: as normals, and in units of the lobe's width, where they decide how a glossy surface looks.
    """
    base, metallic, xy, z = stored[..., :3], stored[..., 3:4], stored[..., 5:7], stored[..., 7:8]
    roughness = stored[..., 4:5].clamp(min=MIN_ROUGHNESS)
    relative = torch.asinh(xy / z.clamp(min=0.1) / roughness.square()) / 3
    steepness = 4 * xy.square().sum(-1, keepdim=True)
    return torch.cat([2 * base - 0.8, metallic, roughness.log() + 0.8, 3 * xy, relative, steepness], -1)


def _choice(out: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Shares of a lobe for all texels, and for the bright ones by either weight; (..., 2) outputs to (..., 1) each.

    Width and direction of a lobe go together: a sharp highlight of bright texels is no use around another normal.
    """
    logits = torch.cat([torch.zeros_like(out[..., :1]), _DECISION * out - _CAUTION], -1)
    shares = logits.softmax(-1)
    return shares[..., :1], shares[..., 1:2], shares[..., 2:]


def _more(detail: Tensor, crisp: Tensor) -> Tensor:
    """(..., 7) what more sharpening adds to base colour, metallic, roughness, n_x and n_y."""
    colours, roughness, normals = (crisp[..., i : i + 1] for i in range(_CRISP))
    return torch.cat(
        [
            colours * detail[..., : PLACES.metallic.stop],
            roughness * detail[..., PLACES.roughness],
            normals * detail[..., PLACES.normal],
        ],
        -1,
    )


def _changed(found: Statistics, out: Tensor, more: Tensor) -> Tensor:
    """(..., 8) stored channels: the averages, changed by (..., _OUTPUTS) numbers, and by (..., 7) that are added."""
    said: _Outputs[Tensor] = parts(_SAID, out)
    kept, tall, upward = _choice(said.choice)
    change = said.to_lean * found.to_lean + said.to_widened * found.to_widened + said.to_geometric * found.to_geometric
    change = kept * (change + said.to_quartic * found.to_quartic) + tall * found.to_tall + upward * found.to_upward
    freedom = kept * found.freedom + tall * found.tall_freedom + upward * found.upward_freedom
    change = change + freedom * said.roughness.tanh()
    shaded = found.log_roughness.exp()
    # What lies below the roughness that is shaded is kept beside the change, so that a change of nothing changes
    # nothing.
    below = found.roughness - found.roughness.clamp(min=MIN_ROUGHNESS)
    least = found.to_narrowest - _NARROWER * freedom
    roughness = (shaded * torch.maximum(change, least).clamp(max=_MOST_CHANGE).exp() + below + more[..., 4:5]).clamp(
        0, 1
    )
    gain = _MOST_GAIN * found.colour_freedom.clamp(max=1) * found.metallic * said.gain.tanh()
    base = (found.base * gain.exp() + said.metallic_colour * found.metallic_colour + more[..., :3]).clamp(0, 1)
    metallic = (found.metallic + said.metallic_variance * found.metallic_variance + more[..., 3:4]).clamp(0, 1)
    tilt = (1 + freedom * said.tilt.tanh()) * found.normal + kept * said.lean_normal * found.lean_normal
    tilt = tilt + tall * found.tall_normal + upward * found.upward_normal
    # A highlight is lost when it moves by its own width, however far the texels spread.
    reach = torch.minimum(found.spread.sqrt(), _FARTHEST * roughness.square())
    xy = tilt + reach * said.normal.tanh() + more[..., 5:7]
    xy = xy * (xy.square().sum(-1, keepdim=True) / _MAX_LENGTH2).clamp(min=1).rsqrt()
    height = (1 - xy.square().sum(-1, keepdim=True)).clamp(min=_MIN_HEIGHT2).sqrt()
    return torch.cat([base, metallic, roughness, xy, height], -1)
