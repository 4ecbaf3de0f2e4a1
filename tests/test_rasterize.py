"""rasterize: against its twin, against geometry computed independently, and what no image may show."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from mipbake.base.errors import UsageError
from mipbake.raster import DepthPeeler, RasterizeContext, rasterize, reference

from .raster_scenes import cube, flat, grid, needs_cuda, projection, random_mesh, rotation

SIDES = st.integers(1, 20)
SEEDS = st.integers(0, 2**32 - 1)


def assert_same_layer(result: tuple[Tensor, Tensor], twin: tuple[Tensor, Tensor]) -> None:
    """Asserts the same triangles, and values that are equal but for rounding."""
    (rast, db), (expected, expected_db) = result, twin
    assert rast.dtype == expected.dtype and rast.shape == expected.shape and db.shape == expected_db.shape
    assert torch.equal(rast[..., 3], expected[..., 3])
    torch.testing.assert_close(rast, expected, rtol=0, atol=1e-6 if rast.dtype == torch.float32 else 1e-10)
    scale = 1 + expected_db.abs().amax(-1, keepdim=True)
    torch.testing.assert_close(db / scale, expected_db / scale, rtol=0, atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, height=SIDES, width=SIDES, batch=st.integers(1, 3), triangles=st.integers(0, 14))
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_random_triangles(dtype: torch.dtype, seed: int, height: int, width: int, batch: int, triangles: int) -> None:
    pos, tri = random_mesh(seed, batch, triangles, dtype=dtype)
    assert_same_layer(rasterize(None, pos, tri, (height, width)), reference.rasterize(pos, tri, (height, width)))


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, height=SIDES, width=SIDES)
def test_random_ranges(seed: int, height: int, width: int) -> None:
    pos, tri = random_mesh(seed, 1, 12)
    rng = np.random.default_rng(seed)
    start = rng.integers(0, 13, 4)
    count = [rng.integers(0, 13 - s) for s in start]  # may be none
    ranges = torch.tensor(np.stack([start, count], 1), dtype=torch.int32)
    result = rasterize(None, pos[0], tri, (height, width), ranges)
    assert_same_layer(result, reference.rasterize(pos[0], tri, (height, width), ranges))
    for item, (s, c) in enumerate(ranges.tolist()):
        rast, _ = rasterize(None, pos, tri[s : s + c], (height, width))
        ids = torch.where(rast[0, ..., 3] > 0, rast[0, ..., 3] + s, 0)
        assert torch.equal(result[0][item, ..., 3], ids)
        assert torch.equal(result[0][item, ..., :3], rast[0, ..., :3])


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_vertices_at_pixel_centres(seed: int) -> None:
    """Every decision is a tie, and the twin decides it in exact arithmetic."""
    rng = np.random.default_rng(seed)
    H, W = 6, 10
    points = np.stack([rng.integers(-2, W + 2, 15) * 2 + 1 - W, rng.integers(-2, H + 2, 15) * 2 + 1 - H], -1)
    w = 2.0 ** rng.integers(-2, 3, (15, 1)) * np.array([W * H])
    pos = torch.from_numpy(np.concatenate([points * [H, W] * w / (W * H), 0 * w, w], 1)).float()[None]
    tri = torch.from_numpy(rng.integers(0, 15, (6, 3))).int()
    for t in range(len(tri)):
        result, twin = (
            f(tri[t : t + 1])[0]
            for f in (lambda one: rasterize(None, pos, one, (H, W)), lambda one: reference.rasterize(pos, one, (H, W)))
        )
        assert torch.equal(result[..., 3], twin[..., 3])


def cover_counts(pos: Tensor, tri: Tensor, size: tuple[int, int]) -> Tensor:
    """How many triangles cover each pixel, each rasterised by itself."""
    one = torch.stack([torch.arange(len(tri)), torch.ones(len(tri), dtype=torch.int64)], 1).int()
    rast, _ = rasterize(None, pos[0], tri, size, ranges=one)
    return (rast[..., 3] > 0).sum(0)


@pytest.mark.parametrize("size", [(16, 16), (16, 24), (15, 17)])
@pytest.mark.parametrize("seed", [None, 1, 2])
def test_watertight_plane(size: tuple[int, int], seed: int | None) -> None:
    """A tessellation over all of the image covers each pixel once; without a seed, its vertices lie on pixel centres or
    on lines through them."""
    points, tri = grid(8, 8, seed)
    for scale in (1.0, 1 - 1 / 16, 1.25):
        counts = cover_counts(flat(points * scale, dtype=torch.float32), tri, size)
        if scale >= 1:
            assert torch.all(counts == 1)
        else:
            assert torch.all(counts <= 1) and torch.all(counts[1:-1, 1:-1] == 1)


def test_nothing_to_draw() -> None:
    pos, tri = random_mesh(0)
    none = torch.empty(0, 3, dtype=torch.int32)
    degenerate = torch.tensor([[3, 3, 5], [4, 4, 4], [7, 8, 7]], dtype=torch.int32)
    line = flat(np.array([[-1.0, -1], [0, 0], [1, 1]]), dtype=torch.float32)
    behind = pos.clone()
    behind[..., 3] = -behind[..., 3].abs()
    outside = flat(np.array([[1.1, -1], [4, 0], [1.1, 1]]), dtype=torch.float32)
    before, beyond = (flat(np.array([[-1.0, -1], [3, -1], [-1, 3]]), z, torch.float32) for z in (-1.01, 1.01))
    first = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    scenes = [(pos, none), (pos, degenerate), (line, first), (behind, tri)]
    for points, triangles in (*scenes, (outside, first), (before, first), (beyond, first)):
        leaf = points.clone().requires_grad_()
        rast, db = rasterize(None, leaf, triangles, (7, 5))
        assert torch.all(rast == 0) and torch.all(db == 0)
        (rast.sum() + db.sum()).backward()
        assert leaf.grad is not None and torch.all(leaf.grad == 0)
    empty = torch.empty(0, 20, 4)
    assert rasterize(None, empty, tri, (7, 5))[0].shape == (0, 7, 5, 4)
    assert rasterize(None, pos[0], tri, (7, 5), torch.empty(0, 2, dtype=torch.int32))[0].shape == (0, 7, 5, 4)


def test_nearest_wins_and_the_first_of_equals() -> None:
    points = np.array([[-1.0, -1], [3, -1], [-1, 3]])
    pos = torch.cat([flat(points, z, torch.float32) for z in (0.5, -0.25, 0.25, -0.25)], 1)
    tri = torch.arange(12, dtype=torch.int32).view(4, 3)
    assert torch.all(rasterize(None, pos, tri, (3, 3))[0][..., 3] == 2)
    order = torch.tensor([3, 2, 0, 1])
    assert torch.all(rasterize(None, pos, tri[order], (3, 3))[0][..., 3] == 1)
    same = tri[:1].repeat(5, 1)
    assert torch.all(rasterize(None, pos, same, (3, 3))[0][..., 3] == 1)


@pytest.mark.parametrize("seed", range(3))
def test_barycentrics_are_those_of_the_rays(seed: int) -> None:
    """Perspective-correct (u, v) and depth, against rays cast into the scene (Cramer's rule in view space)."""
    corners, tri = cube()
    turned = corners @ rotation(seed).T - [0, 0, 4.0]
    matrix = projection()
    clip = np.concatenate([turned, np.ones((8, 1))], 1) @ matrix.T
    H, W = 21, 34
    rast, db = rasterize(None, torch.from_numpy(clip)[None], tri, (H, W))

    def hit(row: float, column: float, corner: np.ndarray) -> np.ndarray:
        ray = np.array([((2 * column + 1) / W - 1) / 1.5, ((2 * row + 1) / H - 1) / 1.5, -1.0])
        weights = np.linalg.solve(corner.T, ray)  # of the corners, up to the distance
        return np.append(weights / weights.sum(), 1 / weights.sum())

    checked = 0
    for row, column in np.argwhere(rast[0, ..., 3].numpy() > 0):
        values = rast[0, row, column].numpy()
        corner = turned[tri[int(values[3]) - 1].numpy()]
        u, v, _, distance = hit(row, column, corner)
        assert values[:2] == pytest.approx([u, v], abs=1e-12)
        assert values[2] == pytest.approx((matrix[2, 2] * -distance + matrix[2, 3]) / distance, abs=1e-12)
        e = 1e-5
        along = (hit(row, column + e, corner) - hit(row, column - e, corner))[:2] / (2 * e)
        across = (hit(row + e, column, corner) - hit(row - e, column, corner))[:2] / (2 * e)
        expected = [along[0], across[0], along[1], across[1]]
        assert db[0, row, column].numpy() == pytest.approx(expected, abs=1e-7)
        checked += 1
    assert checked > 100


def test_depth_peeling() -> None:
    """Layers equal the sorted depths of single triangles."""
    pos, tri = random_mesh(3, 2, 10)
    size = (17, 13)
    single = torch.stack([rasterize(None, pos, tri[t : t + 1], size)[0][..., 2:] for t in range(10)])
    depths = torch.where(single[..., 1] > 0, single[..., 0], torch.inf).sort(0).values
    with DepthPeeler(None, pos, tri, size) as peeler:
        previous = twin = None
        for layer in range(11):
            rast, db = peeler.rasterize_next_layer()
            twin, twin_db = reference.rasterize(pos, tri, size, previous=twin)
            assert_same_layer((rast, db), (twin, twin_db))
            expected = depths[layer] if layer < 10 else torch.full_like(depths[0], torch.inf)
            assert torch.equal(torch.where(rast[..., 3] > 0, rast[..., 2], torch.inf), expected)
            if previous is not None:
                drawn = rast[..., 3] > 0
                assert torch.all(rast[..., 2][drawn] > previous[..., 2][drawn])
                assert torch.all(previous[..., 3][drawn] > 0)
            previous = rast
    assert torch.all(rast == 0)


def test_peelers_begin_again_and_work_in_with_alone() -> None:
    pos, tri = random_mesh(3)
    peeler = DepthPeeler(None, pos.requires_grad_(), tri, (8, 8), grad_db=False)
    with pytest.raises(UsageError, match="the depth peeler is not open"):
        peeler.rasterize_next_layer()
    with peeler:
        first, first_db = peeler.rasterize_next_layer()
        second, _ = peeler.rasterize_next_layer()
    with peeler:
        assert torch.equal(peeler.rasterize_next_layer()[0], first)
    assert not torch.equal(first, second)
    assert first.requires_grad and not torch.autograd.grad(first_db.sum(), pos)[0].any()
    with pytest.raises(UsageError, match="the depth peeler is not open"):
        peeler.rasterize_next_layer()
    ranges = torch.tensor([[0, 12], [2, 1]], dtype=torch.int32)
    with DepthPeeler(None, pos[0], tri, (8, 8), ranges) as ranged:
        ranged.rasterize_next_layer()
        assert torch.equal(ranged.rasterize_next_layer()[0][:1], second)


def test_arrays_need_no_torch() -> None:
    script = """
import sys
import numpy as np
from mipbake import raster
pos = np.array([[[-1, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1]]], np.float32)
tri = np.array([[0, 1, 2]], np.int32)
ctx = raster.RasterizeContext()
rast, db = raster.rasterize(ctx, pos, tri, (4, 4))
color, _ = raster.interpolate(pos, rast, tri, db, "all")
raster.antialias(color, rast, pos, tri, raster.antialias_construct_topology_hash(tri))
with raster.DepthPeeler(ctx, pos, tri, (4, 4)) as peeler:
    peeler.rasterize_next_layer()
assert "torch" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script], check=True)


def test_concurrent_calls_with_one_context() -> None:
    context = RasterizeContext()
    scenes = [(random_mesh(seed, 1, 40 * (1 + seed % 3)), (20 + 9 * seed, 61 - 7 * seed)) for seed in range(6)]
    expected = [rasterize(None, *mesh, size)[0] for mesh, size in scenes]

    def repeatedly(k: int) -> bool:
        mesh, size = scenes[k % 6]
        return all(torch.equal(rasterize(context, *mesh, size)[0], expected[k % 6]) for _ in range(10))

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(repeatedly, range(12)))


@needs_cuda
@pytest.mark.parametrize("mode", ["instanced", "range"])
def test_cuda_agrees(mode: str) -> None:
    pos, tri = random_mesh(21, 3, 200, 150)
    ranges = None
    if mode == "range":
        pos, ranges = pos[0], torch.tensor([[0, 150], [60, 140], [7, 0], [3, 1]], dtype=torch.int32)
    results = []
    for device in ("cpu", "cuda"):
        p = pos.to(device, copy=True).requires_grad_()
        with DepthPeeler(None, p, tri.to(device), (65, 83), ranges) as peeler:
            layers = [peeler.rasterize_next_layer() for _ in range(3)]
        weights = torch.linspace(-1, 1, 4, device=device)
        sum((rast * weights).sum() + (db * weights).tanh().sum() for rast, db in layers).backward()
        results.append([t.detach().cpu() for layer in layers for t in layer] + [p.grad.cpu()])
    *cpu, cpu_grad = results[0]
    *cuda, cuda_grad = results[1]
    for k in range(3):
        assert_same_layer((cuda[2 * k], cuda[2 * k + 1]), (cpu[2 * k], cpu[2 * k + 1]))
    torch.testing.assert_close(cuda_grad, cpu_grad, rtol=1e-3, atol=1e-4 * float(cpu_grad.abs().max()))
