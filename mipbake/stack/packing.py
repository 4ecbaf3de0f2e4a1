"""Which channels of which maps lie together in a file: as the source had them, or as engines expect them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.base.names import known_name
from mipbake.material.pixel_filter import level_sizes, resample
from mipbake.source.decode import upsample
from mipbake.source.layout import FLIPPED, INVERTED, LAYOUTS, LOG, SIGNED, UNIT, FileChannel, FileLayout, MapLayout
from mipbake.source.names import with_convention
from mipbake.source.normal import normalised
from mipbake.source.options import CARRIED
from mipbake.source.texture_set import TextureSet

Levels: TypeAlias = list[NDArray[np.float32]]
Wrap: TypeAlias = tuple[str, str]

SOURCE, SEPARATE = "source", "separate"


@dataclass(frozen=True)
class Piece:
    """One channel of a packed file.

    Args:
        map: name of the map; empty for a constant.
        index: of the channel in the map.
        inverted: whether the file holds the opposite: gloss for roughness, green down for normals.
        default: what stands in its place where there is no such map; None: the file ends before it.
    """

    map: str
    index: int = 0
    inverted: bool = False
    default: float | None = None


@dataclass(frozen=True)
class PackedFile:
    """A file: its name and its channels. It is made where its first channels that have no default are there."""

    name: str
    pieces: tuple[Piece, ...]


def _colours(map: str) -> tuple[Piece, ...]:
    return tuple(Piece(map, i) for i in range(3))


_BASE = PackedFile("base_color", (*_colours("base_color"), Piece("opacity")))
_OCCLUSION = Piece("occlusion", default=1.0)

PACKINGS: Mapping[str, tuple[PackedFile, ...]] = {
    SOURCE: (),
    SEPARATE: (),
    "orm": (_BASE, PackedFile("orm", (_OCCLUSION, Piece("roughness"), Piece("metallic")))),
    "mask-map": (
        _BASE,
        PackedFile(
            "mask_map", (Piece("metallic"), _OCCLUSION, Piece("", default=1.0), Piece("roughness", inverted=True))
        ),
    ),
    "metallic-smoothness": (
        _BASE,
        PackedFile("metallic_smoothness", (*(Piece("metallic"),) * 3, Piece("roughness", inverted=True))),
    ),
}
"""`source`: as the source's files were; `separate`: a file for each map; `orm`: occlusion, roughness and metallic in
red, green and blue, opacity in the alpha of the base colour; `mask-map`: metallic, occlusion, 1 and smoothness, as
Unity's HDRP reads them; `metallic-smoothness`: metallic in red, green and blue, smoothness in alpha, as Unity's URP
does. Maps that no rule names get a file each."""


@dataclass(frozen=True)
class Normals:
    """How normal maps are written.

    Args:
        convention: "opengl" (green up), "directx" (green down) or "source", as the source's file had it.
        channels: 3, or 2 where the shader works the third out.
    """

    convention: str = SOURCE
    channels: int = 3


def source_files(texture_set: TextureSet) -> tuple[PackedFile, ...]:
    """The files that a texture set was read from, as packed files of the same names and channels.

    Colours, normals and anisotropy keep all their channels, grey files or not, because filtering may tint and turn
    them; normals of two channels stay so. Roles without a file get one of their own.
    """
    by_file: dict[str, dict[str, Piece]] = {}
    names: dict[str, str] = {}
    for role, texture in texture_set.maps.items():
        source = texture.source
        path = None if source.converted else source.path
        key = str(path) if path else role
        names[key] = path.stem if path else role
        down = role == "normal" and texture_set.convention.name == "directx"
        channels = source.channels if path else ""
        slots = by_file.setdefault(key, {})
        count = 2 if role == "normal" and len(channels) == 2 else texture.pixels.shape[-1]
        letters = channels if len(channels) == count and channels != "Y" else "RGBA"[:count]
        if any(letter in slots for letter in letters):  # two roles of one channel part in what is baked
            slots, names[role] = by_file.setdefault(role, {}), role
        for index, letter in enumerate(letters):
            # Not every stack of the set has them.
            default = 1.0 if role.startswith((CARRIED, "anisotropy")) else None
            slots[letter] = Piece(role, index, source.inverted or (down and index == 1), default)
    return tuple(
        PackedFile(name, _in_order(by_file[key])) for key, name in zip(names, _distinct(names.values()), strict=True)
    )


def _in_order(slots: Mapping[str, Piece]) -> tuple[Piece, ...]:
    """Pieces in the places that their letters have; a file of one channel is grey, whatever the letter was."""
    if len(slots) == 1:
        return tuple(slots.values())
    last = max("RGBA".index(letter) for letter in slots)
    return tuple(slots.get(letter, Piece("", default=1.0)) for letter in "RGBA"[: last + 1])


def _distinct(names: Iterable[str]) -> list[str]:
    """Names that all differ, even where upper and lower case count as the same."""
    seen: set[str] = set()
    out = []
    for name in names:
        tried, number = name, 2
        while tried.lower() in seen:
            tried, number = f"{name}_{number}", number + 1
        seen.add(tried.lower())
        out.append(tried)
    return out


def pack(
    maps: Sequence[tuple[MapLayout, Levels]],
    packing: str,
    source: Sequence[PackedFile] = (),
    normals: Normals = Normals(),
    wrap: Wrap = ("wrap", "wrap"),
) -> list[tuple[FileLayout, Levels]]:
    """The files of a stack, with levels (H_L, W_L, channels of the file): views of the maps where a file holds
    neighbouring channels of one map. UsageError for an unknown packing or convention.

    Args:
        packing: a name in `PACKINGS`.
        source: files of the source, from `source_files`; where they are unknown, `source` means `separate`.
        wrap: addressing, for maps that are resampled to share a file.
    """
    packing = known_name("packing", packing, PACKINGS)
    known_name("normal convention", normals.convention, (SOURCE, "opengl", "directx"))
    by_name = {layout.name: (layout, levels) for layout, levels in maps}
    known = {piece.map for file in source for piece in file.pieces if piece.map}
    # Materials in another model than the source's have maps of other names.
    as_source = packing == SOURCE and {m.name for m, _ in maps if m.shades} <= known | {"anisotropy"}
    rules = list(source if as_source else PACKINGS[packing])
    used: set[str] = set()
    wanted = normals.convention
    if wanted == SOURCE:
        # Tensors of roughness know one orientation alone, and their normals keep to it.
        tensors = any(LOG in layout.encodings for layout, _ in maps)
        normals = replace(normals, convention="opengl" if tensors else _convention(source))
    files = []
    for rule in rules:
        pieces = _present(rule, by_name)
        if pieces:
            maps_here = {piece.map for piece in pieces}
            used |= maps_here
            changed = wanted != SOURCE and "normal" in maps_here
            files.append(PackedFile(with_convention(rule.name, wanted) if changed else rule.name, pieces))
    for layout, _ in maps:
        if layout.name not in used and not layout.name.startswith(CARRIED):
            files.append(PackedFile(layout.name, tuple(Piece(layout.name, i) for i in range(len(layout.encodings)))))
    names = _distinct(file.name for file in files)
    return [_file(replace(file, name=name), by_name, normals, wrap) for file, name in zip(files, names, strict=True)]


def _convention(source: Sequence[PackedFile]) -> str:
    """The convention of the normal map in the source's files; OpenGL's where the files are unknown."""
    green = [piece for file in source for piece in file.pieces if piece.map == "normal" and piece.index == 1]
    return "directx" if any(piece.inverted for piece in green) else "opengl"


def _present(rule: PackedFile, maps: Mapping[str, object]) -> tuple[Piece, ...]:
    """The pieces of a rule up to the first that is not there and has no default; none where no map is there at all."""
    pieces: list[Piece] = []
    for piece in rule.pieces:
        if piece.map in maps:
            pieces.append(piece)
        elif piece.default is not None:
            pieces.append(Piece("", default=piece.default))
        else:
            break
    return tuple(pieces) if any(piece.map for piece in pieces) else ()


def _file(
    file: PackedFile, maps: Mapping[str, tuple[MapLayout, Levels]], normals: Normals, wrap: Wrap
) -> tuple[FileLayout, Levels]:
    down = normals.convention == "directx"
    pieces = [replace(p, inverted=down) if (p.map, p.index) == ("normal", 1) else p for p in file.pieces]
    if normals.channels == 2 and all(piece.map == "normal" for piece in pieces):
        pieces = pieces[:2]
        layout, levels = maps["normal"]
        if len(layout.encodings) == 3:  # whoever works the third out takes for granted that they are unit
            maps = {**maps, "normal": (layout, [normalised(level) for level in levels])}
    chains = {p.map: maps[p.map][1] for p in pieces if p.map}
    # Baked levels are never resampled: maps that do not shade take their size.
    leading = [chain for name, chain in chains.items() if maps[name][0].shades] or list(chains.values())
    size = max((chain[0].shape[:2] for chain in leading), key=lambda s: s[0] * s[1])
    chains = {name: _at_size(chain, (size[0], size[1]), wrap) for name, chain in chains.items()}
    channels = tuple(_channel(piece, maps) for piece in pieces)
    packed = FileLayout(file.name, channels, any(maps[name][0].shades for name in chains))
    first = next(iter(chains.values()))
    run = slice(pieces[0].index, pieces[0].index + len(pieces))
    if all(p.map == pieces[0].map and p.index == run.start + i for i, p in enumerate(pieces)):
        return packed, [level[..., run] for level in first]  # views: copies would be as large as the stack
    count = min(len(chain) for chain in chains.values())
    stacked = []
    for index in range(count):
        constant = np.ones(first[index].shape[:2], np.float32)
        parts = [chains[p.map][index][..., p.index] if p.map else constant * np.float32(p.default or 0) for p in pieces]
        stacked.append(np.stack(parts, -1))
    return packed, stacked


def _channel(piece: Piece, maps: Mapping[str, tuple[MapLayout, Levels]]) -> FileChannel:
    if not piece.map:
        return FileChannel("", 0, UNIT, f"the constant {piece.default:g}")
    layout = maps[piece.map][0]
    encoding, meaning = layout.encodings[piece.index], layout.meanings[piece.index]
    if not piece.inverted:
        return FileChannel(piece.map, piece.index, encoding, meaning)
    opposite = {UNIT: INVERTED, SIGNED: FLIPPED}.get(encoding)
    if opposite is None:
        raise UsageError(f"the map {piece.map} cannot be inverted: its encoding is {encoding}")
    return FileChannel(piece.map, piece.index, opposite, f"{meaning}, inverted")


def _at_size(chain: Levels, size: tuple[int, int], wrap: Wrap) -> Levels:
    """A chain that begins at a size: its own levels wherever one is of the size that is wanted, else resampled ones."""
    if chain[0].shape[:2] == size:
        return chain
    own = {level.shape[:2]: level for level in chain}
    return [own[each] if each in own else _resampled(chain, each, wrap) for each in level_sizes(*size)]


def _resampled(chain: Levels, size: tuple[int, int], wrap: Wrap) -> NDArray[np.float32]:
    """The coarsest level that is no smaller than a size along either side, averaged; else level 0, which is also
    interpolated."""
    height, width = size
    level = next((each for each in reversed(chain) if each.shape[0] >= height and each.shape[1] >= width), chain[0])
    larger = upsample(level, max(width, level.shape[1]), max(height, level.shape[0]), wrap)
    return resample(np.ascontiguousarray(larger), size, "box", wrap)


def unpacked(files: Sequence[tuple[FileLayout, Sequence[NDArray[np.float32]]]], model: str) -> dict[str, Levels]:
    """Maps with their levels from the files of one output that hold them; the third channel of normals where files have
    two of it."""
    channels: dict[str, dict[int, Levels]] = {}
    for layout, chain in files:
        levels = list(chain)  # once, where levels are made as they are asked for
        for place, channel in enumerate(layout.channels):
            if channel.map:
                channels.setdefault(channel.map, {})[channel.index] = [level[..., place] for level in levels]
    maps: dict[str, Levels] = {}
    for name, parts in channels.items():
        wanted = next((len(m.encodings) for m in LAYOUTS[model] if m.name == name), len(parts))
        if name == "normal" and set(parts) == {0, 1} and wanted == 3:
            both = zip(parts[0], parts[1], strict=True)
            parts[2] = [np.sqrt(np.maximum(1 - x * x - y * y, 0)) for x, y in both]
        maps[name] = [np.stack(level, -1) for level in zip(*(parts[i] for i in sorted(parts)), strict=True)]
    return maps
