"""The raster primitives as torch ops: gradcheck of each, opcheck, torch.compile, and which gradients flow where."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import mipbake.raster
from mipbake.base.errors import UsageError
from mipbake.raster import (
    DepthPeeler,
    RasterizeContext,
    antialias,
    antialias_construct_topology_hash,
    interpolate,
    ops,
    rasterize,
    reference,
    triangle_indices,
)
from mipbake.sampling import texture
from mipbake.shading import shade

from .raster_scenes import cube, random_mesh, seen

RANGES = torch.tensor([[0, 4], [2, 3], [6, 0]], dtype=torch.int32)


def scene(mode: str, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor, Tensor | None]:
    """Well-conditioned triangles, some with a vertex behind the eye: pos, tri, ranges."""
    rng = np.random.default_rng(12)
    pos = rng.uniform(-1.3, 1.3, (2, 9, 4))
    pos[..., 2] *= 0.3
    pos[..., 3] = rng.uniform(0.6, 1.8, (2, 9))
    pos[:, 2, 3] = -0.4
    tri = torch.tensor([[0, 1, 2], [3, 4, 5], [8, 7, 6], [0, 4, 8], [1, 5, 6], [2, 3, 7]], dtype=torch.int32)
    positions = torch.from_numpy(pos).to(dtype)
    return (positions, tri, None) if mode == "instanced" else (positions[0], tri, RANGES)


@pytest.mark.parametrize("seed", range(4))
def test_gradients_of_rasterize_are_the_twin_s(seed: int) -> None:
    """On random meshes, in float64 closely; in float32 as far as its results are rounded."""
    mesh, tri = random_mesh(seed, 2)
    generator = torch.Generator().manual_seed(seed)
    weights = torch.randn(2, 2, 13, 11, 4, generator=generator, dtype=torch.float64)
    gradients = []
    calls: list[Callable[..., tuple[Tensor, Tensor]]] = [
        reference.rasterize,
        lambda *a: rasterize(None, *a),
        lambda p, *a: rasterize(None, p.float(), *a),
    ]
    for call in calls:
        pos = mesh.double().requires_grad_()
        rast, rast_db = call(pos, tri, (13, 11))
        # Derivatives grow without bound towards the eye; the gradient is taken where they are ordinary.
        near = rast_db.detach().abs().amax(-1, keepdim=True) < 2
        ((rast * weights[0] * near).sum() + (rast_db * weights[1] * near).sum()).backward()
        gradients.append(pos.grad)
    scale = gradients[0].abs().amax()
    torch.testing.assert_close(gradients[1] / scale, gradients[0] / scale, rtol=0, atol=1e-10)
    torch.testing.assert_close(gradients[2] / scale, gradients[0] / scale, rtol=0, atol=1e-4)
    assert torch.all(gradients[1][..., 2] == 0)


@pytest.mark.parametrize("channels", [1, 3, 4, 13])
def test_renders_over_several_tiles_are_the_twin_s(channels: int) -> None:
    """All three primitives on images larger than what a thread of the kernels takes at once, and all gradients."""
    mesh, tri = random_mesh(50 + channels, 2, 50, 60, torch.float64)
    generator = torch.Generator().manual_seed(channels)
    attributes = torch.randn(60, channels, generator=generator, dtype=torch.float64)
    weights = torch.randn(2, 71, 133, channels, generator=generator, dtype=torch.float64)
    results = []
    for door in (mipbake.raster, reference):
        context = (None,) if door is mipbake.raster else ()
        pos, attr = mesh.clone().requires_grad_(), attributes.clone().requires_grad_()
        rast, rast_db = door.rasterize(*context, pos, tri, (71, 133))
        color, slopes = door.interpolate(attr, rast, tri, rast_db, [0])
        near = rast_db.detach().abs().amax(-1, keepdim=True) < 1
        image = door.antialias(color, rast, pos, tri)
        loss = (image * weights * near).sum() + (slopes * near).sum()
        results.append([image, slopes, *torch.autograd.grad(loss, (pos, attr))])
    for actual, expected in zip(*results, strict=True):
        assert (actual - expected).norm() < 1e-10 * expected.norm()


def test_derivatives_without_a_gradient() -> None:
    pos, tri, _ = scene("instanced")
    p = pos.clone().requires_grad_()
    rast, rast_db = rasterize(None, p, tri, (6, 6), grad_db=False)
    assert rast.requires_grad and rast_db.requires_grad  # a graph of zeros, as nvdiffrast's
    assert not torch.autograd.grad(rast_db.sum(), p, retain_graph=True)[0].any()
    assert torch.equal(rast_db, rasterize(None, pos, tri, (6, 6))[1])
    full, full_db = rasterize(None, p, tri, (6, 6))
    (without,) = torch.autograd.grad(interpolate(p, rast, tri, rast_db, "all")[1].sum(), p)
    (through,) = torch.autograd.grad(interpolate(p, full, tri, full_db, "all")[1].sum(), p)
    (attributes,) = torch.autograd.grad(interpolate(p, full.detach(), tri, full_db.detach(), "all")[1].sum(), p)
    assert torch.equal(without, attributes) and not torch.allclose(through, attributes)


def test_only_the_gradients_that_are_needed() -> None:
    pos, tri, _ = scene("instanced", torch.float32)
    assert not rasterize(None, pos, tri, (5, 5))[0].requires_grad
    leaf = pos.clone().requires_grad_()
    rast, rast_db = rasterize(None, leaf, tri, (5, 5))
    attr = torch.rand(9, 3)
    color, slopes = interpolate(attr, rast, tri, rast_db, "all")
    antialias(color.detach(), rast, leaf, tri).sum().backward(retain_graph=True)
    antialias(color, rast, pos, tri).sum().backward(retain_graph=True)
    slopes.sum().backward()
    assert attr.grad is None and leaf.grad is not None
    fixed = attr.clone().requires_grad_()
    interpolate(fixed, rast.detach(), tri)[0].sum().backward()
    assert fixed.grad is not None


def test_second_derivatives_are_refused() -> None:
    pos, tri, _ = scene("instanced", torch.float32)
    leaf, texels = pos.requires_grad_(), torch.rand(1, 4, 4, 3, requires_grad=True)
    rast, _ = rasterize(None, leaf, tri, (5, 5))
    attr = interpolate(leaf, rast.detach(), tri)[0]
    color = antialias(attr, rast.detach(), leaf.detach(), tri)
    looked_up = texture(texels, torch.rand(1, 3, 3, 2))
    material = torch.rand(5, 8, requires_grad=True)
    up = torch.tensor([[0.0, 0.0, 1.0]])
    results = {
        "rasterize": (rast[..., :2], leaf),
        "interpolate": (attr, leaf),
        "antialias": (color, attr),
        "texture": (looked_up, texels),
        "shade": (shade("gltf", material, up, up), material),
    }
    for op, (result, wanted) in results.items():
        (first,) = torch.autograd.grad((result**2).sum(), wanted, create_graph=True)
        with pytest.raises(UsageError, match=f"^{op} has first derivatives only"):
            first.sum().backward(retain_graph=True)


@pytest.mark.long
def test_triangles_beyond_what_floats_count_have_numbers() -> None:
    first = 2**24 - 2
    tri = np.zeros((first + 6, 3), np.int32)  # all but the last six have no area
    pos = np.array([[0, 0, 0, 1]], np.float32)
    for row in range(6):
        low, high = (2 * (row + end) / 6 - 1 for end in (0, 1))
        pos = np.concatenate([pos, np.array([[-3, low, 0, 1], [3, low, 0, 1], [3, high, 0, 1], [-3, high, 0, 1]])])
        tri[first + row] = [4 * row + 1, 4 * row + 2, 4 * row + 3]
    pos = pos[None].astype(np.float32)
    rast, _ = rasterize(None, pos, tri, (6, 8))
    expected = np.broadcast_to(np.arange(first, first + 6)[:, None], (6, 8))
    found = triangle_indices(rast)[0]
    assert np.array_equal(found[found >= 0], expected[found >= 0]) and (found >= 0).any(1).all()
    assert np.array_equal(triangle_indices(torch.from_numpy(rast)).numpy()[0], found)
    attr = np.repeat(np.arange(len(pos[0]), dtype=np.float32)[None, :, None], 2, 2)
    shown, _ = interpolate(attr, rast, tri)
    assert np.all((np.abs(shown[0, ..., 0] - (4 * np.arange(6)[:, None] + 2)) <= 1)[found >= 0])
    rast[0, 0, 0, 3] = np.nextafter(rast[..., 3].max(), np.float32(np.inf))
    with pytest.raises(UsageError, match="triangle_id"):
        interpolate(attr, rast, tri)


def samples(op: str) -> list[tuple[Any, ...]]:
    pos, tri, ranges = scene("range")
    many, _, _ = scene("instanced")
    rast, rast_db = rasterize(None, many, tri, (4, 5))
    previous = rast.clone()
    if op == "rasterize":
        return [
            (pos.requires_grad_(), tri, 4, 5, ranges, None, 0),
            (many.requires_grad_(), tri, 3, 3, None, None, 0),
            (many.detach(), tri, 4, 5, None, previous, 0),
        ]
    attr = torch.rand(1, 9, 3, dtype=torch.float64)
    if op == "interpolate":
        leaves = [t.clone().requires_grad_() for t in (attr, rast, rast_db)]
        return [(leaves[0], leaves[1], tri, leaves[2], [1, 1, 0]), (attr[0], leaves[1], tri, None, [])]
    following = antialias_construct_topology_hash(tri).next
    color = torch.rand(2, 4, 5, 3, dtype=torch.float64).requires_grad_()
    return [
        (color, rast, many.requires_grad_(), tri, following, 1.5),
        (color.detach(), rast, many.detach().requires_grad_(), tri, following, 1.0),
    ]


@pytest.mark.long
@pytest.mark.parametrize("op", ["rasterize", "interpolate", "antialias"])
def test_opcheck(op: str) -> None:
    for arguments in samples(op):
        torch.library.opcheck(getattr(ops, op), arguments)


def test_opcheck_of_the_backward_ops() -> None:
    pos, tri, _ = scene("instanced")
    rast, rast_db = rasterize(None, pos, tri, (4, 5))
    grad = torch.rand_like(rast)
    quick = {"test_utils": ("test_schema", "test_faketensor")}  # they have no gradient of their own
    torch.library.opcheck(ops.rasterize_backward, (pos, tri, rast, grad, None), **quick)
    torch.library.opcheck(ops.rasterize_backward, (pos, tri, rast, grad, grad), **quick)
    attr, out = torch.rand(9, 3, dtype=torch.float64), torch.rand(2, 4, 5, 3, dtype=torch.float64)
    needs = True, False, True
    torch.library.opcheck(ops.interpolate_backward, (attr, rast, tri, rast_db, [1, 2], out, grad, *needs), **quick)
    following = antialias_construct_topology_hash(tri).next
    torch.library.opcheck(ops.antialias_backward, (out, rast, pos, tri, following, out, 2.0, False, True), **quick)
    torch.library.opcheck(ops.topology, (tri, 9), **quick)


@pytest.mark.long
def test_compiled_equals_eager() -> None:
    """The public functions in one graph, forward and backward, for more than one size."""
    corners, tri = cube()
    attr = torch.rand(8, 3, generator=torch.Generator().manual_seed(4)).requires_grad_()
    context, topology = RasterizeContext(), antialias_construct_topology_hash(tri)

    def loss(p: Tensor, a: Tensor, height: int) -> Tensor:
        with DepthPeeler(context, p, tri, (height, 20)) as peeler:
            rast, rast_db = peeler.rasterize_next_layer()
            behind, _ = peeler.rasterize_next_layer()
        color, slopes = interpolate(a, rast, tri, rast_db, diff_attrs="all")
        far, _ = interpolate(a, behind, tri)
        blended = antialias(color, rast, p, tri) + 0.3 * antialias(far, behind, p, tri, topology)
        return (blended**2).sum() + slopes.tanh().sum()

    # The backend without code generation still traces forward and backward through the fake implementations.
    compiled = torch.compile(loss, fullgraph=True, backend="aot_eager", dynamic=True)
    for height, batch in ((16, 1), (24, 2)):
        pos = seen(corners, 4.0, 1).expand(batch, 8, 4).clone().requires_grad_()
        eager = torch.autograd.grad(loss(pos, attr, height), (pos, attr))
        for a, e in zip(torch.autograd.grad(compiled(pos, attr, height), (pos, attr)), eager, strict=True):
            torch.testing.assert_close(a, e, rtol=1e-5, atol=1e-5)
