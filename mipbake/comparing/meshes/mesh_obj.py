"""Wavefront OBJ, read line by line.

This module uses no library: the known libraries take indices that count backwards from the end of the file and not from
their line, or silently drop what they cannot resolve.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.tangents import corner_normals, with_tangents

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_CREASE = 60.0
"""Degrees between triangles beyond which their edge stays sharp, in meshes without normals."""

_NUMBERS = {"v": ("a position", 3), "vt": ("a texture coordinate", 1), "vn": ("a normal", 3)}
_ABSENT = -1
_MOST = 1 << 31
"""More than any file has of anything; larger numbers fit no array."""


@dataclass
class _Statements:
    """What a file says: numbers, and for each corner of each polygon its indices (position, uv, normal)."""

    v: list[list[float]] = field(default_factory=list)
    vt: list[list[float]] = field(default_factory=list)
    vn: list[list[float]] = field(default_factory=list)
    corners: list[tuple[int, int, int]] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


def read_obj(path: Path) -> Mesh:
    """The polygons of the whole file as triangles; v turned to point down, as `Mesh` has it.

    Polygons may be concave. Normals are the file's; corners without one are smoothed over edges up to 60 degrees.
    Tangents are generated (`mipbake.comparing.meshes.tangents`). Materials, lines, points and free-form surfaces are
    passed over. Errors are those of `read_mesh`, and name the line.
    """
    said = _parse(path, disk.read_bytes(path, "a mesh"))
    if not said.corners:
        raise InputError(f"the mesh {path} has no triangles: expected lines that begin with f, so export polygons")
    sizes = np.array(said.sizes)
    corner = _checked(path, said, np.array(said.corners, np.int64), np.repeat(said.lines, sizes))
    positions, normals = np.array(said.v), np.array(said.vn).reshape(-1, 3)
    uv = np.array([[u, 1 - v] for u, v in ((*each, 0.0)[:2] for each in said.vt)])
    corner = corner[triangulated(positions[corner[:, 0]], sizes)]  # (T, 3, 3)

    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    absent = np.append(length[:, 0] == 0, True)[corner[..., 2]]  # -1 is the one beyond the last
    if absent.any():
        made = corner_normals(positions, corner[..., 0].astype(np.int32), _CREASE)[absent]
        made, index = np.unique(made, axis=0, return_inverse=True)
        corner[absent, 2] = len(normals) + index.reshape(-1)
        normals, length = np.concatenate([normals, made]), np.append(length, np.ones((len(made), 1)), 0)
    normals = normals / np.where(length > 0, length, 1)

    # One vertex for each combination that is used.
    flat = corner.reshape(-1, 3)
    _, two = np.unique(flat[:, 0] * len(uv) + flat[:, 1], return_inverse=True)
    _, first, index = np.unique(two.reshape(-1) * len(normals) + flat[:, 2], return_index=True, return_inverse=True)
    used = flat[first]
    triangles = index.reshape(-1, 3).astype(np.int32)
    return with_tangents(path.name, positions[used[:, 0]], normals[used[:, 2]], uv[used[:, 1]], triangles)


def _parse(path: Path, data: bytes) -> _Statements:
    said = _Statements()
    known: dict[str, tuple[int, int, int]] = {}  # corners come back in every polygon around a vertex
    for line, (kind, *words) in _lines(data.decode("utf-8", "replace")):
        if kind == "f":
            corners = [known.get(word) or _corner(path, line, word, said) for word in words]
            known.update((word, corner) for word, corner in zip(words, corners, strict=True) if "-" not in word)
            if len(corners) < 3:
                raise _wrong(path, line, f"has {len(corners)} corners, expected at least 3")
            said.corners += corners
            said.sizes.append(len(corners))
            said.lines.append(line)
        elif kind in _NUMBERS:
            what, least = _NUMBERS[kind]
            try:
                numbers = [float(word) for word in words[:3]]
            except ValueError:
                numbers = []
            if len(numbers) < least or not all(map(math.isfinite, numbers)):
                count = "three" if least == 3 else "one to three"
                text = " ".join(words[:3])
                raise _wrong(path, line, f"gives {what} as {text!r}: expected {count} finite numbers")
            getattr(said, kind).append(numbers)
    return said


def _wrong(path: Path, line: int, what: str) -> InputError:
    return InputError(f"line {line} of the mesh {path} {what}: export it again")


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    """Words of lines that have any, with the line's number; a backslash at the end goes on in the next line."""
    words: list[str] = []
    for number, line in enumerate(text.split("\n"), 1):
        plain = line.partition("#")[0].strip()
        words += plain.removesuffix("\\").split()
        if words and not plain.endswith("\\"):
            yield number, words
            words = []
    if words:
        yield text.count("\n") + 1, words


