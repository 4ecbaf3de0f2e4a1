"""MIPNet (Gauthier et al. 2022, "MIPNet: Neural Normal-to-Anisotropic-Roughness MIP Mapping"), re-implemented.

This code is written anew. The idea comes from the paper's abstract; the cascade, the clamps and the sizes of the layers
are facts read in the authors' published scripts. No code of theirs is used, and their weights were never published.
What it is:

- A texel is five numbers: normal x, y, and the symmetric square root of the 2 x 2 roughness tensor S (a, b, c), whose
  eigenvalues are the roots of the eigenvalues of S, which are alpha_x^2 and alpha_y^2. They keep their meaning at every
  level.
- Every level is the 2 x 2 box average of the level before plus what a perceptron sees in it. A single-scale network
  reads windows of 2 x 2 texels: it makes level 1. A multi-scale network, shared by all coarser levels, reads 4 x 4
  texels of two levels before, 2 x 2 of the level before, and what the single-scale network made of these.
- Base colour and metallic, or albedo and F0, are box averages. Level 0 is the source: the method does not know of
  pixel filters.

What differs from theirs:

- It is trained with the loss, data, trainer and light-view pairs of `mipbake-1` in place of a tonemapped L1 loss on
  renders of single texels: what is compared is the architecture.
- The last layers start at zero, so that an untrained network makes box averages.
- The authors also read a height map, which glTF materials do not have.
- The target `gltf` has one roughness a texel: alpha = (alpha_x alpha_y)^(1/2), the geometric mean, which is how
  mipbake.material.convert drops anisotropy. A network for `gltf` is trained through this reduction; the next level
  still reads the tensor. The target `gltf-anisotropic` holds what the network makes as it is. `ggx` and `beckmann` are
  read and made by networks of their own. The exponent of `beckmann` is averaged like a colour, because the method
  knows no exponents.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from mipbake import material
from mipbake.base.errors import UsageError
from mipbake.material import MAX_LOG_ALPHA2, MIN_ROUGHNESS, Kind, model_named
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.pixel_filter import Wrap
from mipbake.models.architecture import Architecture, Levels
from mipbake.models.architectures import ARCHITECTURES
from mipbake.models.base import Network, Stacks
from mipbake.models.level_filter import Lookup
from mipbake.models.parameters import agreeing, clamp

TARGETS = ("gltf", "gltf-anisotropic", "ggx", "beckmann")

_STATE = 5
_MAX_LENGTH2 = 0.999**2  # of (x, y) of normals: the derivative of sqrt(1 - x^2) has no bound
_TINY = 1e-6  # of differences of eigenvalues, whose derivative jumps at 0
_APART = 1e-3  # half of what both axes of isotropic lobes differ by, over alpha
_ROWS = 1 << 14  # windows at a time: 64 MiB of the widest layer


@dataclass(frozen=True)
class MipnetConfig(Architecture):
    """Architecture.

    Args:
        target: one of TARGETS.
        single_layers, single_width: hidden layers of the single-scale network.
        multi_layers, multi_width: hidden layers of the multi-scale network.
    """

    architecture: ClassVar[str] = "mipnet"
    trained_with: ClassVar[str] = "balanced"

    target: str = "gltf"
    single_layers: int = 2
    single_width: int = 512
    multi_layers: int = 3
    multi_width: int = 1024

    def __post_init__(self) -> None:
        if self.target not in TARGETS:
            raise UsageError(f"network.target must be one of {', '.join(TARGETS)}, got {self.target!r}")
        for name in ("single_layers", "single_width", "multi_layers", "multi_width"):
            if getattr(self, name) < 1:
                raise UsageError(f"network.{name} must be at least 1, got {getattr(self, name)}")

    @property
    def encoders(self) -> tuple[str, ...]:
        """The material model that is read."""
        return ("gltf" if self.target == "gltf-anisotropic" else self.target,)

    @property
    def decoders(self) -> tuple[str, ...]:
        """The target."""
        return (self.target,)

    def build(self) -> MipnetNetwork:
        """See Architecture."""
        return MipnetNetwork(self)


@dataclass(frozen=True)
class SingleLightsConfig(MipnetConfig):
    """The same network, trained with the paper's loss."""

    architecture: ClassVar[str] = "mipnet-single-lights"
    trained_with: ClassVar[str] = "single-lights"


KINDS: Mapping[str, type[MipnetConfig]] = {each.trained_with: each for each in (MipnetConfig, SingleLightsConfig)}
"""The configuration of a network by the loss that trains it."""


def register() -> None:
    """Makes this process read weights and checkpoints of these networks, which are no part of the library."""
    ARCHITECTURES.update({kind.architecture: kind for kind in KINDS.values()})


