"""antialias: against its twin, against areas that are known, and its silhouettes one by one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from mipbake.raster import _device, antialias, antialias_construct_topology_hash, rasterize, reference

from .raster_scenes import cube, flat, grid, needs_cuda, random_mesh, seen, threads

SEEDS = st.integers(0, 2**32 - 1)
QUAD = torch.tensor([[0, 1, 2], [1, 3, 2]], dtype=torch.int32)


def rectangle(
    left: float | Tensor, right: float | Tensor, low: float = -0.5, high: float = 0.5, w: float = 1.0
) -> Tensor:
    """pos (1, 4, 4) of a rectangle, of QUAD's triangles, with gradients to its sides."""
    left, right = torch.as_tensor(left).double(), torch.as_tensor(right).double()
    z, one = torch.zeros(()).double(), torch.ones(()).double()
    rows = [torch.stack([x, y * one, z, one]) for y in (low, high) for x in (left, right)]
    return (torch.stack(rows) * w)[None]


def coverage(pos: Tensor, tri: Tensor, size: tuple[int, int]) -> Tensor:
    """Antialiased white on black, (B, H, W)."""
    rast, _ = rasterize(None, pos.detach(), tri, size)
    return antialias((rast[..., 3:] > 0).to(pos.dtype), rast, pos, tri)[..., 0]


