"""Random and regular meshes for the tests of the raster primitives."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake import _native

needs_cuda = pytest.mark.skipif(
    not (torch.cuda.is_available() and _native.cuda_compiled()),
    reason="no CUDA device and CUDA kernels here: the GPU kernels of the raster primitives are not tested",
)


def random_mesh(
    seed: int, batch: int = 1, triangles: int = 12, vertices: int = 20, dtype: torch.dtype = torch.float32
) -> tuple[Tensor, Tensor]:
    """pos (B, V, 4) and tri (T, 3): sizes from slivers to more than the image, either side towards the eye, some behind
    it, some through it, some before the near plane or behind the far one, some degenerate."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-1.6, 1.6, (batch, vertices, 2))
    z = rng.uniform(-1.4, 1.4, (batch, vertices, 1))
    w = np.where(rng.random((batch, vertices, 1)) < 0.2, rng.uniform(-1.5, -0.2, z.shape), rng.uniform(0.4, 3, z.shape))
    drawn = rng.integers(0, vertices, (20 + 2 * triangles, 3))  # some name a vertex twice
    # No two on the same vertices: in which of them a pixel lies would be for rounding to say.
    first = np.unique(np.sort(drawn, 1), axis=0, return_index=True)[1]
    tri = drawn[np.sort(first)[:triangles]]
    assert len(tri) == triangles
    pos = torch.from_numpy(np.concatenate([xy * np.abs(w), z * np.abs(w), w], -1)).float().to(dtype)
    return pos, torch.from_numpy(tri).int()


def grid(columns: int, rows: int, seed: int | None = None) -> tuple[NDArray[np.float64], Tensor]:
    """Points (V, 2) of a grid over [-1, 1]^2, its inner ones moved by less than
    a quarter of a cell where seeded; and its triangles, all the same way round."""
    x, y = np.meshgrid(np.linspace(-1, 1, columns + 1), np.linspace(-1, 1, rows + 1))
    points = np.stack([x, y], -1)
    if seed is not None:
        shift = np.random.default_rng(seed).uniform(-0.24, 0.24, points.shape) * [2 / columns, 2 / rows]
        points[1:-1, 1:-1] += shift[1:-1, 1:-1]
    index = np.arange((columns + 1) * (rows + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    flip = (np.indices(a.shape).sum(0) % 2).astype(bool)[..., None]
    first = np.where(flip, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(flip, np.stack([d, c, b], -1), np.stack([a, d, c], -1))
    tri = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    return points.reshape(-1, 2), torch.from_numpy(tri).int()


def projection(near: float = 0.5, far: float = 20.0, focal: float = 1.5) -> NDArray[np.float64]:
    """OpenGL's perspective matrix, looking along -z; columns times it."""
    a, b = (far + near) / (near - far), 2 * far * near / (near - far)
    return np.array([[focal, 0, 0, 0], [0, focal, 0, 0], [0, 0, a, b], [0, 0, -1, 0]])


def rotation(seed: int) -> NDArray[np.float64]:
    """A random rotation matrix."""
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def cube() -> tuple[NDArray[np.float64], Tensor]:
    """Corners (8, 3) of [-1, 1]^3 and its 12 triangles, counter-clockwise seen from outside."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    tri = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return corners, torch.tensor(tri, dtype=torch.int32)


def seen(points: NDArray[np.float64], distance: float, seed: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """Clip-space positions (1, V, 4) of points (V, 3), turned at random and moved away from the eye."""
    view = points @ rotation(seed).T - [0, 0, distance]
    clip = np.concatenate([view, np.ones((len(view), 1))], 1) @ projection().T
    return torch.from_numpy(clip).to(torch.float32).to(dtype)[None]


def flat(points: NDArray[np.float64], depth: float = 0.0, dtype: torch.dtype = torch.float64) -> Tensor:
    """Positions (1, V, 4) of points (V, 2) of the image plane, with w = 1."""
    z, w = np.full((len(points), 1), depth), np.ones((len(points), 1))
    return torch.from_numpy(np.concatenate([points, z, w], 1)).to(dtype)[None]


@contextmanager
def threads(count: int) -> Iterator[None]:
    """The native core with that many threads."""
    default = _native.num_threads()
    _native.set_num_threads(count)
    try:
        yield
    finally:
        _native.set_num_threads(default)
