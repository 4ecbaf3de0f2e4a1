"""interpolate: against its twin and against linear functions, whose interpolation is known."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from mipbake.raster import interpolate, rasterize, reference

from .raster_scenes import cube, needs_cuda, random_mesh, seen

SEEDS = st.integers(0, 2**32 - 1)


def scene(seed: int, size: tuple[int, int], batch: int, dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """Rasters of a random mesh and its triangles, the derivatives held to where float32 can compare them."""
    pos, tri = random_mesh(seed, batch, 10, dtype=dtype)
    rast, rast_db = rasterize(None, pos, tri, size)
    return rast, rast_db.clamp(-3, 3), tri


@settings(max_examples=25, deadline=None)
@given(
    seed=SEEDS,
    size=st.tuples(st.integers(1, 16), st.integers(1, 16)),
    batch=st.integers(1, 3),
    channels=st.integers(1, 9),
    mode=st.sampled_from(["range", "one", "many"]),
    selected=st.lists(st.integers(0, 8), max_size=5) | st.sampled_from(["all", None]),
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_random_meshes(dtype, seed, size, batch, channels, mode, selected):
    """Values, derivatives and all gradients, for a second index buffer with vertices of its own; repeated ones too."""
    rast, rast_db, tri = scene(seed, size, batch, dtype)
    generator = torch.Generator().manual_seed(seed)
    shape = {"range": (7, channels), "one": (1, 7, channels), "many": (batch, 7, channels)}[mode]
    attr = torch.randn(shape, generator=generator, dtype=dtype)
    other = torch.randint(0, 7, tri.shape, generator=generator, dtype=torch.int32)
    diff_attrs = [k % channels for k in selected] if isinstance(selected, list) else selected
    leaves = [t.clone().requires_grad_() for t in (attr, rast, rast_db)]
    twins = [t.double().requires_grad_() for t in (attr, rast, rast_db)]
    results = interpolate(leaves[0], leaves[1], other, leaves[2], diff_attrs)
    expected = reference.interpolate(twins[0], twins[1], other, twins[2], diff_attrs)
    weights = [torch.randn(e.shape, generator=generator, dtype=torch.float64) for e in expected]
    close = {"rtol": 0, "atol": 1e-12 if dtype == torch.float64 else 1e-5}
    for result, e in zip(results, expected, strict=True):
        assert result.dtype == dtype
        torch.testing.assert_close(result.double(), e, **close)
    for outputs in (results, expected):
        sum((o.double() * w).sum() for o, w in zip(outputs, weights, strict=True)).backward()
    for leaf, twin in zip(leaves, twins, strict=True):
        if twin.grad is None:  # no derivatives were asked for
            assert leaf.grad is None
            continue
        scale = 1 + float(twin.grad.abs().max())
        torch.testing.assert_close(leaf.grad.double() / scale, twin.grad / scale, **close)
        assert leaf is not leaves[1] or torch.all(leaf.grad[..., 2:] == 0)


def test_projected_positions_return_to_their_pixels() -> None:
    """Interpolated clip-space positions project to their pixel's centre, in perspective, and move with it."""
    corners, tri = cube()
    pos = seen(corners, 4.0, 2, torch.float64)
    H, W = 14, 25
    rast, rast_db = rasterize(None, pos, tri, (H, W))
    out, out_da = interpolate(pos, rast, tri, rast_db, "all")
    drawn = rast[..., 3] > 0
    clip, slope = out[drawn], out_da[drawn].view(-1, 4, 2)
    _, row, column = torch.nonzero(drawn, as_tuple=True)
    w = clip[:, 3:]
    torch.testing.assert_close(
        clip[:, :2] / w, torch.stack([(2 * column + 1) / W - 1, (2 * row + 1) / H - 1], 1).double()
    )
    torch.testing.assert_close(clip[:, 2] / w[:, 0], rast[drawn][:, 2])
    projected = (slope[:, :2] - clip[:, :2, None] / w[..., None] * slope[:, 3:]) / w[..., None]
    expected = torch.diag(torch.tensor([2 / W, 2 / H], dtype=torch.float64)).expand_as(projected)
    torch.testing.assert_close(projected, expected, rtol=0, atol=1e-12)


def test_empty_meshes_and_images() -> None:
    attr, none = torch.rand(4, 2, requires_grad=True), torch.empty(0, 3, dtype=torch.int32)
    rast = torch.zeros(1, 3, 3, 4, requires_grad=True)
    out, out_da = interpolate(attr, rast, none, torch.zeros(1, 3, 3, 4), "all")
    assert torch.all(out == 0) and torch.all(out_da == 0)
    (out.sum() + out_da.sum()).backward()
    assert torch.all(attr.grad == 0) and torch.all(rast.grad == 0)
    assert interpolate(attr, torch.zeros(0, 3, 3, 4), none)[0].shape == (0, 3, 3, 2)
    assert interpolate(torch.rand(4, 0), rast, none)[0].shape == (1, 3, 3, 0)


@needs_cuda
def test_cuda_agrees() -> None:
    pos, tri = random_mesh(8, 3, 300, 200)
    rast, rast_db = rasterize(None, pos, tri, (70, 90))
    rast_db = rast_db.clamp(-3, 3)
    for attr in (torch.randn(1, 200, 6), torch.randn(3, 200, 6), torch.randn(200, 6)):
        results = []
        for device in ("cpu", "cuda"):
            leaves = [t.to(device, copy=True).requires_grad_() for t in (attr, rast, rast_db)]
            outputs = interpolate(leaves[0], leaves[1], tri.to(device), leaves[2], [1, 4])
            sum((o * o.detach().cos()).sum() for o in outputs).backward()
            results.append([t.cpu() for t in (*outputs, *(leaf.grad for leaf in leaves))])
        for a, b in zip(*results, strict=True):
            torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4 * (1 + float(b.abs().max())))
