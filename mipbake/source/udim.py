"""UDIM tile sets: tiles side by side as one texture set, so that filtering crosses their borders, and apart again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from mipbake.base.errors import UsageError
from mipbake.base.messages import listed
from mipbake.material.directions import untangled
from mipbake.material.fill import fill
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.decode import TextureMap, resized, unit_vectors
from mipbake.source.options import CARRIED, ROLES, SHADING_ROLES
from mipbake.source.sources import MapSource, spoken
from mipbake.source.texture_set import TextureSet
from mipbake.source.tiles import name_with, place

CLAMPED = ("clamp", "clamp")

Pair: TypeAlias = tuple[int, int]
"""Row and column, or height and width."""

_LACKING: Mapping[str, tuple[float, ...]] = {
    "anisotropy": (1.0, 0.0, 0.0),
    "occlusion": (1.0,),
    "emissive": (0.0, 0.0, 0.0),
    "opacity": (1.0,),
}
"""What stands for a map that other tiles have. A height is continued from them: any number would be a step."""


@dataclass(frozen=True, eq=False)
class Mosaic:
    """What is baked at once: one texture set, or tiles side by side.

    Args:
        texture_set: what is baked. For tiles it is all of them as one, clamped, holes between them filled from those
            around; it has no alpha cutoff, because coverage is kept for each tile, not for all tiles together.
        sets: the texture sets that stacks are cut out for, by tile; the same one under 0 for a set that is no tile.
            Tiles of another size lie around them.
        cells: number of every tile to its row and column, from the top left.
        rows, columns: size in tiles.
    """

    texture_set: TextureSet
    sets: Mapping[int, TextureSet]
    cells: Mapping[int, Pair] = field(default_factory=dict)
    rows: int = 1
    columns: int = 1

    def near(self, tile: int) -> list[int]:
        """The numbers of the tiles that touch one."""
        return sorted(_neighbours(tile, self.cells))


def islands(tiles: Iterable[int]) -> list[list[int]]:
    """Tile numbers in groups that touch, corners included: tiles that lie apart need no mosaic in common."""
    left, groups = set(tiles), []
    while left:
        group = [min(left)]
        left.remove(group[0])
        for tile in group:  # which grows meanwhile
            near = _neighbours(tile, left)
            left.difference_update(near)
            group += near
        groups.append(sorted(group))
    return groups


def mosaics(tiles: Mapping[int, TextureSet]) -> list[Mosaic]:
    """Texture sets side by side as their tile numbers say, u to the right and v upwards: a mosaic for each size that
    tiles have, the largest first, in which the tiles of that size keep their texels. It is the rectangle around all
    tiles, so those that lie far apart are better joined by `islands`. UsageError for tiles with different alpha
    cutoffs.

    Tiles of another size than the mosaic's are resampled to it, for what is filtered across borders. A map that only
    some tiles have is a constant in the others (anisotropy of strength 0, occlusion, opacity and carried channels 1,
    emissive 0; a height is continued from the tiles around). Where there is no tile, the maps are continued from the
    tiles around: nothing foreign is filtered into their borders.
    """
    cutoffs = list(dict.fromkeys(s.alpha_cutoff for s in tiles.values()))
    if len(cutoffs) > 1:
        values = " and ".join("none" if cutoff is None else f"{cutoff:g}" for cutoff in cutoffs)
        raise UsageError(f"the tiles have different alpha cutoffs, {values}: load all of them with the same")
    sizes = {(each.height, each.width) for each in tiles.values()}
    return [_joined(tiles, size) for size in sorted(sizes, reverse=True)]


def _joined(tiles: Mapping[int, TextureSet], size: Pair) -> Mosaic:
    """The mosaic in which the tiles of a size, (height, width), keep their texels."""
    sets = {tile: tiles[tile] for tile in sorted(tiles)}
    places = {tile: place(tile) for tile in sets}
    left, bottom = (min(p[axis] for p in places.values()) for axis in (0, 1))
    right, top = (max(p[axis] for p in places.values()) for axis in (0, 1))
    cells = {tile: (top - v, u - left) for tile, (u, v) in places.items()}
    rows, columns = top - bottom + 1, right - left + 1

    inside = {tile: each for tile, each in sets.items() if (each.height, each.width) == size}
    sizes = {role: size for role in SHADING_ROLES}
    carried = {role: None for s in sets.values() for role in s.maps if role.startswith(CARRIED)}
    groups = (inside.values(), sets.values())
    roles = [role for role in (*ROLES, *carried) if any(role in s.maps for s in sets.values())]
    for role in roles:
        if role not in SHADING_ROLES:
            of_size, every = ([s.maps[role].pixels.shape for s in some if role in s.maps] for some in groups)
            there = of_size or every
            sizes[role] = (max(s[0] for s in there), max(s[1] for s in there))
    placed = {cells[tile]: each for tile, each in sets.items()}
    maps = {role: _mosaic_map(role, placed, (rows, columns), sizes[role]) for role in roles}

    conventions = [s.convention for s in sets.values()]
    decided = [c for c in conventions if c.decided_by != "flat"]
    notes = _common({tile: (*s.notes, *_notes(s, size, roles)) for tile, s in sets.items()})
    warnings = _common({tile: s.warnings for tile, s in sets.items()})
    texture_set = TextureSet(
        next(iter(sets.values())).name,
        maps,
        columns * size[1],
        rows * size[0],
        CLAMPED,
        (decided or conventions)[0],
        hashlib.sha256(json.dumps([(tile, s.source_hash) for tile, s in sets.items()]).encode()).hexdigest(),
        tuple(notes),
        (*warnings, *_warnings(sets, size)),
    )
    named = {tile: replace(each, name=name_with(each.name, tile)) for tile, each in inside.items()}
    return Mosaic(texture_set, named, cells, rows, columns)


def _neighbours(tile: int, among: Iterable[int]) -> list[int]:
    u, v = place(tile)
    return [t for t in among if t != tile and max(abs(place(t)[0] - u), abs(place(t)[1] - v)) == 1]


def _mosaic_map(role: str, placed: Mapping[Pair, TextureSet], grid: Pair, size: Pair) -> TextureMap:
    """One role of tiles by row and column, each at `size` (height, width), in a grid of so many rows and columns."""
    height, width = size
    channels = next(s.maps[role].pixels.shape[2] for s in placed.values() if role in s.maps)
    pixels = np.zeros((grid[0] * height, grid[1] * width, channels), np.float32)
    known = np.zeros(pixels.shape[:2], bool)
    constant = _constant(role)
    for (row, column), texture_set in placed.items():
        here = (slice(row * height, (row + 1) * height), slice(column * width, (column + 1) * width))
        if role in texture_set.maps:
            pixels[here] = resized(texture_set.maps[role], width, height, CLAMPED).pixels
        elif constant is not None:
            pixels[here] = constant
        known[here] = role in texture_set.maps or constant is not None
    if not known.all():
        if role == "anisotropy":
            pixels = untangled(pixels, CLAMPED)
        filled = unit_vectors(fill(pixels, known.astype(np.float32)), role)
        pixels = np.where(known[..., None], pixels, filled)
    return TextureMap(pixels, MapSource.made(role, pixels.shape[1], pixels.shape[0], "tiles side by side"))


def _constant(role: str) -> tuple[float, ...] | None:
    """What stands for a map in tiles that lack it; None where it is continued from the others."""
    return (1.0,) if role.startswith(CARRIED) else _LACKING.get(role)


def _common(sentences: Mapping[int, Iterable[str]]) -> list[str]:
    """Every sentence once: as it is where all tiles say it, else with the tiles that do."""
    said: dict[str, list[int]] = {}
    for tile, several in sentences.items():
        for sentence in dict.fromkeys(several):
            said.setdefault(sentence, []).append(tile)
    return [
        sentence if len(tiles) == len(sentences) else f"{listed(tiles)}: {sentence}" for sentence, tiles in said.items()
    ]


def _notes(texture_set: TextureSet, size: Pair, roles: Iterable[str]) -> list[str]:
    """What is assumed of a tile beside others, which have this size, (height, width), and these maps."""
    here, (height, width) = (texture_set.height, texture_set.width), size
    resampled = f"resampled from {here[1]} x {here[0]} to {width} x {height} beside tiles of that size"
    return [resampled] * (here != size) + [
        f"no {spoken(role)} map, which other tiles have: "
        + ("it is continued from them" if _constant(role) is None else "a constant that changes nothing is used")
        for role in roles
        if role not in texture_set.maps
    ]


def _warnings(sets: Mapping[int, TextureSet], size: Pair) -> list[str]:
    """What the user should look at in tiles, of this size, (height, width), together."""
    found = []
    by_name: dict[str, list[str]] = {}
    for tile, texture_set in sets.items():
        if texture_set.convention.decided_by != "flat":
            by_name.setdefault(texture_set.convention.name, []).append(str(tile))
    if len(by_name) > 1:
        read = " and ".join(f"{listed(tiles)} as {spoken(name)}" for name, tiles in by_name.items())
        found.append(f"normal maps of one set were read differently, {read}: set the normal convention")
    exact = exact_levels(*size)
    if exact != len(level_sizes(*size)):
        found.append(
            f"the tiles measure {size[1]} x {size[0]}: their levels from {exact} on do not divide them evenly and are "
            "looked up between texels of the mosaic, which blurs them slightly; square tiles with a power of two as "
            "side are cut out exactly"
        )
    return found


def exact_levels(height: int, width: int) -> int:
    """How many levels of a tile consist of whole texels of the mosaic's levels."""
    return sum(1 for level in range(len(level_sizes(height, width))) if not (height | width) & ((1 << level) - 1))
