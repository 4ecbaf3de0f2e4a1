"""Training configurations: typed, read from TOML. The defaults are the paper's settings (section 3.4)."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_type_hints

from mipbake.errors import UsageError
from mipbake.models.config import NetworkConfig
from mipbake.pixel_filter import filter_named
from mipbake.training.baseline import TrainableConfig, architectures

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def _require(condition: bool, name: str, expected: str, got: object) -> None:
    if not condition:
        raise UsageError(f"{name} must be {expected}, got {got!r}")


def _share(name: str, value: float) -> None:
    _require(0 <= value <= 1, name, "between 0 and 1", value)


@dataclass(frozen=True)
class DataConfig:
    """Materials to train on; a folder of texture sets, procedural sets, or both.

    Args:
        folder: one texture set in each subfolder; "" for none.
        held_out: of every `held_out` sets in the folder one is kept for validation; 0 keeps none.
        procedural_sets: how many sets the project's own generator makes.
        procedural_size: their side in texels.
        strided: share of the patches that take every 2nd, 4th or 8th texel of a larger place: what coarse levels cover.
        plain: share of the patches that are left as they are, except for orientation and the order of colours.
        description, licence: of the data, for the weights' card.
    """

    folder: str = ""
    held_out: int = 14
    procedural_sets: int = 0
    procedural_size: int = 256
    strided: float = 0.0
    plain: float = 0.0
    description: str = "procedural sets of this project"
    licence: str = "CC0-1.0"

    def __post_init__(self) -> None:
        _require(self.held_out == 0 or self.held_out > 1, "data.held_out", "0 or at least 2", self.held_out)
        _require(self.procedural_sets >= 0, "data.procedural_sets", "at least 0", self.procedural_sets)
        _require(self.procedural_size >= 32, "data.procedural_size", "at least 32", self.procedural_size)
        for name in ("strided", "plain"):
            _share(f"data.{name}", getattr(self, name))


WEIGHTINGS = ("prediction", "error")

AUGMENTED = ("gltf", "ggx", "beckmann")
"""Material models that data augmentation knows, and so those that can be read."""


@dataclass(frozen=True)
class LossConfig:
    """One step's batch and its loss (section 3.2).

    Args:
        crops: material patches a step.
        crop_size: their side in texels, a power of two.
        pairs: light-view pairs a patch.
        near_mirror_fraction: share of the pairs whose light lies near the mirror direction of the view.
        lods: levels of detail drawn for each patch.
        pixel_filter: filter of the noisy reference.
        target_samples: surface samples whose mean is one pixel of the noisy reference; divides `pairs`.
        weighting: what a render's squared error is divided by. "prediction": its own energy, equation 5 of the paper.
            "error": the error itself, measured with a second, independent noisy reference.
    """

    crops: int = 1
    crop_size: int = 32
    pairs: int = 64
    near_mirror_fraction: float = 0.0
    lods: int = 5
    pixel_filter: str = "gaussian"
    target_samples: int = 1
    weighting: str = "prediction"

    def __post_init__(self) -> None:
        for name in ("crops", "pairs", "lods", "target_samples"):
            _require(getattr(self, name) >= 1, f"loss.{name}", "at least 1", getattr(self, name))
        power = self.crop_size >= 4 and self.crop_size & (self.crop_size - 1) == 0
        _require(power, "loss.crop_size", "a power of two of at least 4", self.crop_size)
        _share("loss.near_mirror_fraction", self.near_mirror_fraction)
        _require(
            self.pairs % self.target_samples == 0, "loss.target_samples", "a divisor of pairs", self.target_samples
        )
        filter_named(self.pixel_filter)
        _require(self.weighting in WEIGHTINGS, "loss.weighting", " or ".join(WEIGHTINGS), self.weighting)

    @property
    def mirror_pairs(self) -> int:
        """How many of the pairs are near the mirror."""
        return round(self.near_mirror_fraction * self.pairs)

    @property
    def max_lod(self) -> int:
        """Last level of a patch, 1 x 1."""
        return self.crop_size.bit_length() - 1


@dataclass(frozen=True)
class BalancedLossConfig:
    """One step's batch and its loss, for networks that correct averages (mipbake.training.balanced_loss).

    Args:
        crops: material patches a step.
        crop_size: their side in texels, a power of two.
        near_mirror, hemisphere, narrow_lobes, wide_lobes: light-view pairs a patch, drawn like those pair sets, around
            the lobe of a texel and around one as wide as the patch; together a multiple of 6.
        grazing: share of the pairs whose views are drawn towards the horizon.
        rooms: views a patch that see several lights. room_lights: lights of each.
        mirror_weight, hemisphere_weight: weight of the mean errors over those pair sets.
        light_weight: weight of the errors of single lights of rooms.
        room_weight, blur_weight, mean_weight: of the errors of their sums, by pixel, over 4 x 4 pixels and over all.
        pixel_filter: filter of the noisy reference. any_filter: share of the steps with a filter drawn from all of
            them.
        below: share of the levels of detail below 0 that are kept; the others become 0.
    """

    crops: int = 4
    crop_size: int = 32
    near_mirror: int = 6
    hemisphere: int = 4
    narrow_lobes: int = 4
    wide_lobes: int = 4
    grazing: float = 0.5
    rooms: int = 2
    room_lights: int = 6
    mirror_weight: float = 1.5
    hemisphere_weight: float = 1.0
    light_weight: float = 0.5
    room_weight: float = 1.0
    blur_weight: float = 2.0
    mean_weight: float = 2.0
    pixel_filter: str = "gaussian"
    any_filter: float = 0.4
    below: float = 0.5

    def __post_init__(self) -> None:
        for name in ("crops", "near_mirror", "hemisphere", "narrow_lobes", "wide_lobes", "rooms", "room_lights"):
            _require(getattr(self, name) >= 1, f"loss.{name}", "at least 1", getattr(self, name))
        power = self.crop_size >= 4 and self.crop_size & (self.crop_size - 1) == 0
        _require(power, "loss.crop_size", "a power of two of at least 4", self.crop_size)
        for name in ("grazing", "any_filter", "below"):
            _share(f"loss.{name}", getattr(self, name))
        _require(self.grazing < 1, "loss.grazing", "below 1, or no pair is seen from above", self.grazing)
        for name in ("mirror_weight", "hemisphere_weight", "light_weight", "room_weight", "blur_weight", "mean_weight"):
            _require(getattr(self, name) >= 0, f"loss.{name}", "at least 0", getattr(self, name))
        _require(sum(self.kinds) % 6 == 0, "pairs of [loss], rooms' not included,", "a multiple of 6", sum(self.kinds))
        filter_named(self.pixel_filter)

    @property
    def room_weights(self) -> tuple[float, float, float]:
        """Weights of the errors of rooms by pixel, over 4 x 4 pixels and over all."""
        return self.room_weight, self.blur_weight, self.mean_weight

    @property
    def kinds(self) -> tuple[int, int, int, int]:
        """Pairs of each kind."""
        return self.near_mirror, self.hemisphere, self.narrow_lobes, self.wide_lobes

    @property
    def pairs(self) -> int:
        """How many pairs a patch has, with the pairs of rooms."""
        return sum(self.kinds) + self.rooms * self.room_lights

    @property
    def max_lod(self) -> int:
        """Last level of a patch, 1 x 1."""
        return self.crop_size.bit_length() - 1


LOSSES: Mapping[str, type[LossConfig] | type[BalancedLossConfig]] = {
    "single-lights": LossConfig,
    "balanced": BalancedLossConfig,
}


@dataclass(frozen=True)
class OptimiserConfig:
    """Adam and its schedule.

    Args:
        learning_rate: after the ramp.
        beta1, beta2, epsilon: Adam's.
        ramp: steps of the linear ramp from zero.
        halve_every: steps after which the rate is halved, again and again.
        fall_from, fall_until: steps between which the rate also falls along half a cosine, to a hundredth; 0 for never.
        clip: longest gradient; longer ones are shortened. 0 for any length.
        ema_decay: decay of the moving average of the weights that is validated and exported; 0 for no average.
    """

    learning_rate: float = 5e-5
    beta1: float = 0.95
    beta2: float = 0.95
    epsilon: float = 1e-6
    ramp: int = 100
    halve_every: int = 50_000
    fall_from: int = 0
    fall_until: int = 0
    clip: float = 0.0
    ema_decay: float = 0.0

    def __post_init__(self) -> None:
        for name in ("learning_rate", "epsilon"):
            _require(getattr(self, name) > 0, f"optimiser.{name}", "positive", getattr(self, name))
        for name in ("beta1", "beta2", "ema_decay"):
            value = getattr(self, name)
            _require(0 <= value < 1, f"optimiser.{name}", "at least 0 and below 1", value)
        for name in ("ramp", "halve_every"):
            _require(getattr(self, name) >= 1, f"optimiser.{name}", "at least 1", getattr(self, name))
        for name in ("fall_from", "clip"):
            _require(getattr(self, name) >= 0, f"optimiser.{name}", "at least 0", getattr(self, name))
        _require(self.fall_until >= self.fall_from, "optimiser.fall_until", "at least fall_from", self.fall_until)

    def rate(self, step: int) -> float:
        """Learning rate of step 0, 1, ..."""
        rate = self.learning_rate * min(1.0, (step + 1) / self.ramp) * 0.5 ** (step // self.halve_every)
        if self.fall_until:
            done = min(max(0.0, (step - self.fall_from) / max(1, self.fall_until - self.fall_from)), 1.0)
            rate *= 0.01 + 0.99 * (1 + math.cos(math.pi * done)) / 2
        return rate


@dataclass(frozen=True)
class RunConfig:
    """Length, seed and what is written when.

    Args:
        steps: optimisation steps.
        seed: of everything random; a step's numbers depend on the seed and its index alone.
        log_every, validate_every, checkpoint_every: steps between lines of the log, validations, checkpoints.
        tensorboard: also log for TensorBoard.
        uses: steps that a batch serves, where drawing it costs as much as a step: once when it is drawn, then as one of
            the last few.
    """

    steps: int = 310_000
    seed: int = 0
    log_every: int = 100
    validate_every: int = 2_000
    checkpoint_every: int = 1_000
    tensorboard: bool = False
    uses: int = 1

    def __post_init__(self) -> None:
        for name in ("steps", "log_every", "validate_every", "checkpoint_every", "uses"):
            _require(getattr(self, name) >= 1, f"run.{name}", "at least 1", getattr(self, name))
        _require(self.seed >= 0, "run.seed", "at least 0", self.seed)


@dataclass(frozen=True)
class TrainingConfig:
    """A whole configuration; the sections of the TOML file."""

    network: TrainableConfig = field(default_factory=NetworkConfig)
    data: DataConfig = field(default_factory=DataConfig)
    loss: LossConfig | BalancedLossConfig = field(default_factory=LossConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    run: RunConfig = field(default_factory=RunConfig)

    def __post_init__(self) -> None:
        for model in self.network.encoders:
            _require(model in AUGMENTED, "network.encoders", f"of {', '.join(AUGMENTED)} in a training", model)
        latent, balanced = isinstance(self.network, NetworkConfig), isinstance(self.loss, BalancedLossConfig)
        _require(latent != balanced, "loss.kind", '"balanced" unless network.architecture is "latent"', self.kinds)

    @property
    def kinds(self) -> tuple[str, str]:
        """network.architecture and loss.kind."""
        network = next(name for name, kind in architectures().items() if isinstance(self.network, kind))
        return network, next(name for name, kind in LOSSES.items() if isinstance(self.loss, kind))


def read_config(path: Path) -> TrainingConfig:
    """The configuration in a TOML file; UsageError says which field is wrong and what was expected."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: the configuration cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise UsageError(f"{path}: not a TOML file ({error})") from error
    return config_from(content)


