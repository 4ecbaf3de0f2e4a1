"""The architectures that there are, by name."""

from __future__ import annotations

from mipbake.models.architecture import Architecture
from mipbake.models.latent_config import LatentConfig
from mipbake.models.moment_config import MomentConfig

ARCHITECTURES: dict[str, type[Architecture]] = {kind.architecture: kind for kind in (LatentConfig, MomentConfig)}
"""What descriptions of weights and configurations may name as `architecture`.

A script that compares with a network of its own adds it here (benchmarks/mipnet.py); the network is known to that
process alone.
"""
