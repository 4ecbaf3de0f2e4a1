"""Texels as coordinates to descend on, and the part of a level that a region of them sees.

Coordinates are what `mipbake.models.parameters` makes of each map: colours as they are, roughness as ln alpha^2,
normals as x and y, directions as they are, strengths squared. A unit is chosen for each, about as large a change
everywhere (`mipbake.material.FACTS`): normals in units of the lobe's width alpha, since what turns a mirror over is
nothing to a rough surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake import material, sampling
from mipbake.material import FACTS, LEAST_STRENGTH, Facts, Kind, MaterialModel, model_named
from mipbake.models import parameters
from mipbake.reference.problem import Image, Problem, Region

_LEAST_ALPHA = 0.02  # width of a lobe that a normal's step is measured in, at least; a guess


def to_coordinates(stored: Tensor, model: str) -> Tensor:
    """(..., C) valid stored channels to (..., P) coordinates."""
    layout = model_named(model)
    if all(FACTS[part.kind].as_stored for part in layout.parts):
        return stored
    return torch.cat([parameters.to_coordinates(stored[..., p.channels], p.kind) for p in layout.parts], -1)


def to_stored(coordinates: Tensor, model: str) -> Tensor:
    """(..., P) coordinates, any numbers, to (..., C) valid stored channels, differentiable."""
    layout = model_named(model)
    parts = [(coordinates[..., part.coordinates], part.kind) for part in layout.parts]
    return torch.cat([parameters.of_coordinates(*part, layout.least_alpha2) for part in parts], -1)


def units(coordinates: Tensor, model: str) -> Tensor:
    """(..., P): how far a coordinate moves in one step at most."""
    layout = model_named(model)
    out = coordinates.new_tensor([facts.step for facts in _facts(layout)]).expand_as(coordinates).clone()
    width = _log_alpha(coordinates, layout).clamp(math.log(_LEAST_ALPHA), 0).exp()
    for part in layout.parts:
        if part.kind in (Kind.NORMAL, Kind.NORMAL_XY):
            out[..., part.coordinates] *= width
    return out


def _facts(layout: MaterialModel) -> list[Facts]:
    """Of each coordinate."""
    return [each.facts for each in layout.stored for _ in range(each.facts.coordinates)]


def _log_alpha(coordinates: Tensor, layout: MaterialModel) -> Tensor:
    """(..., 1) the logarithm of a lobe's width, the mean over its axes; of the narrower one where a model has lines."""
    for part in layout.parts:
        own = coordinates[..., part.coordinates]
        if part.kind is Kind.ROUGHNESS:
            return own / 2
        if part.kind is Kind.LOG_TENSOR:
            return (own[..., 0:1] + own[..., 1:2]) / 4
    raise AssertionError(f"the width of a lobe of {layout.name} is not known")


def limits(coordinates: Tensor, model: str) -> tuple[Tensor, Tensor]:
    """(P,) least and largest value of each coordinate."""
    low, high = coordinates.new_tensor([facts.range for facts in _facts(model_named(model))]).T
    return low, high


def without_heights(gradient: Tensor, texels: Tensor, model: str) -> Tensor:
    """(..., D) gradients by stored channels less the height of the normal, which x and y settle: (..., C) to D.

    texels: (..., C) stored channels that the gradients were taken at.
    """
    layout = model_named(model)
    if not layout.of(Kind.NORMAL):
        return gradient
    out = []
    for part in layout.parts:
        own = gradient[..., part.channels]
        if part.kind is Kind.NORMAL:
            normal = texels[..., part.channels]
            own = own[..., 0:2] - own[..., 2:3] * (normal[..., 0:2] / normal[..., 2:3].clamp(min=parameters.MIN_HEIGHT))
        out.append(own)
    return torch.cat(out, -1)


