"""What every door computes of inputs that reach all kernels of it, in a process of any instruction set:
`python -m tests.door_results`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from mipbake import _native, raster, sampling, shading, stochastic
from mipbake.stochastic import Channels, Moments

from .shading_inputs import MODELS, directions, frames, material, pairs

Results = list[tuple[np.ndarray, float]]
"""Arrays, each with the relative error in which instruction sets may differ; 0 is for the same bits."""

# Batch, size, boundary and filter: small textures are summed an item at a time, large ones sorted into bins of rows.
LOOKUPS: list[tuple[int, tuple[int, ...], Any, str, int]] = [
    (1, (40, 30), "wrap", "linear", 4),
    (1, (40, 30), "wrap", "linear-mipmap-linear", 1),
    (5, (16, 16), "clamp", "linear-mipmap-linear", 2),
    (5, (16, 16), "clamp", "anisotropic", 3),
    (2, (257, 301), "mirror", "linear-mipmap-nearest", 6),
    (2, (257, 301), "mirror", "anisotropic", 8),
    (1, (1, 5000), ("zero", "wrap"), "linear", 11),
    (1, (1, 5000), ("zero", "wrap"), "nearest", 4),
    (2, (6, 33, 33), "cube", "linear", 4),
    (2, (6, 150, 150), "cube", "linear-mipmap-linear", 11),
]


def texture() -> Results:
    found: Results = []
    generator = torch.Generator().manual_seed(0)
    for dtype, error in ((torch.float32, 2e-3), (torch.float64, 1e-9)):
        options: Any = {"generator": generator, "dtype": dtype}
        for batch, size, boundary, filter_mode, channels in LOOKUPS:
            axes = len(size)
            tex = torch.rand(batch, *size, channels, **options).requires_grad_()
            # Away from the kinks, where two roundings may fall on different sides.
            uv = (2 * torch.randint(-9000, 9000, (1, 60, 100, 2), generator=generator) + 1).to(dtype) / 8192
            if axes == 3:
                uv = torch.cat([uv.clamp(-0.999, 0.999), torch.ones_like(uv[..., :1])], -1).roll(channels, -1)
            uv_da = (torch.randn(1, 60, 100, 2 * axes, **options) * 0.1).requires_grad_()
            bias = torch.rand(1, 60, 100, **options) - 0.5
            leaves = [tex, uv.requires_grad_(), uv_da, bias.requires_grad_()]
            out = sampling.texture(*leaves, filter_mode=filter_mode, boundary_mode=boundary)
            grad = torch.randn(out.shape, **options)
            gradients = torch.autograd.grad(out, leaves, grad, allow_unused=True, materialize_grads=True)
            found += [(t.detach().numpy(), error) for t in (out, *gradients)]
    return found


def rasters() -> Results:
    found: Results = []
    generator = torch.Generator().manual_seed(0)
    for dtype, error in ((torch.float32, 1e-6), (torch.float64, 1e-14)):
        for channels, vertices, triangles in ((1, 30, 20), (4, 900, 700), (11, 90, 60)):
            pos = torch.randn(2, vertices, 4, generator=generator)
            pos[..., 3] = pos[..., 3] / 3 + 1
            tri = torch.randint(0, vertices, (triangles, 3), generator=generator, dtype=torch.int32)
            attr = torch.randn(vertices, channels, generator=generator)
            leaves = [t.to(dtype).requires_grad_() for t in (pos, attr)]
            rast, rast_db = raster.rasterize(None, leaves[0], tri, (70, 101))
            color, slopes = raster.interpolate(leaves[1], rast, tri, rast_db, [0, channels - 1])
            image = raster.antialias(color, rast, leaves[0], tri)
            # Derivatives grow without bound towards the eye.
            near = rast_db.detach().abs().amax(-1, keepdim=True) < 1
            gradients = torch.autograd.grad((image**2 * near).sum() + (slopes * near).sum(), leaves)
            found += [(t.detach().numpy(), 0) for t in (rast, rast_db)]
            found += [(t.detach().numpy(), error) for t in (color, slopes, image, *gradients)]
    return found


def shade() -> Results:
    """More texels than a block, and a last packet that is not full, whatever its width; few texels and many pairs."""
    rng = np.random.default_rng(0)
    found: Results = []
    for model in MODELS:
        for N, K in ((171, 40), (2, 3000)):
            arrays = [a.astype(np.float32) for a in (material(rng, model, 2, N), *pairs(rng, 2, K))]
            stored, light, view = (torch.from_numpy(a) for a in arrays)
            radiance = shading.shade(model, stored.requires_grad_(), light, view)
            (grad,) = torch.autograd.grad(radiance, stored, torch.sign(0.1 - radiance.detach()))
            found += [(shading.shade(model, *arrays), 0), (radiance.detach().numpy(), 0), (grad.numpy(), 0)]
    return found


def shade_lit() -> Results:
    """A last packet that is not full, whatever its width, and more lights than are listed at once."""
    rng = np.random.default_rng(0)
    found: Results = []
    for model in MODELS:
        for dtype in (np.float32, np.float64):
            case = (material(rng, model, 1171), frames(rng, 1171), directions(rng, 1171), directions(rng, 70))
            radiance = rng.uniform(0.1, 3, (70, 3))
            found.append((shading.shade_lit(model, *(a.astype(dtype) for a in (*case, radiance))), 0))
    return found


def estimates() -> Results:
    """The kernels of stochastic gradients, which are compiled without contraction."""
    generator = np.random.default_rng(0)
    found: list[np.ndarray] = []
    for dtype in (np.float32, np.float64):
        channels = Channels((0.1, 0.0, 0.02, 0.3), (0.0,) * 4, (1.0,) * 4)
        lifted = Channels((0.1, 0.1, 0.0, 0.3), (0.0,) * 4, (1.0,) * 4, 0)
        values = generator.uniform(-0.2, 1.2, (9001, 4)).astype(dtype)
        images = [generator.uniform(0, 1, (20011, 3)).astype(dtype) for _ in range(3)]
        made_of = stochastic.contributions(generator.integers(-1, 9001, (20011, 4)).astype(np.int32))
        for each in (channels, lifted):
            sides = stochastic.perturb(values, each, 5, 6)
            differences = stochastic.pixel_differences(*images, images[0][:, 0].copy())
            gradient = np.zeros_like(values)
            stochastic.add_gradient(gradient, differences, made_of, each, 5, 6)
            found += [*sides, differences, gradient.copy()]
            moments = Moments.of(values)
            for _ in range(3):
                stochastic.descend(values, gradient.copy(), moments, each)
            found += [values.copy(), moments.first, moments.second]
    uv = generator.uniform(-2, 3, (20011, 2)).astype(np.float32)
    uv_da = (generator.normal(size=(20011, 4)) * 0.1).astype(np.float32)
    for texels in ("nearest", "trilinear", "anisotropic"):
        found.append(stochastic.touched_texels([(33, 17), (16, 8), (8, 4)], uv, None, uv_da, None, texels))
    return [(each, 0) for each in found]


def splats() -> Results:
    """Thousands of splats over tiles that are not whole, in a kernel that is compiled without contraction."""
    generator = np.random.default_rng(0)
    centers = generator.uniform(-5, 105, (3000, 2)).astype(np.float32)
    widths, turn = generator.uniform(0.02, 1, (3000, 2)).astype(np.float32), generator.uniform(-0.9, 0.9, 3000)
    mixed = (turn * np.sqrt(widths.prod(-1))).astype(np.float32)
    conics = np.stack([widths[:, 0], mixed, widths[:, 1]], -1)
    paint = generator.uniform(0, 1, (3000, 4)).astype(np.float32)
    depth = generator.uniform(-0.1, 1, 3000).astype(np.float32)
    found = [*raster.splats(centers, conics, paint, depth, (70, 101), 5)]
    # A splat in each tile that ends at the centre of a pixel, in the columns of one register or of another.
    row, column = np.divmod(np.arange(16 * 64), 64)
    ends = np.stack([16 * column + 4.5, 8 * row + 3.5], -1)
    centers = (ends - generator.uniform((1, 0), (3.5, 0), ends.shape)).astype(np.float32)
    paint = generator.uniform(0.1, 1, (len(ends), 4)).astype(np.float32)
    conics = np.zeros((len(ends), 3), np.float32)
    conics[:, 0] = conics[:, 2] = 2 * np.log(255 * paint[:, 3].astype(float)) / (ends - centers)[:, 0] ** 2
    found += raster.splats(centers, conics, paint, np.ones(len(ends), np.float32), (128, 1024), 1)
    return [(each, 0) for each in found]


DOORS: dict[str, Callable[[], Results]] = {
    "texture": texture,
    "raster": rasters,
    "shade": shade,
    "shade_lit": shade_lit,
    "stochastic": estimates,
    "splats": splats,
}


if __name__ == "__main__":
    arrays = {f"{door} {i}": array for door, call in DOORS.items() for i, (array, _) in enumerate(call())}
    np.savez(sys.stdout.buffer, isa=_native.isa(), **arrays)
