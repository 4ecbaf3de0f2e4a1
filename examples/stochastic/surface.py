"""A subdivision surface from pictures: its control mesh, its displacement and its normal map, all at once.

Figures 6 and 1 of Deliot, Heitz and Belcour (2024). A ball of quadrilaterals is subdivided by Catmull and Clark's rule,
displaced along its normals by a map, and shaded by glTF's model with a normal map. With --physical there are maps of
albedo, metallic and roughness, too. What is wanted are pictures of a bumpy ball, which is no surface of that kind, from
cameras around it. A pixel is credited to the control vertices that its triangle depends on, to the texels of the
displacement at that triangle's corners, and to the texels that it was shaded with.

    python examples/stochastic/surface.py                figure 6 at a CPU's size
    python examples/stochastic/surface.py --physical     figure 1, into surface-physical.png and .json

What is reported is the PSNR of views that nothing was learned from, and how far the surface is from the true one, in
the mean, by radii; the ball's radius is about 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scene import LIGHTS, RADIANCE, WIDTH, Camera, Floats, Ints, ball, bumpy_ball, cameras, distance, normals
from shared import parse, psnr, report

from mipbake import raster, sampling, shading, stochastic
from mipbake.stochastic import Channels, Descent, Group, Shown, Subdivision
from mipbake.stochastic.descent import Render


@dataclass(frozen=True)
class Settings:
    steps: int = 6
    texture_size: int = 128
    resolution: int = 128
    fineness: int = 96
    cameras: int = 24
    iterations: int = 400
    estimates: int = 4
    physical: bool = False
    seed: int = 0


FULL = Settings(steps=13, texture_size=1024, resolution=512, fineness=256, cameras=96, iterations=2000, estimates=16)

PIXELS = {"vertices": 2.0, "height": 0.3}
"""How far steps move the surface."""
TEXEL = 0.02
"""Steps of what shades."""
RATES = {"vertices": 0.25, "height": 0.1, "maps": 1.0}
"""The paper has 1 for all. With few estimates a step the surface crumples then, before the pictures are alike."""

LEVELS = 2

GREY = (0.5, 0.5, 0.5, 0.0, 0.6)
"""Base colour, metallic and roughness where they are not learned."""


def lit(camera: Camera, points: Floats, frames: Floats, material: Floats) -> Floats:
    """(N, 3) displayed colours of points (N, 3) with frames (N, 3, 3) and glTF's stored channels (N, 8)."""
    view = camera.eye - points
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    material = np.concatenate([material[:, :5], 2 * material[:, 5:] - 1], -1)
    shown = shading.shade_lit("gltf", material, frames, view, LIGHTS, RADIANCE)
    return shown / (1 + shown)


def frames_of(normal: Floats, along: Floats) -> Floats:
    """(N, 3, 3): axes of tangent spaces with normals of any length, the first axis towards `along`."""
    n = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    t = along - (along * n).sum(-1, keepdims=True) * n
    t /= np.linalg.norm(t, axis=-1, keepdims=True)
    return np.stack([t, np.cross(n, t), n], 1)


