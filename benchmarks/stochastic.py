"""Figure 3 of Deliot, Heitz and Belcour 2024 at a CPU's size: soups of triangles become a picture. Prints Markdown.

    python benchmarks/stochastic.py [--steps 0]
    python benchmarks/stochastic.py --many 10240

Errors of pixels are credited to the triangles that the pixels show (equation 8), or the error of the whole image is
credited to all triangles (equation 4). Both ways take as many renders. A soup of transparent triangles goes through a
deep buffer of triangles (section 4.4). A second table is the paper's table 3: what each part of a step takes.
`--steps` takes so many steps of every soup in place of its own. `--many` takes the paper's largest soup alone, and so
many estimates in all, of which 8, 32 or 128 make a step (N of equation 9). Seconds are those of the processor, of all
threads together, which other processes do not disturb.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from timing import arguments, cpu_name, table

from mipbake import _native, raster, stochastic
from mipbake.stochastic import Channels, Descent, Group, Moments, Shown

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

CREDITS = ("per pixel", "full image")
"""Equation 8, and equation 4."""


@dataclass(frozen=True)
class Soup:
    """What is optimised, and how.

    Args:
        triangles: their number; each has 3 vertices in 3D and a colour, 12 parameters.
        side: pixels of the square image in each direction.
        steps: of Adam.
        estimates: of the gradient for each step, N of equation 9; each takes two renders.
        layers: 1 where triangles are opaque; else they have an opacity too, and so many layers are blended.
    """

    triangles: int
    side: int
    steps: int
    estimates: int
    layers: int = 1

    @property
    def parameters(self) -> int:
        return self.triangles * (12 if self.layers == 1 else 13)

    @property
    def channels(self) -> Channels:
        """A vertex moves by 1.5 pixels, between the paper's 1 and 2. The other steps are guesses, in which a hundred
        steps of Adam can cross the range: 1/50 of a depth, a colour or an opacity."""
        pixel = 2 / self.side
        place = ((1.5 * pixel, 1.5 * pixel, 0.02), (-1.1, -1.1, -0.95), (1.1, 1.1, 0.95))
        colour = 3 if self.layers == 1 else 4
        return Channels(
            (*place[0] * 3, *(0.02,) * colour), (*place[1] * 3, *(0.0,) * colour), (*place[2] * 3, *(1.0,) * colour)
        )

    def drawn(self, count: int, generator: np.random.Generator) -> Floats:
        """Triangles at random places, 1.5 of them above a pixel (a guess), in random colours."""
        centre = generator.uniform(-1, 1, (count, 1, 2))
        turn = generator.uniform(0, math.tau, (count, 1)) + np.array([0, 1, 2]) * (math.tau / 3)
        # An equilateral triangle has 1.3 times the square of its radius for an area.
        radius = math.sqrt(4 * 1.5 / self.triangles / 1.3)
        corners = centre + radius * np.stack([np.cos(turn), np.sin(turn)], -1)
        depth = generator.uniform(-0.9, 0.9, (count, 1, 1)).repeat(3, 1)
        places = np.concatenate([corners, depth], -1).reshape(count, 9)
        colours = generator.uniform(0.2, 0.8, (count, 3 if self.layers == 1 else 4))
        return np.concatenate([places, colours], 1).astype(np.float32)


SOUPS: Mapping[str, Soup] = {
    "1K triangles": Soup(1_000, 256, 150, 8),
    "10K triangles": Soup(10_000, 256, 100, 8),
    "100K triangles": Soup(100_000, 512, 25, 8),
    "500 transparent, 6 layers": Soup(500, 128, 60, 8, layers=6),
}
"""Numbers of steps are guesses, for some minutes in all. The paper has 128 estimates for each step."""

LARGEST, ESTIMATES = "100K triangles", (8, 32, 128)
"""What `--many` fits, and how many estimates make a step."""

PAPER: Mapping[str, tuple[float, float, float, float, float]] = {
    "1K triangles": (0.012, 0.028, 0.013, 0.021, 6.8),
    "10K triangles": (0.014, 0.038, 0.014, 0.021, 8.4),
    LARGEST: (0.054, 0.126, 0.035, 0.105, 27),
}
"""Table 3: milliseconds of P, R and G for each of 128 estimates, of D, and of a step, on an RTX 4090."""


def picture(side: int) -> Floats:
    """(side, side, 3), rows bottom up: hills before an evening sky, a sun, a lake and a striped tower."""
    across, up = np.meshgrid((np.arange(side) + 0.5) / side, (np.arange(side) + 0.5) / side)
    image = np.stack([0.95 - 0.6 * up, 0.55 - 0.25 * up + 0.1 * np.sin(9 * across), 0.35 + 0.4 * up], -1)
    sun = np.hypot(across - 0.68, up - 0.7)
    image += np.exp(-((sun / 0.16) ** 2))[..., None] * [0.5, 0.35, 0.1]
    image[sun < 0.07] = [1, 0.95, 0.7]
    for index, height in enumerate((0.5, 0.4, 0.28)):
        ridge = height + 0.06 * np.sin((5 + 3 * index) * across + index) + 0.02 * np.sin(31 * across + 5 * index)
        shade = np.array([[0.35, 0.3, 0.5], [0.2, 0.3, 0.35], [0.08, 0.2, 0.15]][index])
        texture = 1 + 0.25 * np.sin(60 * across + 40 * up) * np.sin(47 * up - 20 * across)
        image = np.where((up < ridge)[..., None], shade * texture[..., None], image)
    lake = ((across - 0.3) / 0.25) ** 2 + ((up - 0.12) / 0.07) ** 2 < 1
    image[lake] = np.stack([0.4 + 0.3 * np.sin(90 * up), 0.5 + 0.2 * np.sin(90 * up), 0.6 + 0 * up], -1)[lake]
    tower = (np.abs(across - 0.85) < 0.04) & (up > 0.15) & (up < 0.62)
    image[tower] = np.where((np.mod(up * 14, 1) < 0.5)[..., None], [0.9, 0.9, 0.85], [0.7, 0.15, 0.1])[tower]
    return np.clip(image, 0, 1).astype(np.float32)


def psnr(image: Floats, wanted: Floats) -> float:
    """In dB, of values whose peak is 1."""
    return float(-10 * np.log10(np.square(image - wanted, dtype=np.float64).mean()))


class SoupRenderer:
    """Renders soups. It only renders: an image, and which triangles each pixel shows."""

    def __init__(self, soup: Soup) -> None:
        self.soup = soup
        self.context = raster.RasterizeContext()
        self.triangles = np.arange(3 * soup.triangles, dtype=np.int32).reshape(-1, 3)

    def render(self, values: Floats) -> tuple[Floats, Ints]:
        """(P, 3) image before black, and (P, layers) triangles, -1 for none."""
        pos = np.ones((1, 3 * self.soup.triangles, 4), np.float32)
        pos[0, :, :3] = values[:, :9].reshape(-1, 3)
        layers = []
        with raster.DepthPeeler(self.context, pos, self.triangles, (self.soup.side, self.soup.side)) as peeler:
            for _ in range(self.soup.layers):
                rast, _ = peeler.rasterize_next_layer()
                layers.append(rast[..., 3].reshape(-1).astype(np.int32) - 1)
        ids = np.stack(layers, -1)
        return self._blended(values, ids), ids

    def _blended(self, values: Floats, ids: Ints) -> Floats:
        paint = np.concatenate([values[:, 9:], np.zeros_like(values[:1, 9:])])  # the last, -1, is none
        if self.soup.layers == 1:
            return paint[ids[:, 0]]
        image, through = np.zeros((len(ids), 3), np.float32), np.ones((len(ids), 1), np.float32)
        for layer in ids.T:
            own = paint[layer]
            image += through * own[:, 3:] * own[:, :3]
            through *= 1 - own[:, 3:]
        return image


Curve = list[tuple[int, float, float]]
"""(renders, seconds of the processor, PSNR) on the way."""


def after(curve: Curve, number: float, column: int) -> float:
    """PSNR after a number of renders (column 0) or seconds (column 1)."""
    return float(np.interp(number, [each[column] for each in curve], [each[2] for each in curve]))


def fit(soup: Soup, credit: str, seed: int = 0, measured: int = 20) -> Curve:
    """Optimises a soup from random triangles.

    Args:
        credit: one of CREDITS.
        measured: how often the PSNR is measured on the way; the clock stands still meanwhile.
    """
    generator, renderer = np.random.default_rng(seed), SoupRenderer(soup)
    wanted = picture(soup.side).reshape(-1, 3)
    values = soup.drawn(soup.triangles, generator)
    descent = Descent({"soup": Group(values, soup.channels)}, seed)

    def shown(given: Mapping[str, Floats]) -> Shown:
        image, ids = renderer.render(given["soup"])
        return Shown(image, {"soup": ids if credit == CREDITS[0] else None})

    curve = [(0, 0.0, psnr(renderer.render(values)[0], wanted))]
    measuring, began = 0.0, time.process_time()
    for step in range(soup.steps):
        descent.step([(shown, wanted)] * soup.estimates)
        resample(soup, values, descent.moments["soup"], generator)
        if (step + 1) * measured // soup.steps > step * measured // soup.steps:
            stopped = time.process_time()
            image = renderer.render(values)[0]
            curve.append(((step + 1) * soup.estimates * 2, stopped - began - measuring, psnr(image, wanted)))
            measuring += time.process_time() - stopped
    return curve


def resample(soup: Soup, values: Floats, moments: Moments, generator: np.random.Generator) -> None:
    """Triangles of less than half a pixel (a guess) begin again at another place, in their colour (section 5)."""
    a, b, c = (values[:, 3 * corner : 3 * corner + 2] for corner in range(3))
    (x, y), (s, t) = (b - a).T, (c - a).T
    thin = np.flatnonzero(np.abs(x * t - y * s) / 2 < 0.5 * (2 / soup.side) ** 2)
    values[thin, :9] = soup.drawn(len(thin), generator)[:, :9]
    arrays: tuple[Any, ...] = (moments.first, moments.second, moments.steps)
    for array in arrays:
        array[thin] = 0


def row(name: str, soup: Soup) -> list[str]:
    """A line of the table: both ways of crediting."""
    own, whole = (fit(soup, credit) for credit in CREDITS)
    equal = min(curve[-1][1] for curve in (own, whole))
    ends = (f"{curve[-1][2]:.1f} dB" for curve in (own, whole))
    both = ", ".join(f"{after(curve, equal, 1):.1f} dB" for curve in (own, whole))
    renders, first = own[-1][0], own[0][2]
    return [name, f"{soup.parameters:,}", f"{renders:,}", f"{first:.1f} dB", *ends, f"{equal:.0f} s: {both}"]


def parts(soup: Soup, rounds: int = 7) -> tuple[float, float, float, float]:
    """Milliseconds of the parts of table 3, medians: P, R and G of an estimate (R is two renders), D of a step."""
    renderer, channels = SoupRenderer(soup), soup.channels
    wanted, values = picture(soup.side).reshape(-1, 3), soup.drawn(soup.triangles, np.random.default_rng(0))
    gradient, moments, sides = np.zeros_like(values), Moments.of(values), (values.copy(), values.copy())
    found: list[list[float]] = []
    for number in range(rounds):
        clock = [time.process_time()]
        stochastic.perturb(values, channels, number, 0, None, sides)
        clock.append(time.process_time())
        (plus, of_plus), (minus, of_minus) = (renderer.render(side) for side in sides)
        clock.append(time.process_time())
        differences = stochastic.pixel_differences(plus, minus, wanted)
        made_of = stochastic.contributions(np.concatenate([of_plus, of_minus], 1))
        stochastic.add_gradient(gradient, differences, made_of, channels, number)
        clock.append(time.process_time())
        stochastic.descend(values, gradient, moments, channels, 1.0, made_of.elements)
        clock.append(time.process_time())
        found.append([1e3 * (after - before) for before, after in pairwise(clock)])
    perturbing, rendering, crediting, descending = (median(each) for each in zip(*found, strict=True))
    return perturbing, rendering, crediting, descending


def parts_table(soups: Mapping[str, Soup]) -> str:
    """Table 3, and the paper's lines of it."""
    rows = []
    for name, soup in soups.items():
        measured = parts(soup)
        whole = sum(measured[:3]) * soup.estimates + measured[3]
        lines = [(name, measured, soup.estimates, whole)]
        if name in PAPER:
            lines.append(("the paper, RTX 4090", PAPER[name][:4], 128, PAPER[name][4]))
        for who, each, count, total in lines:
            cells = [f"{number:.3g} ms (x {count})" for number in each[:3]]
            rows.append([who, *cells, f"{each[3]:.3g} ms", f"{float(f'{total:.3g}'):g} ms"])
    return table(["a step per pixel", "P", "R", "G", "D", "sum"], rows)