def _corner(path: Path, line: int, word: str, said: _Statements) -> tuple[int, int, int]:
    """Indices from 0 of position, uv and normal, as in 7/3/5, 7//5, 7/3 or 7; negative ones count from here back."""
    parts = word.split("/")
    counts = (len(said.v), len(said.vt), len(said.vn))
    try:
        given = [int(part) if part else None for part in (*parts, "", "")[:3]]
    except ValueError:
        given = [None]
    numbers = [(i, n) for i, n in zip(given, counts, strict=False) if i is not None]
    if given[0] is None or len(parts) > 3 or any(i == 0 or not -n <= i <= _MOST for i, n in numbers):
        expected = "numbers of a position, a texture coordinate and a normal as in 7/3/5, counted from 1"
        raise _wrong(path, line, f"has the corner {word!r}: expected {expected}")
    v, vt, vn = (_ABSENT if i is None else i - 1 if i > 0 else n + i for i, n in zip(given, counts, strict=True))
    return v, vt, vn


def _checked(path: Path, said: _Statements, corners: Indices, lines: Indices) -> Indices:
    """The corners, (N, 3), when their indices lead somewhere and each has a texture coordinate."""
    for column, (kind, (what, _)) in enumerate(_NUMBERS.items()):
        count = len(getattr(said, kind))
        beyond = np.flatnonzero(corners[:, column] >= count)
        if len(beyond):
            number = corners[beyond[0], column] + 1
            expected = f"refers to {what} with number {number} of {count}: expected one that the file holds"
            raise _wrong(path, lines[beyond[0]], expected)
    without = np.flatnonzero(corners[:, 1] == _ABSENT)
    if len(without):
        raise InputError(
            f"the mesh {path} has no texture coordinates in line {lines[without[0]]}: expected them at every corner, "
            "so unwrap the mesh and export it with UVs"
        )
    return corners


def triangulated(points: Array, sizes: Indices) -> Indices:
    """(T, 3) indices of corners: polygons cut into triangles.

    Args:
        points: (N, 3), the corners of all polygons, one after the other.
        sizes: (P,), corners of each, 3 or more.
    """
    starts = np.cumsum(sizes) - sizes
    found = []
    for size in np.unique(sizes):
        corner = starts[sizes == size][:, None] + np.arange(size)
        p = points[corner]
        edge = np.roll(p, -1, 1) - p
        away = p - p[:, :1]
        normal = np.cross(away, np.roll(away, -1, 1)).sum(1)  # Newell's: twice the area
        turn = (np.cross(np.roll(edge, 1, 1), edge) * normal[:, None]).sum(-1)
        convex = (turn >= 0).all(-1)
        fan = np.stack([np.zeros(size - 2, int), np.arange(1, size - 1), np.arange(2, size)], -1)
        found.append(corner[convex][:, fan].reshape(-1, 3))
        for each in np.flatnonzero(~convex):
            found.append(corner[each][_ears(p[each], normal[each])])
    return np.concatenate(found)


def _ears(p: Array, normal: Array) -> Indices:
    """(n - 2, 3): a simple polygon (n, 3), cut by ear clipping in the plane that it faces most."""
    axis = int(np.abs(normal).argmax())
    x, y = p[:, (axis + 1) % 3], p[:, (axis + 2) % 3] * np.sign(normal[axis])

    def side(a: int, b: int, c: Array | int) -> Array:
        return np.asarray((x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a]))

    left, found = list(range(len(p))), []
    while len(left) > 2:
        for at in range(len(left)):
            a, b, c = left[at - 1], left[at], left[(at + 1) % len(left)]
            rest = np.array([each for each in left if each not in (a, b, c)], int)
            inside = (side(a, b, rest) >= 0) & (side(b, c, rest) >= 0) & (side(c, a, rest) >= 0)
            for each in (a, b, c):  # a bridge to a hole comes back to where it was
                inside &= (x[rest] != x[each]) | (y[rest] != y[each])
            if side(a, b, c) > 0 and not inside.any():
                break
        else:  # what is left has no area, or crosses itself
            at, (a, b, c) = 1, left[:3]
        found.append((a, b, c))
        del left[at]
    return np.array(found)
