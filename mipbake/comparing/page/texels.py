"""Stacks in a report: what the interactive view is given of them, and their levels as thumbnails."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.page.markup import TIMES, Html, element
from mipbake.comparing.page.pictures import Album, bytes_of
from mipbake.comparing.ranking import LINEAR, best_closed_form
from mipbake.comparing.result import Comparison
from mipbake.comparing.viewer import Source, texel_bytes, viewer_fragment
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.layout import LAYOUTS, MapLayout, to_file
from mipbake.stack.stack import MipStack


@dataclass(frozen=True)
class Window:
    """What the interactive view is given of a stack at most.

    Args:
        side: in texels.
        bytes: of texels that a page may hold before they are compressed; larger sets get a smaller window.

    """

    side: int = 1024
    bytes: int = 48 << 20


WINDOW = Window()

THUMBNAIL = 128
THUMBNAIL_LEVELS = 6


def view_names(comparison: Comparison, stacks: Mapping[str, MipStack]) -> list[str]:
    """Methods in the interactive view, A first and B last: the subject, the best closed form, `linear (box)`."""
    names = (comparison.subject, best_closed_form(comparison), LINEAR)
    return [name for name in dict.fromkeys(names) if name is not None and name in stacks]


def view(
    comparison: Comparison, stacks: Mapping[str, MipStack], source: Source | None, window: Window = WINDOW
) -> tuple[Html, str]:
    """The interactive view, and a sentence about what was left out of it; both empty without a stack."""
    chosen = {name: stacks[name] for name in view_names(comparison, stacks)}
    if not chosen:
        return Html(""), ""
    size = next(iter(chosen.values())).size
    chosen = {name: stack for name, stack in chosen.items() if stack.size == size}
    if source is not None and source.stored.shape[:2] != size:
        source = None
    side = window_side(list(chosen.values()), source, window)
    if max(size) > side:
        height, width = (min(length, side) for length in size)
        note = (
            f"The view holds {width} {TIMES} {height} of the set's {size[1]} {TIMES} {size[0]} texels, from its upper "
            "left corner at every level, to keep this page small; the window's borders do not meet where it repeats."
        )
        chosen = {name: cropped(stack, side) for name, stack in chosen.items()}
        source = source and replace(source, stored=np.ascontiguousarray(source.stored[:side, :side]))
    else:
        note = ""
    return Html(viewer_fragment(chosen, source, pixel_filter=comparison.pixel_filter)), note


def window_side(stacks: Sequence[MipStack], source: Source | None, window: Window = WINDOW) -> int:
    """The largest power of two, up to the window's side, with which all stacks and the source fit into its bytes."""
    texel = sum(texel_bytes(stack.model) * 4 / 3 for stack in stacks) + (texel_bytes(source.model) if source else 0)
    side = window.side
    while side * side * texel > window.bytes:
        side //= 2
    return side


def cropped(stack: MipStack, side: int) -> MipStack:
    """The upper left window of a stack, `side` texels (a power of two) of level 0 where it is larger.

    A level of the window is the window of the level: `side >> L` texels. With sides of the set that are powers of two
    it shows the same surface at every level; otherwise levels of odd size shift it by less than a texel.
    """
    height, width = (min(length, side) for length in stack.size)
    sizes = level_sizes(height, width)
    levels = [np.ascontiguousarray(stack.levels[i][:rows, :columns]) for i, (rows, columns) in enumerate(sizes)]
    return replace(stack, levels=levels, extra={})


# ---- thumbnails


def thumbnails(
    comparison: Comparison, stacks: Mapping[str, MipStack], album: Album, progress: Callable[[], None]
) -> Html:
    """The first levels of every map of the subject, and of `linear (box)` below for comparison."""
    names = [name for name in dict.fromkeys((comparison.subject, LINEAR)) if name in stacks]
    if not names:
        return Html("")
    groups: dict[str, list[Html]] = {}
    for name in names:
        for layout, levels in stacks[name].maps():
            if layout.shades or name == names[0]:  # maps that do not shade are the same in every stack
                row = _row(name, layout, levels, _range(layout, levels), album)
                groups.setdefault(layout.name, []).append(row)
            progress()
    return element(
        "div",
        [element("section", element("h3", _spoken(map_name)), rows, class_="map") for map_name, rows in groups.items()],
        class_="maps",
    )


def thumbnail_count(comparison: Comparison, stacks: Mapping[str, MipStack]) -> int:
    """How often `thumbnails` tells its progress."""
    names = dict.fromkeys((comparison.subject, LINEAR))
    return sum(len(LAYOUTS[stacks[n].model]) + len(stacks[n].extra) for n in names if n in stacks)


def _row(
    name: str, layout: MapLayout, levels: Sequence[NDArray[np.float32]], limits: tuple[float, float], album: Album
) -> Html:
    cells = []
    for index, level in enumerate(levels[:THUMBNAIL_LEVELS]):
        height, width = level.shape[:2]
        pixels = bytes_of(_as_colours(_reduced(level), layout, limits))
        label = f"{_spoken(layout.name)}, {name}, level {index}"
        picture = album.add(label, pixels, "map", layout.name, name, f"level-{index}")
        shown = picture.html(label, class_="texels")
        cells.append(
            element(
                "figure", shown, element("figcaption", f"level {index}", element("small", f"{width} {TIMES} {height}"))
            )
        )
    return element(
        "div",
        element("h4", name),
        element(
            "div",
            cells,
            class_="strip small",
            tabindex=0,
            role="region",
            aria_label=f"{_spoken(layout.name)}: levels of {name}",
        ),
        class_="levels",
    )


def _spoken(name: str) -> str:
    return name.replace("_", " ").replace("color", "colour").capitalize()


def _reduced(level: NDArray[np.float32]) -> NDArray[np.float64]:
    """Level or, where it is larger than a thumbnail, means over blocks of its texels, as a browser would reduce it."""
    reduced = level.astype(np.float64)
    longest = max(reduced.shape[:2])
    for axis in (0, 1):
        length = reduced.shape[axis]
        if longest > THUMBNAIL:
            count = max(1, length * THUMBNAIL // longest)
            edges = np.arange(count) * length // count
            counts = np.diff([*edges, length]).reshape([-1, 1, 1] if axis == 0 else [1, -1, 1])
            reduced = np.add.reduceat(reduced, edges, axis) / counts
    return reduced


def _range(layout: MapLayout, levels: Sequence[NDArray[np.float32]]) -> tuple[float, float]:
    """Least and greatest value over all levels of a map of logarithms, whose values have no bounds; else 0 and 1."""
    if "log" not in layout.encodings:
        return 0.0, 1.0
    return float(min(level.min() for level in levels)), float(max(level.max() for level in levels))


def _as_colours(level: NDArray[np.float64], layout: MapLayout, limits: tuple[float, float]) -> NDArray[np.float64]:
    """(h, w, C) stored channels as (h, w, 3) numbers from 0 to 1, as the map's 8-bit file would look."""
    values = to_file(level, layout.encodings, srgb=True)
    low, high = limits
    values = (values - low) / max(high - low, 1e-6)
    channels = values.shape[-1]
    if channels in (1, 3):
        return np.broadcast_to(values, (*values.shape[:2], 3))
    if channels == 2:  # a normal without its z
        z = np.sqrt(np.clip(1 - (level**2).sum(-1, keepdims=True), 0, 1))
        return np.concatenate([values, (z + 1) / 2], -1)
    return values[..., :3]
