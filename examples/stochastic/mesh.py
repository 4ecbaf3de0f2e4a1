"""A mesh and its map, by stochastic gradients of a renderer that only renders, and by exact gradients of that scene.

Figures 4 and 5, and table 2, of Deliot, Heitz and Belcour (2024). The vertices of a ball of 3,072 triangles, as many as
the paper's mesh has, and a map become what cameras see of a bumpy ball: a map of albedo that nothing shades (figure 4),
or of normals under lamps (figure 5). One renderer draws both ways. Exact gradients flow through mipbake's primitives,
with silhouettes by `antialias`. Stochastic gradients only look at pictures, and at the triangle and the place in the
map that each pixel shows; they are estimated for vertices and texels at once, as in the paper, or in turns. All have
Adam, and rates that fall to 0. Stochastic descents have a number of steps, and the exact one as many as take equally
long, by the processor's clock.

    python examples/stochastic/mesh.py
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scene import LIGHTS, RADIANCE, WIDTH, Camera, ball, bumpy_ball, cameras, distance
from shared import parse, report
from torch import Tensor
from torch.nn.functional import normalize

from mipbake import raster, sampling, stochastic
from mipbake.stochastic import Channels, Descent, Group, Shown

KINDS = ("albedo", "normals")
METHODS = ("exact", "at once", "in turns")


@dataclass(frozen=True)
class Settings:
    steps: int = 16
    texture_size: int = 128
    resolution: int = 128
    fineness: int = 96
    cameras: int = 24
    iterations: int = 300
    estimates: int = 4
    views: int = 2
    seed: int = 0


FULL = Settings(texture_size=1024, resolution=1024, fineness=256, cameras=96, iterations=2000, estimates=16, views=8)

PERTURBED, TEXEL = 1.0, 0.02
"""How far stochastic gradients perturb a vertex, in pixels, and a texel."""
RATE = 0.25
"""Of steps of vertices, in pixels, at first. The paper has what vertices are perturbed by; with few estimates the mesh
crumples then."""


class Scene:
    """The mesh with a map, and how it is drawn."""

    def __init__(self, settings: Settings, kind: str) -> None:
        self.settings, self.kind, self.context = settings, kind, raster.RasterizeContext()
        mesh = ball(settings.steps, settings.texture_size)
        self.start, self.triangles = torch.from_numpy(mesh.points), torch.from_numpy(mesh.triangles)
        self.uv = torch.from_numpy(mesh.uv.reshape(-1, 2))
        places = np.arange(len(self.uv), dtype=np.int32).reshape(-1, 4)
        self.uv_triangles = torch.from_numpy(places[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3))
        self.topology = raster.antialias_construct_topology_hash(self.triangles)
        self.held_out, self.learned = cameras(settings.cameras)
        self.lights, self.radiance = (torch.tensor(each, dtype=torch.float32) for each in (LIGHTS, RADIANCE / 10))
        self.bumpy = bumpy_ball(settings.fineness)
        self.wanted = {camera: self.truth(camera) for camera in (*self.held_out, *self.learned)}

    def begin(self) -> dict[str, Tensor]:
        """The ball, grey; or with its own normals in the map."""
        size = self.settings.texture_size
        texels = torch.full((size * size, 3), 0.5)
        if self.kind == "normals":
            # The atlas as positions (1, V, 4): rasterising it shows what texels lie on.
            flat = torch.nn.functional.pad(2 * self.uv - 1, (0, 2))
            flat[:, 3] = 1
            rast, _ = raster.rasterize(None, flat[None], self.uv_triangles, (size, size))
            normal = torch.empty(len(self.uv), 3)  # of corners of the atlas
            normal[self.uv_triangles.long()] = self.start[self.triangles.long()]
            texels = (raster.interpolate(normal[None], rast, self.uv_triangles)[0].reshape(-1, 3) + 1) / 2
        return {"vertices": self.start.clone(), "texels": texels.contiguous()}

    def drawn(self, values: Mapping[str, Tensor], camera: Camera, smooth: bool) -> tuple[Tensor, Tensor, Tensor]:
        """(1, H, W, 3) picture, what `rasterize` gives, and (1, H, W, 2) places in the map.

        Args:
            smooth: whether silhouettes are blended, which gives them gradients.
        """
        points, size = values["vertices"], self.settings.resolution
        to_clip = torch.from_numpy(camera.to_clip)
        pos = (torch.cat([points, torch.ones_like(points[:, :1])], -1) @ to_clip.T)[None].contiguous()
        rast, _ = raster.rasterize(self.context, pos, self.triangles, (size, size), grad_db=False)
        uv, _ = raster.interpolate(self.uv[None], rast, self.uv_triangles)
        side = self.settings.texture_size
        texture = values["texels"].reshape(1, side, side, 3)
        color = sampling.texture(texture, uv, filter_mode="linear", boundary_mode="clamp")
        color = self.shaded(color) * (rast[..., 3:] > 0)
        if smooth:
            color = raster.antialias(color, rast, pos, self.triangles, self.topology)
        return color, rast, uv

    def shaded(self, color: Tensor) -> Tensor:
        if self.kind == "albedo":
            return color
        return (normalize(2 * color - 1, dim=-1) @ self.lights.T).clamp(min=0) @ self.radiance

    @torch.no_grad()
    def render(self, values: Mapping[str, Any], camera: Camera) -> Shown:
        color, rast, uv = self.drawn(values, camera, smooth=False)
        ids = rast[..., 3].reshape(-1, 1)
        size, seen = self.settings.texture_size, (ids[:, 0] > 0).byte()
        uv = uv.reshape(-1, 2)
        texels = stochastic.touched_texels(
            [(size, size)], uv, torch.zeros(len(uv)), None, seen, boundary=("clamp",) * 2
        )
        vertices = stochastic.touched_vertices(ids, self.triangles)
        return Shown(color.reshape(-1, 3), {"vertices": vertices, "texels": texels})

    @torch.no_grad()
    def truth(self, camera: Camera) -> Tensor:
        """(P, 3): the bumpy ball, from two by two samples a pixel."""
        points, normal, paint, triangles = self.bumpy
        size = 2 * self.settings.resolution
        attributes = torch.from_numpy(paint[:, :3].copy() if self.kind == "albedo" else (normal + 1) / 2)
        pos = torch.from_numpy(np.concatenate([points, np.ones_like(points[:, :1])], -1) @ camera.to_clip.T)[None]
        rast, _ = raster.rasterize(self.context, pos.contiguous(), torch.from_numpy(triangles), (size, size))
        color, _ = raster.interpolate(attributes[None].contiguous(), rast, torch.from_numpy(triangles))
        color = self.shaded(color) * (rast[..., 3:] > 0)
        return torch.nn.functional.avg_pool2d(color.permute(0, 3, 1, 2), 2)[0].permute(1, 2, 0).reshape(-1, 3)

    def views(self, count: int, generator: np.random.Generator) -> list[tuple[Camera, Tensor]]:
        """Some cameras that are learned from, with what they should show."""
        chosen = (self.learned[number] for number in generator.integers(len(self.learned), size=count))
        return [(camera, self.wanted[camera]) for camera in chosen]

    @torch.no_grad()
    def pictures(self, values: Mapping[str, Tensor]) -> list[Tensor]:
        """(P, 3) of each camera that is held out."""
        return [self.drawn(values, camera, smooth=True)[0].reshape(-1, 3) for camera in self.held_out]

    def quality(self, values: Mapping[str, Tensor]) -> tuple[float, float]:
        """PSNR of the cameras that are held out, and the mean distance from the true surface, by radii."""
        wanted = torch.stack([self.wanted[camera] for camera in self.held_out])
        return report.psnr(torch.stack(self.pictures(values)), wanted), distance(values["vertices"].numpy())


@dataclass(frozen=True)
class Learned:
    """What a method came to, in how many steps, and how long a step takes."""

    values: Mapping[str, Tensor]
    steps: int
    seconds: float


def stochastically(scene: Scene, in_turns: bool) -> Learned:
    """Adam by estimates, of all parameters at once; or of vertices in every other step, and of texels in the others."""
    settings, values = scene.settings, scene.begin()
    step = PERTURBED * WIDTH / settings.resolution
    groups = {
        "vertices": Group(values["vertices"], Channels((step,) * 3, (-2.0,) * 3, (2.0,) * 3), RATE / PERTURBED),
        "texels": Group(values["texels"], Channels((TEXEL,) * 3, (0.0,) * 3, (1.0,) * 3)),
    }
    names = [[name] for name in groups] if in_turns else [list(groups)]
    descents = [Descent({name: groups[name] for name in some}, settings.seed) for some in names]
    generator, began = np.random.default_rng(settings.seed), time.process_time()
    for iteration in range(settings.iterations):
        pairs = [
            (lambda given, camera=camera: scene.render({**values, **given}, camera), wanted)
            for camera, wanted in scene.views(settings.estimates, generator)
        ]
        # Each turn goes as far in all as without turns.
        rate = len(descents) * (1 - iteration / settings.iterations)
        descents[iteration % len(descents)].step(pairs, rate)
    return Learned(values, settings.iterations, (time.process_time() - began) / settings.iterations)


def exactly(scene: Scene, seconds: float) -> Learned:
    """Adam by exact gradients, for so many seconds."""
    settings, values = scene.settings, scene.begin()
    rates = {"vertices": RATE * WIDTH / settings.resolution, "texels": TEXEL}
    groups = [{"params": [values[name].requires_grad_(True)], "lr": rate} for name, rate in rates.items()]
    optimiser, generator, steps = torch.optim.Adam(groups), np.random.default_rng(settings.seed), 0
    began = time.process_time()
    while (spent := time.process_time() - began) < seconds:
        for group, rate in zip(optimiser.param_groups, rates.values(), strict=True):
            group["lr"] = rate * (1 - spent / seconds)
        loss = sum(
            (scene.drawn(values, camera, smooth=True)[0].reshape(-1, 3) - wanted).square().mean()
            for camera, wanted in scene.views(settings.views, generator)
        )
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        steps += 1
    return Learned({name: each.detach() for name, each in values.items()}, steps, spent / steps)


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = parse(__doc__, Settings(), FULL, arguments)
    log = report.Report("mesh", settings, folder)
    columns, rows = {}, []
    for kind in KINDS:
        scene = Scene(settings, kind)
        rough, turns = (stochastically(scene, in_turns) for in_turns in (False, True))
        exact = exactly(scene, rough.steps * rough.seconds)
        start, learned = scene.begin(), dict(zip(METHODS, (exact, rough, turns), strict=True))
        before = scene.quality(start)
        for method, each in learned.items():
            after = scene.quality(each.values)
            columns[f"{kind}, {method}"] = {
                "pictures a step": settings.views if each is exact else 2 * settings.estimates,
                "milliseconds a step": 1000 * each.seconds,
                "steps": each.steps,
                "psnr": [before[0], after[0]],
                "distance": [before[1], after[1]],
            }
        shown = [scene.pictures(values) for values in (start, *(each.values for each in learned.values()))]
        wanted = [scene.wanted[camera] for camera in scene.held_out]
        rows += list(zip(wanted, *shown, strict=True))[:2]
    log.figures.update(columns)
    figures = columns.values()
    log.table(
        ["figure", *columns],
        [
            ["pictures a step", *(str(each["pictures a step"]) for each in figures)],
            ["time a step", *(f"{each['milliseconds a step']:.0f} ms" for each in figures)],
            [
                "time a picture",
                *(f"{each['milliseconds a step'] / each['pictures a step']:.1f} ms" for each in figures),
            ],
            ["steps", *(str(each["steps"]) for each in figures)],
            ["PSNR of held-out views", *("{:.1f} to {:.1f} dB".format(*each["psnr"]) for each in figures)],
            ["mean distance from the surface", *("{:.3f} to {:.3f}".format(*each["distance"]) for each in figures)],
        ],
    )
    size = settings.resolution
    log.save(report.mosaic([[report.upright(each.reshape(size, size, 3)) for each in row] for row in rows]))


if __name__ == "__main__":
    main()
