"""The primitives as they are used: rasterize, interpolate, texture and antialias, and fits through all of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from mipbake import raster, sampling

from .raster_scenes import cube, needs_cuda, random_mesh, seen


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