def config_from(content: Mapping[str, Any]) -> TrainingConfig:
    """A configuration from nested plain types, as TOML and checkpoints hold it."""
    sections: dict[str, Any] = {f.name: f.default_factory for f in fields(TrainingConfig)}
    _known(content, sections, "section")
    content = dict(content)
    for name, (key, kinds) in _kinds().items():
        section = content.get(name, {})
        if isinstance(section, Mapping) and key in section:
            kind = section[key]
            _require(isinstance(kind, str) and kind in kinds, f"{name}.{key}", f"one of {', '.join(kinds)}", kind)
            sections[name] = kinds[kind]
            content[name] = {k: value for k, value in section.items() if k != key}
    return TrainingConfig(**{name: _section(name, sections[name], content.get(name, {})) for name in sections})


def _kinds() -> Mapping[str, tuple[str, Mapping[str, type[Any]]]]:
    """Sections of several kinds, and the field that says which; without it they are what the paper has."""
    return {"network": ("architecture", architectures()), "loss": ("kind", LOSSES)}


def _section(name: str, kind: type[Any], content: Any) -> Any:
    _require(isinstance(content, Mapping), f"[{name}]", "a section", content)
    types = get_type_hints(kind)
    _known(content, types, f"field of [{name}]")
    values: dict[str, Any] = {}
    for key, value in content.items():
        expected = types[key]
        if expected == tuple[str, ...]:
            right = isinstance(value, (list, tuple)) and all(isinstance(v, str) for v in value)
            _require(right, f"{name}.{key}", "a list of strings", value)
            values[key] = tuple(value)
            continue
        if expected is float and isinstance(value, int) and not isinstance(value, bool):
            values[key] = float(value)
            continue
        right = isinstance(value, expected) and (expected is bool or not isinstance(value, bool))
        _require(right, f"{name}.{key}", _WORDS[expected], value)
        values[key] = value
    return kind(**values)


_WORDS: Mapping[Any, str] = {int: "a whole number", float: "a number", str: "a string", bool: "true or false"}


def _known(content: Mapping[str, Any], known: Mapping[str, Any], what: str) -> None:
    for key in content:
        if key not in known:
            raise UsageError(f"unknown {what} {key!r}: expected one of {', '.join(known)}")


def plain(config: TrainingConfig) -> dict[str, Any]:
    """Nested plain types; the inverse of config_from."""
    content = dataclasses.asdict(config)
    for (name, (key, _)), kind in zip(_kinds().items(), config.kinds, strict=True):
        content[name] = {key: kind, **content[name]}
    return content
