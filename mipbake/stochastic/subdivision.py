"""Catmull-Clark subdivision of control meshes, and the control vertices that a refined triangle was made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mipbake.base.arguments import checked, dtype_of, is_array, whole
from mipbake.base.errors import UsageError

if TYPE_CHECKING:
    from torch import Tensor

    Array = TypeVar("Array", NDArray[Any], Tensor)

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Subdivision:
    """A control mesh's topology after some levels of subdivision, from `Subdivision.of`.

    Refined vertices are weighted means of control vertices (Catmull and Clark 1978), and the weights depend on the
    topology alone. So they are made once, and `refine` takes any positions.

    Args:
        quads: (F, 4) int32, the refined faces, turned as the control faces are.
        triangles: (2 F, 3) int32: triangles 2 f and 2 f + 1 are quad f, split between its corners 0 and 2.
        sources: (V, K) int32, the control vertices that each refined vertex is a mean of.
        weights: (V, K) float32, their weights; 0 behind the last.
        supports: (2 F, M) int32: the control vertices that the corners of each triangle are means of, -1 behind the
            last. `touched_vertices` takes it in place of triangles.
    """

    quads: Any
    triangles: Any
    sources: Any
    weights: Any
    supports: Any
    _faces: tuple[tuple[int, ...], ...]
    _levels: int

    @classmethod
    def of(cls, faces: Sequence[Sequence[int]] | NDArray[Any], levels: int) -> Subdivision:
        """Args:
            faces: of the control mesh, each with 3 or more corners, the same way round. The mesh may have a boundary,
                which becomes a cubic B-spline, corners included.
            levels: of subdivision, 1 or more.

        Returns:
            NumPy arrays. Refined vertices are first those of the control vertices, in their order.

        Raises:
            UsageError: there are no levels or faces, an edge that two faces have in the same direction, a vertex that
                is in no face or in two fans of faces, or a face with less than 3 different corners.
        """
        polygons = tuple(tuple(int(corner) for corner in face) for face in faces)
        depth = whole(levels)
        if depth is None or depth < 1 or not polygons:
            raise UsageError(f"{len(polygons)} faces are to have {levels} levels: expected 1 or more of both")
        if (least := min(map(len, polygons))) < 3:
            raise UsageError(f"a face has {least} corners: expected 3 or more")
        if twice := [face for face in polygons if len(set(face)) < len(face)]:
            raise UsageError(f"the face {twice[0]} has a corner twice: expected different vertices")
        corners, sides = np.array([c for face in polygons for c in face]), np.array([len(face) for face in polygons])
        if corners.min() < 0:
            raise UsageError(f"a face has the corner {corners.min()}: expected numbers of vertices, from 0 on")
        used, count = np.unique(corners), int(corners.max()) + 1
        if len(used) < count:
            loose = int((used != np.arange(len(used))).argmax())
            raise UsageError(f"vertex {loose} is in no face: expected a mesh without loose vertices")
        mean = _Sparse(np.arange(count), np.arange(count), np.ones(count))
        for _ in range(depth):
            level, quads = _refined(corners, sides)
            mean = level @ mean
            corners, sides = quads.reshape(-1), np.full(len(quads), 4)
        sources, weights = mean.rows_of(-1)
        triangles = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
        made_of = np.where(weights > 0, sources, -1)[triangles].reshape(len(triangles), -1)
        supports, _ = _Sparse(*_pairs(made_of), np.ones(np.count_nonzero(made_of >= 0))).rows_of(-1)
        numbers = {"quads": quads, "triangles": triangles, "sources": np.maximum(sources, 0), "supports": supports}
        made: dict[str, Any] = {name: each.astype(np.int32) for name, each in numbers.items()}
        return cls(**made, weights=weights.astype(np.float32), _faces=polygons, _levels=depth)

    def to(self, device: str) -> Subdivision:
        """The same as tensors."""
        import torch

        arrays = [field.name for field in fields(self) if not field.name.startswith("_")]
        moved: Any = {name: torch.as_tensor(getattr(self, name), device=device) for name in arrays}
        return replace(self, **moved)

    def refine(self, vertices: Array) -> Array:
        """(V, C) values of refined vertices, from those of control vertices (N, C), of any floating-point dtype.

        Arrays go with arrays, and tensors with what `to` made; gradients flow to tensors.

        Raises:
            UsageError: vertices are another kind of array or of numbers, or another number of them.
        """
        needed = max(max(face) for face in self._faces) + 1
        checked("vertices", vertices, ("the subdivision", self.weights), (), ((needed, "C"),))
        if not dtype_of(vertices).startswith(("float", "bfloat")):  # as whole numbers, weights would be 0
            raise UsageError(f"vertices is {dtype_of(vertices)}: expected floating-point numbers")
        xp: Any = np
        if not is_array(vertices):
            import torch as xp
        refined: Array = xp.einsum("vk,vkc->vc", xp.asarray(self.weights, dtype=vertices.dtype), vertices[self.sources])
        return refined

    def refine_corners(self, values: NDArray[Any]) -> NDArray[Any]:
        """(F, 4, C) values at the corners of refined faces, linear between those of the control faces' corners.

        So texture coordinates are carried along, which may differ between the faces at a vertex.

        Args:
            values: (sum of the faces' corners, C), face by face.

        Raises:
            UsageError: no array, or another number of values.
        """
        sides = np.array([len(face) for face in self._faces])
        checked("values", values, ("the list of faces", sides), (), ((int(sides.sum()), "C"),), "one for each corner")
        for _ in range(self._levels):
            of, following = np.repeat(np.arange(len(sides)), sides), _following(sides)
            middle = (values + values[following]) / 2
            centre = np.add.reduceat(values, np.cumsum(sides) - sides) / sides[:, None]
            before = np.empty_like(middle)
            before[following] = middle
            values = np.stack([values, middle, centre[of], before], 1).reshape(-1, values.shape[1])
            sides = np.full(len(of), 4)
        return values.reshape(-1, 4, values.shape[1])


@dataclass(frozen=True)
class _Sparse:
    """A matrix by its entries; those at the same place are added."""

    row: Ints
    column: Ints
    value: NDArray[np.float64]

    def __matmul__(self, other: _Sparse) -> _Sparse:
        order = np.argsort(other.row, kind="stable")
        counts = np.bincount(other.row, minlength=int(self.column.max(initial=-1)) + 1)
        starts, length = np.cumsum(counts) - counts, counts[self.column]
        mine = np.repeat(np.arange(len(self.row)), length)
        within = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
        theirs = order[starts[self.column[mine]] + within]
        product = self.value[mine] * other.value[theirs]
        return _Sparse(self.row[mine], other.column[theirs], product).summed()

    def summed(self) -> _Sparse:
        """The same, each place once, row by row."""
        width = int(self.column.max(initial=0)) + 1
        keys, place = np.unique(self.row * width + self.column, return_inverse=True)
        value: Any = np.bincount(place, self.value)
        return _Sparse(keys // width, keys % width, value)

    def rows_of(self, none: int) -> tuple[Ints, NDArray[np.float64]]:
        """(R, K) columns and values of each row, `none` and 0 behind the last."""
        entries = self.summed()
        counts = np.bincount(entries.row)
        place = np.arange(len(entries.row)) - np.repeat(np.cumsum(counts) - counts, counts)
        columns, values = np.full((len(counts), counts.max()), none), np.zeros((len(counts), counts.max()))
        columns[entries.row, place], values[entries.row, place] = entries.column, entries.value
        return columns, values


def _pairs(listed: Ints) -> tuple[Ints, Ints]:
    row, place = np.nonzero(listed >= 0)
    return row, listed[row, place]


def _following(sides: Ints) -> Ints:
    """For each corner of all faces the next one of its face."""
    ends = np.cumsum(sides)
    following = np.arange(ends[-1]) + 1
    following[ends - 1] = ends - sides
    return following


def _fan(corners: Ints, following: Ints, edge: Ints, rim: NDArray[np.bool_]) -> Ints:
    """(V,) how many faces a walk around each vertex meets, from one of its faces over the edges at the vertex."""
    order = np.argsort(edge, kind="stable")
    twins = np.flatnonzero(edge[order][1:] == edge[order][:-1])
    opposite = np.zeros_like(corners)
    opposite[order[twins]], opposite[order[twins + 1]] = order[twins + 1], order[twins]
    # The corner that a fan begins with follows the one that it ends with.
    first, last = np.zeros(corners.max() + 1, np.int64), np.flatnonzero(rim[edge])
    first[corners[following[last]]] = following[last]
    turned = np.where(rim[edge], first[corners], following[opposite])
    first[corners] = np.arange(len(corners))
    vertex, met = np.arange(len(first)), np.zeros(len(first), np.int64)
    at = first
    while len(vertex):
        met[vertex] += 1
        on = turned[at] != first[vertex]
        vertex, at = vertex[on], turned[at][on]
    return met


def _refined(corners: Ints, sides: Ints) -> tuple[_Sparse, Ints]:
    """One level: refined vertices as means of the vertices, and the refined faces (a quad for each corner).

    Vertices are numbered as vertex points, edge points, face points.
    """
    count, of = int(corners.max()) + 1, np.repeat(np.arange(len(sides)), sides)
    following = _following(sides)
    a, b = corners, corners[following]
    if len(np.unique(a * count + b)) < len(a):
        raise UsageError("two faces run along an edge in the same direction: expected faces turned alike, two an edge")
    edges, edge = np.unique(np.minimum(a, b) * count + np.maximum(a, b), return_inverse=True)
    first, second = edges // count, edges % count
    rim = np.bincount(edge, minlength=len(edges)) == 1
    valence, on_rim = np.bincount(corners, minlength=count), np.zeros(count, np.int64)
    for end in (first, second):
        on_rim += np.bincount(end[rim], minlength=count)
    if ((on_rim != 0) & (on_rim != 2)).any() or (_fan(corners, following, edge, rim) < valence).any():
        raise UsageError("two fans of faces meet at a vertex: expected one fan, or one ring, around each vertex")

    face_points = _Sparse(of, corners, 1 / sides[of])
    inner_edge, inner = ~rim[edge], on_rim == 0
    n = valence.astype(float)
    every, points = np.arange(len(edges)), np.arange(count)
    # An edge point: the mean of the ends and of the two face points; on the boundary of the ends (sharp rule).
    share = np.where(rim, 0.5, 0.25)
    edge_rows = [
        _Sparse(every, first, share),
        _Sparse(every, second, share),
        _Sparse(edge[inner_edge], of[inner_edge], np.full(inner_edge.sum(), 0.25)) @ face_points,
    ]
    # A vertex point: (Q + 2 R + (n - 3) S) / n, with the means Q of face points and R of the edges' middles.
    ours = inner[corners]
    vertex_rows = [
        _Sparse(corners[ours], of[ours], 1 / n[corners[ours]] ** 2) @ face_points,
        _Sparse(points[inner], points[inner], (n[inner] - 3) / n[inner]),
        _Sparse(points[~inner], points[~inner], np.full((~inner).sum(), 0.75)),
    ]
    for end, other in ((first, second), (second, first)):
        at, on = inner[end], rim
        vertex_rows += [
            _Sparse(end[at], end[at], 1 / n[end[at]] ** 2),
            _Sparse(end[at], other[at], 1 / n[end[at]] ** 2),
            _Sparse(end[on], other[on], np.full(on.sum(), 0.125)),
        ]
    before = np.empty_like(edge)
    before[following] = edge
    quads = np.stack([corners, count + edge, count + len(edges) + of, count + before], -1)
    parts = [*((0, rows) for rows in vertex_rows), *((count, rows) for rows in edge_rows)]
    parts.append((count + len(edges), face_points))
    row, column, value = (
        np.concatenate(each)
        for each in zip(*((offset + rows.row, rows.column, rows.value) for offset, rows in parts), strict=True)
    )
    return _Sparse(row, column, value), quads
