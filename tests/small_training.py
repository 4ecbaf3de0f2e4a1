"""Trainings small enough for tests."""

from __future__ import annotations

from functools import partial
from typing import Any

from mipbake.training import loop
from mipbake.training.config import TrainingConfig, config_from
from mipbake.training.validation import ValidationEffort


def tiny(**sections: dict[str, Any]) -> TrainingConfig:
    """Seconds: small patches, few pairs, two procedural sets."""
    content: dict[str, dict[str, Any]] = {
        "network": {"growth": 4, "encoder_layers": 2, "decoder_layers": 1, "latent_channels": 16},
        "data": {"held_out": 0, "procedural_sets": 2, "procedural_size": 64},
        "loss": {"crops": 2, "crop_size": 16, "pairs": 4, "lods": 2, "target_samples": 2, "near_mirror_fraction": 0.5},
        "optimiser": {"learning_rate": 1e-3, "ramp": 2, "ema_decay": 0.9},
        "run": {"steps": 6, "log_every": 2, "validate_every": 4, "checkpoint_every": 3},
    }
    for name, section in sections.items():
        content[name] |= section
    return config_from(content)


def tiny_balanced(**sections: dict[str, Any]) -> TrainingConfig:
    """As `tiny`, of the architecture and the loss of the released weights."""
    content: dict[str, dict[str, Any]] = {
        "network": {
            "architecture": "moments", "latent_channels": 4, "convolutions": 1, "pointwise": 1, "growth": 4,
            "decoder_layers": 1, "decoder_growth": 4,
        },
        "data": {"held_out": 0, "procedural_sets": 2, "procedural_size": 64, "plain": 0.5, "strided": 0.5},
        "loss": {"kind": "balanced", "crops": 2, "crop_size": 16},
        "optimiser": {"learning_rate": 1e-3, "ramp": 2, "ema_decay": 0.9, "clip": 5.0},
        "run": {"steps": 6, "log_every": 2, "validate_every": 4, "checkpoint_every": 3, "uses": 2},
    }  # fmt: skip
    for name, section in sections.items():
        content[name] |= section
    return config_from(content)


SMALL = ValidationEffort(patches=2, patch_size=16, pairs=4, points=16, samples=8, picture_samples=4)
"""Validation of seconds less."""

train = partial(loop.train, say=lambda _: None, effort=SMALL)
"""A training that says nothing."""
