"""antialias: against its twin, against areas that are known, and its silhouettes one by one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from mipbake.raster import _device, antialias, antialias_construct_topology_hash, rasterize, reference

from .raster_scenes import flat, needs_cuda, random_mesh

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


@settings(max_examples=15, deadline=None)
@given(
    seed=SEEDS,
    size=st.tuples(st.integers(1, 18), st.integers(1, 18)),
    batch=st.integers(1, 3),
    channels=st.integers(1, 9),
    ranged=st.booleans(),
    boost=st.sampled_from([1.0, 0.0, -3.5]),
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_random_meshes(dtype, seed, size, batch, channels, ranged, boost):
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
