"""Texels as coordinates to descend on, and the part of a level that a block of them sees.

Coordinates are what `models.parameters` has: colours as they are, roughness as ln alpha^2, normals as x and y; for
`gltf-anisotropic` also the direction and the square of the strength. A unit is chosen for each, about as large a change
everywhere: normals in units of the lobe's width alpha, since what turns a mirror over is nothing to a rough surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake import material, sampling
from mipbake.material import MAX_LOG_GAMMA
from mipbake.models import parameters
from mipbake.pixel_filter import Wrap
from mipbake.reference.problem import Image, Region

_COLOUR, _LOG_ALPHA2, _NORMAL, _DIRECTION, _STRENGTH, _LOG_GAMMA = 0.03, 0.15, 0.15, 0.1, 0.03, 0.1
_UNITS = {
    "gltf": (_COLOUR,) * 4 + (_LOG_ALPHA2,) + (_NORMAL,) * 2,
    "gltf-anisotropic": (_COLOUR,) * 4 + (_LOG_ALPHA2,) + (_NORMAL,) * 2 + (_DIRECTION,) * 2 + (_STRENGTH,),
    "ggx": (_COLOUR,) * 6 + (_NORMAL,) * 2 + (_LOG_ALPHA2,) * 3,
    "beckmann": (_COLOUR,) * 6 + (_NORMAL,) * 2 + (_LOG_ALPHA2,) * 3 + (_LOG_GAMMA,),
}
_TENSORS = ("ggx", "beckmann")  # models whose coordinates are their stored channels
_LEAST_STRENGTH = 1e-3  # strength enters shading squared: from 0 itself no gradient leads away
_LEAST_ALPHA = 0.02
_NORMALS = {"gltf": slice(5, 7), "gltf-anisotropic": slice(5, 7), "ggx": slice(6, 8), "beckmann": slice(6, 8)}
_FREE = (-math.inf, math.inf)
_ROUGHNESS = (parameters.MIN_LOG_ALPHA2, 0.0)
_LIMITS = {
    "gltf": ((0.0, 1.0),) * 4 + (_ROUGHNESS,) + (_FREE,) * 2,
    "gltf-anisotropic": ((0.0, 1.0),) * 4 + (_ROUGHNESS,) + (_FREE,) * 4 + ((_LEAST_STRENGTH**2, 1.0),),
    "ggx": ((0.0, 1.0),) * 6 + (_FREE,) * 5,
    "beckmann": ((0.0, 1.0),) * 6 + (_FREE,) * 5 + ((-MAX_LOG_GAMMA, MAX_LOG_GAMMA),),
}
_RING = 4  # texels around a block that its pixels read: one of their own level, two or three of the finer one, a half


def to_coordinates(stored: Tensor, model: str) -> Tensor:
    """(..., C) valid stored channels to (..., P) coordinates."""
    if model != "gltf-anisotropic":
        return parameters.to_parameters(stored, model)
    strength = stored[..., 10:11].clamp(_LEAST_STRENGTH, 1)
    return torch.cat([parameters.to_parameters(stored[..., :8], "gltf"), stored[..., 8:10], strength.square()], -1)


def to_stored(coordinates: Tensor, model: str) -> Tensor:
    """(..., P) coordinates, any numbers, to (..., C) valid stored channels, differentiable."""
    if model != "gltf-anisotropic":
        return parameters.to_stored(coordinates, model)
    direction = coordinates[..., 7:9]
    direction = direction / direction.square().sum(-1, keepdim=True).sqrt().clamp(min=1e-6)
    strength = parameters.clamp(coordinates[..., 9:10], _LEAST_STRENGTH**2, 1).sqrt()
    return torch.cat([parameters.to_stored(coordinates[..., :7], "gltf"), direction, strength], -1)


def units(coordinates: Tensor, model: str) -> Tensor:
    """(..., P): how far a coordinate moves in one step at most."""
    out = coordinates.new_tensor(_UNITS[model]).expand_as(coordinates).clone()
    half = coordinates[..., 4:5] / 2 if model not in _TENSORS else (coordinates[..., 8:9] + coordinates[..., 9:10]) / 4
    out[..., _NORMALS[model]] *= half.clamp(math.log(_LEAST_ALPHA), 0).exp()
    return out


def at_limits(coordinates: Tensor, gradient: Tensor, model: str) -> Tensor:
    """(..., P) whether descent would lead a coordinate out of its range."""
    low, high = coordinates.new_tensor(_LIMITS[model]).T
    out: Tensor = ((coordinates <= low) & (gradient > 0)) | ((coordinates >= high) & (gradient < 0))
    return out


def without_heights(gradient: Tensor, texels: Tensor, model: str) -> Tensor:
    """(..., D) gradients by stored channels less the height of the normal, which x and y settle: (..., C) to D.

    texels: (..., C) stored channels that the gradients were taken at.
    """
    if model in _TENSORS:
        return gradient
    slopes = texels[..., 5:7] / texels[..., 7:8].clamp(min=parameters.MIN_HEIGHT)
    xy = gradient[..., 5:7] - gradient[..., 7:8] * slopes
    return torch.cat([gradient[..., :5], xy, gradient[..., 8:]], -1)


def per_coordinate(coordinates: Tensor, model: str) -> Tensor:
    """(..., P) derivative of each channel of `without_heights` by its coordinate."""
    out = torch.ones_like(coordinates)
    if model not in _TENSORS:
        out[..., 4] = (coordinates[..., 4] / 4).exp() / 4
    if model == "gltf-anisotropic":
        out[..., 9] = 0.5 * coordinates[..., 9].clamp(min=_LEAST_STRENGTH**2).rsqrt()
    return out


@dataclass
class Axis:
    """Where the free texels of a level lie along one axis, and what is around them."""

    size: int
    first: int
    last: int
    mode: str

    @classmethod
    def of(cls, size: int, low: float, high: float, mode: str) -> Axis:
        # Rounded alike for neighbours: windows share no texel and leave none out.
        first, last = round(low * size), round(high * size)
        return cls(size, first, last, mode)

    @property
    def whole(self) -> bool:
        return self.last - self.first == self.size

    @property
    def index(self) -> NDArray[np.int64]:
        """Texels of the crop: the free ones, with a ring of more around them where the level goes on."""
        if self.whole:
            return np.arange(self.size)
        index = np.arange(self.first - _RING, self.last + _RING)
        return index % self.size if self.mode == "wrap" else np.clip(index, 0, self.size - 1)

    @property
    def inside(self) -> slice:
        """The free texels in the crop."""
        return slice(None) if self.whole else slice(_RING, -_RING)

    @property
    def boundary(self) -> str:
        return self.mode if self.whole else "clamp"

    def local(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coordinates in units of the texture to coordinates in units of the crop."""
        ring = 0 if self.whole else _RING
        return np.asarray((u * self.size - self.first + ring) / (self.last - self.first + 2 * ring))

    def pixels(self) -> tuple[int, int]:
        """First and last cell of pixels that see free texels."""
        low, high = (self.first, self.last) if self.whole else (self.first - 1, self.last + 1)
        return (low, high) if self.mode == "wrap" else (max(low, 0), min(high, self.size))