class _Perceptron(nn.Module):
    """Windows, (..., inputs) numbers each, to (..., 5), zero at first."""

    def __init__(self, inputs: int, layers: int, width: int) -> None:
        super().__init__()
        self.hidden = nn.ModuleList(nn.Linear(width if i else inputs, width) for i in range(layers))
        self.output = nn.Linear(width, _STATE)
        nn.init.zeros_(self.output.weight)
        nn.init.zeros_(self.output.bias)

    def forward(self, windows: Tensor) -> Tensor:
        parts = []
        for part in torch.split(windows.flatten(0, -2), _ROWS):  # type: ignore[no-untyped-call]
            maps = part
            for layer in self.hidden:
                maps = functional.leaky_relu(layer(maps))
            parts.append(self.output(maps))
        return torch.cat(parts).reshape(*windows.shape[:-1], _STATE)


class MipnetNetwork(Network):
    """Both networks and the cascade. Images are (B, H, W, channels), and repeat."""

    def __init__(self, config: MipnetConfig) -> None:
        super().__init__(config)
        self.target = config.target
        (self.read,) = config.encoders
        self.limits = alphas_of(self.read)
        self.single = _Perceptron(2 * 2 * _STATE, config.single_layers, config.single_width)
        self.multi = _Perceptron((4 * 4 + 2 * 2 + 1) * _STATE, config.multi_layers, config.multi_width)

    def forward(
        self,
        stored: Tensor,
        source: str = "gltf",  # noqa: ARG002
        pixel_filter: str = "gaussian",  # noqa: ARG002
        sampler: Sampler = DEFAULT_SAMPLER,  # noqa: ARG002
    ) -> Stacks:
        """(B, H, W, C) stored channels of the model that is read to every level of the target, the first the source's.

        Args:
            stored: sides that are powers of two, or windows of 2 x 2 leave texels over.
            source: the model that is read.
            pixel_filter, sampler: change nothing.

        Raises:
            UsageError: other sides.
        """
        height, width = stored.shape[1:3]
        if height & (height - 1) or width & (width - 1):
            raise UsageError(
                f"MIPNet halves textures with windows of 2 x 2 texels: expected sides that are powers of two, got "
                f"{width} x {height}; resize the maps"
            )
        levels, (others, state) = [stored], separated(stored, self.read)
        for each in self._states(state)[1:]:
            others = _boxed(_filled(others, 2))
            levels.append(_TEXELS[self.target](others, each))
        if self.target == "gltf-anisotropic":
            along = torch.ones_like(stored[..., :1])
            levels[0] = torch.cat([stored, along, torch.zeros_like(along), torch.zeros_like(along)], -1)
        return {self.target: agreeing(levels, self.target, ("wrap", "wrap"))}

    def _states(self, state: Tensor) -> list[Tensor]:
        """(B, H_L, W_L, 5) of every level."""
        states = [valid_state(state, self.limits)]
        while max(states[-1].shape[1:3]) > 1:
            before = _filled(states[-1], 2)
            average, near = _boxed(before), _windows(before, 2)
            change = self.single(near)
            if len(states) > 1:
                far, first = _windows(_filled(states[-2], 4), 4), valid_state(average + change, self.limits)
                change = self.multi(torch.cat([far, near, first], -1))
            states.append(valid_state(average + change, self.limits))
        return states

    def levels(
        self,
        stored: NDArray[np.float32],
        read: str,
        made: str,
        lookup: Lookup,
        wrap: Wrap,  # noqa: ARG002
        progress: Callable[[float], None] = lambda _: None,
    ) -> Levels:
        """See Baker. Lookups and wrap modes change nothing, and sides must be powers of two."""
        channels = torch.from_numpy(np.ascontiguousarray(stored, np.float32))
        with torch.inference_mode():
            levels = self(channels[None], read, lookup.kernel)[made]
        progress(1.0)
        return [material.regularise(level[0].numpy(), made) for level in levels]


