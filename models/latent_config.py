"""The architecture of the paper's networks: encoders, latents that are averaged, decoders (latent_network.py)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mipbake.base.device import PROCESSOR
from mipbake.base.errors import UsageError
from mipbake.material import MODELS, convert, directions, regularise
from mipbake.material.pixel_filter import Wrap
from mipbake.models.architecture import PAPER, Architecture, Baker, Description, Levels, Tensors, check_counts, layers

if TYPE_CHECKING:
    from mipbake.models.latent_network import LatentNetwork

PARAMETERS = {name: model.parameters for name, model in MODELS.items()}
"""Unconstrained optimisation parameters of each material model (mipbake.models.parameters)."""

LATENT_FILTERS = ("gaussian", "box", "tent", "mitchell", "blackman-harris")
"""Kernels that latents can be downsampled with; mipbake.material.pixel_filter has them."""


@dataclass(frozen=True)
class LatentConfig(Architecture):
    """Architecture of one network (sections 3.3 and 3.5 of Kemppinen et al. 2023).

    Args:
        encoders: material models that are read, keys of PARAMETERS; each has an encoder of its own.
        decoders: material models that are made; each has a decoder of its own, and all decoders read the same latents.
        latent_filter: kernel of the linear downsampling in latent space.
        latent_channels: maps of the latent code; at least as many as the encoders' models have parameters together.
        encoder_layers: dense 3 x 3 layers; also the encoder's halo in texels.
        decoder_layers: dense 1 x 1 layers.
        growth: new maps a layer.
    """

    architecture: ClassVar[str] = "latent"
    trained_with: ClassVar[str] = "single-lights"

    encoders: tuple[str, ...] = ("gltf",)
    decoders: tuple[str, ...] = ("gltf",)
    latent_filter: str = "gaussian"
    latent_channels: int = 64
    encoder_layers: int = 6
    decoder_layers: int = 4
    growth: int = 16

    def __post_init__(self) -> None:
        for name in ("encoders", "decoders"):
            _check_models(name, getattr(self, name))
        if self.latent_filter not in LATENT_FILTERS:
            raise UsageError(
                f"unknown latent filter {self.latent_filter!r}: expected one of {', '.join(LATENT_FILTERS)}"
            )
        check_counts(self)
        least = sum(PARAMETERS[model] for model in self.encoders)
        if self.latent_channels < least:
            raise UsageError(
                f"network.latent_channels must be at least {least} for {', '.join(self.encoders)}, "
                f"got {self.latent_channels}"
            )

    def finished(self, levels: Levels, made: str, target: str, wrap: Wrap) -> Levels:
        """See Architecture. Directions agree before vectors are renormalised."""
        if made != target:
            levels = directions.agreeing([convert(level, made, target) for level in levels], target, wrap)
        return [regularise(level, target) for level in levels]

    def build(self) -> LatentNetwork:
        """See Architecture."""
        from mipbake.models.latent_network import LatentNetwork

        return LatentNetwork(self)

    def baker(self, tensors: Tensors, pixel_filters: tuple[str, ...], device: str = PROCESSOR) -> Baker:
        """See Architecture. In the native core."""
        from mipbake.models.latent_baker import LatentBaker

        return LatentBaker(self, pixel_filters, tensors, device)

    def describe(self) -> Description:
        """See Architecture."""
        return Description(
            method=PAPER,
            encoder=layers(self.encoder_layers, "3 x 3", self.growth),
            latents=f"{self.latent_channels} channels, downsampled with `{self.latent_filter}`",
            decoder=layers(self.decoder_layers, "1 x 1", self.growth),
        )


def _check_models(name: str, models: Any) -> None:
    if not isinstance(models, tuple) or not models or len(set(models)) < len(models):
        raise UsageError(f"network.{name} must name one or more different material models, got {models!r}")
    for model in models:
        if model not in PARAMETERS:
            raise UsageError(f"no network for material model {model!r}: expected one of {', '.join(PARAMETERS)}")
