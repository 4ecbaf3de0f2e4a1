"""Normals and tangent frames for meshes that bring none.

Frames follow the rules of MikkTSpace (Mikkelsen 2008), which glTF prescribes: a triangle's tangent is the direction in
which u grows; each of its corners projects it into the plane of the corner's normal, and corners of one place are
averaged, weighted by the corners' angles in that plane. Corners are of one place where position, normal, uv and
handedness are equal, whichever indices they had. Triangles without area in the texture take the frame of their
neighbours, or else an arbitrary one.
Different from the original: corners of one place are averaged even where their triangles share no edge (two fans that
touch in one vertex), and triangles without area in the texture join the handedness of the first neighbour.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.meshes.mesh import Mesh

Array = NDArray[np.float64]

_COMPARED = 1 << 20  # times that two corners at one position are compared, at once


def with_tangents(name: str, positions: Array, normals: Array, uv: Array, triangles: NDArray[np.int32]) -> Mesh:
    """The mesh with tangents; vertices where two handednesses meet are split, so V may grow, and T stays.

    The arrays have the shapes and dtypes of the arrays of `Mesh`.
    """
    place = _places(positions, normals, uv)[triangles]  # (T, 3)
    p, t = positions[triangles], uv[triangles] * [1, -1]  # the frame's second axis points up in the image
    e1, e2, f1, f2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    area = f1[:, 0] * f2[:, 1] - f1[:, 1] * f2[:, 0]
    size = np.abs(f1).max(-1) * np.abs(f2).max(-1)
    textured = np.abs(area) > 1e-12 * np.maximum(size, 1e-300)
    side = np.where(area < 0, -1.0, 1.0)
    along = np.where(textured[:, None], (e1 * f2[:, 1:] - e2 * f1[:, 1:]) * side[:, None], 0)

    corner_n = normals[triangles]  # (T, 3, 3)
    tangent = unit(_in_plane(along[:, None], corner_n)) * _angles(p, corner_n)[..., None]

    # What has no area in the texture takes the side of another triangle at one of its places, where there is one.
    first_side = np.zeros(place.max() + 1)
    first_side[place[textured][::-1].reshape(-1)] = np.repeat(side[textured][::-1], 3)
    seen = first_side[place[~textured]]
    side[~textured] = np.where(seen.any(-1), seen[np.arange(len(seen)), (seen != 0).argmax(-1)], 1.0)

    key = place * 2 + (side < 0)[:, None]
    sums = np.zeros((2 * (place.max() + 1), 3))
    np.add.at(sums, key.reshape(-1), tangent.reshape(-1, 3))

    # A vertex for each combination of an old vertex and a side.
    combined, corner = np.unique(triangles.astype(np.int64) * 2 + (side < 0)[:, None], return_inverse=True)
    corner = corner.reshape(-1)
    old, w = combined // 2, np.where(combined % 2, -1.0, 1.0)
    key_of = np.zeros(len(combined), np.int64)
    key_of[corner] = key.reshape(-1)
    n, found = normals[old], sums[key_of]
    found = np.where(np.linalg.norm(found, axis=-1, keepdims=True) > 1e-30, found, any_tangent(n))
    tangents = np.concatenate([unit(_in_plane(found, n)), w[:, None]], -1)
    return Mesh(name, positions[old], n, uv[old], tangents, corner.reshape(-1, 3).astype(np.int32))


def corner_normals(positions: Array, triangles: NDArray[np.int32], crease: float) -> Array:
    """(T, 3, 3) unit normals of corners, for meshes without any.

    A corner's is the mean of the triangles around its position whose planes are turned by at most `crease` degrees from
    its own, weighted by their angles there. So 0 gives flat triangles, and 180 no edge at all.
    """
    p = positions[triangles]
    face = unit(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
    weighted = (face[:, None] * _angles(p, np.zeros_like(p))[..., None]).reshape(-1, 3)
    face = np.repeat(face, 3, 0)
    place = _places(positions)[triangles].reshape(-1)
    around = np.argsort(place, kind="stable")
    first, count = np.searchsorted(place[around], place), np.bincount(place)[place]
    least = np.cos(np.radians(crease)) - 1e-9
    normals = np.empty_like(face)
    for some in np.split(np.arange(len(place)), np.flatnonzero(np.diff(np.cumsum(count) // _COMPARED)) + 1):
        starts = np.cumsum(count[some]) - count[some]
        one = np.repeat(some, count[some])
        other = around[first[one] + np.arange(len(one)) - np.repeat(starts, count[some])]
        counts = (face[one] * face[other]).sum(-1) >= least
        normals[some] = np.add.reduceat(weighted[other] * counts[:, None], starts)
    normals = unit(normals)
    return np.where(normals.any(-1, keepdims=True), normals, [0.0, 1.0, 0.0]).reshape(-1, 3, 3)


def any_tangent(n: Array) -> Array:
    """(N, 3) unit vectors, each normal to one of the (N, 3) unit vectors, in no direction in particular."""
    axis = np.where(np.abs(n[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    return unit(_in_plane(axis, n))


def _places(*arrays: Array) -> NDArray[np.int64]:
    """(V,): an index for each vertex, the same where all its values are."""
    _, index = np.unique(np.concatenate(arrays, -1) + 0.0, axis=0, return_inverse=True)
    return np.asarray(index.reshape(-1), np.int64)


def _angles(p: Array, n: Array) -> Array:
    """(T, 3): the angle of each corner, between its edges in the plane of its normal."""
    ahead = unit(_in_plane(np.roll(p, -1, 1) - p, n))
    behind = unit(_in_plane(np.roll(p, 1, 1) - p, n))
    return np.asarray(np.arccos(np.clip((ahead * behind).sum(-1), -1, 1)))


def _in_plane(v: Array, n: Array) -> Array:
    return np.asarray(v - (v * n).sum(-1, keepdims=True) * n)


def unit(v: Array) -> Array:
    """v / |v|; 0 where v is 0."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(v / np.where(length > 0, length, 1))
