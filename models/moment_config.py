"""The architecture of networks that correct averages (moment_network.py)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mipbake.base.device import PROCESSOR
from mipbake.base.errors import UsageError
from mipbake.material import MODELS, Kind, MaterialModel, losses, model_named
from mipbake.material.aim import LOOKUPS, Sampler
from mipbake.models.architecture import PAPER, Architecture, Baker, Description, Tensors, check_counts, layers

if TYPE_CHECKING:
    from mipbake.models.moment_network import MomentNetwork


def _round_twin(model: MaterialModel) -> str:
    """The model whose lobes are round, and that is the same otherwise."""
    (found,) = (name for name in model.exact if not MODELS[name].anisotropic)
    return found


def _known(model: MaterialModel) -> bool:
    """Whether the colours are known: one with a share of metal, or a diffuse and a specular reflectance."""
    return (len(model.of(Kind.REFLECTANCE)), len(model.of(Kind.SHARE))) in ((1, 1), (2, 0))


FEATURES = ("trilinear", "anisotropic", "bias", "accumulated")
"""What a network may take of a sampler: how near it is to one lookup, and to the most, which sum to 1; its MIP bias;
and 1 where it averages frames, else 0."""


NAMED, MOST_LEVEL = 3, 8
"""Numbers that tell the decoder a level, and the last level that it distinguishes. Not tuned."""


MADE = tuple(name for name, model in MODELS.items() if _known(model))
"""The material models that can be made."""


@dataclass(frozen=True)
class MomentConfig(Architecture):
    """Architecture of a network that corrects averages (mipbake.models.moment_network).

    Args:
        decoders: the one material model that is made. It is also read, unless it stores directions: then its round twin
            is read.
        latent_channels: learned maps beside the moments.
        convolutions: dense 3 x 3 layers of the encoder; also its halo in texels.
        pointwise: dense 1 x 1 layers of the encoder.
        growth: new maps a layer of the encoder.
        decoder_layers: dense 1 x 1 layers. decoder_growth: new maps of each.
        samplers: what the network takes of the sampler, the first of FEATURES; none: one stack serves all.

    The network of `mipbake-1` has the defaults, which are guesses.
    """

    architecture: ClassVar[str] = "moments"
    trained_with: ClassVar[str] = "balanced"

    decoders: tuple[str, ...] = ("gltf",)
    latent_channels: int = 40
    convolutions: int = 2
    pointwise: int = 2
    growth: int = 24
    decoder_layers: int = 4
    decoder_growth: int = 32
    samplers: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(self.decoders) != 1 or self.decoders[0] not in MADE:
            raise UsageError(f"network.decoders must be one of {', '.join(MADE)} here, got {self.decoders!r}")
        if self.samplers not in (FEATURES[:count] for count in (0, 2, 4)):
            raise UsageError(
                f"network.samplers must be {list(FEATURES)}, the first two of them or [], got {list(self.samplers)!r}"
            )
        check_counts(self)

    def taken(self, sampler: Sampler) -> Sampler | None:
        """See Architecture."""
        return sampler if self.samplers else None

    def features(self, sampler: Sampler) -> tuple[float, ...]:
        """What the network takes of a sampler: the numbers that `samplers` are of it."""
        share = math.log2(sampler.lookups) / math.log2(LOOKUPS[-1])
        return (1 - share, share, sampler.bias, float(sampler.frames > 1))[: len(self.samplers)]

    @property
    def encoders(self) -> tuple[str, ...]:
        """The material model that is read."""
        (made,) = self.decoders
        return (made if model_named(made).lines is None else _round_twin(model_named(made)),)

    @property
    def anisotropic(self) -> bool:
        """Whether lobes that are made have two widths."""
        (made,) = self.decoders
        return model_named(made).anisotropic

    def takes(self, source: str) -> bool:
        """Whether a source is baked: what it says of lobes must not be lost where the model that is made could say
        it."""
        (read,), (made,) = self.encoders, self.decoders
        return losses(source, made).anisotropy or not losses(source, read).anisotropy

    def build(self) -> MomentNetwork:
        """See Architecture."""
        from mipbake.models.moment_network import MomentNetwork

        return MomentNetwork(self)

    def baker(self, tensors: Tensors, pixel_filters: tuple[str, ...], device: str = PROCESSOR) -> Baker:
        """See Architecture. In the native core."""
        from mipbake.models.moment_baker import MomentBaker

        return MomentBaker(self, pixel_filters, tensors, device)

    def describe(self) -> Description:
        """See Architecture."""
        from mipbake.models.moments import moment_count

        (read,) = self.encoders
        count = moment_count(model_named(read))
        return Description(
            method=f"averages of moments, corrected; after {PAPER}",
            encoder=f"{self.convolutions} layers of 3 x 3 and {layers(self.pointwise, '1 x 1', self.growth)}",
            latents=f"{self.latent_channels} learned channels and {count} moments, filtered with the pixel filter",
            decoder=layers(self.decoder_layers, "1 x 1", self.decoder_growth),
        )
