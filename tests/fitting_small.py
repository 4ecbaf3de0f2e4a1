"""A small set, a renderer of a few lines, and fits of a few steps in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mipbake import MipStack, TextureSet
from mipbake.fitting import Frame, Levels, fit
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.references import Supersampled
from mipbake.material.pixel_filter import filter_named

from .independent_scenes import bilinear
from .viewer_scenes import material, stack_of

SIDE = 8
REPEATS = ("wrap", "wrap")
KERNEL = filter_named("gaussian")


@dataclass(frozen=True, eq=False)
class Spot:
    """A view of `Plain`: so many pixels, each as large as a texel of a level."""

    name: str
    level: int
    side: int = SIDE
    offset: tuple[float, float] = (0.0, 0.0)

    @property
    def scale(self) -> str:
        return f"level {self.level}"

    def moved(self, right: float, up: float) -> Spot:
        return replace(self, offset=(self.offset[0] + right, self.offset[1] + up))


@dataclass(eq=False)
class Plain:
    """Looks one level up bilinearly, and multiplies maps, so that means of maps do not show means of pictures.

    Args:
        damaged: makes another frame of each frame, from it and how many there were before.
        log: the names of views, as they were rendered.
    """

    damaged: Callable[[Frame, int], Any] = lambda frame, _count: frame
    log: list[str] = field(default_factory=list)

    def render(self, levels: Levels, view: Spot) -> Any:
        height, width = levels.sizes[0]
        right, up = view.offset
        rows, columns = np.meshgrid(np.arange(view.side) + 0.5 - up, np.arange(view.side) + 0.5 + right, indexing="ij")
        uv = np.stack([columns / width, rows / height], -1) * 2**view.level
        level = min(view.level, len(levels.sizes) - 1)
        colour, metallic, roughness, normal = (
            bilinear(levels.maps[name][level].astype(np.float64), uv)
            for name in ("base_color", "metallic", "roughness", "normal")
        )
        image = np.square(colour) * (0.2 + roughness) * (0.3 + normal[..., :1]) + 0.1 * metallic * normal[..., 1:2]
        frame = Frame(image, uv.astype(np.float32), lod=np.full(uv.shape[:2], level, np.float32))
        self.log.append(view.name)
        return self.damaged(frame, len(self.log) - 1)


def texture_set(side: int = SIDE) -> TextureSet:
    stored = material("gltf", side, side)
    return TextureSet.from_arrays(
        "small", base_color=stored[..., :3], metallic=stored[..., 3], roughness=stored[..., 4], normal=stored[..., 5:]
    )


def spots(each: int = 5, levels: Sequence[int] = (0, 1, 2, 3)) -> list[Spot]:
    """Views whose pixels are as large as texels of a level, at places of their own. One in five is held out."""
    rng = np.random.default_rng(1)
    return [
        Spot(f"spot {number} of level {level}", level, offset=(float(rng.uniform(0, 8)), float(rng.uniform(0, 8))))
        for level in levels
        for number in range(each)
    ]


def start(side: int = SIDE) -> MipStack:
    """Averaged levels of the small set."""
    return stack_of(material("gltf", side, side), "gltf")


def fitted(renderer: Any = None, views: Sequence[Any] | None = None, stack: MipStack | None = None, **more: Any) -> Any:
    """A fit of the small set in a few steps, without rounds of least squares."""
    settings = {"steps": 96, "passes": 16, "rounds": 0} | more
    if "reference" not in settings:
        settings["source"] = texture_set()
    found = spots() if views is None else views
    return fit(stack or start(), Plain() if renderer is None else renderer, found, **settings)


def same(first: MipStack, second: MipStack) -> bool:
    """Bit for bit."""
    return all(a.tobytes() == b.tobytes() for a, b in zip(first.levels, second.levels, strict=True))


def levels_of(stack: MipStack) -> Levels:
    parameters = Parameters.of(stack.model, *stack.size, len(stack.levels))
    return parameters.levels(parameters.values(list(stack.levels)), stack.wrap)


def source_levels(texture: TextureSet) -> Levels:
    parameters = Parameters.of("gltf", texture.height, texture.width, 1)
    return parameters.levels(parameters.values([texture.material("gltf")]), texture.wrap)


def supersampled(renderer: Any, source: Levels, view: Any, passes: int, seed: int = 0, whole: bool = True) -> Any:
    """(H, W, 3) the mean of so many renders of the source."""
    found = Supersampled(renderer, source, view, KERNEL, seed, whole)
    found.refine(passes)
    return found.halves().mean(0)


def error(stack: MipStack, renderer: Any, view: Any, wanted: np.ndarray) -> float:
    """Squared error of a view, as a share of the reference's sum of squares."""
    image = renderer.render(levels_of(stack), view).image
    return float(np.square(image - wanted).sum() / np.square(wanted).sum())
