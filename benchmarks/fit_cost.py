"""What a step of a fit costs, by its parts: for images of several sizes, and for stacks of which the same part shows.

    python benchmarks/fit_cost.py [--renderers trivial torch gl]

The renderer `trivial` looks one texel up for each pixel, so that what the fit itself costs is told apart. `perturb`,
`credit` and `descend` call the doors of `mipbake.stochastic` as a step does. `render` is half of the two renders of a
step, with texels that are new in them, and `others` is all that `mipbake.fitting.fit` does between the renders of two
steps. `check` is what it does around the renders of a check, which comes once a round over the views. All are medians.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from timing import cpu_name, measure

from mipbake import stochastic
from mipbake.comparing.meshes.camera import Camera
from mipbake.comparing.meshes.shapes import plane
from mipbake.fitting import Frame, Levels, View, fit
from mipbake.fitting.kernels import TorchRenderer
from mipbake.fitting.named import RendererChoice
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.renderer import new_stamps
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.environment import directional
from mipbake.stack.stack import MipStack, Provenance

PIXELS = (64, 128, 256, 512)
"""Sides of images, of a stack of `STACK` texels a side, all of them at level of detail 0."""

STACK = 512

TEXELS = (256, 512, 1024, 2048)
"""Sides of stacks, of which a view of `WINDOW` pixels a side shows as many texels of level 0."""

WINDOW = 128

STEPS, CHECKED = 24, 8  # steps of a fit, and pixels a side of the view that it checks with
ROUNDS = 15  # of the doors

Array = NDArray[np.float32]


@dataclass(eq=False)
class Trivial:
    """Shows the base colour of the nearest texel of level 0, times the metallic, roughness and slope there."""

    _at: dict[View, tuple[Array, NDArray[np.intp], NDArray[np.intp]]] = field(default_factory=dict)

    def render(self, levels: Levels, view: View) -> Frame:
        height, width = levels.sizes[0]
        if view not in self._at:
            rows, columns = (np.arange(n) for n in view.size)
            x, y = np.meshgrid((columns + 0.5) / width, (rows + 0.5) / height)
            uv = np.stack([x, y], -1).astype(np.float32)
            self._at[view] = uv, (y * height).astype(np.intp) % height, (x * width).astype(np.intp) % width
        uv, i, j = self._at[view]
        parts = [levels.maps[name][0][i, j] for name in ("metallic", "roughness", "normal")]
        image = levels.maps["base_color"][0][i, j] * (parts[0] + parts[1] + parts[2][..., :1])
        return Frame(image, uv, lod=np.zeros(view.size, np.float32))


@dataclass(eq=False)
class Clocked:
    """A renderer, and when it began and ended what: (view, begin, end)."""

    renderer: Any
    log: list[tuple[View, float, float]] = field(default_factory=list)

    def render(self, levels: Levels, view: View) -> Frame:
        begin = time.perf_counter()
        frame: Frame = self.renderer.render(levels, view)
        self.log.append((view, begin, time.perf_counter()))
        return frame


RENDERERS: dict[str, Callable[[], Any]] = {
    "trivial": Trivial,
    "torch": TorchRenderer,
    "gl": RendererChoice("gl", "clearcoat").made,
}


def stack_of(side: int) -> MipStack:
    """A stack of `gltf`, of random values."""
    rng = np.random.default_rng(0)
    levels = []
    for height, width in level_sizes(side, side):
        level = rng.uniform(0.3, 0.7, (height, width, 8)).astype(np.float32)
        level[..., 5:7] = (level[..., 5:7] - 0.5) * 0.2
        level[..., 7] = np.sqrt(1 - np.square(level[..., 5:7]).sum(-1))
        levels.append(level)
    return MipStack("random", "gltf", levels, {}, ("wrap", "wrap"), Provenance("linear", "gaussian"))


def view_of(pixels: int, stack: int, place: tuple[float, float] = (0.5, 0.5)) -> View:
    """A view from above, of as many texels of level 0 as it has pixels; `place` is where, from 0 to 1 along u and v."""
    shown = 4.0  # units of the world
    side = shown * stack / pixels
    x, z = ((side - shown) * (each - 0.5) for each in place)
    # The camera is 2 above the plane, and sees 45 degrees to each side.
    camera = Camera((x, shown / 2, z), (x, 0.0, z), up=(0.0, 0.0, -1.0), field_of_view=90.0)
    light = directional("lights", [[0.3, 1.0, 0.2], [-0.4, 0.8, -0.3]], [[2.0, 2.0, 2.0], [1.0, 1.0, 1.0]])
    return View(f"{pixels} pixels", "near", plane(side, side), camera, light, (pixels, pixels))


@dataclass(frozen=True)
class Cost:
    """Seconds of each part of a step."""

    perturb: float
    credit: float
    descend: float
    render: float
    others: float
    check: float


def cost(renderer: Any, pixels: int, stack_side: int) -> Cost:
    """What a step costs with a view of `pixels` a side of a stack of `stack_side` texels a side."""
    stack, view = stack_of(stack_side), view_of(pixels, stack_side)
    clocked = Clocked(renderer)
    # One round of as many steps, each at a place of its own: a renderer also gets back what the step before has moved.
    places = np.random.default_rng(0).random((STEPS, 2)).tolist()
    views = [view_of(pixels, stack_side, (u, v)) for u, v in places]
    checked = view_of(CHECKED, stack_side)
    fit(
        stack, clocked, views, reference=lambda each: np.full((*each.size, 3), 0.5, np.float32), held_out=[checked],
        steps=STEPS,
    )  # fmt: skip
    doors = _doors(renderer, stack, view)
    render, others, check = _between(clocked.log, checked)
    return Cost(doors["perturb"], doors["credit"], doors["descend"], render, others, check)


def _between(log: Sequence[tuple[View, float, float]], checked: View) -> tuple[float, float, float]:
    """Seconds of a render, of what lies between the renders of two steps, and of what lies around a check's renders.

    A render is the mean of both of a step, because the first one also uploads what the step before has changed.
    """
    # Preparing renders every view once, and a probe four times; a check follows, then the steps, then a check.
    first = next(i for i, (view, *_) in enumerate(log) if view is checked and i > STEPS + 1) + 1
    steps = log[first : first + 2 * STEPS]
    assert len(steps) == 2 * STEPS and not any(view is checked for view, *_ in steps)
    renders = [(b[2] - b[1] + a[2] - a[1]) / 2 for a, b in zip(steps[2::2], steps[3::2], strict=True)]
    others = [steps[i + 1][1] - steps[i][2] for i in range(1, len(steps) - 1, 2)]
    around = log[first + 2 * STEPS][1] - steps[-1][2] + log[first + 2 * STEPS + 1][1] - log[first + 2 * STEPS][2]
    return statistics.median(renders), statistics.median(others), around


def _doors(renderer: Any, stack: MipStack, view: View) -> dict[str, float]:
    """Seconds of the doors that a step calls."""
    parameters = Parameters.of(stack.model, *stack.size, len(stack.levels))
    values, channels = parameters.values(list(stack.levels)), parameters.channels
    frame = renderer.render(parameters.levels(values, stack.wrap, new_stamps(parameters.sizes)), view)
    count = view.size[0] * view.size[1]
    uv, lod = (np.asarray(each, np.float32).reshape(count, -1) for each in (frame.uv, frame.lod))
    found = stochastic.contributions(stochastic.touched_texels(parameters.sizes, uv, lod.reshape(count)))
    elements = np.asarray(found.elements)
    sides, gradient, moments = (values.copy(), values.copy()), np.zeros_like(values), stochastic.Moments.of(values)
    image, other = (np.full((count, 3), value, np.float32) for value in (0.4, 0.5))

    def credit() -> None:
        differences = stochastic.pixel_differences(image, other, other)
        stochastic.add_gradient(gradient, differences, found, channels, 1)

    timed = measure(
        {
            "perturb": lambda: stochastic.perturb(values, channels, 1, 0, elements, sides),
            "credit": credit,
            "descend": lambda: stochastic.descend(values, gradient, moments, channels, 1.0, elements),
        },
        ROUNDS,
    )
    return {name: each.median for name, each in timed.items()}


def printed(title: str, rows: Sequence[tuple[str, str, Cost]]) -> str:
    """Markdown."""
    heads = ["renderer", title, "perturb", "credit", "descend", "render", "others", "check"]
    lines = [f"| {' | '.join(heads)} |", f"| {' | '.join(['---'] * len(heads))} |"]
    for renderer, what, found in rows:
        parts = (found.perturb, found.credit, found.descend, found.render, found.others, found.check)
        lines.append(f"| {renderer} | {what} | {' | '.join(f'{1e3 * each:.2f} ms' for each in parts)} |")
    return "\n".join(lines)


def main() -> None:
    """Prints both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--renderers", nargs="+", choices=RENDERERS, default=list(RENDERERS))
    options = parser.parse_args()
    by_pixels, by_stack = [], []
    with ExitStack() as stack:
        for name in options.renderers:
            renderer = RENDERERS[name]()
            if hasattr(renderer, "close"):
                stack.enter_context(closing(renderer))
            by_pixels += [(name, f"{n} x {n}", cost(renderer, n, STACK)) for n in PIXELS]
            by_stack += [(name, f"{n} x {n}", cost(renderer, WINDOW, n)) for n in TEXELS]
    print(f"Images of a stack of {STACK} x {STACK} texels, every pixel a texel, on {cpu_name()}:\n")
    print(printed("pixels", by_pixels))
    print(f"\nStacks, of which a view of {WINDOW} x {WINDOW} pixels shows as many texels:\n")
    print(printed("texels", by_stack))


if __name__ == "__main__":
    main()
