"""Stacks in a report: what the interactive view is given of them, and their levels as thumbnails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.page.markup import TIMES, Html, element, joined, note, region
from mipbake.comparing.page.names import called
from mipbake.comparing.page.pictures import bytes_of, picture
from mipbake.comparing.result import LINEAR, Comparison
from mipbake.comparing.viewer import texel_bytes, viewer_fragment
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.layout import MapLayout, to_file
from mipbake.stack.stack import MipStack

WINDOW_SIDE = 1024
"""Texels a side that the interactive view is given of a stack at most."""

WINDOW_BYTES = 48 << 20
"""Of texels that a page may hold before they are compressed; larger sets get a smaller window."""

THUMBNAIL = 128
THUMBNAIL_LEVELS = 6


def view(comparison: Comparison, source: FilteredSource | None) -> Html:
    """The interactive view, with a sentence about what was left out of it; empty without a stack.

    It holds plain MIP maps, the subject's stack and the truth.
    """
    names = dict.fromkeys((LINEAR, comparison.subject))
    chosen = {called(comparison, name): comparison.stacks[name] for name in names if name in comparison.stacks}
    if not chosen:
        return Html("")
    size = next(reversed(chosen.values())).size
    chosen = {name: stack for name, stack in chosen.items() if stack.size == size}
    if source is not None and source.stored.shape[:2] != size:
        source = None
    side, text = _window_side(list(chosen.values()), source), None
    if max(size) > side:
        height, width = (min(length, side) for length in size)
        text = note(
            f"The view holds {width} {TIMES} {height} of the set's {size[1]} {TIMES} {size[0]} texels, from its upper "
            "left corner at every level, to keep this page small; the window's borders do not meet where it repeats."
        )
        chosen = {name: _cropped(stack, side) for name, stack in chosen.items()}
        source = source and replace(source, stored=np.ascontiguousarray(source.stored[:side, :side]))
    return joined([Html(viewer_fragment(chosen, source)), text])


def _window_side(stacks: Sequence[MipStack], source: FilteredSource | None) -> int:
    """The largest power of two, up to WINDOW_SIDE, with which all stacks and the source fit into WINDOW_BYTES."""
    texel = sum(texel_bytes(stack.model) * 4 / 3 for stack in stacks) + (texel_bytes(source.model) if source else 0)
    side = WINDOW_SIDE
    while side * side * texel > WINDOW_BYTES:
        side //= 2
    return side


def _cropped(stack: MipStack, side: int) -> MipStack:
    """The upper left window of a stack, `side` texels (a power of two) of level 0 where it is larger.

    A level of the window is the window of the level: `side >> L` texels. With sides of the set that are powers of two
    it shows the same surface at every level; otherwise levels of odd size shift it by less than a texel.
    """
    sizes = level_sizes(*(min(length, side) for length in stack.size))
    levels = [np.ascontiguousarray(stack.levels[i][:rows, :columns]) for i, (rows, columns) in enumerate(sizes)]
    return replace(stack, levels=levels, extra={})


# ---- thumbnails


def thumbnails(comparison: Comparison) -> Html:
    """The first levels of every map of the subject, and of `linear (box)` below for comparison."""
    groups: dict[str, list[Html]] = {}
    for name in dict.fromkeys((comparison.subject, LINEAR)):
        for layout, levels in comparison.stacks[name].maps() if name in comparison.stacks else ():
            if layout.shades or layout.name not in groups:  # maps that do not shade are the same in every stack
                groups.setdefault(layout.name, []).append(_row(name, layout, levels))
    sections = [element("section", element("h3", _spelt(key)), rows, class_="map") for key, rows in groups.items()]
    return element("div", sections, class_="maps") if sections else Html("")


def _row(name: str, layout: MapLayout, levels: Sequence[NDArray[np.float32]]) -> Html:
    low, high = 0.0, 1.0
    if "log" in layout.encodings:  # logarithms have no bounds
        low, high = (float(f([f(level) for level in levels])) for f in (np.min, np.max))
    cells = []
    for index, level in enumerate(levels[:THUMBNAIL_LEVELS]):
        height, width = level.shape[:2]
        label = f"{_spelt(layout.name)}, {name}, level {index}"
        shown = picture(_pixels(level, layout, low, high), label, class_="texels")
        caption = element("figcaption", f"level {index}", element("small", f"{width} {TIMES} {height}"))
        cells.append(element("figure", shown, caption))
    strip = region(f"{_spelt(layout.name)}: levels of {name}", cells, class_="strip small")
    return element("div", element("h4", name), strip, class_="levels")


def _spelt(name: str) -> str:
    return name.replace("_", " ").replace("color", "colour").capitalize()


def _pixels(level: NDArray[np.float32], layout: MapLayout, low: float, high: float) -> NDArray[np.uint8]:
    """(h, w, 3): a level as the map's 8-bit file would look; means over blocks where it is larger than a thumbnail, as
    a browser would reduce it. Values from `low` to `high` are shown."""
    stored = level.astype(np.float64)
    longest = max(stored.shape[:2])
    for axis, length in enumerate(stored.shape[:2]):
        if longest > THUMBNAIL:
            count = max(1, length * THUMBNAIL // longest)
            edges = np.arange(count) * length // count
            counts = np.diff([*edges, length]).reshape([-1, 1, 1] if axis == 0 else [1, -1, 1])
            stored = np.add.reduceat(stored, edges, axis) / counts
    values = (to_file(stored, layout.encodings, srgb=True) - low) / max(high - low, 1e-6)
    channels = values.shape[-1]
    if channels == 1:
        values = np.broadcast_to(values, (*values.shape[:2], 3))
    elif channels == 2:  # a normal without its z
        z = np.sqrt(np.clip(1 - (stored**2).sum(-1, keepdims=True), 0, 1))
        values = np.concatenate([values, (z + 1) / 2], -1)
    return bytes_of(values[..., :3])
