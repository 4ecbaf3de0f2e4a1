"""The picture of the rooms, docs/rooms.svg: what each really imports, from the lowest room to the highest."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from records.scripts import script

from rooms.layers import laid_out, reduced
from rooms.table import EVERYWHERE, python_parts, rows, uses

_LETTER, _HIGH, _LAYER, _GAP, _MARGIN = 7, 24, 64, 18, 16
"""Width of a letter, height of a box, distances of layers and of boxes, and the margin, in pixels."""

_HEAD = (
    '<defs><marker id="head" markerWidth="8" markerHeight="6" refX="8" refY="3" orient="auto">'
    '<path d="M0 0L8 3L0 6z" class="rest"/></marker></defs>'
)


def picture() -> str:
    """The picture as SVG. An arrow is left out where others lead to the same room, and so is what all may import."""
    table = rows("import")
    found = uses(table, python_parts())
    rooms = [room for row in table for room in row.rooms if room != EVERYWHERE]
    graph = reduced({room: [other for other in rooms if other in found[room]] for room in rooms})
    widths = {room: len(room) * _LETTER + 16 for room in rooms}
    layout = laid_out(graph, widths, _GAP)
    x = {each: round(place + _MARGIN) for each, place in layout.x.items()}
    top = len(layout.layers) - 1
    y = {each: _MARGIN + (top - rank) * _LAYER for rank, layer in enumerate(layout.layers) for each in layer}
    width = max(place + widths.get(each, 0) // 2 for each, place in x.items()) + _MARGIN
    drawing = script("benchmarks", "results_page.svg").Drawing(
        width, top * _LAYER + _HIGH + 2 * _MARGIN, "What each room imports, from the lowest room to the highest"
    )
    drawing.parts.append(_HEAD)
    for way in layout.ways:
        path = _path([(x[each], y[each]) for each in way])
        drawing.parts.append(f'<path d="{path}" class="line" style="stroke: var(--rest)" marker-end="url(#head)"/>')
    for room in rooms:
        drawing.parts.append(
            f'<rect x="{x[room] - widths[room] / 2:g}" y="{y[room]}" width="{widths[room]}" height="{_HIGH}" rx="4" '
            'style="fill: var(--ground); stroke: var(--dim)"/>'
        )
        drawing.text(x[room], y[room] + 16, room, "ink middle")
    return drawing.to_svg()


def _path(corners: Sequence[tuple[int, int]]) -> str:
    """A way down, straight through the layers that it passes and curved between them."""
    path = f"M{corners[0][0]} {corners[0][1] + _HIGH}"
    for index, ((before, high), (after, low)) in enumerate(pairwise(corners), 2):
        start, middle = high + _HIGH, (high + _HIGH + low) // 2
        path += f"L{before} {start}C{before} {middle} {after} {middle} {after} {low}"
        path += f"L{after} {low + _HIGH}" if index < len(corners) else ""
    return path
