"""What the channels of a map can hold, and what follows from that, whichever material model the map belongs to.

Code that treats maps differently asks for their kinds and never for the name of a model. A place that forks by kind
knows every kind, or it ends in `unknown`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, unique
from typing import NoReturn

MIN_ROUGHNESS = 0.045
"""Floor of perceptual roughness when shading: engines clamp there too, and narrower lobes strain 32-bit arithmetic."""

MAX_LOG_GAMMA = 1.5
"""Limit of |g| = |ln(gamma)| of `beckmann`: gamma from 0.22, more peaked than materials are, to 4.5, nearly a disc."""

MIN_LOG_ALPHA2 = 4 * math.log(MIN_ROUGHNESS)
"""ln alpha^2 at MIN_ROUGHNESS."""

MAX_LOG_ALPHA2 = 2.0
"""Greatest eigenvalue of the log-roughness tensor, beyond any rough surface.

The least one is the floor that shading has, `least_alpha2` of the model."""

MIN_HEIGHT = 0.01
"""Lifted normals are no flatter than this: the derivative of sqrt(1 - r^2) has no bound."""

LEAST_STRENGTH = 1e-3
"""Anisotropy strength that a descent starts from at least: strength is squared when it is shaded, so no gradient leads
away from 0 itself."""

COLOUR, UNIT, SIGNED, LOG = "colour", "unit", "signed", "log"
"""How files hold a channel (`mipbake.source.layout`)."""

_FREE = (-math.inf, math.inf)


@unique
class Kind(Enum):
    """What the channels of a map hold."""

    REFLECTANCE = "red, green and blue, linear Rec.709"
    SHARE = "a number from 0 to 1 that is averaged as it is, as metallic"
    ROUGHNESS = "perceptual roughness r; alpha = r^2"
    NORMAL = "x, y, z of a unit normal"
    NORMAL_XY = "x, y of a unit normal"
    DIRECTION = "x, y of a unit direction d along the rougher axis; d and -d shade alike"
    STRENGTH = "anisotropy strength of KHR_materials_anisotropy"
    LOG_TENSOR = "a, b, c of the roughness tensor S = exp([[a, c], [c, b]])"
    LOG_GAMMA = "g = ln(gamma) of the generalised Beckmann distribution"


@dataclass(frozen=True)
class Facts:
    """What is true of every map of a kind.

    Coordinates are what a descent moves (`mipbake.baking.search.texel_coordinates`) and, where a model has no
    directions, what networks read and make (`mipbake.models.parameters`).

    Args:
        channels: how many.
        limits: lowest and highest value of a channel.
        encoding: how files hold a channel.
        coordinates: how many stand for the channels.
        step: how far a descent moves a coordinate at once, at most. These are guesses: about as large a change
            everywhere.
        range: lowest and highest value of a coordinate.
        as_stored: whether the coordinates are the stored channels.
        averaged: whether closed forms average the channels as they are stored. They make the other channels anew, from
            averages of normals and of roughness tensors.
        unit_axis: which channel of a unit vector is 1 where the vector has no length; None for what is no unit vector.
    """

    channels: int
    limits: tuple[float, float]
    encoding: str
    coordinates: int
    step: float
    range: tuple[float, float]
    as_stored: bool
    averaged: bool
    unit_axis: int | None = None


FACTS: Mapping[Kind, Facts] = {
    Kind.REFLECTANCE: Facts(3, (0.0, 1.0), COLOUR, 3, 0.03, (0.0, 1.0), as_stored=True, averaged=True),
    Kind.SHARE: Facts(1, (0.0, 1.0), UNIT, 1, 0.03, (0.0, 1.0), as_stored=True, averaged=True),
    # ln alpha^2 = 4 ln r
    Kind.ROUGHNESS: Facts(1, (0.0, 1.0), UNIT, 1, 0.15, (MIN_LOG_ALPHA2, 0.0), as_stored=False, averaged=False),
    # x and y. A step is in units of the lobe's width alpha: what turns a mirror over is nothing to a rough surface.
    Kind.NORMAL: Facts(3, (-1.0, 1.0), SIGNED, 2, 0.15, _FREE, as_stored=False, averaged=False, unit_axis=2),
    Kind.NORMAL_XY: Facts(2, (-1.0, 1.0), SIGNED, 2, 0.15, _FREE, as_stored=True, averaged=False),
    Kind.DIRECTION: Facts(2, (-1.0, 1.0), SIGNED, 2, 0.1, _FREE, as_stored=True, averaged=False, unit_axis=0),
    # the square of the strength
    Kind.STRENGTH: Facts(1, (0.0, 1.0), UNIT, 1, 0.03, (LEAST_STRENGTH**2, 1.0), as_stored=False, averaged=False),
    Kind.LOG_TENSOR: Facts(3, (-30.0, 10.0), LOG, 3, 0.15, _FREE, as_stored=True, averaged=False),
    # Averaged as in section 4 of Kemppinen et al. 2023. What a closed form adds to the roughness tensor assumes a
    # distribution of its own, and not that g.
    Kind.LOG_GAMMA: Facts(
        1,
        (-MAX_LOG_GAMMA, MAX_LOG_GAMMA),
        LOG,
        1,
        0.1,
        (-MAX_LOG_GAMMA, MAX_LOG_GAMMA),
        as_stored=True,
        averaged=True,
    ),
}
"""Every kind has its facts."""


def unknown(kind: NoReturn) -> NoReturn:
    """Ends a fork that knows every kind: mypy reports a kind that was left out, and so does a run that meets it."""
    raise AssertionError(f"a map of the kind {kind} is not known here")
