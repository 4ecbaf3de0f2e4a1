"""Pixels of surfaces turned every way under a studio's lights, as a display shows them, and what stacks are off by.

Single lights say most of the brightest pairs. What people look at is lit from everywhere and tonemapped. Errors from
pixel to pixel are half of what is measured. The other half is brightness by the angle of view: eyes blur what is fine,
but see at once what is darker as a whole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.metrics.images import display_slope, displayed
from mipbake.metrics.pairs import cosine_directions
from mipbake.pixel_filter import slanted_axes
from mipbake.reference.estimate import estimate
from mipbake.reference.lighting import Room
from mipbake.reference.problem import Image, Problem
from mipbake.reference.samples import Pixels
from mipbake.render.environment import Lighting
from mipbake.shading import shade_lit

Array = NDArray[np.float64]

EXPOSURE = 1.5  # a white matte sphere's radiance under the studio's lights, as in compare's views; not tuned here
# Groups of pixels by their angle of view, each of whose brightness is compared; a guess (docs/research.md says what
# brightness by angle brought).
_ANGLES = 8
# Share of a group's brightness: an error that is as good as none; a guess, the floor that the training has too
# (docs/research.md).
_DARKER = 0.02
_BRIGHTNESS = 0.5  # share of brightness in what is measured; a guess (docs/research.md)
_RESOLVED = 0.1  # share of the noise below which an error is chance; a guess
_LEAST = 1e-7  # squared value as displayed that is as good as none; a guess


@dataclass(frozen=True, eq=False)
class LitError:
    """What (P, 3) displayed pixels are off by.

    Args:
        square: mean over pixels and colours. groups: (A, n) indices of pixels seen at about one angle.
        brightness: (A,) by how much each group is brighter in the mean; scale: (A,) squares that it is added to.
    """

    square: float
    groups: NDArray[np.int64]
    brightness: Array
    scale: Array

    @property
    def logarithm(self) -> float:
        """The logarithm of squared errors: of pixels, and of the brightness of groups."""
        groups = float(np.log(np.square(self.brightness) + self.scale).mean())
        return (1 - _BRIGHTNESS) * math.log(self.square) + _BRIGHTNESS * groups

    def slopes(self, off: Image) -> Image:
        """(P, 3) derivative of `logarithm` by what is displayed, of the (P, 3) that it was made of."""
        out = off * np.float32((1 - _BRIGHTNESS) * 2 / (self.square * off.size))
        each = _BRIGHTNESS * 2 * self.brightness / (np.square(self.brightness) + self.scale)
        out[self.groups] += (each / (self.groups.size * 3)).astype(np.float32)[:, None, None]
        return np.asarray(out)

    def curvature(self, rows: Image | Array) -> Array:
        """(J, J) Gauss-Newton curvature of the brightness of groups.

        Args:
            rows: (P, J) derivatives by parameters of each pixel's sum over colours, as displayed.
        """
        along = rows[self.groups].mean(1, dtype=np.float64) / 3
        counts = 2 * _BRIGHTNESS / len(along) / (np.square(self.brightness) + self.scale)
        return np.asarray(along.T @ (along * counts[:, None]))

    @property
    def pixel_weight(self) -> float:
        """What the mean square of pixels counts in the curvature."""
        return 2 * pixel_slope(self.square)


def pixel_slope(square: float) -> float:
    """The derivative of LitError.logarithm by the mean square of pixels."""
    return (1 - _BRIGHTNESS) / max(square, _LEAST)


def lit_error(off: Image, shown: Image, cosine: Image | Array, noise: float = 0.0) -> LitError:
    """The error of (P, 3) differences to what is shown (P, 3), at (P,) cosines of the angle of view.

    Args:
        noise: mean square of the noise of what is shown. What is left of it below a tenth counts as that tenth.
    """
    angles = min(_ANGLES, len(off))
    groups = np.argsort(cosine, kind="stable")[: len(off) // angles * angles].reshape(angles, -1)
    brightness, right = (each[groups].mean((1, 2), dtype=np.float64) for each in (off, shown))
    square = max(float(np.square(off).mean()) - noise, _RESOLVED * noise, _LEAST)
    return LitError(square, groups, brightness, np.maximum(np.square(_DARKER * right), _LEAST))


def room(lighting: Lighting, frame: Image, view: Image) -> Room:
    """All lights at EXPOSURE, on pixels with (P, 3, 3) frames and (P, 3) views."""
    return Room(lighting.direction, lighting.radiance * EXPOSURE, frame, view)


def lit_reference(
    problem: Problem, lit: Room, uv: Array, lod: float | Array, samples: int, rng: np.random.Generator
) -> Image:
    """(P, 3) reference in a room at (P, 2) uv.

    Pixels are square on the screen: on the surface they reach less far across the view than along it.

    Args:
        lod: level of detail of all pixels, or (P,) of each, by their longer side.
    """
    axes = slanted_axes(np.einsum("nij,nj->ni", lit.frame, lit.view))
    return np.asarray(estimate(problem.filtered, Pixels(uv, lod, axes), lit, samples, rng)[0, 0])


def lit_radiance(model: str, texels: Image, frame: Image, view: Image, lighting: Lighting) -> Image:
    """(P, 3) of (P, C) texels under all lights at EXPOSURE, each with its frame (3, 3) and view (3,)."""
    return np.asarray(shade_lit(model, texels, frame, view, lighting.direction, lighting.radiance * EXPOSURE))


def placed(rng: np.random.Generator, count: int) -> tuple[Image, Image]:
    """(N, 3, 3) tangent frames in a room and (N, 3) views from it: spheres seen from about their own height."""
    angle = 2 * math.pi * rng.random(count)
    height = rng.uniform(-0.2, 0.6, count)
    flat = np.sqrt(1 - height * height)
    view = np.stack([flat * np.cos(angle), height, flat * np.sin(angle)], -1)
    local = cosine_directions(rng, count)  # where on the sphere's disc: normals are cosine-distributed around the view
    side = np.stack([-view[:, 2], np.zeros(count), view[:, 0]], -1)
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    up = np.cross(side, view)
    normal = local[:, :1] * side + local[:, 1:2] * up + local[:, 2:] * view
    tangent = np.stack([normal[:, 2], np.zeros(count), -normal[:, 0]], -1)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
    frame = np.stack([tangent, np.cross(normal, tangent), normal], 1)
    return frame.astype(np.float32), view.astype(np.float32)


def displayed_float32(radiance: Image) -> Image:
    """`metrics.images.displayed` in float32, the precision of renders."""
    return np.asarray(displayed(radiance), np.float32)


def display_slope_float32(radiance: Image) -> Image:
    """`metrics.images.display_slope` in float32."""
    return np.asarray(display_slope(radiance), np.float32)