def many_table(estimates: int) -> str:
    """PSNR of the largest soup on the way, by how many estimates make a step; all have as many renders."""
    soup, rows, shares = SOUPS[LARGEST], [], (1 / 8, 1 / 4, 1 / 2, 1)
    for count in ESTIMATES:
        steps = max(estimates // count, 1)
        curve = fit(dataclasses.replace(soup, estimates=count, steps=steps), CREDITS[0])
        ends = [f"{after(curve, 2 * estimates * share, 0):.1f} dB" for share in shares]
        rows.append([f"{soup.parameters:,}", str(count), f"{steps:,}", *ends, f"{curve[-1][1]:,.0f} s"])
    renders = [f"{2 * estimates * share:,.0f} renders" for share in shares]
    return table(["parameters", "N", "steps", *renders, "processor"], rows)


def main() -> None:
    options = arguments(__doc__, steps=0, many=0)
    print(f"{cpu_name()}, {_native.isa()}; {_native.num_threads()} threads\n", flush=True)
    if options.many:
        print(many_table(options.many))
        return
    heads = ["soup", "parameters", "renders", "at first", *CREDITS, "both after as many seconds"]
    soups = {name: dataclasses.replace(soup, steps=options.steps or soup.steps) for name, soup in SOUPS.items()}
    print(table(heads, [row(name, soup) for name, soup in soups.items()]), flush=True)
    print(f"\n{parts_table(soups)}")


if __name__ == "__main__":
    main()
