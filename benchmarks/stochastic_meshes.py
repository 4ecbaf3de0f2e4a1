"""Figures 4 and 5 of Deliot et al. 2024: a mesh with an albedo or a normal map, by stochastic and by exact gradients.

Both ways learn the vertices of a sphere and a texture that it wears from pictures of a bumpy one. They start from the
same sphere, see the same pictures in the same order, and use Adam with rates that fall alike over the time that they
have. The exact gradients are those of mipbake's own primitives: rasterize, interpolate, texture and antialias.
"""

from __future__ import annotations

import itertools
import sys
import time
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from stochastic_soups import Clock, psnr
from torch import Tensor

from mipbake import raster, sampling, stochastic
from mipbake.stochastic import Channels, Moments

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples" / "fitting"))
from camera import random_quaternions, rotation_matrix, to_clip
from meshes import sphere
from textures import fractal_noise

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

DISTANCE = 3.2
CLOCKS = {"wall": time.perf_counter, "processor": time.process_time}
"""Seconds of the wall's clock, or of all threads together, which other processes do not disturb."""
CLAMP = ("clamp", "clamp")
LAST = 0.1
"""Rates fall to this share of what they are at first."""


@dataclass(frozen=True)
class Setting:
    """What is learned.

    Args:
        kind: "albedo" (figure 4) or "normal" (figure 5).
        texture: texels of the square texture in each direction; a multiple of 6.
        side: pixels of the square images in each direction.
        views, held_out: numbers of pictures, for learning and for measuring.
        estimates, images: pictures for each step of Adam: stochastic and exact.
        texels: which of a lookup stochastic errors are credited to, as `touched_texels` has it.
    """

    kind: str
    texture: int
    side: int
    views: int = 48
    held_out: int = 8
    estimates: int = 8
    images: int = 4
    texels: str = "nearest"


@dataclass(frozen=True)
class Surface:
    """Of each pixel: (P, 1) triangles, 0 for none; (P, 2) uv, NaN for none; (P, 3) the light in the map's frame."""

    ids: Ints
    uv: Floats
    light: Floats | None