@settings(max_examples=30, deadline=None)
@given(
    seed=SEEDS,
    size=st.tuples(st.integers(1, 18), st.integers(1, 18)),
    batch=st.integers(1, 3),
    channels=st.integers(1, 9),
    ranged=st.booleans(),
    boost=st.sampled_from([1.0, 0.0, -3.5]),
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_random_meshes(
    dtype: torch.dtype, seed: int, size: tuple[int, int], batch: int, channels: int, ranged: bool, boost: float
) -> None:
    pos, tri = random_mesh(seed, 1 if ranged else batch, 12, vertices=9, dtype=dtype)
    ranges = torch.tensor([[0, 12], [3, 5]], dtype=torch.int32) if ranged else None
    pos = pos[0] if ranged else pos
    rast, _ = rasterize(None, pos, tri, size, ranges)
    generator = torch.Generator().manual_seed(seed)
    color = torch.randn(*rast.shape[:3], channels, generator=generator, dtype=dtype)
    grad = torch.randn(color.shape, generator=generator, dtype=dtype)
    c, p = color.clone().requires_grad_(), pos.clone().requires_grad_()
    out = antialias(c, rast, p, tri, pos_gradient_boost=boost)
    out.backward(grad)
    c64, p64 = color.double().requires_grad_(), pos.double().requires_grad_()
    expected = reference.antialias(c64, rast, p64, tri, boost)
    expected.backward(grad.double())
    close = {"rtol": 0, "atol": 1e-11 if dtype == torch.float64 else 2e-5}
    assert out.dtype == dtype
    torch.testing.assert_close(out.double(), expected, **close)
    torch.testing.assert_close(c.grad.double(), c64.grad, **close)
    expected_grad = torch.zeros_like(p64) if p64.grad is None else p64.grad
    scale = 1 + float(expected_grad.abs().max())
    torch.testing.assert_close(p.grad.double() / scale, expected_grad / scale, **close)
    assert torch.all(p.grad[..., 2] == 0)


@pytest.mark.parametrize("turned", [False, True])
def test_the_area_follows_an_edge_exactly(turned: bool) -> None:
    """An upright edge that extends beyond the pixels: each row's sum is its distance in pixels, for every position."""
    H, W = 8, 10
    for right in np.linspace(-0.35, 0.83, 40):
        pos = rectangle(-2.0, float(right), -2.0, 2.0)
        pos = pos[..., [1, 0, 2, 3]] if turned else pos
        image = coverage(pos, QUAD, (W, H) if turned else (H, W))[0]
        image = image.T if turned else image
        torch.testing.assert_close(image.sum(1), torch.full((H,), (right + 1) * W / 2, dtype=torch.float64))
        assert torch.all((image >= 0) & (image <= 1))


@pytest.mark.parametrize("shift", [0.0, 0.125, 0.25, 0.375])
def test_a_long_diagonal_between_centres_is_off_by_an_eighth_of_a_pixel(shift: float) -> None:
    """In pixels the edge is x + y = c. Between centres it cuts corners of an eighth off, which is not seen."""
    size, c = 12, 11.5 + shift  # sums of centres are whole numbers
    points = torch.tensor([[-99, c + 99], [c + 99, -99], [-99, -99]], dtype=torch.float64) / size * 2 - 1
    pos = torch.cat([points, torch.tensor([[0.0, 1]] * 3, dtype=torch.float64)], -1)[None]
    image = coverage(pos, torch.tensor([[0, 1, 2]], dtype=torch.int32), (size, size))[0, 1:-1, 1:-1].numpy()
    sums = np.add.outer(np.arange(1.0, size - 1), np.arange(1.0, size - 1))  # x + y of each pixel's lower left corner
    inside = np.clip(c - sums, 0, 2)  # of the pixel's diagonal
    exact = np.where(inside < 1, inside**2 / 2, 1 - (2 - inside) ** 2 / 2)
    off = np.abs(image - exact).max()
    if shift == 0:
        assert off == pytest.approx(1 / 8)
        np.testing.assert_allclose(image, np.rint(image), atol=1e-12)  # as without antialiasing
    else:
        assert off < 1 / 8


@pytest.mark.parametrize("w", [1.0, 0.3, 7.0])
@pytest.mark.parametrize("boost", [1.0, 2.5])
def test_gradient_of_the_area_of_a_square(w: float, boost: float) -> None:
    """d area / d side = its height W / 2 in pixels, and in clip space as the quotient x / w has it.

    Each corner is cut off as a triangle, so that the pixels along a side show triangles that own it.
    """
    H, W = 16, 12
    sides = torch.tensor([-0.4417, 0.45], dtype=torch.float64, requires_grad=True)
    corners = rectangle(sides[0], sides[1], w=w)[0]  # above and below, its borders are borders of pixels
    middles = [(corners[a] + corners[b]) / 2 for a, b in ((0, 1), (1, 3), (3, 2), (2, 0))]
    pos = torch.cat([corners, torch.stack(middles)])[None]
    tri = [(0, 4, 7), (1, 5, 4), (3, 6, 5), (2, 7, 6), (4, 5, 6), (4, 6, 7)]
    tri = torch.tensor(tri, dtype=torch.int32)
    rast, _ = rasterize(None, pos.detach(), tri, (H, W))
    image = antialias((rast[..., 3:] > 0).double(), rast, pos, tri, pos_gradient_boost=boost)
    assert image.sum().item() == pytest.approx(8 * (0.45 + 0.4417) * W / 2)
    by_pos, by_sides = torch.autograd.grad(image.sum(), (pos, sides))
    torch.testing.assert_close(by_sides, boost * 8 * W / 2 * torch.tensor([-1.0, 1.0], dtype=torch.float64))
    torch.testing.assert_close((by_pos * pos).sum(-1), torch.zeros(1, 8, dtype=torch.float64), rtol=0, atol=1e-9)
    assert torch.all(by_pos[..., 2] == 0)


def test_one_pixel_and_uniform_images() -> None:
    pos, tri = random_mesh(4)
    for size in ((1, 1), (9, 11)):
        rast, _ = rasterize(None, pos, tri, size)
        color = torch.full((1, *size, 3), 0.7, requires_grad=True)
        p = pos.clone().requires_grad_()
        out = antialias(color, rast, p, tri)
        assert torch.equal(out, color)
        out.sum().backward()
        assert torch.all(p.grad == 0)
        torch.testing.assert_close(color.grad.sum(), torch.tensor(3.0 * size[0] * size[1]))


def test_colours_are_only_exchanged() -> None:
    """Blending is convex: nothing leaves the range of a pixel and its neighbours."""
    for seed in range(4):
        corners, tri = cube()
        pos = seen(corners, 4.0, seed)
        rast, _ = rasterize(None, pos, tri, (24, 24))
        color = torch.rand(1, 24, 24, 3)
        changed = antialias(color, rast, pos, tri) != color
        assert 10 < changed.any(-1).sum() < 200


def test_inner_edges_are_left_alone() -> None:
    """A tessellated plane has silhouettes at its border only, and none where its border is outside of the image."""
    points, tri = grid(5, 5, seed=2)
    color = torch.rand(1, 32, 32, 2, dtype=torch.float64)
    for scale, changes in ((1.3, False), (0.7, True)):
        pos = flat(points * scale)
        rast, _ = rasterize(None, pos, tri, (32, 32))
        changed = (antialias(color, rast, pos, tri) != color).any(-1)[0]
        assert changed.any() == changes
        assert not changed[8:24, 8:24].any()


def folded(angle: float) -> Tensor:
    """Two triangles that share an upright edge, seen along z: the second turned by an angle about it, 0 is flat."""
    across = 0.9 * np.cos(angle)
    corners = np.array([[0.03, -0.9], [0.03, 0.9], [-0.87, 0.0], [0.03 + across, 0.0]])
    pos = flat(corners)
    pos[0, 3, 2] = 0.9 * np.sin(angle)
    return pos


FOLD = torch.tensor([[0, 1, 2], [1, 0, 3]], dtype=torch.int32)


def test_silhouettes_are_borders_and_folds() -> None:
    border = torch.tensor([False, True, True])
    for angle, fold in ((0.0, False), (1.2, False), (np.pi / 2, True), (2.0, True), (np.pi, True)):
        pos = folded(angle)
        if angle == np.pi / 2:
            pos[0, 3, 0] = pos[0, 0, 0]  # seen edge-on, exactly
        for tri in (FOLD, FOLD[:, [0, 2, 1]]):
            outline = reference.silhouettes(pos, tri)[0, 0]
            assert torch.equal(
                outline[[0, 1, 2] if tri is FOLD else [2, 1, 0]], border | torch.tensor([fold, False, False])
            )
        rast, _ = rasterize(None, pos, FOLD, (20, 20))
        color = torch.rand(1, 20, 20, 1, dtype=torch.float64)
        p = pos.clone().requires_grad_()
        out = antialias(color, rast, p, FOLD)
        torch.testing.assert_close(out, reference.antialias(color, rast, pos, FOLD))
        assert (out[0, 6:14, 9:11] != color[0, 6:14, 9:11]).any() == fold


def test_edges_of_many_triangles() -> None:
    """Three triangles around an edge: a silhouette where all lie on one side, and not with one on the other."""
    corners = np.array([[0.03, -0.9], [0.03, 0.9], [-0.8, 0.0], [-0.7, 0.3], [-0.6, -0.3], [0.9, 0.1]])
    pos = flat(corners)
    pos[0, :, 2] = torch.tensor([0, 0, -0.1, 0.2, 0.5, 0.0])
    one_side = torch.tensor([[0, 1, 2], [1, 0, 3], [0, 1, 4]], dtype=torch.int32)
    both = torch.cat([one_side, torch.tensor([[1, 0, 5]], dtype=torch.int32)])
    color = torch.rand(1, 20, 20, 1, dtype=torch.float64)
    for tri, silhouette in ((one_side, True), (both, False)):
        assert torch.all(reference.silhouettes(pos, tri)[0, :, 0] == silhouette)
        rast, _ = rasterize(None, pos, tri, (20, 20))
        out = antialias(color, rast, pos, tri)
        assert (out[0, 9:11, 9:11] != color[0, 9:11, 9:11]).any() == silhouette
        torch.testing.assert_close(out, reference.antialias(color, rast, pos, tri))


def test_the_nearer_surface_is_the_silhouette() -> None:
    """A small quad before a large one: its border is blended, in front of a surface as in front of nothing."""
    small, large = rectangle(-0.43, 0.38, -0.41, 0.36), rectangle(-3.0, 3.0, -3.0, 3.0)
    tri = torch.cat([QUAD, QUAD + 4])
    images = []
    for near in (True, False):
        pos = torch.cat([small, large], 1)
        pos[0, 4:, 2] = 0.5 if near else -0.5
        rast, _ = rasterize(None, pos, tri, (16, 16))
        inside = ((rast[..., 3:] > 0) & (rast[..., 3:] <= 2)).double()
        images.append(antialias(inside, rast, pos, tri)[..., 0])
    torch.testing.assert_close(images[0], coverage(small, QUAD, (16, 16)))
    assert torch.all(images[1] == 0)


def test_edges_through_the_eye() -> None:
    """A border that passes behind the eye is blended where it is in front, and nowhere else."""
    pos = torch.tensor([[[0.3, -4.0, 0, 1.0], [-0.2, 6.0, 0, -1.0], [-40.0, -4, 0, 1]]], dtype=torch.float64)
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    rast, _ = rasterize(None, pos, tri, (24, 24))
    color = torch.rand(1, 24, 24, 2, dtype=torch.float64)
    p, q = pos.clone().requires_grad_(), pos.clone().requires_grad_()
    out, expected = antialias(color, rast, p, tri), reference.antialias(color, rast, q, tri)
    assert (rast[..., 3] > 0).any() and (out != color).any()
    torch.testing.assert_close(out, expected)
    for result, twin in zip(*(torch.autograd.grad((o**2).sum(), x) for o, x in ((out, p), (expected, q))), strict=True):
        torch.testing.assert_close(result, twin)


def cycles_of(following: Tensor) -> set[frozenset[int]]:
    seen_edges: set[frozenset[int]] = set()
    flat_next = following.flatten().tolist()
    for edge in range(len(flat_next)):
        cycle, at = {edge}, flat_next[edge]
        while at != edge:
            assert at not in cycle
            cycle.add(at)
            at = flat_next[at]
        seen_edges.add(frozenset(cycle))
    return seen_edges


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, triangles=st.integers(0, 40), vertices=st.integers(1, 12))
def test_topology(seed: int, triangles: int, vertices: int) -> None:
    """Cycles of the edges on the same two vertices, found by the native core, by sorting and by a dictionary."""
    tri = torch.from_numpy(np.random.default_rng(seed).integers(0, vertices, (triangles, 3))).int()
    groups: dict[frozenset[int], set[int]] = {}
    for t, corners in enumerate(tri.tolist()):
        for e in range(3):
            groups.setdefault(frozenset((corners[e], corners[(e + 1) % 3])), set()).add(3 * t + e)
    expected = {frozenset(edges) for edges in groups.values()}
    native = antialias_construct_topology_hash(tri).next
    assert native.shape == tri.shape and native.dtype == torch.int32
    assert cycles_of(native) == expected
    if triangles:
        assert cycles_of(_device.cycles(tri, vertices)) == expected
    assert np.array_equal(antialias_construct_topology_hash(tri.numpy()).next, native.numpy())


