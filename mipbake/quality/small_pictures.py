"""Small pictures of a surface under many lights: what stacks are judged by and trained on, as people see it.

A picture is SIDE x SIDE pixels of a plane that is seen from afar, at a slant, in a room. The plane is a floor, a wall
or anything between: no ceiling. All its pixels have one view, one footprint and one level of detail, which is the one
of a lookup by the sampler that the stack is made for. Where that sampler averages frames, every pixel is looked up and
shaded once a frame. How far a picture is from right is `mipbake.quality.metrics.visible`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake.material.aim import Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import slanted_axes
from mipbake.quality.environment import Lighting
from mipbake.quality.metrics.visible import SIDE
from mipbake.quality.reference.estimate import estimate
from mipbake.quality.reference.lighting import SummedLights
from mipbake.quality.reference.samples import Pixels
from mipbake.quality.samplers import frames_at, in_frames, mean_of_frames
from mipbake.shading import shade_lit
from mipbake.shading.adjoint import shade_adjoint

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SLANTS = (0.5, 1.0), (0.1, 0.5)
"""Cosines of the angle of view, from and to, of the kinds of pictures: facing the viewer, and slanted."""

PIXELS = SIDE * SIDE
"""Pixels of a picture."""

MEDIAN = 0.6
"""What the median is exposed to, as in films: not tuned."""

_HEIGHTS = -0.2, 0.6  # sines of the angle from which cameras look down
_CONTRAST = 16.0  # between the median of all pictures and the darkest that one is exposed for
_DARK = 1e-6  # radiance below which all pictures are black


@dataclass(frozen=True, eq=False)
class SmallPictures:
    """N pictures.

    Args:
        size: (width, height) of level 0.
        lod: (N,) level of detail of the lookups. longer: (N,) level of detail of the longer side of pixels.
        uv: (N, PIXELS, 2) centres of pixels, row by row. axes: (N, 2, 2) of a pixel, as `Pixels` takes them.
        lookups: (N,) of each pixel in each frame, side by side along its longer side.
        light, view: (N, L, 3) unit vectors in the tangent frame of each picture. power: (N, L, 3) irradiance.
        lights: (N,) of each picture: the first of L, the others have no power.
        frames: whose mean is shown. Below, the points of a picture are its pixels, and of each all frames.
    """

    size: tuple[int, int]
    lod: Array
    longer: Array
    uv: Array
    axes: Image
    lookups: NDArray[np.int64]
    light: Image
    view: Image
    power: Image
    lights: NDArray[np.int64]
    frames: int

    @property
    def points(self) -> int:
        """How many points of a picture are shaded."""
        return PIXELS * self.frames

    def part(self, some: NDArray[np.intp]) -> SmallPictures:
        """Some of the pictures, by their indices."""
        if np.array_equal(some, np.arange(len(self.lod))):
            return self
        arrays = ("lod", "longer", "uv", "axes", "lookups", "light", "view", "power", "lights")
        return replace(self, **{name: getattr(self, name)[some] for name in arrays})

    def reference(self, source: FilteredSource, samples: int, rng: np.random.Generator) -> Image:
        """(N, PIXELS, 3) linear radiance, an unbiased estimate."""
        out = np.empty((*self.uv.shape[:2], 3), np.float32)
        for some, light, view, power in self._alike:
            pixels = Pixels(self.uv[some], self.longer[some, None], self.axes[some, None])
            lighting = SummedLights(light, view[:, 0], power)
            out[some] = estimate(source, pixels, lighting, samples, rng)[:, 0]
        return out

    def looked_up_at(self, some: slice | NDArray[np.intp], count: int) -> Array:
        """(n, points, count, 2) where `count` lookups of each point of n pictures lie."""
        width = np.exp2(self.longer[some])[:, None] / np.array(self.size)
        places = ((np.arange(count) + 0.5) / count - 0.5).astype(np.float32)  # in units of a pixel's longer side
        offsets = places[:, None] * (self.axes[some, 0] * width)[:, None, None, :]
        at = self.uv[some]
        if self.frames > 1:
            at = frames_at(at, self.axes[some][:, None] * width[:, None, None], self.frames)
        return np.asarray(at[:, :, None] + offsets)

    def radiance(self, model: str, texels: Image) -> Image:
        """(N, PIXELS, 3) linear radiance of (N, points, C) looked-up texels."""
        out = np.empty((*texels.shape[:2], 3), np.float32)
        frame = np.broadcast_to(np.eye(3, dtype=np.float32), (texels.shape[1], 3, 3))
        for some, light, view, power in self._alike:
            seen = np.broadcast_to(view[:, :1], (len(some), texels.shape[1], 3))
            out[some] = shade_lit(model, texels[some], frame, seen, light, power)
        return mean_of_frames(out, self.frames)

    def adjoint(self, model: str, texels: Image, gradient: Image) -> Image:
        """(N, points, C) derivatives by texels, from (N, PIXELS, 3) derivatives by `radiance`."""
        out = np.empty(texels.shape, np.float32)
        gradient = in_frames(gradient, self.frames)
        for some, light, view, power in self._alike:
            by_light = _of_each_light(power, np.asarray(gradient[some], np.float32))
            out[some] = shade_adjoint(model, np.ascontiguousarray(texels[some], np.float32), light, view, by_light)
        return out

    @cached_property
    def _alike(self) -> list[tuple[NDArray[np.intp], Image, Image, Image]]:
        """Indices of pictures that have as many lights, with the lights, views and powers of these."""
        out = []
        for count in np.unique(self.lights).tolist():
            some = np.flatnonzero(self.lights == count)
            light, view, power = (
                np.ascontiguousarray(each[some, :count]) for each in (self.light, self.view, self.power)
            )
            out.append((some, light, view, power))
        return out


def _of_each_light(power: Image, gradient: Image) -> Image:
    """(n, L, P, 3) products of (n, L, 3) and (n, P, 3).

    As a product of matrices, of whose columns each has one number beside zeros: the same bits, and far faster than
    NumPy's multiplication, whose inner loops run over three colours.
    """
    count, pixels = gradient.shape[:2]
    columns = np.zeros((count, 3, pixels, 3), np.float32)
    for colour in range(3):
        columns[:, colour, :, colour] = gradient[..., colour]
    return np.asarray(np.matmul(power, columns.reshape(count, 3, -1)).reshape(count, -1, pixels, 3))


def draw_small_pictures(
    rng: np.random.Generator,
    lod: Array,
    slant: Array,
    size: tuple[int, int],
    sampler: Sampler,
    rooms: Sequence[Lighting],
    centre: Array,
) -> SmallPictures:
    """Pictures of planes in rooms, which take turns.

    Args:
        lod: (N,) level of detail of the lookups, the MIP bias included. slant: (N,) cosines of the angle of view.
        size: (width, height) of level 0. centre: (N, 2) uv of the middle of each picture.
        sampler: says how far a pixel reaches that is looked up at a level.
    """
    frame, world_view = _placed(rng, slant)
    local = np.einsum("nij,nj->ni", frame, world_view)
    axes = slanted_axes(local)
    lookups = _lookups(slant, sampler)
    longer = lod - sampler.bias + np.log2(lookups)
    place = np.arange(SIDE) - (SIDE - 1) / 2
    rows, columns = np.meshgrid(place, place, indexing="ij")
    steps = np.stack([rows.reshape(-1), columns.reshape(-1)], -1)  # rows go along the view, columns across
    texels = np.einsum("pk,nkx->npx", steps, axes) * np.exp2(longer)[:, None, None]
    lit = [rooms[index % len(rooms)] for index in range(len(slant))]
    most = max(len(room.direction) for room in rooms)
    direction, power = (np.zeros((len(slant), most, 3)) for _ in range(2))
    direction[:] = 0, 1, 0  # of lights without power, in rooms that have fewer
    for index, room in enumerate(lit):
        direction[index, : len(room.direction)], power[index, : len(room.direction)] = room.direction, room.radiance
    light = np.einsum("nij,nkj->nki", frame, direction)
    view = np.broadcast_to(local[:, None], light.shape)
    return SmallPictures(
        size,
        lod,
        longer,
        centre[:, None] + texels / np.array(size),
        axes.astype(np.float32),
        lookups,
        np.ascontiguousarray(light, np.float32),
        np.ascontiguousarray(view, np.float32),
        power.astype(np.float32),
        np.array([len(room.direction) for room in lit]),
        sampler.frames,
    )


def reach(sampler: Sampler) -> float:
    """How far lookups lie from the middle of a picture at most, in texels of the level of detail that they are at."""
    longest = _lookups(np.array([low for low, _ in SLANTS]), sampler).max()
    # The other side of pixels is longer than a lookup is wide by less than another one. Frames show points of a pixel
    # that are less than half a pixel from its centre.
    side = SIDE if sampler.frames == 1 else SIDE + 1
    return float(2**-sampler.bias * side / 2 * math.hypot(longest, min(longest, 2)))


def _lookups(slant: Array, sampler: Sampler) -> NDArray[np.int64]:
    """(N,) lookups of a pixel at (N,) cosines of the angle of view."""
    return np.minimum(np.ceil(1 / slant - 1e-9), sampler.lookups).astype(np.int64)


def draw_slants(rng: np.random.Generator, count: int) -> Array:
    """(count,) cosines of the angle of view, the same number for each kind of SLANTS, one kind after the other."""
    each = count // len(SLANTS)
    spread = (np.arange(each) + rng.random((len(SLANTS), each))) / each
    return np.concatenate(
        [low + rng.permutation(row) * (high - low) for (low, high), row in zip(SLANTS, spread, strict=True)]
    )


def exposures(radiance: Image) -> Image:
    """(N, 1, 1) exposures of pictures of which (N, PIXELS, 3) is right: for their median, halfway to the median of all,
    from which they don't go far."""
    own = np.median(radiance.reshape(len(radiance), -1), -1)
    every = max(float(np.median(own)), _DARK)
    near = own.clip(every / _CONTRAST, every * _CONTRAST)
    return np.asarray((MEDIAN / np.sqrt(near * every))[:, None, None], np.float32)


