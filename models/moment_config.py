"""The architecture of networks that correct averages (moment_network.py)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mipbake.errors import UsageError
from mipbake.models.architecture import PAPER, Architecture, Description, check_counts, layers

if TYPE_CHECKING:
    from mipbake.models.moment_network import MomentNetwork


@dataclass(frozen=True)
class MomentConfig(Architecture):
    """Architecture of a network that corrects averages (mipbake.models.moment_network); it reads `gltf`.

    Args:
        decoders: the one material model that is made, `gltf` or `gltf-anisotropic`.
        latent_channels: learned maps beside the moments.
        convolutions: dense 3 x 3 layers of the encoder; also its halo in texels.
        pointwise: dense 1 x 1 layers of the encoder.
        growth: new maps a layer of the encoder.
        decoder_layers: dense 1 x 1 layers. decoder_growth: new maps of each.
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

    def __post_init__(self) -> None:
        if self.decoders not in (("gltf",), ("gltf-anisotropic",)):
            raise UsageError(f"network.decoders must be gltf or gltf-anisotropic here, got {self.decoders!r}")
        check_counts(self)

    @property
    def encoders(self) -> tuple[str, ...]:
        """The material model that is read."""
        return ("gltf",)

    @property
    def anisotropic(self) -> bool:
        """Whether lobes that are made have two widths."""
        return self.decoders == ("gltf-anisotropic",)

    def takes(self, source: str) -> bool:
        """Whether a source is baked: anisotropic lobes are made from round ones, and lobes that are given would be
        lost."""
        return not self.anisotropic or source == "gltf"

    def build(self) -> MomentNetwork:
        """See Architecture."""
        from mipbake.models.moment_network import MomentNetwork

        return MomentNetwork(self)

    def describe(self) -> Description:
        """See Architecture."""
        from mipbake.models.moments import COUNT

        return Description(
            method=f"averages of moments, corrected; after {PAPER}",
            encoder=f"{self.convolutions} layers of 3 x 3 and {layers(self.pointwise, '1 x 1', self.growth)}",
            latents=f"{self.latent_channels} learned channels and {COUNT} moments, filtered with the pixel filter",
            decoder=layers(self.decoder_layers, "1 x 1", self.decoder_growth),
        )