@dataclass
class Scene:
    """The sphere, its atlas, and the true asset. The atlas has the six grids of the sphere side by side, 3 x 2."""

    setting: Setting
    steps: int = 16
    context: raster.RasterizeContext = field(default_factory=raster.RasterizeContext)

    def __post_init__(self) -> None:
        mesh = sphere(self.steps)
        self.base = mesh.positions
        self.triangles = mesh.triangles
        self.hash = raster.antialias_construct_topology_hash(self.triangles)
        n, texture = self.steps, self.setting.texture
        lattice = torch.arange(n + 1) / n
        corners, faces = [], self.triangles.shape[0] // 6
        rows = torch.arange(n * n)
        row, column = rows // n, rows % n
        # As meshes.sphere makes a face's triangles: (a, b, c) of all squares, then (a, c, d); turned on every other.
        places = [(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)]
        inset = 1.0 / (texture // 3)  # a texel, so that lookups stay on their face
        for face in range(6):
            made = []
            for order in ((0, 1, 2), (0, 2, 3)):
                tri = torch.stack([torch.stack([places[k][1], places[k][0]], -1) for k in order], 1)
                made.append(tri if face % 2 else tri.flip(1))
            spread = lattice[torch.cat(made)] * (1 - 2 * inset) + inset
            corners.append((spread + torch.tensor([face // 2, face % 2])) / torch.tensor([3.0, 2.0]))
            assert len(made[0]) * 2 == faces
        self.uv = torch.cat(corners).reshape(-1, 2).contiguous()
        self.uv_triangles = torch.arange(len(self.uv), dtype=torch.int32).reshape(-1, 3)
        # The frame of a normal map: attributes of the unmoved sphere.
        up = torch.tensor([0.1, 0.2, 0.97])
        tangent = torch.nn.functional.normalize(torch.linalg.cross(up.expand_as(self.base), self.base), dim=-1)
        self.frame = torch.cat([tangent, torch.linalg.cross(self.base, tangent), self.base], -1).contiguous()
        direction = self.base.numpy()
        relief = fractal_noise(direction, 1.5, 6, 0.5, seed=5).astype(np.float32)
        self.true_places = self.base * (1 + 0.12 * torch.from_numpy(relief)[:, None])
        self.true_texels = self._painted()
        generator = torch.Generator().manual_seed(7)
        count = self.setting.views + self.setting.held_out
        self.rotations = rotation_matrix(random_quaternions(count, generator))
        self.lights = torch.nn.functional.normalize(
            torch.randn(count, 3, generator=generator) * 0.6 + torch.tensor([0.0, 0.3, 1.0]), dim=-1
        )

    def _painted(self) -> Tensor:
        """(S, S, 3): noise over the atlas, at every scale up to two texels."""
        s = self.setting.texture
        v, u = np.meshgrid((np.arange(s) + 0.5) / s, (np.arange(s) + 0.5) / s, indexing="ij")
        points = np.stack([6 * u, 6 * v, 0 * u], -1)
        noises = [fractal_noise(points + 9 * k, 1, s / 24, 0.7, seed=70 + 10 * k) for k in range(3)]
        noise = torch.from_numpy(np.stack(noises, -1).astype(np.float32))
        if self.setting.kind == "albedo":
            return (0.5 + 0.4 * noise).clamp(0, 1)
        slopes = (0.45 * noise[..., :2]).clamp(-0.65, 0.65)
        normal = torch.cat([slopes, (1 - slopes.square().sum(-1, keepdim=True)).sqrt()], -1)
        return (normal + 1) / 2

    @property
    def first_texels(self) -> Tensor:
        grey = [0.5, 0.5, 0.5] if self.setting.kind == "albedo" else [0.5, 0.5, 1.0]
        return torch.tensor(grey).expand(self.setting.texture, self.setting.texture, 3).contiguous()

    @property
    def pixel(self) -> float:
        """What is one pixel at the distance of the centre: the view is 0.8 times as wide as the distance."""
        return 0.8 * DISTANCE / self.setting.side

    def clip(self, places: Tensor, view: int) -> Tensor:
        out: Tensor = to_clip(places, self.rotations[view : view + 1], DISTANCE)
        return out

    def exact(self, places: Tensor, texels: Tensor, view: int) -> Tensor:
        """(1, S, S, 3), with silhouettes blended; differentiable. Every measure is taken by it."""
        pos = self.clip(places, view)
        size = (self.setting.side, self.setting.side)
        rast, _ = raster.rasterize(self.context, pos, self.triangles, size, grad_db=False)
        uv, _ = raster.interpolate(self.uv, rast, self.uv_triangles)
        colour = sampling.texture(texels[None], uv, filter_mode="linear", boundary_mode="clamp")
        if self.setting.kind == "normal":
            frame, _ = raster.interpolate(self.frame, rast, self.triangles)
            local = torch.nn.functional.normalize(2 * colour - 1, dim=-1)
            light = self.rotations[view].T @ self.lights[view]
            shade = (frame.reshape(*frame.shape[:-1], 3, 3) @ light * local).sum(-1, keepdim=True)
            colour = 0.1 + 0.8 * shade.clamp_min(0) * torch.tensor([1.0, 0.9, 0.7])
        colour = colour * (rast[..., 3:] > 0)
        out: Tensor = raster.antialias(colour, rast, pos, self.triangles, self.hash)
        return out

    def surface(self, places: Floats, view: int) -> Surface:
        """What a picture shows of the mesh, by a renderer that only renders, in NumPy."""
        s = self.setting.side
        pos = self.clip(torch.from_numpy(places), view).numpy()
        rast, _ = raster.rasterize(self.context, pos, self._arrays["triangles"], (s, s))
        ids = rast[..., 3].reshape(-1, 1).astype(np.int32)
        uv, _ = raster.interpolate(self._arrays["uv"], rast, self._arrays["uv_triangles"])
        uv = uv.reshape(-1, 2)
        uv[ids[:, 0] == 0] = np.nan
        light = None
        if self.setting.kind == "normal":
            frame, _ = raster.interpolate(self._arrays["frame"], rast, self._arrays["triangles"])
            towards = (self.rotations[view].T @ self.lights[view]).numpy()
            light = frame.reshape(-1, 3, 3) @ towards
        return Surface(ids, uv, light)

    def plain(self, seen: Surface, texels: Floats) -> Floats:
        """(P, 3) its picture, without blended silhouettes."""
        stack = texels.reshape(1, self.setting.texture, self.setting.texture, 3)
        colour = sampling.texture(stack, seen.uv[None, None], filter_mode="linear", boundary_mode="clamp")[0, 0]
        if seen.light is not None:
            local = 2 * colour - 1
            length = np.sqrt(np.einsum("pi,pi->p", local, local))
            shade = np.einsum("pi,pi->p", local, seen.light) / np.maximum(length, 1e-6)
            colour = np.float32(0.1) + np.maximum(shade, 0)[:, None] * np.array([0.8, 0.72, 0.56], np.float32)
        shown: Floats = np.where(seen.ids > 0, colour, np.float32(0))
        return shown

    @cached_property
    def _arrays(self) -> dict[str, NDArray[np.generic]]:
        names = ("triangles", "uv", "uv_triangles", "frame")
        return {name: getattr(self, name).numpy() for name in names}

    @cached_property
    def wanted(self) -> list[Tensor]:
        """The pictures, with blended silhouettes."""
        with torch.no_grad():
            return [self.exact(self.true_places, self.true_texels, view) for view in range(len(self.rotations))]

    @cached_property
    def wanted_plain(self) -> list[Floats]:
        texels = self.true_texels.reshape(-1, 3).numpy()
        places = self.true_places.numpy()
        return [self.plain(self.surface(places, view), texels) for view in range(self.setting.views)]

    def score(self, places: Tensor, texels: Tensor) -> float:
        """PSNR in dB over the pictures that are held out, together."""
        with torch.no_grad():
            held = range(self.setting.views, len(self.rotations))
            shown = torch.cat([self.exact(places, texels, view) for view in held])
        return psnr(shown.numpy(), torch.cat([self.wanted[view] for view in held]).numpy())


@dataclass
class Learned:
    """(seconds, PSNR) on the way, steps of Adam, seconds of stages, and the asset."""

    curve: list[tuple[float, float]]
    steps: int
    seconds: dict[str, float]
    places: Tensor
    texels: Tensor


class Schedule:
    """Whether time is left, what the rate is, and when to measure; the clock stands still while measuring."""

    def __init__(self, budget: float, clock: str, measured: int = 12) -> None:
        self.clock = CLOCKS[clock]
        self.budget, self.next, self.every = budget, 0.0, budget / measured
        self.spent, self.since = 0.0, self.clock()

    @property
    def seconds(self) -> float:
        return self.spent + self.clock() - self.since

    @property
    def rate(self) -> float:
        return float(LAST ** min(self.seconds / self.budget, 1))

    def measures(self) -> bool:
        """Stops the clock where it is time to measure."""
        self.spent = self.seconds
        self.since = self.clock()
        due = self.spent >= min(self.next, self.budget)
        if due:
            self.next += self.every
        return due

    def go(self) -> None:
        self.since = self.clock()


def by_exact_gradients(
    scene: Scene, budget: float, clock: str, place_rate: float, texel_rate: float, seed: int = 0
) -> Learned:
    """Adam on what backpropagation gives."""
    places = scene.base.clone().requires_grad_()
    texels = scene.first_texels.clone().requires_grad_()
    groups = [{"params": [places], "lr": place_rate}, {"params": [texels], "lr": texel_rate}]
    optimiser = torch.optim.Adam(groups, eps=1e-20)
    drawn, curve, steps = np.random.default_rng(seed), [], 0
    assert scene.wanted
    schedule = Schedule(budget, clock)
    while True:
        if schedule.measures():
            curve.append((schedule.spent, scene.score(places.detach(), texels.detach())))
            if schedule.spent >= budget:
                break
            schedule.go()
        for group, rate in zip(optimiser.param_groups, (place_rate, texel_rate), strict=True):
            group["lr"] = rate * schedule.rate
        optimiser.zero_grad()
        for view in drawn.integers(0, scene.setting.views, scene.setting.images):
            error = (scene.exact(places, texels, int(view)) - scene.wanted[view]).square().sum()
            error.backward()
        optimiser.step()
        with torch.no_grad():
            texels.clamp_(0, 1)
        steps += 1
    return Learned(curve, steps, {}, places.detach(), texels.detach())


@dataclass(frozen=True)
class Perturbing:
    """How parameters are perturbed, which is also how fast Adam moves them.

    Args:
        pixels: how far a vertex moves, in pixels at the distance of the centre.
        texel: of a channel of a texel.
        apart: whether estimates take turns: one moves vertices alone, the next one texels alone. A vertex changes the
            pixels of its triangles much more than a texel does, and is noise to the texels that they show.
    """

    pixels: float
    texel: float
    apart: bool


AS_THE_PAPER = Perturbing(1.5, 0.02, apart=False)
"""Everything moves at once, vertices by 1 to 2 pixels."""

IN_TURNS = Perturbing(0.25, 0.02, apart=True)
"""The best of a few that were tried for the albedo map."""


def by_stochastic_gradients(scene: Scene, budget: float, clock: str, moving: Perturbing, seed: int = 0) -> Learned:
    """Equation 9, with a random picture for each estimate, and Adam with rates of magnitudes."""
    setting = scene.setting
    pixel, normal = moving.pixels * scene.pixel, setting.kind == "normal"
    of_places = Channels((pixel,) * 3, (-2.0,) * 3, (2.0,) * 3)
    height = 0.0 if normal else moving.texel
    of_texels = Channels((moving.texel, moving.texel, height), (0.0,) * 3, (1.0,) * 3, 0 if normal else None)
    places = scene.base.numpy().copy()
    texels = scene.first_texels.reshape(-1, 3).numpy().copy()
    arrays = [places, texels]
    channels = [of_places, of_texels]
    gradients = [np.zeros_like(each) for each in arrays]
    moments = [Moments.of(each) for each in arrays]
    sides = [(each.copy(), each.copy()) for each in arrays]
    sizes, level = [(setting.texture, setting.texture)], np.zeros(setting.side**2, np.float32)
    triangles = scene.triangles.numpy()
    drawn, curve, steps, number, stages = np.random.default_rng(seed), [], 0, 0, Clock()
    assert scene.wanted and scene.wanted_plain
    schedule = Schedule(budget, clock)
    while True:
        if schedule.measures():
            texture = torch.from_numpy(texels.reshape(setting.texture, setting.texture, 3))
            curve.append((schedule.spent, scene.score(torch.from_numpy(places), texture)))
            if schedule.spent >= budget:
                break
            schedule.go()
        moved = [np.zeros(len(each), bool) for each in arrays]
        for view in drawn.integers(0, setting.views, setting.estimates):
            number += 1
            changed = [number % 2] if moving.apart else [0, 1]
            with stages.stage("P"):
                for k in changed:
                    stochastic.perturb(arrays[k], channels[k], number, 2 * seed + k, None, sides[k])
            with stages.stage("R"):
                at, worn = (sides[k] if k in changed else (arrays[k],) for k in (0, 1))
                seen = [scene.surface(each, int(view)) for each in at]
                plus, minus = scene.plain(seen[0], worn[0]), scene.plain(seen[-1], worn[-1])
            with stages.stage("G"):
                differences = stochastic.pixel_differences(plus, minus, scene.wanted_plain[view])
                for k in changed:
                    if k == 0:
                        touched = stochastic.touched_vertices(np.concatenate([s.ids for s in seen], 1), triangles)
                    else:
                        read = [
                            stochastic.touched_texels(sizes, s.uv, level, None, None, setting.texels, CLAMP)
                            for s in seen
                        ]
                        touched = np.concatenate([each[:, :4] for each in read], 1)
                    made_of = stochastic.contributions(touched)
                    stochastic.add_gradient(gradients[k], differences, made_of, channels[k], number, 2 * seed + k)
                    moved[k][made_of.elements] = True
        with stages.stage("D"):
            for k in (0, 1):
                elements = np.flatnonzero(moved[k]).astype(np.int32)
                stochastic.descend(arrays[k], gradients[k], moments[k], channels[k], schedule.rate, elements)
        steps += 1
    texture = torch.from_numpy(texels.reshape(setting.texture, setting.texture, 3))
    return Learned(curve, steps, stages.spent, torch.from_numpy(places), texture)


def within(curve: list[tuple[float, float]], wanted: float) -> float | None:
    """Seconds after which a PSNR is reached; None where it is not."""
    for (before, low), (after, high) in itertools.pairwise(curve):
        if high >= wanted:
            return before + (after - before) * max(0.0, (wanted - low) / max(high - low, 1e-9))
    return None