def _placed(rng: np.random.Generator, slant: Array) -> tuple[Array, Array]:
    """(N, 3, 3) tangent frames in a room, rows tangent, bitangent and normal, and (N, 3) views from it."""
    count = len(slant)
    around, roll = (2 * math.pi * rng.random(count) for _ in range(2))
    height = rng.uniform(*_HEIGHTS, count)
    flat = np.sqrt(1 - height * height)
    lean = np.sqrt(1 - slant * slant)
    # From `steep` to pi less `steep`, the normal does not look down.
    steep = np.arcsin(np.clip(-slant * height / np.maximum(lean * flat, 1e-9), -1, 1))
    turn = steep + rng.random(count) * (math.pi - 2 * steep)
    view = np.stack([flat * np.cos(around), height, flat * np.sin(around)], -1)
    side = np.stack([-np.sin(around), np.zeros(count), np.cos(around)], -1)
    up = np.cross(side, view)
    normal = slant[:, None] * view + lean[:, None] * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up)
    axis = np.where(np.abs(normal[:, 1:2]) < 0.9, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    first = np.cross(axis, normal)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(normal, first)
    tangent = np.cos(roll)[:, None] * first + np.sin(roll)[:, None] * second
    return np.stack([tangent, np.cross(normal, tangent), normal], 1), view