class Surface:
    """The subdivision surface, and how it is drawn: NumPy arrays in, pictures out."""

    def __init__(self, settings: Settings) -> None:
        self.settings, self.context = settings, raster.RasterizeContext()
        self.control = ball(settings.steps, settings.texture_size)
        self.topology = Subdivision.of(self.control.quads, LEVELS)
        corners = self.topology.refine_corners(self.control.uv.reshape(-1, 2)).reshape(-1, 2).astype(np.float32)
        # Corners of quads have coordinates of their own; those of the first quad at a vertex are where it is displaced.
        self.uv = corners
        places = np.arange(len(corners), dtype=np.int32).reshape(-1, 4)
        self.uv_triangles = places[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
        _, first = np.unique(self.topology.quads, return_index=True)
        self.vertex_uv = np.ascontiguousarray(self.uv[first])
        size = settings.texture_size
        self.sizes = [(size, size)]
        of_vertices = self.texels_at(self.vertex_uv)
        self.height_of = of_vertices[self.topology.triangles].reshape(len(self.topology.triangles), -1)

    def texels_at(self, uv: Floats) -> Ints:
        """(P, 8): the texels of a bilinear lookup."""
        return stochastic.touched_texels(self.sizes, uv, lod=np.zeros(len(uv), np.float32), boundary=("clamp", "clamp"))

    def start(self) -> dict[str, Floats]:
        """A control mesh whose surface is about the unit ball, without bumps."""
        count = self.settings.texture_size**2
        points = self.control.points
        points = points / np.linalg.norm(self.topology.refine(points)[: len(points)], axis=-1, keepdims=True)
        maps = np.tile(np.float32([*GREY, 0.5, 0.5, 1.0]), (count, 1))
        return {"vertices": points.astype(np.float32), "height": np.zeros((count, 1), np.float32), "maps": maps}

    def points(self, values: Mapping[str, Any]) -> tuple[Floats, Floats]:
        """(V, 3) displaced vertices, and normals before that."""
        smooth = self.topology.refine(values["vertices"])
        normal = normals(smooth, self.topology.triangles)
        size = self.settings.texture_size
        texels, places = values["height"].reshape(1, size, size, 1), self.vertex_uv[None, None]
        height = sampling.texture(texels, places, filter_mode="linear", boundary_mode="clamp")
        return smooth + height[0, 0] * normal, normal

    def render(self, values: Mapping[str, Any], camera: Camera) -> Shown:
        points, normal = self.points(values)
        size, triangles = self.settings.resolution, self.topology.triangles
        pos = np.concatenate([points, np.ones_like(points[:, :1])], -1) @ camera.to_clip.T
        rast, _ = raster.rasterize(self.context, pos[None], triangles, (size, size))
        ids = rast[..., 3].reshape(-1).astype(np.int32)
        seen = np.flatnonzero(ids)
        there, _ = raster.interpolate(np.concatenate([points, normal], -1)[None], rast, triangles)
        uv, _ = raster.interpolate(self.uv[None], rast, self.uv_triangles)
        uv, there = uv.reshape(-1, 2)[seen], there.reshape(-1, 6)[seen]
        maps = values["maps"].reshape(1, self.settings.texture_size, self.settings.texture_size, 8)
        material = sampling.texture(maps, uv[None, None], filter_mode="linear", boundary_mode="clamp")[0, 0]
        frames = frames_of(there[:, 3:], self.tangents(points)[ids[seen] - 1])
        image = np.zeros((size * size, 3), np.float32)
        image[seen] = lit(camera, there[:, :3], frames, material)
        texels = np.full((size * size, 8), -1, np.int32)
        texels[seen] = self.texels_at(uv)
        vertices = stochastic.touched_vertices(ids[:, None], self.topology.supports)
        heights = stochastic.touched_vertices(ids[:, None], self.height_of)
        return Shown(image, {"vertices": vertices, "height": heights, "maps": texels})

    def tangents(self, points: Floats) -> Floats:
        """(T, 3): where u grows on each triangle."""
        corners, uv = points[self.topology.triangles], self.uv[self.uv_triangles]
        (a, b), (s, t) = ((each[:, 1] - each[:, 0], each[:, 2] - each[:, 0]) for each in (corners, uv))
        area = s[:, :1] * t[:, 1:] - s[:, 1:] * t[:, :1]
        return np.asarray((a * t[:, 1:] - b * s[:, 1:]) * np.sign(area))


class Truth:
    """What pictures are of: a bumpy ball of small triangles."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.points, self.normal, paint, self.triangles = bumpy_ball(settings.fineness)
        paint = paint if settings.physical else np.broadcast_to(np.float32(GREY), paint.shape)
        self.paint = np.concatenate([paint, np.tile(np.float32([0.5, 0.5, 1]), (len(paint), 1))], 1)

    def render(self, camera: Camera) -> Floats:
        """(P, 3)"""
        size = self.settings.resolution
        pos = np.concatenate([self.points, np.ones_like(self.points[:, :1])], -1) @ camera.to_clip.T
        rast, _ = raster.rasterize(None, pos[None], self.triangles, (size, size))
        seen = np.flatnonzero(rast[..., 3])
        each = np.concatenate([self.points, self.normal, self.paint], -1)
        there = raster.interpolate(each[None], rast, self.triangles)[0].reshape(size * size, -1)[seen]
        image = np.zeros((size * size, 3), np.float32)
        image[seen] = lit(camera, there[:, :3], frames_of(there[:, 3:6], np.roll(there[:, 3:6], 1, 1)), there[:, 6:])
        return image


def groups(settings: Settings, values: Mapping[str, Floats]) -> dict[str, Group]:
    """What is learned, and in which steps."""
    pixel = WIDTH / settings.resolution
    vertex, height, texel = PIXELS["vertices"] * pixel, PIXELS["height"] * pixel, TEXEL
    shades = texel if settings.physical else 0.0
    channels = {
        "vertices": Channels((vertex,) * 3, (-2.0,) * 3, (2.0,) * 3),
        "height": Channels((height,), (-0.5,), (0.5,)),
        "maps": Channels((*(shades,) * 5, texel, texel, 0.0), (0.0,) * 8, (1.0,) * 8, lifted=5),
    }
    return {name: Group(values[name], channels[name], RATES[name]) for name in values}


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = parse(__doc__, Settings(), FULL, arguments)
    log = report.Report("surface-physical" if settings.physical else "surface", settings, folder)
    surface, truth = Surface(settings), Truth(settings)
    held_out, learned = cameras(settings.cameras)
    wanted = {camera: truth.render(camera) for camera in (*held_out, *learned)}
    values = surface.start()
    learned_groups = groups(settings, values)
    # With many maps, what moves the surface would be noise to the texels: then they are learned in turns.
    turns = [["vertices", "height"], ["maps"]] if settings.physical else [list(learned_groups)]
    descents = [Descent({name: learned_groups[name] for name in some}, settings.seed) for some in turns]
    count = sum(len(each.values) * int(np.count_nonzero(each.channels.magnitude)) for each in learned_groups.values())

    def state() -> tuple[float, float, list[Floats]]:
        """PSNR of the cameras that are held out, the mean distance from the true surface, and the pictures."""
        images = [surface.render(values, camera).image for camera in held_out]
        found = psnr(np.stack(images), np.stack([wanted[camera] for camera in held_out]))
        return found, distance(surface.points(values)[0]), images

    def view(camera: Camera) -> tuple[Render, Floats]:
        return lambda given: surface.render({**values, **given}, camera), wanted[camera]

    generator, states = np.random.default_rng(settings.seed), [state()]
    for iteration in range(settings.iterations):
        chosen = generator.integers(len(learned), size=settings.estimates)
        # Each turn goes as far in all as without turns.
        rate = len(descents) * (1 - iteration / settings.iterations)
        descents[iteration % len(descents)].step((view(learned[number]) for number in chosen), rate)
    states.append(state())
    log.table(
        ["figure", "at the start", "at the end"],
        [
            ["PSNR of held-out views", *(f"{each[0]:.1f} dB" for each in states)],
            ["mean distance from the surface", *(f"{each[1]:.3f}" for each in states)],
        ],
    )
    renders = 2 * sum(descent.estimates for descent in descents)
    log.add(
        f"{count} parameters, {renders} renders",
        parameters=count, renders=renders,
        psnr=[each[0] for each in states], distance=[each[1] for each in states],
    )  # fmt: skip
    size = settings.resolution
    rows = [[wanted[camera] for camera in held_out], *(each[2] for each in states)]
    log.save(report.mosaic([[image.reshape(size, size, 3)[::-1] for image in row] for row in rows]))


if __name__ == "__main__":
    main()
