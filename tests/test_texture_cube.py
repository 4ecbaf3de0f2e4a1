"""Cube maps: faces, seams, corners, vectors without a direction."""

from __future__ import annotations

from itertools import combinations, product
from typing import Any

import numpy as np
import pytest

from mipbake.sampling import reference, texture, texture_construct_mip

SIZES = (1, 2, 3, 5, 8)

# OpenGL 4.6, table 8.19, solved for the direction at (s, t) of each face: sc = 2 s - 1, tc = 2 t - 1.
TOWARDS = (
    lambda sc, tc: (1, -tc, -sc),
    lambda sc, tc: (-1, -tc, sc),
    lambda sc, tc: (sc, 1, tc),
    lambda sc, tc: (sc, -1, -tc),
    lambda sc, tc: (sc, -tc, 1),
    lambda sc, tc: (-sc, -tc, -1),
)


def lookup(tex: Any, vectors: Any, **options: Any) -> Any:
    """(P, C) of one (6, S, S, C) cube map at (P, 3)."""
    return texture(tex[None], np.asarray(vectors)[None, None], boundary_mode="cube", **options)[0, 0]


def centres(size: int) -> Any:
    """(6, S, S, 3) vectors towards the centre of every texel."""
    c = (2 * np.arange(size) + 1) / size - 1
    return np.array([[[TOWARDS[face](sc, tc) for sc in c] for tc in c] for face in range(6)])


@pytest.mark.parametrize("size", SIZES)
def test_texel_centres_return_the_texels(size: int) -> None:
    tex = np.random.default_rng(1).random((6, size, size, 3))
    for length in (1, 0.125, 3):
        vectors = centres(size).reshape(-1, 3) * length
        for filter_mode in ("nearest", "linear"):
            out = lookup(tex, vectors, filter_mode=filter_mode)
            np.testing.assert_allclose(out, tex.reshape(-1, 3), rtol=1e-14)
    np.testing.assert_array_equal(lookup(tex, centres(size).reshape(-1, 3)), tex.reshape(-1, 3))


EDGES = [
    (axes, signs) for axes in combinations(range(3), 2) for signs in product((-1.0, 1.0), repeat=2)
]  # two coordinates at +-1, the third free: 12


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("lod", [0.0, 0.6])
def test_lookups_are_continuous_across_all_edges_and_corners(size: int, lod: float) -> None:
    tex = np.random.default_rng(2).random((6, size, size, 2))
    step, along = 1e-7, np.linspace(-1, 1, 101)
    for (a, b), (sign_a, sign_b) in EDGES:
        edge = np.empty((len(along), 3))
        edge[:, a], edge[:, b], edge[:, 3 - a - b] = sign_a, sign_b, along
        sides = []
        for axis in (a, b):  # towards the face of that axis
            inside = edge.copy()
            inside[:, axis] *= 1 + step
            sides.append(lookup(tex, inside, mip_level_bias=[[[lod]]]))
        np.testing.assert_allclose(sides[0], sides[1], rtol=0, atol=20 * size * step)
    for corner in product((-1.0, 1.0), repeat=3):
        around = np.array(corner) * (1 + step * (1 - np.eye(3)[[0, 1, 2, 0, 1, 2]] * [[1], [1], [1], [2], [2], [2]]))
        values = lookup(tex, around, mip_level_bias=[[[lod]]])
        assert np.ptp(values, axis=0).max() < 20 * size * step


@pytest.mark.parametrize("size", SIZES)
def test_a_corner_is_the_mean_of_its_three_texels(size: int) -> None:
    tex = np.random.default_rng(3).random((6, size, size, 4))
    where = centres(size)
    for corner in product((-1.0, 1.0), repeat=3):
        meeting = []
        for face in range(6):
            if np.sign(np.array(TOWARDS[face](0, 0))) @ corner > 0:
                nearest = np.argmax(where[face].reshape(-1, 3) @ corner)
                meeting.append(tex[face].reshape(-1, 4)[nearest])
        assert len(meeting) == 3
        np.testing.assert_allclose(lookup(tex, [corner])[0], np.mean(meeting, 0), rtol=1e-12)


