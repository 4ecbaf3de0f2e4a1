"""Where an object is and how it is turned, and the camera's position, direction and field of view, from one picture.

Deliot, Heitz and Belcour (2024), equation 4: every pixel shows the camera, so that the error of the whole picture is
credited to its seven numbers. The object's six are credited with the pixels that show it. A cube with six colours lies
on a floor of tiles; both are known, and neither where they are seen from. The renderer colours each pixel by its
triangle, and has no edges that could be differentiated. Steps are smaller than the paper's 1 to 2 pixels, with which
the object is thrown out of the picture while the camera is still wrong.

    python examples/stochastic/pose.py

Trials are independent of each other. Each has its own truth and start; what is reported are medians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shared import parse, report

from mipbake import raster
from mipbake.stochastic import Channels, Descent, Group, Shown

Floats = NDArray[np.float64]

TILES, SIDE = 6, 1.2
"""Of the floor: along each side, and how long one is. The cube's edges are 1.6 long."""
EYE, SLOPE = np.array([2.8, -3.4, 3.0]), 0.8
"""Of the camera that truth and start are near: its position, and half a picture's width at distance 1. It looks at the
origin."""
PAINT = np.array([[0.9, 0.1, 0.1], [0.1, 0.7, 0.2], [0.1, 0.3, 0.9], [0.95, 0.85, 0.1], [1, 1, 1], [0.9, 0.5, 0.1]])


@dataclass(frozen=True)
class Settings:
    trials: int = 8
    resolution: int = 96
    iterations: int = 1000
    estimates: int = 2
    pixels: float = 0.4
    seed: int = 0


FULL = Settings(trials=100, resolution=512, iterations=4000)


def turned(vector: Floats) -> Floats:
    """(3, 3): the rotation around a vector (3,) by its length (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / max(angle, 1e-12)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def looking() -> Floats:
    """(3, 3): axes of the camera at EYE as rows: to the right, up, and back."""
    back = EYE / np.linalg.norm(EYE)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


class Scene:
    """The floor and the cube, and how they are drawn.

    An object is (x, y, z, rotation vector); a camera is (x, y, z relative to EYE, rotation vector before it looks at
    the origin, logarithm of its slope relative to SLOPE). Both are rows of 6 and 7 numbers.
    """

    def __init__(self, settings: Settings) -> None:
        self.size, self.context, self.axes = settings.resolution, raster.RasterizeContext(), looking()
        line = (np.arange(TILES + 1) - TILES / 2) * SIDE
        corners = [(0, 0), (0, 1), (1, 1), (1, 0)]
        floor = [[(line[i + a], line[j + b], -0.8) for a, b in corners] for i in range(TILES) for j in range(TILES)]
        cube = []
        for axis in range(3):
            for side in (-0.8, 0.8):
                face = np.full((4, 3), side)
                face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = np.array(corners).T * 1.6 - 0.8
                cube.append(face)
        quads = np.concatenate([floor, cube])
        self.points, self.cube = quads.reshape(-1, 3), 4 * len(floor)
        place = np.arange(len(self.points), dtype=np.int32).reshape(-1, 4)
        self.triangles = place[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
        tiles = np.random.default_rng(1).uniform(0.15, 0.65, (len(floor), 3))
        self.paint = np.concatenate([np.zeros((1, 3)), np.concatenate([tiles, PAINT]).repeat(2, 0)])

    def render(self, values: Mapping[str, Any]) -> Shown:
        (placed, camera), points = (values[name][0] for name in ("object", "camera")), self.points.copy()
        points[self.cube :] = points[self.cube :] @ turned(placed[3:]).T + placed[:3]
        seen = (points - EYE - camera[:3]) @ (turned(camera[3:6]) @ self.axes).T
        slope, near, far = SLOPE * math.exp(camera[6]), 0.5, 40
        depth = -(far + near) / (far - near) * seen[:, 2] - 2 * far * near / (far - near)
        pos = np.stack([seen[:, 0] / slope, seen[:, 1] / slope, depth, -seen[:, 2]], -1)
        rast, _ = raster.rasterize(self.context, pos[None], self.triangles, (self.size, self.size))
        ids = rast[..., 3].reshape(-1).astype(np.int32)
        shows = np.where(ids > self.cube // 2, 0, -1).astype(np.int32)
        return Shown(self.paint[ids], {"object": shows[:, None]})


def channels(settings: Settings) -> dict[str, Channels]:
    """Steps that move what is seen by so many pixels at the origin, a corner of the cube, or the picture's edge."""
    pixel = settings.pixels * 2 * SLOPE / settings.resolution
    distance, reach, no = float(np.linalg.norm(EYE)), 1.4, math.inf
    steps = {
        "object": (pixel * distance,) * 3 + (pixel * distance / reach,) * 3,
        "camera": (pixel * distance,) * 3 + (pixel,) * 3 + (pixel / SLOPE,),
    }
    return {name: Channels(each, (-no,) * len(each), (no,) * len(each)) for name, each in steps.items()}