def test_topology_is_kept_and_cannot_be_changed() -> None:
    corners, tri = cube()
    pos = seen(corners, 4.0, 1)
    rast, _ = rasterize(None, pos, tri, (20, 20))
    color = torch.rand(1, 20, 20, 3)
    topology = antialias_construct_topology_hash(tri)
    assert torch.equal(antialias(color, rast, pos, tri, topology), antialias(color, rast, pos, tri))
    with pytest.raises(dataclasses.FrozenInstanceError):
        topology.next = None
    assert "tensor" not in repr(topology)


def test_arrays_equal_tensors() -> None:
    pos, tri = random_mesh(2, 2, 30)
    rast, _ = rasterize(None, pos, tri, (30, 40))
    color = torch.rand(2, 30, 40, 4)
    tensors = antialias(color, rast, pos, tri)
    inputs = [t.numpy() for t in (color, rast, pos, tri)]
    for topology in (None, antialias_construct_topology_hash(inputs[3])):
        assert np.array_equal(antialias(*inputs, topology), tensors.numpy())
    turned = [t.transpose(0, 1).contiguous().transpose(0, 1) for t in (color, rast, pos, tri)]
    assert torch.equal(antialias(*turned), tensors)
    assert np.array_equal(antialias(*(t.numpy() for t in turned)), tensors.numpy())