def _windows(image: Tensor, side: int) -> Tensor:
    """(B, H, W, C) to (B, H / side, W / side, side^2 C)."""
    batch, height, width, channels = image.shape
    split = image.reshape(batch, height // side, side, width // side, side, channels)
    return split.permute(0, 1, 3, 2, 4, 5).reshape(batch, height // side, width // side, -1)


def _boxed(image: Tensor) -> Tensor:
    """(B, H, W, C) to its averages of 2 x 2 texels."""
    batch, height, width, channels = image.shape
    return image.reshape(batch, height // 2, 2, width // 2, 2, channels).mean((2, 4))


def _filled(image: Tensor, side: int) -> Tensor:
    """The image, repeated along axes that are shorter than a window."""
    rows, columns = (max(1, side // length) for length in image.shape[1:3])
    return image if rows == columns == 1 else image.repeat(1, rows, columns, 1)


def _axes(state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """From (..., 5): both eigenvalues of the root of the tensor, the larger first, and half their difference; (...)."""
    a, b, c = state[..., 2:].unbind(-1)
    mean, radius = (a + b) / 2, (((a - b) / 2).square() + c * c + _TINY**2).sqrt() - _TINY
    return mean + radius, mean - radius, radius


Limits = tuple[float, float]
"""The least and the largest alpha."""


def alphas_of(read: str) -> Limits:
    """What a model that is read can say of alpha."""
    model = model_named(read)
    return model.least_alpha2**0.5, 1.0 if model.of(Kind.ROUGHNESS) else math.exp(MAX_LOG_ALPHA2 / 2)


def separated(stored: Tensor, read: str) -> tuple[Tensor, Tensor]:
    """What is averaged of (..., C) stored channels, (..., n), and what the networks read, (..., 5)."""
    model = model_named(read)
    xy = stored[..., model.normal][..., :2]
    for tensor in model.of(Kind.LOG_TENSOR):
        a, b, c = stored[..., tensor].unbind(-1)
        mean, d, c = (a + b) / 4, (a - b) / 4, c / 2  # of the logarithm of the root
        q = (d * d + c * c).sqrt()
        sinhc = torch.where(q > _APART, q.sinh() / q.clamp(min=_APART), torch.ones_like(q))
        root = mean.exp()[..., None] * torch.stack([q.cosh() + sinhc * d, q.cosh() - sinhc * d, sinhc * c], -1)
        exponents = [stored[..., g] for g in model.of(Kind.LOG_GAMMA)]
        return torch.cat([stored[..., :6], *exponents], -1), torch.cat([xy, root], -1)
    alpha = stored[..., 4:5].clamp(min=MIN_ROUGHNESS).square()
    return stored[..., :4], torch.cat([xy, alpha, alpha, torch.zeros_like(alpha)], -1)


def valid_state(state: Tensor, limits: Limits) -> Tensor:
    """(..., 5) with normals inside the disc and lobes between the narrowest and the widest that there are."""
    xy = state[..., :2]
    xy = xy * (xy.square().sum(-1, keepdim=True) / _MAX_LENGTH2).clamp(min=1).rsqrt()
    wide, narrow, radius = _axes(state)
    wide, narrow = clamp(wide, *limits), clamp(narrow, *limits)
    mean, shrink = (wide + narrow) / 2, (wide - narrow + _TINY) / (2 * radius + _TINY)  # 1 at isotropy
    d, c = shrink * (state[..., 2] - state[..., 3]) / 2, shrink * state[..., 4]
    return torch.cat([xy, torch.stack([mean + d, mean - d, c], -1)], -1)


def isotropic_texels(colours: Tensor, state: Tensor) -> Tensor:
    """(..., 4) and (..., 5) to `gltf`, (..., 8)."""
    a, b, c = state[..., 2:3], state[..., 3:4], state[..., 4:5]
    roughness = (a * b - c * c).clamp(MIN_ROUGHNESS**4, 1).sqrt().sqrt()
    return torch.cat([colours, roughness, _lifted(state)], -1)


def anisotropic_texels(colours: Tensor, state: Tensor) -> Tensor:
    """(..., 4) and (..., 5) to `gltf-anisotropic`, (..., 11); mipbake.material has the inverse map.

    At isotropy, where training starts, strength has no derivative and direction no value, but the lobe has both: axes
    are set apart by a share that does not show, so that what grows there meets what vanishes.
    """
    a, b, c = state[..., 2:3], state[..., 3:4], state[..., 4:5]
    mean = (a + b) / 2
    d = (a - b) / 2 + _APART * mean
    radius = (d * d + c * c + _TINY**2).sqrt()
    narrow = clamp(mean - radius, MIN_ROUGHNESS**2, 1)
    strength = (2 * radius / (1 - narrow).clamp(min=1e-3)).clamp(max=1).sqrt()
    angle = torch.atan2(c, torch.where(d * d + c * c < _TINY**2, _TINY, d)) / 2
    return torch.cat([colours, narrow.sqrt(), _lifted(state), angle.cos(), angle.sin(), strength], -1)


def tensor_texels(others: Tensor, state: Tensor) -> Tensor:
    """(..., 6) and (..., 5) to `ggx`, (..., 11); (..., 7) and (..., 5) to `beckmann`, (..., 12)."""
    wide, narrow, _ = _axes(state)
    ratio = (wide - narrow) / narrow
    even = ratio < _APART  # where the logarithm of the ratio is nearly the ratio less one
    slope = torch.where(even, 1 - ratio / 2, ratio.clamp(min=_APART).log1p() / ratio.clamp(min=_APART)) / narrow
    mean = wide.log() + narrow.log()
    d, c = slope * (state[..., 2] - state[..., 3]), 2 * slope * state[..., 4]
    tensor = torch.stack([mean + d, mean - d, c], -1)
    return torch.cat([others[..., :6], state[..., :2], tensor, others[..., 6:]], -1)


def _lifted(state: Tensor) -> Tensor:
    """(..., 3) unit normals."""
    xy = state[..., :2]
    return torch.cat([xy, (1 - xy.square().sum(-1, keepdim=True)).sqrt()], -1)


_TEXELS: Mapping[str, Callable[[Tensor, Tensor], Tensor]] = {
    "gltf": isotropic_texels,
    "gltf-anisotropic": anisotropic_texels,
    "ggx": tensor_texels,
    "beckmann": tensor_texels,
}
"""Makes texels of each target, of what was averaged and of what the networks made."""
