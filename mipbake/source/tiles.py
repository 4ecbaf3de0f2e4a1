"""UDIM tiles by the names of files: which tile a file belongs to, and what a tile's files are.

Tile 1001 + u + 10 v covers the unit square at (u, v) of the texture coordinates, u from 0 to 9, v upwards from 0.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.source.options import LoadOptions

FIRST, LAST = 1001, 1999

# What stands before and after a tile in a name, so that numbers within words are not tiles.
_NUMBER = re.compile(r"(?<=[._-])1\d{3}(?=[._-])")
_CELL = re.compile(r"(?<=[._-])u(\d{1,2})_v(\d{1,3})(?=[._-])", re.IGNORECASE)
PLACEHOLDER = re.compile("<(UDIM|UVTILE)>", re.IGNORECASE)
CHANNELS = re.compile(":[RGBA]{1,4}$", re.IGNORECASE)
"""What may follow the name of a file that is chosen for a role."""


def is_pattern(name: str | os.PathLike[str]) -> bool:
    """Whether a name holds <UDIM> (1001) or <UVTILE> (u1_v1, as Mudbox counts)."""
    return PLACEHOLDER.search(os.fspath(name)) is not None


def place(tile: int) -> tuple[int, int]:
    """(u, v) of a tile, whole numbers from 0."""
    v, u = divmod(tile - FIRST, 10)
    return u, v


def pattern_files(pattern: str | os.PathLike[str]) -> dict[int, Path]:
    """The files that a pattern with <UDIM> or <UVTILE> stands for, by tile; InputError when there are none."""
    path = Path(pattern)
    parts = PLACEHOLDER.split(path.name)[::2]
    if len(parts) != 2 or is_pattern(path.parent):
        raise InputError(f"{path} is not a pattern of tiles: expected <UDIM> or <UVTILE> once, in the file's name")
    before, after = parts
    names = [p.name for p in disk.files_in(path.parent)] if disk.is_dir(path.parent) else []
    found = {}
    for name in names:
        middle = name[len(before) : len(name) - len(after)]
        if name.startswith(before) and name.endswith(after) and (tile := _tile_named(middle)) is not None:
            found[tile] = path.parent / name
    if not found:
        raise InputError(
            f"{path} stands for no file: expected tiles such as {PLACEHOLDER.sub('1001', path.name)} in {path.parent}"
        )
    return dict(sorted(found.items()))


def tiles_of(files: Iterable[str | os.PathLike[str]]) -> Mapping[int, list[Path]]:
    """The tiles that files belong to, by their names: tile to its files, in their order; empty when there are none.

    A name holds its tile between dots, underscores or hyphens: `wood_color.1001.exr`, `wood_1001_color.png`,
    `wood_color_u1_v1.tif`. A number is taken for a tile only where a second file has the same name except for the tile,
    or where others do so with the same number: `wood_1024.png` alone is as wide as it says. A name with <UDIM> or
    <UVTILE> stands for all its files, even for a single file; InputError where there is none. Files of no tile are left
    out.
    """
    tiles: dict[Path, int] = {}
    sets: dict[tuple[Path, str, str], dict[int, Path]] = {}
    for file in dict.fromkeys(Path(f) for f in files):
        if is_pattern(file):
            tiles |= {path: tile for tile, path in pattern_files(file).items()}
        for tile, before, after in _readings(file.name):
            sets.setdefault((file.parent, before, after), {})[tile] = file
    for several in sorted(sets.values(), key=len):  # the larger set decides where a name holds two numbers
        if len(several) > 1:
            tiles |= {path: tile for tile, path in several.items()}
    known = set(tiles.values())
    for several in sets.values():
        for tile, path in several.items():
            if path not in tiles and tile in known:
                tiles[path] = tile
    by_tile: dict[int, list[Path]] = {tile: [] for tile in sorted(set(tiles.values()))}
    for path, tile in tiles.items():
        by_tile[tile].append(path)
    return {tile: sorted(paths) for tile, paths in by_tile.items()}


def tile_options(options: LoadOptions, tile: int, folder: Path | None = None) -> LoadOptions:
    """The options for one tile: <UDIM> and <UVTILE> in the maps are replaced, which are relative to the folder, or to
    the working directory. Maps that this tile has no file for are left out, as `load` fills them with constants;
    InputError where it has no normal or no roughness map."""
    maps = dict(options.maps)
    u, v = place(tile)
    written = {"UDIM": str(tile), "UVTILE": f"u{u + 1}_v{v + 1}"}
    for role, choice in options.maps.items():
        if not isinstance(choice, (str, os.PathLike)) or not is_pattern(choice):
            continue
        text = PLACEHOLDER.sub(lambda found: written[found[1].upper()], os.fspath(choice))
        there = (folder or Path()) / CHANNELS.sub("", text)
        maps[role] = text
        if "*" not in text and not disk.is_file(there):
            if role in ("normal", "roughness"):
                raise InputError(f"tile {tile} has no {role} map: expected {there}")
            maps[role] = None
    return replace(options, maps=maps)


def text_of(name: str, tile: int) -> str:
    """How a file's name writes its tile: `1001` or `u1_v1`; empty where it does not."""
    for found, before, after in _readings(name):
        if found == tile:
            return name[len(before) : len(name) - len(after)]
    return ""


def name_with(name: str, tile: int) -> str:
    """The name of the set of a tile."""
    return f"{name}_{tile}"


def name_without(name: str, tile: int) -> str:
    """The name of the set of all tiles, from the name of one tile."""
    return name.removesuffix(f"_{tile}")


def _tile_named(text: str) -> int | None:
    """The tile that a placeholder's text names: 1001 to 1999, or u1_v1 and so on."""
    tile = int(text) if re.fullmatch(r"1\d{3}", text) else 0
    if found := re.fullmatch(r"u(\d{1,2})_v(\d{1,3})", text, re.IGNORECASE):
        u, v = int(found[1]), int(found[2])
        tile = FIRST + u - 1 + 10 * (v - 1) if 1 <= u <= 10 and v >= 1 else 0
    return tile if FIRST <= tile <= LAST else None


def _readings(name: str) -> list[tuple[int, str, str]]:
    """Every number in a name that could be its tile, with what stands before and after it."""
    return [
        (tile, name[: match.start()], name[match.end() :])
        for pattern in (_NUMBER, _CELL)
        for match in pattern.finditer(name)
        if (tile := _tile_named(match[0])) is not None
    ]
