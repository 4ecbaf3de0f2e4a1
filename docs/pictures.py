"""What pictures of pages share: the stacks that the README compares, spheres, and grids of pictures with words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import mipbake
from mipbake.comparing.meshes import mesh_render
from mipbake.comparing.meshes.mesh_render import Frame, Reference
from mipbake.comparing.scenes import View, standard_views
from mipbake.quality import environment
from mipbake.quality.metrics.images import displayed
from mipbake.source.texture_set import TextureSet
from mipbake.stack.stack import MipStack

SET = Path(__file__).resolve().parent.parent / "examples" / "lacquered_leather"
PLAIN, BAKED, REFERENCE = "plain MIP maps", "mipbake", "truth"
GAP, HEAD, LINE, LEFT = 6, 24, 15, 118  # pixels

LETTERS = 22
"""Of the README's pictures, in pixels: they are read on phones, too."""

GROUND = (13, 17, 23)  # the colour of GitHub's dark pages; on light ones the panel stands by itself
BRIGHT, DIM, GOOD = (230, 237, 243), (139, 148, 158), (86, 211, 100)

_RIM = 2.5  # pixels at the sphere's outline that are not shown: no pixel there lies wholly on the sphere
_FILLED = 0.94  # of the half height by the sphere's radius, as mipbake.comparing.scenes has it

Picture = NDArray[np.uint8]
"""(H, W, 3) sRGB, rows from the top."""


@lru_cache(maxsize=1)
def load() -> tuple[TextureSet, Mapping[str, MipStack]]:
    """The set, and the two stacks that are compared: averaged with the box, and mipbake's default."""
    texture_set = mipbake.load(SET)
    return texture_set, {
        PLAIN: mipbake.bake(texture_set, method="linear", pixel_filter="box"),
        BAKED: mipbake.bake(texture_set),
    }


def spheres(lighting: environment.Lighting, side: int) -> dict[str, View]:
    """The standard views of spheres, `side` pixels high and wide, by scale."""
    texture_set, stacks = load()
    size = (texture_set.height, texture_set.width)
    views = standard_views(size, lighting, len(stacks[BAKED].levels) - 1, (side, side))
    return {view.scale: view for view in views if view.view == "sphere"}


def turned(view: View, repeats: int, turns: float) -> View:
    """The sphere with its texture `repeats` times around, turned by `turns` of one repeat.

    A sphere looks the same from everywhere, so turning it is moving the texture along u.
    """
    uv = view.mesh.uv * (repeats / np.ptp(view.mesh.uv[:, 0])) + [turns, 0]
    return replace(view, mesh=replace(view.mesh, uv=uv))


def render(view: View, passes: int, resolved_share: float = 0.1) -> tuple[dict[str, Frame], Reference]:
    """The candidates of a view, and the reference: at most `passes` samples a pixel, until it resolves both."""
    texture_set, stacks = load()
    frames = {
        name: mesh_render.candidate(view, stack.levels, stack.model, texture_set.wrap) for name, stack in stacks.items()
    }
    kernel = stacks[BAKED].provenance.pixel_filter
    source = texture_set.filtered(kernel)
    return frames, mesh_render.reference(
        view, source, 0, list(frames.values()), resolved_share, min(32, passes), passes
    )


def shown(radiance: NDArray[np.float32]) -> Picture:
    """A sphere as displays show it (x / (1 + x), then sRGB), on the panel's ground, its outline antialiased."""
    side = len(radiance)
    y, x = np.mgrid[:side, :side] + 0.5 - side / 2
    cover = np.clip(_FILLED * side / 2 - _RIM - np.hypot(x, y) + 0.5, 0, 1)[..., None]
    mixed = cover * displayed(radiance.astype(np.float64)) * 255 + (1 - cover) * np.array(GROUND)
    return np.round(mixed).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Cell:
    """A picture of a grid, lines of words below it, and which of these are the best of a row."""

    picture: Picture
    words: Sequence[str] = ()
    best: Sequence[bool] = ()


def grid(heads: Sequence[str], rows: Mapping[str, Sequence[Cell]], size: int = 13) -> Image.Image:
    """Rows of pictures, with their names at the left, under the names of their columns, in letters of `size` pixels."""
    top = HEAD - 13 + size
    wide = [max(row[column].picture.shape[1] for row in rows.values()) for column in range(len(heads))]
    lines = {name: max(len(cell.words) for cell in row) for name, row in rows.items()}
    high = {name: max(len(cell.picture) for cell in row) + GAP + LINE * lines[name] for name, row in rows.items()}
    words = [word for name in rows for word in name.split(", ") if word]
    left = max(LEFT, 2 * GAP + max(math.ceil(font(size - 1).getlength(word)) for word in words)) if words else GAP
    image = Image.new("RGB", (left + sum(wide) + GAP * len(wide), top + sum(high.values())), GROUND)
    pen, at = ImageDraw.Draw(image), left
    for head, width in zip(heads, wide, strict=True):
        pen.text((at + width // 2, top - 8), head, BRIGHT, font(size), "ms")
        at += width + GAP
    for name, row in rows.items():
        for line, word in enumerate(name.split(", ")):
            pen.text((GAP, top + high[name] // 2 + (size + 3) * line - 8), word, BRIGHT, font(size - 1), "lm")
        at = left
        for width, cell in zip(wide, row, strict=True):
            image.paste(Image.fromarray(cell.picture), (at, top))
            for line, word in enumerate(cell.words):
                colour = GOOD if line < len(cell.best) and cell.best[line] else DIM
                pen.text((at + width // 2, top + len(cell.picture) + 13 + LINE * line), word, colour, font(11), "ms")
            at += width + GAP
        top += high[name]
    return image


@lru_cache(maxsize=8)
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own, so that the pictures are the same on every machine."""
    return ImageFont.load_default(size)