def test_a_linear_field_on_the_sides_has_no_seam() -> None:
    """Height as a colour: around the four side faces it is a linear ramp that all of them share."""
    size = 16
    tex = np.ascontiguousarray(centres(size)[..., 1:2])
    azimuth, height = np.linspace(0, 2 * np.pi, 1000), 0.4
    direction = np.stack([np.cos(azimuth), np.zeros_like(azimuth), np.sin(azimuth)], -1)
    direction /= np.abs(direction).max(-1, keepdims=True)
    direction[:, 1] = height
    np.testing.assert_allclose(lookup(tex, direction), height, rtol=0, atol=1e-12)


@pytest.mark.parametrize("filter_mode", ["nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear"])
def test_vectors_without_a_direction_give_zeros_and_no_gradients(filter_mode: str) -> None:
    import torch

    tex = torch.rand(1, 6, 4, 4, 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    invalid = [[0, 0, 0], [np.nan, 1, 0], [0, np.inf, 1], [-np.inf] * 3, [1, 2, np.nan], [-0.0, 0.0, -0.0]]
    uv = torch.tensor([*invalid, [1, 0.2, -0.3], [1e-300, 0, 0], [1e300, -1e300, 0]], dtype=torch.float64)
    uv = uv[None, None].requires_grad_()
    uv_da = torch.full((1, 1, len(uv[0, 0]), 6), 0.1, dtype=torch.float64, requires_grad=True)
    bias = torch.zeros(1, 1, len(uv[0, 0]), dtype=torch.float64, requires_grad=True)
    tex.requires_grad_()
    out = texture(tex, uv, uv_da, bias, filter_mode=filter_mode, boundary_mode="cube")
    assert torch.all(out[0, 0, :6] == 0) and torch.all(out[0, 0, 6:] > 0)
    out[0, 0, :6].sum().backward()
    for leaf in (tex, uv, uv_da, bias):
        assert leaf.grad is None or torch.all(leaf.grad == 0)


def test_each_face_filters_by_itself() -> None:
    tex = np.random.default_rng(5).random((2, 6, 7, 7, 3))
    cube = texture_construct_mip(tex, cube_mode=True)
    for face in range(6):
        flat = texture_construct_mip(np.ascontiguousarray(tex[:, face]))
        for a, b in zip(cube.levels, flat.levels, strict=True):
            np.testing.assert_array_equal(a[:, face], b)
    assert [level.shape for level in cube.levels] == [(2, 6, 3, 3, 3), (2, 6, 1, 1, 3)]


def test_the_level_follows_the_projection() -> None:
    """A pixel that turns the vector by a texel of the middle of a face sees level 0; by 2^L texels, level L."""
    size = 32
    levels = [np.full((1, 6, size >> level, size >> level, 1), float(level)) for level in range(6)]
    for level in range(6):
        for direction, length in (((1, 0, 0), 1.0), ((0, -2, 0), 2.0), ((0, 0, 0.5), 0.5)):
            turn = np.zeros(6)
            turn[2 * ((int(np.argmax(np.abs(direction))) + 1) % 3)] = length * 2 / size * 2**level
            out = texture(
                levels[0],
                np.array(direction, float).reshape(1, 1, 1, 3),
                turn.reshape(1, 1, 1, 6),
                mip=levels[1:],
                boundary_mode="cube",
            )
            assert out.item() == pytest.approx(level, abs=1e-12)
    # Lengthening the vector alone moves nothing: no footprint, level 0.
    radial = np.array([0.3, 0, -0.6, 0, 1.2, 0]).reshape(1, 1, 1, 6)
    out = texture(levels[0], np.array([[[[0.3, -0.6, 1.2]]]]), radial, mip=levels[1:], boundary_mode="cube")
    assert out.item() == 0


def test_the_twin_agrees_on_edges_and_corners() -> None:
    import torch

    generator = torch.Generator().manual_seed(6)
    for size in SIZES:
        tex = torch.rand(1, 6, size, size, 2, generator=generator, dtype=torch.float64)
        on_cube = torch.rand(1, 4, 200, 3, generator=generator, dtype=torch.float64) * 2 - 1
        near = torch.where(on_cube.abs() > 0.4, on_cube.sign() * (1 - on_cube.abs() * 1e-3), on_cube)
        torch.testing.assert_close(
            texture(tex, near, boundary_mode="cube"),
            reference.texture(tex, near, boundary_mode="cube"),
            rtol=1e-12,
            atol=1e-12,
        )
