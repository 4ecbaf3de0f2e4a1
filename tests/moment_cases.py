"""Stored channels of every model, and small networks that correct their averages."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from numpy.typing import NDArray

from mipbake.material import MIN_ROUGHNESS, MODELS, Kind, lift_normal, model_named
from mipbake.material.pixel_filter import Wrap
from mipbake.models.moment_config import MADE, MomentConfig
from mipbake.models.moment_network import MomentNetwork

TORUS: Wrap = ("wrap", "wrap")
SMALL = MomentConfig(latent_channels=6, convolutions=2, pointwise=1, growth=5, decoder_layers=2, decoder_growth=6)


def bumpy(height: int, width: int, seed: int = 0) -> NDArray[np.float32]:
    """Valid stored channels of `gltf`, with colours that are exactly 0 and 1 among them."""
    rng = np.random.default_rng(seed)
    colour = np.clip(rng.uniform(-0.3, 1.3, (height, width, 4)), 0, 1)
    roughness = rng.uniform(MIN_ROUGHNESS, 1, (height, width, 1))
    normal = lift_normal(rng.uniform(-0.5, 0.5, (height, width, 2)))
    return np.concatenate([colour, roughness, normal], -1).astype(np.float32)


ANISOTROPIC = dataclasses.replace(SMALL, decoders=("gltf-anisotropic",))


def of_model(model: str, height: int, width: int, seed: int = 0) -> NDArray[np.float32]:
    """Valid stored channels of a model, whatever they are: lobes are stretched where they can be."""
    given, rng = bumpy(height, width, seed), np.random.default_rng(seed)
    if model == "gltf":
        return given
    drawn = {
        Kind.REFLECTANCE: np.clip(rng.uniform(-0.3, 1.3, (height, width, 6)), 0, 1),
        Kind.NORMAL_XY: given[..., 5:7],
        Kind.LOG_TENSOR: rng.uniform([-4.4, -4.4, -0.4], [-0.1, -0.1, 0.4], (height, width, 3)),
        Kind.LOG_GAMMA: rng.uniform(-1, 1, (height, width, 1)),
    }
    return np.concatenate([drawn[part.kind] for part in model_named(model).parts], -1).astype(np.float32)


READ = [model for model in MADE if MODELS[model].lines is None]
"""Models that networks read and make as they are."""


def config_of(model: str) -> MomentConfig:
    return dataclasses.replace(SMALL, decoders=(model,))


def trained_like(config: MomentConfig = SMALL) -> MomentNetwork:
    """Every unit has its say."""
    torch.manual_seed(3)
    network = MomentNetwork(config)
    with torch.no_grad():
        network.output.weight.normal_(0, 1.5)
        network.output.bias.normal_(0, 1.5)
        if network.stretch is not None:
            network.stretch.weight.normal_(0, 1.5)
    return network.eval().requires_grad_(False)
