"""The primitives as they are used: rasterize, interpolate, texture and antialias, and fits through all of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from mipbake import raster, sampling

from .raster_scenes import cube, grid, needs_cuda, projection, random_mesh, seen


def textured_quad(tilt: float) -> tuple[Tensor, Tensor, Tensor]:
    """A square seen at an angle: pos (1, V, 4), tri, texture coordinates (V, 2)."""
    points, tri = grid(3, 3)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    world = np.concatenate([points, np.zeros((len(points), 1))], 1) @ turn.T - [0, 0, 2.5]
    clip = np.concatenate([world, np.ones((len(world), 1))], 1) @ projection().T
    return torch.from_numpy(clip).float()[None], tri, torch.from_numpy((points + 1) / 2).float()


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=needs_cuda)])
def test_a_texture_is_learned_through_a_mesh(device: str) -> None:
    """It is learned from renders at several angles alone, mips and silhouettes included; the loss falls to a tenth and
    further."""
    views = [[t.to(device) for t in textured_quad(tilt)] for tilt in (0.0, 0.5, -0.7, 1.0)]
    context = raster.RasterizeContext()
    topology = raster.antialias_construct_topology_hash(views[0][1])

    def render(tex: Tensor) -> Tensor:
        images = []
        for pos, tri, uv in views:
            rast, rast_db = raster.rasterize(context, pos, tri, (48, 48))
            coordinates, uv_da = raster.interpolate(uv, rast, tri, rast_db, diff_attrs="all")
            color = sampling.texture(tex, coordinates, uv_da, boundary_mode="clamp")
            color = torch.where(rast[..., 3:] > 0, color, 0)
            images.append(raster.antialias(color, rast, pos, tri, topology))
        return torch.cat(images)

    target = torch.rand(1, 16, 16, 3, generator=torch.Generator().manual_seed(1)).to(device)
    learned = torch.full_like(target, 0.5).requires_grad_()
    with torch.no_grad():
        images = render(target)
    optimizer = torch.optim.Adam([learned], lr=0.05)
    losses = []
    for _ in range(40):
        loss = torch.mean((render(learned) - images) ** 2)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0] / 100
    assert torch.mean((learned - target) ** 2) < torch.mean((0.5 - target) ** 2) / 10


def test_arrays_in_any_layout_render_what_tensors_do() -> None:
    pos, tri = random_mesh(8, 3, 300, 200)
    attr, tex = torch.rand(3, 200, 2), torch.rand(1, 20, 12, 3)
    topology = raster.antialias_construct_topology_hash(tri)

    def render(*given: Any, kept: Any = None) -> list[Any]:
        p, t, a, x = given
        rast, rast_db = raster.rasterize(None, p, t, (70, 90))
        uv, uv_da = raster.interpolate(a, rast, t, rast_db, diff_attrs="all")
        image = raster.antialias(sampling.texture(x, uv, uv_da), rast, p, t, kept)
        return [rast, rast_db, uv, uv_da, image]

    expected = render(pos, tri, attr, tex)
    assert all(t.any() for t in expected)
    turned = [t.transpose(0, -1).contiguous().transpose(0, -1) for t in (pos, tri, attr, tex)]
    for given in ((pos, tri, attr, tex), turned):
        assert all(torch.equal(a, b) for a, b in zip(render(*given, kept=topology), expected, strict=True))
        arrays = render(*(t.numpy() for t in given))
        for array, tensor in zip(arrays, expected, strict=True):
            assert isinstance(array, np.ndarray) and np.array_equal(array, tensor.numpy())


@needs_cuda
def test_a_render_with_cuda_is_that_of_the_cpu() -> None:
    corners, tri = cube()
    pos = torch.cat([seen(corners, 4.0, seed) for seed in range(3)])
    uv = torch.from_numpy(np.random.default_rng(1).uniform(size=(8, 2))).float()
    tex = torch.rand(1, 32, 32, 4)
    results = []
    for device in ("cpu", "cuda"):
        p, t, a, x = (v.to(device) for v in (pos, tri, uv, tex))
        p, a, x = (v.clone().requires_grad_() for v in (p, a, x))
        rast, rast_db = raster.rasterize(None, p, t, (64, 80))
        coordinates, uv_da = raster.interpolate(a, rast, t, rast_db, diff_attrs="all")
        image = raster.antialias(sampling.texture(x, coordinates, uv_da), rast, p, t)
        (image**2).mean().backward()
        results.append([v.detach().cpu() for v in (image, p.grad, a.grad, x.grad)])
    for gpu, cpu in zip(results[1], results[0], strict=True):
        torch.testing.assert_close(gpu, cpu, rtol=1e-3, atol=1e-3 * float(cpu.abs().max()))


def test_more_pixels_give_better_gradients_of_small_triangles() -> None:
    """d area / d scale of a finely tessellated disc: few pixels miss triangles of the silhouette, and more pixels,
    averaged, miss fewer."""
    around = 96
    angle = np.arange(around) * 2 * np.pi / around
    rings = [np.stack([np.cos(angle), np.sin(angle)], -1) * r for r in np.linspace(0.8, 1, 3)]
    points = np.concatenate([[[0.0, 0.0]], *rings])
    first = [(0, 1 + i, 1 + (i + 1) % around) for i in range(around)]
    quads = [
        (a + i, a + (i + 1) % around, b + i, b + (i + 1) % around)
        for a, b in ((1, 1 + around), (1 + around, 1 + 2 * around))
        for i in range(around)
    ]
    tri = torch.tensor(first + [t for a, b, c, d in quads for t in ((a, b, c), (b, d, c))], dtype=torch.int32)
    exact = around * np.sin(2 * np.pi / around) * 0.6  # area is around / 2 sin(...) scale^2, in clip space

    def gradient(size: int, shift: tuple[float, float]) -> float:
        scale = torch.tensor(0.6, dtype=torch.float64, requires_grad=True)
        at = torch.from_numpy(points) * scale + torch.tensor(shift, dtype=torch.float64)
        pos = torch.cat([at, torch.zeros_like(at[:, :1]), torch.ones_like(at[:, :1])], -1)[None]
        rast, _ = raster.rasterize(None, pos.detach(), tri, (size, size))
        image = raster.antialias((rast[..., 3:] > 0).double(), rast, pos, tri)
        (found,) = torch.autograd.grad(image.sum() * (2 / size) ** 2, scale)
        return float(found)

    shifts = [(0.013 * i, -0.007 * i) for i in range(12)]
    few, more = (np.mean([abs(gradient(n, each) / exact - 1) for each in shifts]) for n in (16, 64))
    assert few > 0.3
    assert more < few / 2


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=needs_cuda)])
def test_vertices_are_recovered_from_a_silhouette(device: str) -> None:
    """A white triangle on black finds the place of another one, by the gradients of antialias alone."""
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32, device=device)
    target = torch.tensor([[-0.6, -0.55], [0.65, -0.4], [0.05, 0.7]], device=device)
    learned = (target + torch.tensor([[0.15, -0.1], [-0.2, 0.1], [0.15, -0.2]], device=device)).requires_grad_()

    def render(points: Tensor) -> Tensor:
        pos = torch.cat([points, torch.zeros_like(points[:, :1]), torch.ones_like(points[:, :1])], 1)[None]
        rast, _ = raster.rasterize(None, pos, tri, (32, 32))
        return raster.antialias((rast[..., 3:] > 0).float(), rast, pos, tri)

    image = render(target)
    start = float((learned - target).detach().norm(dim=1).max())
    optimizer = torch.optim.Adam([learned], lr=0.02)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.97)
    for _ in range(120):
        loss = torch.mean((render(learned) - image) ** 2)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    assert (learned - target).norm(dim=1).max() < start / 20
