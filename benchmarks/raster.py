"""Rasterize, interpolate, antialias with gradients; and what hidden geometry costs. Prints Markdown.

    python benchmarks/raster.py [--device cpu] [--side 1024] [--triangles 300000] [--rounds 7]

The first table renders a bumpy sphere that fills a square image, every triangle in the frustum and half of them facing
away, and brings gradients back to its positions and attributes. 4 attributes are interpolated, 2 of them with their
image-space derivatives; 3 channels are antialiased.

The second is figure 9 of Laine et al. 2020: an 8 x 8 grid (128 triangles) repeated 1 to 1024 times, side by side (all
visible, together they cover the image) or stacked in depth (one visible, which covers the image alone), farthest first,
the worst order for a rasterizer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from timing import Timing, arguments, measure, on_device, show
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
    """The three ops on one mesh."""

    def __init__(self, mesh: Mesh, side: int) -> None:
        self.mesh, self.resolution = mesh, (side, side)
        self.context = raster.RasterizeContext()
        self.topology = raster.antialias_construct_topology_hash(mesh.tri)
        generator = torch.Generator().manual_seed(0)
        self.grad_color, self.grad_derivatives = (
            torch.rand(1, side, side, channels, generator=generator).to(mesh.pos.device) for channels in (3, 4)
        )
        self.rast, _ = raster.rasterize(self.context, mesh.pos, mesh.tri, self.resolution)

    def whole(self, backward: bool = True) -> object:
        pos, attr = (t.detach().requires_grad_(backward) for t in (self.mesh.pos, self.mesh.attr))
        rast, rast_db = raster.rasterize(self.context, pos, self.mesh.tri, self.resolution)
        out, out_da = raster.interpolate(attr, rast, self.mesh.tri, rast_db, [0, 1])
        color = raster.antialias(out[..., :3].contiguous(), rast, pos, self.mesh.tri, self.topology)
        if not backward:
            return color
        return torch.autograd.grad([color, out_da], [pos, attr], [self.grad_color, self.grad_derivatives])


def main() -> None:
    options = arguments(__doc__, device="cpu", side=1024, triangles=300_000, rounds=7)
    device = torch.device(options.device)
    machine, synchronize = on_device(options.device)

    def timed(candidates: dict[str, Callable[[], object]]) -> dict[str, Timing]:
        return measure(candidates, options.rounds, synchronize)

    chain = Chain(sphere(options.triangles, device), options.side)
    covered = float((chain.rast[..., 3] > 0).float().mean())
    seen = len(chain.rast[..., 3].unique()) - 1
    print(
        f"{machine}; {_native.num_threads()} threads; torch {torch.__version__}; "
        f"{options.side} x {options.side} pixels, {covered:.0%} covered; "
        f"{len(chain.mesh.tri):,} triangles, {seen:,} seen; medians of {options.rounds} rounds\n"
    )
    found = timed({"forward": lambda: chain.whole(backward=False), "forward + backward": chain.whole})
    rows = [[f"all three, {name}", f"{each.median * 1e3:.1f} ms", f"{each.spread:.0%}"] for name, each in found.items()]
    show(["what", "time", "spread"], rows)
    print()

    def grids() -> Iterator[list[str]]:
        for copies in (1, 64, 256, 1024):
            chains = [Chain(repeated_grids(copies, stacked, device), options.side) for stacked in (False, True)]
            found = timed({"beside": chains[0].whole, "stacked": chains[1].whole})
            beside, stacked = (each.median * 1e3 for each in found.values())
            yield [str(copies), f"{beside:.1f} ms", f"{stacked:.1f} ms", f"{stacked / beside:.2f}"]

    show(["8 x 8 grids, all three forward + backward", "side by side", "stacked in depth", "ratio"], grids())


if __name__ == "__main__":
    main()
