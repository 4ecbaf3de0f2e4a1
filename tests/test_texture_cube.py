"""Cube maps: faces, seams, corners, vectors without a direction."""

from __future__ import annotations

from itertools import combinations, product
from typing import Any

import numpy as np
import pytest

from mipbake.sampling import reference, texture

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
