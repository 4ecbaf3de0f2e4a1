"""Training configurations: typed, read from TOML. The defaults are the paper's settings (section 3.4)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_type_hints

from mipbake.base import toml_text
from mipbake.base.errors import UsageError
from mipbake.base.names import unknown
from mipbake.material import MODELS
from mipbake.models.architecture import Architecture
from mipbake.models.architectures import ARCHITECTURES
from mipbake.models.latent_config import LatentConfig
from mipbake.training.base import Loss
from mipbake.training.captured import MODEL as CAPTURED
from mipbake.training.checks import require, require_least, require_shares
from mipbake.training.loss import SingleLightsLossConfig
from mipbake.training.losses import LOSSES

MIXED = ("another", "itself")
"""What a patch can be mixed with."""


@dataclass(frozen=True)
class DataConfig:
    """Materials to train on; a folder of texture sets, procedural sets, or both.

    Args:
        folder: one texture set in each subfolder; "" for none.
        held_out: of every `held_out` sets in the folder one is kept for validation; 0 keeps none.
        procedural_sets: how many sets the project's own generator makes.
        procedural_size: their side in texels.
        captured_sets: how many sets the project's generator of Beckmann lobes makes, as captures have them. The encoder
            of `beckmann` alone reads them, beside all other sets.
        strided: share of the patches that take every 2nd, 4th or 8th texel of a larger place: what coarse levels cover.
        plain: share of the patches that are left as they are, except for orientation and the order of colours.
        mixed: what a patch is mixed with: "another" patch of any material, half of the time, or "itself", augmented
            anew, always.
        turned: whether patches are turned by multiples of 90 degrees and mirrored.
        boosted: whether every patch is made a little glossier and steeper before its random changes, or the random
            changes lean to gloss and steep normals.
        description, licence: of the data, for the weights' card.

    The paper mixes a material with itself, turns nothing and boosts (sections 3.4 and 4); `paper-*.toml` do. The
    defaults are guesses, and what networks of other configurations are trained with. The paper does not say how it
    validates.
    """

    folder: str = ""
    held_out: int = 14
    procedural_sets: int = 0
    procedural_size: int = 256
    captured_sets: int = 0
    strided: float = 0.0
    plain: float = 0.0
    mixed: str = "another"
    turned: bool = True
    boosted: bool = False
    description: str = "procedural sets of this project"
    licence: str = "CC0-1.0"

    def __post_init__(self) -> None:
        require(self.held_out == 0 or self.held_out > 1, "data.held_out", "0 or at least 2", self.held_out)
        require_least(0, self, "data", "procedural_sets", "captured_sets")
        require_least(32, self, "data", "procedural_size")
        require_shares(self, "data", "strided", "plain")
        require(self.mixed in MIXED, "data.mixed", f"one of {', '.join(MIXED)}", self.mixed)


AUGMENTED = tuple(model.name for model in MODELS.values() if model.lines is None)
"""Material models that data augmentation knows, and so those that can be read: it turns no directions of anisotropy."""


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

    The paper has these defaults (section 3.4).
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
            require(getattr(self, name) > 0, f"optimiser.{name}", "positive", getattr(self, name))
        for name in ("beta1", "beta2", "ema_decay"):
            value = getattr(self, name)
            require(0 <= value < 1, f"optimiser.{name}", "at least 0 and below 1", value)
        require_least(1, self, "optimiser", "ramp", "halve_every")
        require_least(0, self, "optimiser", "fall_from", "clip")
        require(self.fall_until >= self.fall_from, "optimiser.fall_until", "at least fall_from", self.fall_until)

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

    The paper trains for as many steps (section 3.4). What is written when is a guess.
    """

    steps: int = 310_000
    seed: int = 0
    log_every: int = 100
    validate_every: int = 2_000
    checkpoint_every: int = 1_000
    tensorboard: bool = False
    uses: int = 1

    def __post_init__(self) -> None:
        require_least(1, self, "run", "steps", "log_every", "validate_every", "checkpoint_every", "uses")
        require_least(0, self, "run", "seed")


@dataclass(frozen=True)
class TrainingConfig:
    """A whole configuration; the sections of the TOML file."""

    network: Architecture = field(default_factory=LatentConfig)
    data: DataConfig = field(default_factory=DataConfig)
    loss: Loss[Any] = field(default_factory=SingleLightsLossConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    run: RunConfig = field(default_factory=RunConfig)

    def __post_init__(self) -> None:
        for model in self.network.encoders:
            require(model in AUGMENTED, "network.encoders", f"of {', '.join(AUGMENTED)} in a training", model)
        network, size = self.network, self.loss.crop_size
        if self.data.captured_sets or self.data.procedural_sets:
            expected = f"at least loss.crop_size, which is {size}"
            require(self.data.procedural_size >= size, "data.procedural_size", expected, self.data.procedural_size)
        if self.data.captured_sets:
            expected = f"{CAPTURED} where data.captured_sets is not 0"
            require(CAPTURED in network.encoders, "network.encoders", expected, network.encoders)
        expected = f'"{network.trained_with}" where network.architecture is "{network.architecture}"'
        require(self.loss.kind == network.trained_with, "loss.kind", expected, self.loss.kind)


def read_config(path: Path) -> TrainingConfig:
    """The configuration in a TOML file; UsageError says which field is wrong and what was expected."""
    try:
        content = toml_text.parsed(path.read_text(encoding="utf-8"))
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
    for name, (key, kinds) in _KINDS.items():
        section = content.get(name, {})
        if isinstance(section, Mapping) and key in section:
            kind = section[key]
            require(isinstance(kind, str) and kind in kinds, f"{name}.{key}", f"one of {', '.join(kinds)}", kind)
            sections[name] = kinds[kind]
            content[name] = {k: value for k, value in section.items() if k != key}
    return TrainingConfig(**{name: _section(name, sections[name], content.get(name, {})) for name in sections})


_KINDS: Mapping[str, tuple[str, Mapping[str, type[Any]]]] = {
    "network": ("architecture", ARCHITECTURES),
    "loss": ("kind", LOSSES),
}
"""Sections of several kinds, and the field that says which; without it they are what the paper has."""


def _section(name: str, kind: type[Any], content: Any) -> Any:
    require(isinstance(content, Mapping), f"[{name}]", "a section", content)
    hints = get_type_hints(kind)
    types = {f.name: hints[f.name] for f in fields(kind)}
    _known(content, types, f"field of [{name}]")
    values: dict[str, Any] = {}
    for key, given in content.items():
        value, expected = given, types[key]
        right = type(given) is expected
        if expected is float and type(given) is int:
            value, right = float(given), True
        elif expected == _TEXTS and isinstance(given, (list, tuple)):
            value, right = tuple(given), all(isinstance(each, str) for each in given)
        require(right, f"{name}.{key}", _WORDS[expected], given)
        values[key] = value
    return kind(**values)


_TEXTS = tuple[str, ...]
_WORDS: Mapping[Any, str] = {
    **{int: "a whole number", float: "a number", str: "a string", bool: "true or false"},
    _TEXTS: "a list of strings",
}


def _known(content: Mapping[str, Any], known: Mapping[str, Any], what: str) -> None:
    for key in content:
        if key not in known:
            raise UsageError(unknown(what, key, known))


def plain(config: TrainingConfig) -> dict[str, Any]:
    """Nested plain types; the inverse of config_from."""
    content = dataclasses.asdict(config)
    for name, (key, _) in _KINDS.items():
        content[name] = {key: getattr(getattr(config, name), key), **content[name]}
    return content
