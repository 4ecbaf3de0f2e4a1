"""The numbers that fix a network's architecture."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from mipbake.errors import UsageError

PARAMETERS = {"gltf": 7, "ggx": 11}
"""Unconstrained optimisation parameters of each material model that has networks (mipbake.models.parameters)."""

LATENT_FILTERS = ("gaussian", "box", "tent", "mitchell", "blackman-harris")
"""Kernels that latents can be downsampled with; those of mipbake.prefilter.pixel_filter."""


@dataclass(frozen=True)
class NetworkConfig:
    """Architecture of one network (section 3.3 of Kemppinen et al. 2023).

    Args:
        model: material model of input and output, a key of PARAMETERS.
        latent_filter: kernel of the linear downsampling in latent space.
        latent_channels: maps of the latent code; at least as many as the model has parameters.
        encoder_layers: dense 3 x 3 layers; also the encoder's halo in texels.
        decoder_layers: dense 1 x 1 layers.
        growth: new maps a layer.
        residual: whether some latents are fixed to the filtered parameters and their second moment, and the decoder
            predicts a correction (mipbake.models.network); the paper has no such thing.
    """

    model: str = "gltf"
    latent_filter: str = "gaussian"
    latent_channels: int = 64
    encoder_layers: int = 6
    decoder_layers: int = 4
    growth: int = 16
    residual: bool = False

    def __post_init__(self) -> None:
        if self.model not in PARAMETERS:
            raise UsageError(f"no network for material model {self.model!r}: expected one of {', '.join(PARAMETERS)}")
        if self.latent_filter not in LATENT_FILTERS:
            raise UsageError(
                f"unknown latent filter {self.latent_filter!r}: expected one of {', '.join(LATENT_FILTERS)}"
            )
        for field in fields(self):
            value: Any = getattr(self, field.name)
            if field.type == "int" and (not isinstance(value, int) or isinstance(value, bool) or value < 1):
                raise UsageError(f"network.{field.name} must be a whole number of at least 1, got {value!r}")
        if not isinstance(self.residual, bool):
            raise UsageError(f"network.residual must be true or false, got {self.residual!r}")
        least = max(self.parameters, self.fixed_latents + 1)
        if self.latent_channels < least:
            raise UsageError(
                f"network.latent_channels must be at least {least} for model {self.model!r}, got {self.latent_channels}"
            )

    @property
    def parameters(self) -> int:
        """Optimisation parameters a texel has in this model."""
        return PARAMETERS[self.model]

    @property
    def fixed_latents(self) -> int:
        """Latents that are not learned: those of a residual network."""
        return self.parameters + 1 if self.residual else 0