def test_threads_change_nothing() -> None:
    pos, tri = random_mesh(8, 3, 300, 200)
    rast, _ = rasterize(None, pos, tri, (70, 90))
    color = torch.rand(3, 70, 90, 3)
    results = []
    for count in (1, 2, 5):
        with threads(count):
            c, p = color.clone().requires_grad_(), pos.clone().requires_grad_()
            out = antialias(c, rast, p, tri)
            (out**2).sum().backward()
            results.append([out, c.grad, p.grad])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(other, results[0], strict=True))
    assert results[0][2].abs().max() > 0


@needs_cuda
@pytest.mark.parametrize("ranged", [False, True])
def test_cuda_agrees(ranged: bool) -> None:
    pos, tri = random_mesh(8, 3, 300, 200)
    ranges = torch.tensor([[0, 300], [20, 11], [90, 0]], dtype=torch.int32) if ranged else None
    pos = pos[0] if ranged else pos
    rast, _ = rasterize(None, pos, tri, (70, 90), ranges)
    color = torch.rand(3, 70, 90, 5)
    results = []
    for device in ("cpu", "cuda"):
        c, p = (t.to(device, copy=True).requires_grad_() for t in (color, pos))
        out = antialias(c, rast.to(device), p, tri.to(device), pos_gradient_boost=2.0)
        (out**2).sum().backward()
        results.append([t.cpu() for t in (out, c.grad, p.grad)])
    for a, b in zip(*results, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4 * float(b.abs().max()))