def drawn(generator: np.random.Generator, spread: float) -> dict[str, Floats]:
    """An object and a camera near the middle: at spread 1 by 0.4 and 25 degrees, 0.5, 4 degrees and 15 %."""
    sizes = {"object": [0.4] * 3 + [math.radians(25)] * 3, "camera": [0.5] * 3 + [math.radians(4)] * 3 + [0.15]}
    return {name: spread * generator.uniform(-1, 1, (1, len(each))) * each for name, each in sizes.items()}


def errors(values: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, float]:
    """What is reported of a trial."""

    def degrees(first: Floats, second: Floats) -> float:
        cosine = (np.trace(turned(first).T @ turned(second)) - 1) / 2
        return math.degrees(math.acos(min(max(cosine, -1), 1)))

    (mine, its), (camera, its_camera) = ((values[name][0], truth[name][0]) for name in ("object", "camera"))
    angles = [2 * math.degrees(math.atan(SLOPE * math.exp(each[6]))) for each in (camera, its_camera)]
    return {
        "object, distance": float(np.linalg.norm(mine[:3] - its[:3])),
        "object, degrees": degrees(mine[3:], its[3:]),
        "camera, distance": float(np.linalg.norm(camera[:3] - its_camera[:3])),
        "camera's direction, degrees": degrees(camera[3:6], its_camera[3:6]),
        "field of view, degrees": abs(angles[0] - angles[1]),
    }


def found(settings: Settings, scene: Scene, start: Mapping[str, Floats], wanted: Floats, seed: int) -> dict[str, Any]:
    """Where a descent ends."""
    values, steps = {name: each.copy() for name, each in start.items()}, channels(settings)
    descent = Descent({name: Group(each, steps[name]) for name, each in values.items()}, seed)
    for iteration in range(settings.iterations):
        descent.step([(scene.render, wanted)] * settings.estimates, 1 - iteration / settings.iterations)
    return values


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = parse(__doc__, Settings(), FULL, arguments)
    log = report.Report("pose", settings, folder)
    scene, generator = Scene(settings), np.random.default_rng(settings.seed)
    before, after, pictures = [], [], []
    for trial in range(settings.trials):
        truth, start = drawn(generator, 0.5), drawn(generator, 1.0)
        wanted = scene.render(truth).image
        values = found(settings, scene, start, wanted, settings.seed + trial)
        for listed, each in ((before, start), (after, values)):
            rms = math.sqrt(np.square(scene.render(each).image - wanted).mean())
            listed.append(errors(each, truth) | {"picture, RMS": rms})
        pictures.append([wanted, scene.render(start).image, scene.render(values).image])
    medians = [{name: float(np.median([each[name] for each in some])) for name in some[0]} for some in (before, after)]
    log.table(
        ["median error", "at the start", "at the end"],
        [[name, *(f"{each[name]:.3g}" for each in medians)] for name in medians[0]],
    )
    log.add(f"{settings.trials} trials", start=before, end=after)
    shown = [
        [each.reshape(scene.size, scene.size, 3)[::-1] for each in row] for row in list(zip(*pictures[:6], strict=True))
    ]
    log.save(report.mosaic(shown))


if __name__ == "__main__":
    main()
