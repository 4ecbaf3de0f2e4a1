"""Gaussian splats fitted to pictures of a scene, few at first and then more and more.

After figure 7 and section 4.4 of Deliot, Heitz and Belcour (2024). A splat is a Gaussian in space with a colour and an
opacity (Kerbl et al. 2023, 3D Gaussian Splatting for Real-Time Radiance Field Rendering). Pictures of a knot from many
sides are wanted, and pictures from other sides are compared. The renderer blends splats nearest first, and lists those
that make up each pixel.

Between the stages of a fit splats that nobody sees begin again as parts of others, where pictures are wrong.

  hierarchy  few splats in small pictures at first, more in each stage
  flat       all splats in full pictures from the start, in as many stages, for as many seconds of the processor

    python examples/stochastic/splats.py                      on a CPU, in minutes
    python examples/stochastic/splats.py --full               the paper's size
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from shared import camera, meshes, parse, psnr, report, textures

from mipbake import raster
from mipbake.stochastic import Channels, Descent, Group, Shown

Floats = NDArray[np.float32]

DISTANCE, SLOPE = 3.0, 0.4
BLUR = 0.3
"""What the variance of a splat gains in pixels, so that none falls between them (Kerbl et al. 2023)."""
LEAST_OPACITY = 0.03
"""A splat that is fainter, or that no pixel shows, begins again as part of another (a guess)."""

SHOWN_FOR_CREDIT = 8
"""Views that say where pictures are wrong."""


class Stage(NamedTuple):
    """How a stage ended: seconds of the processor from the start, and PSNR in dB over sides that nobody showed."""

    splats: int
    side: int
    seconds: float
    psnr: float


@dataclass(frozen=True)
class Settings:
    splats: int = 8192
    first_splats: int = 1024
    side: int = 256
    first_side: int = 64
    views: int = 24
    test_views: int = 4
    stages: int = 12
    steps: int = 100
    estimates: int = 1
    layers: int = 16
    seed: int = 0


FULL = Settings(splats=131_072, side=512, views=64, stages=20, steps=200, estimates=16)

# ---- The parameters of a splat: position, logarithms of the axes' lengths, their quaternion, colour, opacity ----

POSITION, AXES, TURN, PAINT = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 14)


def channels(side: int) -> Channels:
    """A position moves by 0.15 pixels: of 0.08, 0.15, 0.3, 0.5 and 1 this came farthest with 2048 splats, and the paper
    has 1 to 2. The other steps are the best of a few that were tried."""
    pixel = 2 * SLOPE * DISTANCE / side
    return Channels(
        (*(0.15 * pixel,) * 3, *(0.0125,) * 3, *(0.025,) * 4, *(0.02,) * 4),
        (*(-1.2,) * 3, *(np.log(0.3 * pixel),) * 3, *(-2.0,) * 4, *(0.0,) * 4),
        (*(1.2,) * 3, *(np.log(0.4),) * 3, *(2.0,) * 4, *(1.0,) * 4),
    )


def start(count: int, generator: np.random.Generator) -> Floats:
    """(count, 14): grey balls at random places of the ball that holds the scene."""
    values = np.zeros((count, 14), np.float32)
    place = generator.normal(size=(count, 3))
    place *= generator.uniform(0, 1, (count, 1)) ** (1 / 3) / np.linalg.norm(place, axis=-1, keepdims=True)
    values[:, POSITION] = place
    values[:, AXES] = np.log(0.6 * count ** (-1 / 3))
    values[:, 6] = 1
    values[:, PAINT] = generator.uniform((0.3, 0.3, 0.3, 0.1), (0.7, 0.7, 0.7, 0.3), (count, 4))
    return values


def rotations(quaternions: Floats) -> Floats:
    """(N, 3, 3) of quaternions (N, 4) of any length."""
    w, x, y, z = (quaternions / np.maximum(np.linalg.norm(quaternions, axis=-1, keepdims=True), 1e-6)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def render(values: Floats, view: Floats, side: int, layers: int) -> tuple[Floats, NDArray[np.int32]]:
    """(P, 3) picture before black, and (P, layers) splats that make up each pixel; `view` turns the scene (3, 3).

    A Gaussian in space is projected as one in the plane, by the derivative of the projection at its centre (Zwicker et
    al. 2001, EWA Volume Splatting).
    """
    eye = values[:, POSITION] @ view.T
    depth = DISTANCE - eye[:, 2]
    focal = side / (2 * SLOPE) / depth
    centers = focal[:, None] * eye[:, :2] + side / 2
    slopes = np.zeros((len(values), 2, 3), np.float32)
    slopes[:, 0, 0] = slopes[:, 1, 1] = focal
    slopes[:, :, 2] = focal[:, None] * eye[:, :2] / depth[:, None]
    axes = (slopes @ view) @ (rotations(values[:, TURN]) * np.exp(values[:, None, AXES]))
    across, mixed, up = ((axes[:, i] * axes[:, j]).sum(-1) for i, j in ((0, 0), (0, 1), (1, 1)))
    across, up = across + BLUR, up + BLUR
    conics = np.stack([up, -mixed, across], -1) / (across * up - mixed * mixed)[:, None]
    image, shown = raster.splats(centers, conics, np.ascontiguousarray(values[:, PAINT]), depth, (side, side), layers)
    return image[..., :3].reshape(-1, 3), shown.reshape(side * side, layers)


# ---- What is wanted ----


def scene(views: Floats, side: int, scale: int = 4) -> Floats:
    """(views, P, 3): a knot, painted with a noise and lit from above, supersampled."""
    mesh, normals = meshes.bumpy_knot()
    points, across = mesh.positions.numpy(), normals.numpy()
    hue = textures.fractal_noise(points, 1.5, 6, 0.6, seed=3)
    paint = 0.6 + 0.35 * np.sin(np.stack([4 * hue, 4 * hue + 1.5, 5 * hue + 3], -1))
    colors = (paint * (0.55 + 0.45 * across[:, 1:2])).astype(np.float32)
    matrix = camera.projection(SLOPE).numpy()
    pictures = []
    for view in views:
        eye = np.pad(points @ view.T - [0, 0, DISTANCE], ((0, 0), (0, 1)), constant_values=1).astype(np.float32)
        rast, _ = raster.rasterize(None, (eye @ matrix.T)[None], mesh.triangles.numpy(), (side * scale, side * scale))
        fine, _ = raster.interpolate(colors[None], rast, mesh.triangles.numpy())
        pictures.append(fine.reshape(side, scale, side, scale, 3).mean((1, 3)).reshape(-1, 3))
    return np.stack(pictures)


# ---- Splitting ----


def credits(values: Floats, views: Sequence[tuple[Floats, Floats]], side: int, layers: int) -> Floats:
    """(N,): the square of the light that is missing in the pixels that show each splat; 0 where none does.

    Where there is too much light, as in a haze before nothing, more splats are of no use.
    """
    found = np.zeros(len(values) + 1, np.float32)  # the last is for places of lists that hold none
    for view, wanted in views:
        image, shown = render(values, view, side, layers)
        error = np.square(np.maximum(wanted - image, 0)).sum(-1) + 1e-9
        found += np.bincount(shown.ravel() % len(found), error.repeat(layers), len(found)).astype(np.float32)
    return found[:-1]


def divided(values: Floats, credit: Floats, count: int, generator: np.random.Generator) -> Floats:
    """`count` splats in place of others.

    Faint and unseen splats are dropped. Others are drawn by their credit, and who is drawn k times becomes k + 1 parts
    in a row along its longest axis.
    """
    kept = np.flatnonzero((values[:, 13] >= LEAST_OPACITY) & (credit > 0))
    if not len(kept):
        return start(count, generator)
    drawn = generator.choice(len(kept), max(count - len(kept), 0), p=credit[kept] / credit[kept].sum())
    parts = 1 + np.bincount(drawn, minlength=len(kept))
    parents = kept.repeat(parts)
    of = parts.repeat(parts)
    place = np.arange(len(parents)) - (np.cumsum(parts) - parts).repeat(parts)
    found = values[parents]
    longest = found[:, AXES].argmax(-1)
    rows = np.arange(len(parents))
    direction = rotations(found[:, TURN])[rows, :, longest]
    length = np.exp(found[rows, 3 + longest])
    offset = 1.2 * length * ((2 * place + 1) / of - 1) * (of > 1)
    found[:, POSITION] += offset[:, None] * direction
    found[rows, 3 + longest] -= np.where(of > 1, np.log(of / 1.2), 0)
    return found


# ---- Fitting ----


class Fit:
    """Pictures of the scene, and splats on their way to them."""

    def __init__(self, settings: Settings) -> None:
        self.settings, self.generator = settings, np.random.default_rng(settings.seed)
        turns = rotations(self.generator.normal(size=(settings.views + settings.test_views, 4)).astype(np.float32))
        self.train, self.test = turns[: settings.views], turns[settings.views :]
        self.tests = scene(self.test, settings.side)
        self.pictures: dict[int, list[tuple[Floats, Floats]]] = {}

    def wanted(self, side: int) -> list[tuple[Floats, Floats]]:
        """Views, and the pictures of them."""
        if side not in self.pictures:
            self.pictures[side] = list(zip(self.train, scene(self.train, side), strict=True))
        return self.pictures[side]

    def psnr(self, values: Floats) -> float:
        """Over the sides that nobody showed, in dB."""
        s = self.settings
        shown = np.stack([render(values, view, s.side, 0)[0] for view in self.test])
        return psnr(shown, self.tests)

    def stages(self) -> list[tuple[int, int]]:
        """Splats, and side of the pictures, of each stage: both grow by factors, and are whole for the last third."""
        s, found = self.settings, []
        doublings = max(round(np.log2(s.side / s.first_side)), 0)
        for stage in range(s.stages):
            share = min(1.5 * stage / max(s.stages - 1, 1), 1)
            count = s.first_splats * (s.splats / s.first_splats) ** share
            found.append((round(count), s.side >> (doublings - int(doublings * share))))
        return found

    def descend(self, values: Floats, side: int, seconds: float) -> None:
        """`steps` of Adam, or as many as take some seconds of the processor; their rate falls to a tenth."""
        s, wanted = self.settings, self.wanted(side)

        def shown(view: Floats, given: Mapping[str, Floats]) -> Shown:
            image, layers = render(given["splats"], view, side, s.layers)
            return Shown(image, {"splats": layers})

        descent = Descent({"splats": Group(values, channels(side))}, int(self.generator.integers(2**31)))
        began, share = time.process_time(), 0.0
        while share < 1:
            chosen = self.generator.choice(len(wanted), s.estimates)
            descent.step([(partial(shown, wanted[i][0]), wanted[i][1]) for i in chosen], 0.1**share)
            spent = (time.process_time() - began) / seconds
            share = spent if math.isfinite(seconds) else descent.estimates / (s.steps * s.estimates)

    def run(self, stages: Sequence[tuple[int, int]], seconds: float = math.inf) -> tuple[Floats, list[Stage]]:
        """What the stages, of some seconds each, end with, and how each of them ended."""
        s, found, spent = self.settings, [], 0.0
        values = start(stages[0][0], self.generator)
        for number, (count, side) in enumerate(stages):
            wanted, began = self.wanted(side), time.process_time()
            if number > 0:
                credit = credits(values, wanted[:SHOWN_FOR_CREDIT], side, s.layers)
                values = divided(values, credit, count, self.generator)
            self.descend(values, side, seconds)
            spent += time.process_time() - began
            found.append(Stage(count, side, spent, self.psnr(values)))
        return values, found


def thumbnail(image: Floats, side: int) -> Floats:
    """About 128 pixels a side, top row first, of a picture (P, 3)."""
    factor = max(side // 128, 1)
    kept = side // factor
    blocks = image.reshape(side, side, 3)[: kept * factor, : kept * factor].reshape(kept, factor, kept, factor, 3)
    return np.asarray(report.enlarged(blocks.mean((1, 3))[::-1], 128))


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = parse(__doc__, Settings(), FULL, arguments)
    log = report.Report("splats", settings, folder)
    fit = Fit(settings)
    heads = ["stage", "splats", "pictures", "processor", "pictures from other sides", "flat, after as long"]
    at_first = start(settings.first_splats, np.random.default_rng(settings.seed))
    values, grown = fit.run(fit.stages())
    log.add(f"hierarchy: {grown[-1].psnr:.1f} dB", hierarchy=grown)
    seconds = grown[-1].seconds / settings.stages
    other, flat = fit.run([(settings.splats, settings.side)] * settings.stages, seconds)
    log.add(f"flat: {flat[-1].psnr:.1f} dB", flat=flat)
    rows = []
    for number, each in enumerate(grown, 1):
        beside = np.interp(each.seconds, [0, *(one.seconds for one in flat)], [math.nan, *(one.psnr for one in flat)])
        cells = [f"{each.splats:,}", f"{each.side} x {each.side}", f"{each.seconds:.0f} s", f"{each.psnr:.1f} dB"]
        rows.append([str(number), *cells, "" if math.isnan(beside) else f"{beside:.1f} dB"])
    log.table(heads, rows)
    pictures = []
    for view, wanted in zip(fit.test[:3], fit.tests, strict=False):
        shown = [wanted, *(render(each, view, settings.side, 0)[0] for each in (at_first, values, other))]
        pictures.append([thumbnail(image, settings.side) for image in shown])
    log.save(report.mosaic(pictures))


if __name__ == "__main__":
    main()
