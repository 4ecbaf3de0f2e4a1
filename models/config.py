"""The numbers that fix a network's architecture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from mipbake.errors import UsageError

PARAMETERS = {"gltf": 7, "gltf-anisotropic": 9, "ggx": 11, "beckmann": 12}
"""Unconstrained optimisation parameters of each material model that has networks (mipbake.models.parameters)."""

LATENT_FILTERS = ("gaussian", "box", "tent", "mitchell", "blackman-harris")
"""Kernels that latents can be downsampled with; mipbake.pixel_filter has them."""


@dataclass(frozen=True)
class NetworkConfig:
    """Architecture of one network (sections 3.3 and 3.5 of Kemppinen et al. 2023).

    Args:
        encoders: material models that are read, keys of PARAMETERS; each has an encoder of its own.
        decoders: material models that are made; each has a decoder of its own, and all decoders read the same latents.
        latent_filter: kernel of the linear downsampling in latent space.
        latent_channels: maps of the latent code; at least as many as the encoders' models have parameters together.
        encoder_layers: dense 3 x 3 layers; also the encoder's halo in texels.
        decoder_layers: dense 1 x 1 layers.
        growth: new maps a layer.
        residual: whether some latents are fixed to the filtered parameters and their second moment, and the decoder
            predicts a correction (mipbake.models.network), for one material model alone; the paper has no such thing.
    """

    encoders: tuple[str, ...] = ("gltf",)
    decoders: tuple[str, ...] = ("gltf",)
    latent_filter: str = "gaussian"
    latent_channels: int = 64
    encoder_layers: int = 6
    decoder_layers: int = 4
    growth: int = 16
    residual: bool = False

    def __post_init__(self) -> None:
        for name in ("encoders", "decoders"):
            _check_models(name, getattr(self, name))
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
        if self.residual and (len(self.encoders) > 1 or self.decoders != self.encoders):
            raise UsageError("network.residual needs one encoder, and one decoder of the same material model")
        least = max(self.fixed_latents + 1, sum(PARAMETERS[model] for model in self.encoders))
        if self.latent_channels < least:
            raise UsageError(
                f"network.latent_channels must be at least {least} for {', '.join(self.encoders)}, "
                f"got {self.latent_channels}"
            )

    @property
    def models(self) -> tuple[str, ...]:
        """Every material model that is read or made, once."""
        return tuple(dict.fromkeys((*self.encoders, *self.decoders)))

    @property
    def fixed_latents(self) -> int:
        """How many latents are not learned; only a residual network has some."""
        return PARAMETERS[self.encoders[0]] + 1 if self.residual else 0

    @property
    def filtered(self) -> bool:
        """Whether the latents of level 0 have seen the pixel filter, as the fixed ones of a residual network have."""
        return self.residual


@dataclass(frozen=True)
class MomentConfig:
    """Architecture of a network that corrects averages (mipbake.models.moment_network); it reads `gltf`.

    Args:
        decoders: the one material model that is made, `gltf` or `gltf-anisotropic`.
        latent_channels: learned maps beside the moments.
        convolutions: dense 3 x 3 layers of the encoder; also its halo in texels.
        pointwise: dense 1 x 1 layers of the encoder.
        growth: new maps a layer of the encoder.
        decoder_layers: dense 1 x 1 layers. decoder_growth: new maps of each.
    """

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
        for field in fields(self)[1:]:
            value: Any = getattr(self, field.name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise UsageError(f"network.{field.name} must be a whole number of at least 1, got {value!r}")

    @property
    def encoders(self) -> tuple[str, ...]:
        """The material model that is read."""
        return ("gltf",)

    @property
    def models(self) -> tuple[str, ...]:
        """Every material model that is read or made, once."""
        return tuple(dict.fromkeys((*self.encoders, *self.decoders)))


AnyConfig = NetworkConfig | MomentConfig

ARCHITECTURES: Mapping[str, type[NetworkConfig] | type[MomentConfig]] = {
    "latent": NetworkConfig,
    "moments": MomentConfig,
}
"""What descriptions of weights call the kinds of networks."""


def architecture_of(config: AnyConfig) -> str:
    """The key of ARCHITECTURES."""
    return next(name for name, kind in ARCHITECTURES.items() if isinstance(config, kind))


def _check_models(name: str, models: Any) -> None:
    if not isinstance(models, tuple) or not models or len(set(models)) < len(models):
        raise UsageError(f"network.{name} must name one or more different material models, got {models!r}")
    for model in models:
        if model not in PARAMETERS:
            raise UsageError(f"no network for material model {model!r}: expected one of {', '.join(PARAMETERS)}")


_NEAREST = {
    "gltf": ("gltf-anisotropic", "ggx", "beckmann"),
    "gltf-anisotropic": ("ggx", "beckmann", "gltf"),
    "ggx": ("gltf-anisotropic", "beckmann", "gltf"),
    "beckmann": ("ggx", "gltf-anisotropic", "gltf"),
}
"""Encoders that can read each material model converted to theirs, the nearest first."""

_CONVERTED = {"gltf-anisotropic": "ggx"}
"""Decoders whose texels are converted, one by one, to a model that has no decoder of its own."""


_READ = ("gltf", "gltf-anisotropic", "ggx", "beckmann")
"""Each of these models can say all that the models before it can."""


def reads(config: AnyConfig, source: str) -> bool:
    """Whether a network sees all of a source, as it is or converted: one for `gltf` is blind to anisotropic lobes."""
    return any(_READ.index(source) <= _READ.index(model) for model in config.encoders)


def takes(config: AnyConfig, source: str) -> bool:
    """Whether a network bakes a source. A network that makes anisotropic lobes from round lobes would lose the lobes
    that were given."""
    return not (isinstance(config, MomentConfig) and config.decoders == ("gltf-anisotropic",)) or source == "gltf"


def read_as(config: NetworkConfig, source: str) -> str:
    """The encoder that reads materials of a source; its own, or the nearest one, after conversion."""
    wanted = (source, *_NEAREST[source])
    return next(model for model in wanted if model in config.encoders)


def made_from(config: NetworkConfig, target: str) -> str:
    """The decoder whose texels become a target; UsageError where there is none."""
    for model in (target, _CONVERTED.get(target)):
        if model in config.decoders:
            return str(model)
    raise UsageError(f"these weights make {', '.join(targets(config))}, not {target!r}; choose other weights")


def targets(config: AnyConfig) -> tuple[str, ...]:
    """Material models that a network can bake: the models of its decoders, and models that are converted from them."""
    converted = (to for to, made in _CONVERTED.items() if made in config.decoders)
    return tuple(dict.fromkeys((*config.decoders, *converted)))