class Crop:
    """The part of a level that a block sees, its free texels in coordinates.

    Args:
        level: (H, W, C) stored channels.
        free: whether its texels inside the region may move.
    """

    def __init__(self, level: Image, region: Region, model: str, wrap: Wrap, free: bool) -> None:
        self.model = model
        self.columns = Axis.of(level.shape[1], region.left, region.right, wrap[0])
        self.rows = Axis.of(level.shape[0], region.top, region.bottom, wrap[1])
        self._around = np.ascontiguousarray(level[np.ix_(self.rows.index, self.columns.index)])
        self.free = free and self.rows.last > self.rows.first and self.columns.last > self.columns.first
        inside = torch.from_numpy(self._around[self.rows.inside, self.columns.inside])
        self.coordinates = to_coordinates(inside, model)
        self.now: Image = self._around
        self.boundary = self.columns.boundary, self.rows.boundary

    @property
    def window(self) -> tuple[slice, slice]:
        """The free texels in the level."""
        return slice(self.rows.first, self.rows.last), slice(self.columns.first, self.columns.last)

    def move(self, coordinates: Tensor) -> None:
        """Moves the free texels to (h, w, P) coordinates; those out of range stop at its end."""
        with torch.no_grad():
            inside = to_stored(coordinates, self.model)
            self.coordinates = to_coordinates(inside, self.model)
        self.now = self._around.copy()
        self.now[self.rows.inside, self.columns.inside] = inside.numpy()

    def gradient(self, by_texel: Image) -> Tensor:
        """(h, w, P) by the coordinates, from (h', w', C) by the stored channels of `now`."""
        with torch.enable_grad():
            coordinates = self.coordinates.detach().requires_grad_()
            inside = to_stored(coordinates, self.model)
            own = torch.from_numpy(by_texel[self.rows.inside, self.columns.inside])
            # A sum: gradients that are given to autograd make it load symbolic algebra, which takes a second.
            (out,) = torch.autograd.grad((inside * own).sum(), coordinates)
        return out

    def values(self, coordinates: Tensor) -> Image:
        """(h, w, C) stored channels of coordinates of the free texels, unit vectors to the last digit."""
        with torch.no_grad():
            return np.asarray(material.regularise(to_stored(coordinates, self.model).numpy(), self.model), np.float32)

    def local(self, uv: NDArray[np.float64]) -> Image:
        """(P, 2) uv in units of the crop."""
        return np.stack([self.columns.local(uv[:, 0]), self.rows.local(uv[:, 1])], -1).astype(np.float32)

    def look_up(self, uv: NDArray[np.float64]) -> Image:
        """(P, C): the level as it is now at (P, 2) uv, bilinearly."""
        where = self.local(uv)[None, None]
        return np.asarray(
            sampling.texture(self.now[None], where, filter_mode="linear", boundary_mode=self.boundary)[0, 0]
        )

    def pixels(self, least: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """(P, 2) uv: a random place in every texel that the block sees, several where there are few."""
        (top, bottom), (left, right) = self.rows.pixels(), self.columns.pixels()
        cells = np.stack(np.meshgrid(np.arange(left, right), np.arange(top, bottom)), -1).reshape(-1, 2)
        cells = np.tile(cells, (-(-least // len(cells)), 1))
        return np.asarray((cells + rng.random(cells.shape)) / [self.columns.size, self.rows.size])
