"""Rasterize, interpolate, antialias with gradients; and what hidden geometry costs. Prints Markdown.

    python benchmarks/raster.py [--device cpu] [--side 1024] [--triangles 300000] [--rounds 7]

The first table renders a bumpy sphere that fills a square image, every triangle in the frustum and half of them facing
away, and brings gradients back to its positions and attributes. 4 attributes are interpolated, 2 of them with their
image-space derivatives; 3 channels are antialiased. Every op is timed with its backward pass, and the whole chain by
itself. A peeler takes as many layers as the table says.

The second is figure 9 of Laine et al. 2020: an 8 x 8 grid (128 triangles) repeated 1 to 1024 times, side by side (all
visible, together they cover the image) or stacked in depth (one visible, which covers the image alone), farthest first,
the worst order for a rasterizer.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from timing import Timing, cpu_name, measure
from torch import Tensor

from mipbake import _native, raster


@dataclass(frozen=True)
class Mesh:
    """pos (1, V, 4) in clip space, attr (1, V, 4), tri (T, 3)."""

    pos: Tensor
    attr: Tensor
    tri: Tensor


def grid_triangles(rows: int, columns: int) -> Tensor:
    """(2 rows columns, 3) triangles of a grid of (rows + 1) x (columns + 1) vertices, int32."""
    index = torch.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    return torch.cat([torch.stack([a, b, c], -1), torch.stack([b, d, c], -1)]).reshape(-1, 3).int()


def sphere(triangles: int, device: torch.device) -> Mesh:
    """A sphere with bumps in front of a perspective camera, in about as many triangles."""
    side = round(math.sqrt(triangles / 2))
    theta = torch.linspace(0.001, math.pi - 0.001, side + 1)[:, None]
    phi = torch.linspace(0, math.tau, side + 1)[None, :]
    radius = 1 + 0.03 * torch.sin(9 * phi) * torch.sin(11 * theta)
    x, y, z = (radius * c for c in (theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos() + 0 * phi))
    depth, near, far = 4.0 - z, 1.0, 10.0
    scale = 3.75  # the sphere touches the borders of the image
    clip_z = (depth * (far + near) - 2 * far * near) / (far - near)
    pos = torch.stack([scale * x, scale * y, clip_z, depth], -1).reshape(1, -1, 4)
    attr = torch.stack([phi.expand(side + 1, -1), theta.expand(-1, side + 1), x, y], -1).reshape(1, -1, 4)
    return Mesh(pos.contiguous().to(device), attr.contiguous().to(device), grid_triangles(side, side).to(device))


def repeated_grids(copies: int, stacked: bool, device: torch.device) -> Mesh:
    """Figure 9: 8 x 8 grids that cover the image, side by side or one behind the other."""
    across = round(math.sqrt(copies))
    corner = torch.linspace(-1, 1, 9)
    grid = torch.stack([*torch.meshgrid(corner, corner, indexing="xy"), torch.zeros(9, 9), torch.ones(9, 9)], -1)
    grid, tri = grid.reshape(-1, 4), grid_triangles(8, 8)
    positions = []
    for copy in range(copies):
        place = grid.clone()
        if stacked:
            place[:, 2] = 0.9 - 1.8 * copy / copies
        else:
            place[:, 0] = (place[:, 0] + 1 + 2 * (copy % across)) / across - 1
            place[:, 1] = (place[:, 1] + 1 + 2 * (copy // across)) / across - 1
        positions.append(place)
    pos = torch.cat(positions)[None]
    tri = torch.cat([tri + copy * len(grid) for copy in range(copies)])
    attr = torch.rand(1, pos.shape[1], 4, generator=torch.Generator().manual_seed(0))
    return Mesh(pos.contiguous().to(device), attr.to(device), tri.int().contiguous().to(device))


class Chain:
    """The three ops on one mesh, apart and together, each with its backward pass."""

    def __init__(self, mesh: Mesh, side: int) -> None:
        self.mesh, self.resolution = mesh, (side, side)
        self.context = raster.RasterizeContext()
        self.topology = raster.antialias_construct_topology_hash(mesh.tri)
        generator = torch.Generator().manual_seed(0)

        def random(channels: int) -> Tensor:
            return torch.rand(1, side, side, channels, generator=generator).to(mesh.pos.device)

        self.color, self.grad_color = random(3), random(3)
        self.grad_pixels, self.grad_derivatives = random(4), random(4)
        self.rast, self.rast_db = raster.rasterize(self.context, mesh.pos, mesh.tri, self.resolution)

    def rasterize(self, backward: bool = True) -> object:
        pos = self.mesh.pos.detach().requires_grad_(backward)
        rast, rast_db = raster.rasterize(self.context, pos, self.mesh.tri, self.resolution)
        return (
            torch.autograd.grad([rast, rast_db], pos, [self.grad_pixels, self.grad_derivatives]) if backward else rast
        )

    def peel(self, layers: int) -> object:
        with raster.DepthPeeler(self.context, self.mesh.pos, self.mesh.tri, self.resolution) as peeler:
            return [peeler.rasterize_next_layer() for _ in range(layers)]

    def interpolate(self, backward: bool = True) -> object:
        leaves = [t.detach().requires_grad_(backward) for t in (self.mesh.attr, self.rast, self.rast_db)]
        attr, rast, rast_db = leaves
        out, out_da = raster.interpolate(attr, rast, self.mesh.tri, rast_db, [0, 1])
        return (
            torch.autograd.grad([out, out_da], leaves, [self.grad_pixels, self.grad_derivatives]) if backward else out
        )

    def antialias(self, backward: bool = True) -> object:
        color, pos = (t.detach().requires_grad_(backward) for t in (self.color, self.mesh.pos))
        out = raster.antialias(color, self.rast, pos, self.mesh.tri, self.topology)
        return torch.autograd.grad(out, [color, pos], self.grad_color) if backward else out

    def whole(self, backward: bool = True) -> object:
        pos, attr = (t.detach().requires_grad_(backward) for t in (self.mesh.pos, self.mesh.attr))
        rast, rast_db = raster.rasterize(self.context, pos, self.mesh.tri, self.resolution)
        out, out_da = raster.interpolate(attr, rast, self.mesh.tri, rast_db, [0, 1])
        color = raster.antialias(out[..., :3].contiguous(), rast, pos, self.mesh.tri, self.topology)
        if not backward:
            return color
        return torch.autograd.grad([color, out_da], [pos, attr], [self.grad_color, self.grad_derivatives])


def ops_table(chain: Chain, timed: Callable[[dict[str, Callable[[], object]]], dict[str, Timing]]) -> list[str]:
    calls = {
        "rasterize": chain.rasterize,
        "interpolate": chain.interpolate,
        "antialias": chain.antialias,
        "all three": chain.whole,
    }
    candidates: dict[str, Callable[[], object]] = {}
    for name, call in calls.items():
        candidates[f"{name}, forward"] = lambda call=call: call(backward=False)
        candidates[f"{name}, forward + backward"] = call
    for layers in (1, 2, 4):
        candidates[f"layers of a peeler, forward: {layers}"] = lambda layers=layers: chain.peel(layers)  # type: ignore[misc]
    candidates["topology of the triangles"] = lambda: raster.antialias_construct_topology_hash(chain.mesh.tri)
    return [f"| {n} | {t.median * 1e3:.1f} ms | {t.spread:.0%} |" for n, t in timed(candidates).items()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu", help="cpu or cuda (default: %(default)s)")
    parser.add_argument("--side", type=int, default=1024, help="pixels in each direction (default: %(default)s)")
    parser.add_argument("--triangles", type=int, default=300_000, help="of the sphere (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=7, help="timed rounds (default: %(default)s)")
    options = parser.parse_args()
    device = torch.device(options.device)
    on_gpu = device.type == "cuda"
    machine = torch.cuda.get_device_name() if on_gpu else f"{cpu_name()}, {_native.isa()}"

    def timed(candidates: dict[str, Callable[[], object]]) -> dict[str, Timing]:
        return measure(candidates, options.rounds, torch.cuda.synchronize if on_gpu else lambda: None)

    chain = Chain(sphere(options.triangles, device), options.side)
    covered = float((chain.rast[..., 3] > 0).float().mean())
    seen = len(chain.rast[..., 3].unique()) - 1
    print(
        f"{machine}; {_native.num_threads()} threads; torch {torch.__version__}; "
        f"{options.side} x {options.side} pixels, {covered:.0%} covered; "
        f"{len(chain.mesh.tri):,} triangles, {seen:,} seen; medians of {options.rounds} rounds\n"
    )
    print("| what | time | spread |\n|---|---|---|")
    print("\n".join(ops_table(chain, timed)), flush=True)

    print(
        "\n| 8 x 8 grids, all three forward + backward | side by side | stacked in depth | ratio |\n|---|---|---|---|"
    )
    for copies in (1, 64, 256, 1024):
        chains = {s: Chain(repeated_grids(copies, s == "stacked", device), options.side) for s in ("beside", "stacked")}
        times = timed({name: c.whole for name, c in chains.items()})
        beside, stacked = (times[name].median * 1e3 for name in ("beside", "stacked"))
        print(f"| {copies} | {beside:.1f} ms | {stacked:.1f} ms | {stacked / beside:.2f} |", flush=True)


if __name__ == "__main__":
    main()