def per_coordinate(coordinates: Tensor, model: str) -> Tensor:
    """(..., P) derivative of each channel of `without_heights` by its coordinate."""
    out = torch.ones_like(coordinates)
    for part in model_named(model).parts:
        own = coordinates[..., part.coordinates]
        if part.kind is Kind.ROUGHNESS:
            out[..., part.coordinates] = (own / 4).exp() / 4
        elif part.kind is Kind.STRENGTH:
            out[..., part.coordinates] = 0.5 * own.clamp(min=LEAST_STRENGTH**2).rsqrt()
        elif part.kind is not Kind.NORMAL and not FACTS[part.kind].as_stored:
            raise AssertionError(f"the derivative of {part.kind} is not known")
    return out


@dataclass
class Axis:
    """Where the free texels of a level lie along one axis, and what is around them.

    Args:
        size: texels of the level. first, last: of the free texels; last is not one of them.
        mode: what the level has beyond its ends. around: texels at both ends that are looked up as well.
    """

    size: int
    first: int
    last: int
    mode: str
    around: int

    @classmethod
    def of(cls, size: int, low: float, high: float, mode: str, around: int) -> Axis:
        # Rounded alike for neighbours: windows share no texel and leave none out.
        first, last = round(low * size), round(high * size)
        return cls(size, first, last, mode, around)

    @property
    def whole(self) -> bool:
        return self.last - self.first == self.size

    @property
    def index(self) -> NDArray[np.int64]:
        """Texels of the crop: the free ones, with a ring of more around them where the level goes on."""
        if self.whole:
            return np.arange(self.size)
        index = np.arange(self.first - self.around, self.last + self.around)
        return index % self.size if self.mode == "wrap" else np.clip(index, 0, self.size - 1)

    @property
    def inside(self) -> slice:
        """The free texels in the crop."""
        return slice(None) if self.whole else slice(self.around, -self.around)

    @property
    def boundary(self) -> str:
        return self.mode if self.whole else "clamp"

    def local(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coordinates in units of the texture to coordinates in units of the crop."""
        ring = 0 if self.whole else self.around
        return np.asarray((u * self.size - self.first + ring) / (self.last - self.first + 2 * ring))

    def pixels(self) -> tuple[int, int]:
        """First and last cell of pixels that see free texels."""
        low, high = (self.first, self.last) if self.whole else (self.first - 1, self.last + 1)
        return (low, high) if self.mode == "wrap" else (max(low, 0), min(high, self.size))


class Crop:
    """The part of a level that a region sees, its free texels in coordinates.

    Args:
        level: (H, W, C) stored channels.
        free: whether its texels inside the region may move.
        around: texels around the region that are looked up as well, at least 4: pixels of a finer level read three.
    """

    def __init__(self, level: Image, region: Region, problem: Problem, free: bool, around: int) -> None:
        self.model, wrap = problem.target, problem.wrap
        self.columns = Axis.of(level.shape[1], region.left, region.right, wrap[0], around)
        self.rows = Axis.of(level.shape[0], region.top, region.bottom, wrap[1], around)
        self._around = np.ascontiguousarray(level[np.ix_(self.rows.index, self.columns.index)])
        self.free = free and self.rows.last > self.rows.first and self.columns.last > self.columns.first
        inside = torch.from_numpy(self._around[self.rows.inside, self.columns.inside])
        self.coordinates = to_coordinates(inside, self.model)
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

    def bilinear(self, uv: NDArray[np.float64]) -> Image:
        """(P, C): the level as it is now at (P, 2) uv, bilinearly."""
        where = self.local(uv)[None, None]
        return np.asarray(
            sampling.texture(self.now[None], where, filter_mode="linear", boundary_mode=self.boundary)[0, 0]
        )

    def pixels(self, least: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """(P, 2) uv: a random place in every texel that the region sees, several where there are few."""
        (top, bottom), (left, right) = self.rows.pixels(), self.columns.pixels()
        cells = np.stack(np.meshgrid(np.arange(left, right), np.arange(top, bottom)), -1).reshape(-1, 2)
        cells = np.tile(cells, (-(-least // len(cells)), 1))
        return np.asarray((cells + rng.random(cells.shape)) / [self.columns.size, self.rows.size])
