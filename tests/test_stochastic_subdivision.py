"""Catmull-Clark subdivision against what is known of it in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from mipbake import stochastic
from mipbake.base.errors import UsageError
from mipbake.stochastic import Subdivision

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))

SIDE = 7
GRID = np.arange(SIDE**2).reshape(SIDE, SIDE)
FLAT = np.stack([GRID[:-1, :-1], GRID[:-1, 1:], GRID[1:, 1:], GRID[1:, :-1]], -1).reshape(-1, 4)
"""A bounded mesh with faces row by row."""

TETRAHEDRON = [(0, 1, 2), (0, 3, 1), (1, 3, 2), (0, 2, 3)]

MIXED = ((0, 1, 2), (0, 2, 3, 4), (0, 4, 5, 6, 1))
"""A triangle, a quad and a pentagon around vertex 0."""


def test_a_cube_becomes_what_the_paper_says() -> None:
    """By hand: face points at 1, edge points at 3/4, vertex points at (1/3 + 2 2/3 + 0) / 3 = 5/9."""
    once = Subdivision.of(SIDES, 1)
    refined = np.abs(once.refine(CUBE))
    np.testing.assert_allclose(refined[:8], 5 / 9, atol=1e-6)
    np.testing.assert_allclose(np.sort(refined[8:20], 1), np.tile([0, 0.75, 0.75], (12, 1)), atol=1e-6)
    np.testing.assert_allclose(np.sort(refined[20:], 1), np.tile([0, 0, 1], (6, 1)), atol=1e-6)
    assert once.quads.shape == (24, 4) and once.triangles.shape == (48, 3)


def limit(vertices: NDArray[Any], faces: Any, at: int) -> NDArray[Any]:
    """Where a vertex amid quads ends: (n^2 S + 4 sum of E + sum of F) / (n (n + 5)) (Halstead et al. 1993)."""
    around = [[int(c) for c in face] for face in faces if at in face]
    turned = [face[face.index(at) :] + face[: face.index(at)] for face in around]
    beside, across = (sum(vertices[face[k]] for face in turned) for k in (1, 2))
    n = len(around)
    return np.asarray((n**2 * vertices[at] + 4 * beside + across) / (n * (n + 5)))


def test_limits_do_not_move_with_the_level() -> None:
    wild = CUBE + np.random.default_rng(0).uniform(-0.3, 0.3, CUBE.shape)
    expected = [limit(wild, SIDES, at) for at in range(8)]
    for levels in (1, 2, 5):
        fine = Subdivision.of(SIDES, levels)
        refined = fine.refine(wild)
        found = [limit(refined, fine.quads, at) for at in range(8)]
        np.testing.assert_allclose(found, expected, atol=2e-6)
    np.testing.assert_allclose(refined[:8], expected, atol=4e-3)


def test_a_regular_patch_is_a_bicubic_b_spline() -> None:
    """Two levels on a regular mesh insert knots at quarters: products of what they do to one cubic B-spline."""
    heights = np.random.default_rng(1).uniform(-1, 1, (SIDE, SIDE))
    fine = Subdivision.of(FLAT, 2)
    where = fine.refine(np.argwhere(np.ones((SIDE, SIDE))).astype(float))
    values = fine.refine(heights.reshape(-1, 1))[:, 0]

    def knots(rows: NDArray[Any]) -> NDArray[Any]:
        inserted = np.empty((2 * len(rows) - 3, rows.shape[1]))
        inserted[0::2] = (rows[:-1] + rows[1:])[: len(rows) - 1] / 2
        inserted[1::2] = (rows[:-2] + 6 * rows[1:-1] + rows[2:]) / 8
        return inserted

    expected = heights
    for _ in range(2):
        expected = knots(knots(expected).T).T
    # Control points at 0 to 6 become points at 1/2 to 5 1/2, then 3/4 to 5 1/4, a quarter apart.
    inner = ((where > 1.9) & (where < 4.1)).all(1)
    assert inner.sum() == 81
    row, column = np.rint((where[inner] - 0.75) * 4).astype(int).T
    np.testing.assert_allclose(values[inner], expected[row, column], atol=1e-6)


def test_a_boundary_is_a_cubic_b_spline_that_ignores_the_inside() -> None:
    fine, rim = Subdivision.of(FLAT, 2), {*GRID[0], *GRID[-1], *GRID[:, 0], *GRID[:, -1]}
    inside = [vertex for vertex in range(SIDE**2) if vertex not in rim]
    edges: dict[tuple[int, int], int] = {}
    for quad in fine.quads:
        for a, b in zip(quad, np.roll(quad, -1), strict=True):
            edges[min(a, b), max(a, b)] = edges.get((min(a, b), max(a, b)), 0) + 1
    border = sorted({vertex for edge, faces in edges.items() if faces == 1 for vertex in edge})
    assert len(border) == 4 * (SIDE - 1) * 4
    used = fine.sources[border][fine.weights[border] > 0]
    assert not set(used) & set(inside)


@pytest.mark.parametrize(("faces", "count"), [(SIDES, 8), (FLAT, SIDE**2), (MIXED, 7)])
@pytest.mark.parametrize("levels", [1, 3])
def test_weights_are_a_partition_of_unity_and_supports_name_them_all(faces: Any, count: int, levels: int) -> None:
    fine = Subdivision.of(faces, levels)
    assert fine.weights.min() >= 0
    np.testing.assert_allclose(fine.weights.sum(1), 1, atol=1e-6)
    moved = np.random.default_rng(2).normal(size=(count, 1))
    steady = fine.refine(moved)
    for vertex in range(count):
        moved[vertex] += 1
        changed = (np.abs(fine.refine(moved) - steady) > 1e-9)[fine.triangles].any((1, 2))
        moved[vertex] -= 1
        assert ((fine.supports == vertex).any(1) == changed).all()
    ids = np.array([[0], [1], [len(fine.triangles)]], np.int32)
    touched = stochastic.touched_vertices(ids, fine.supports)
    assert (touched[0] == -1).all() and (touched[1:] == fine.supports[[0, -1]]).all()


def test_faces_stay_turned_and_corners_are_carried_along() -> None:
    fine = Subdivision.of(SIDES, 2)
    points = fine.refine(CUBE)
    a, b, c = (points[fine.triangles[:, corner]] for corner in range(3))
    assert (np.einsum("ti,ti->t", np.cross(b - a, c - a), a + b + c) > 0).all()
    square = np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (6, 1))
    uv = fine.refine_corners(square)
    assert uv.shape == (96, 4, 2)
    sides = uv - np.roll(uv, 1, 1)
    np.testing.assert_allclose(np.abs(sides).max((1, 2)), 0.25)
    np.testing.assert_allclose(uv.mean(1).reshape(6, 16, 2).mean(1), 0.5)
    # On a flat regular mesh the corners move as vertices do.
    plane, places = Subdivision.of(FLAT, 2), np.argwhere(np.ones((SIDE, SIDE))).astype(float)
    corners, vertices = plane.refine_corners(places[FLAT.reshape(-1)]), plane.refine(places)[plane.quads]
    inside = ((corners > 1) & (corners < SIDE - 2)).all((1, 2))
    assert inside.sum() > 50
    np.testing.assert_allclose(corners[inside], vertices[inside], atol=1e-6)
    pentagon = Subdivision.of(MIXED, 1).refine_corners(np.arange(12.0)[:, None])
    assert pentagon[7:, 2].tolist() == [[9.0]] * 5  # the mean of 7 to 11


def test_tensors_give_the_same_and_have_gradients() -> None:
    fine = Subdivision.of(SIDES, 2)
    points = torch.tensor(CUBE, requires_grad=True)
    refined = fine.to("cpu").refine(points)
    np.testing.assert_allclose(refined.detach().numpy(), fine.refine(CUBE), atol=1e-12)
    refined[5, 0].backward()
    assert points.grad is not None and points.grad.sum() == pytest.approx(1)


def test_what_is_no_mesh_gets_a_sentence() -> None:
    for faces, levels, said in (
        (SIDES, 0, "6 faces are to have 0 levels"),
        ([], 1, "0 faces"),
        ([(0, 1)], 1, "a face has 2 corners"),
        ([(0, 1, -2)], 1, "corner -2"),
        ([(0, 1, 2), (0, 1, 3)], 1, "the same direction"),
        ([(0, 1, 3)], 1, "vertex 2 is in no face"),
        ([(0, 1, 2), (0, 3, 4)], 1, "two fans"),
        (TETRAHEDRON + [tuple(c and c + 3 for c in face) for face in TETRAHEDRON], 1, "two fans"),
        ([*TETRAHEDRON, (0, 4, 5)], 1, "two fans"),
        ([(0, 1, 1)], 1, r"the face \(0, 1, 1\) has a corner twice"),
        ([(0, 1, 10**12)], 1, "vertex 2 is in no face"),
        (SIDES, 1.5, "6 faces are to have 1.5 levels"),
    ):
        with pytest.raises(UsageError, match=said):
            Subdivision.of(faces, levels)
    fine = Subdivision.of(SIDES, 1)
    with pytest.raises(UsageError, match=r"shape \(7, 3\): expected \(8, C\)"):
        fine.refine(CUBE[:7])
    with pytest.raises(UsageError, match="Tensor"):
        fine.refine(torch.tensor(CUBE))
    with pytest.raises(UsageError, match="vertices is int64: expected floating-point numbers"):
        fine.refine(CUBE.astype(np.int64))
    with pytest.raises(UsageError, match=r"expected \(24, C\)"):
        fine.refine_corners(CUBE)
