"""A deforming surface and its texture, captured from the pictures of fixed cameras.

After section 5 of Laine et al., "Modular Primitives for High-Performance Differentiable Rendering" (2020), on a
generated performance in place of an actor's: a textured ball bulges, dents and twists from frame to frame, before
cameras whose brightness and contrast differ. Neither shading nor the motion is known. Learned are one texture, for
every frame i the vertices V_i = V_base + M3 M2 M1 w_i, where w_i picks column i, and two numbers for each camera. An
iteration shows one frame to one camera. Then several performances are captured together, each of which begins from
another place: one texture for all, which begins as that of the first, and a matrix R_j of 3 x 4 numbers for each
performance, R_j V_base in place of V_base. The loss is |x' - y'|^2 + stiffness L_delta (the paper's stiffness is 3, in
units of length that it does not name), with x' = x - 0.3 blur(x) and the
mean squared change L_delta of the difference between each vertex and the mean of its neighbours.

The pictures are of a mesh with finer triangles, so that the truth is not among what can be learned. What is reported is
the distance between the learned vertices and where the motion takes them, beside that of the base mesh, which does not
move. The ball is 2 long.

    python examples/fitting/capture.py                          on a CPU
    python examples/fitting/capture.py --full --device cuda     the paper's length and numbers of vertices and cameras
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import camera
import meshes
import report
import textures
import torch
from torch import Tensor

import mipbake.nvdiffrast as dr


@dataclass(frozen=True)
class Settings:
    frames: int = 16
    performances: int = 3
    cameras: int = 6
    resolution: int = 128
    texture_size: int = 96
    steps: int = 14
    iterations: int = 10_000
    rate: float = 1e-3
    stiffness: float = 30.0
    seed: int = 0
    device: str = "cpu"


FULL = Settings(frames=89, cameras=9, resolution=2048, texture_size=1024, steps=52, iterations=100_000)

FINER = 3
"""Triangles of the pictures along each of what is learned."""


def performance(points: Tensor, frames: int, number: int = 0) -> Tensor:
    """(F, V, 3): where the frames of one performance take points of the base mesh (V, 3)."""
    time = torch.arange(frames, device=points.device)[:, None] / frames * 2 * math.pi
    moved = points.expand(frames, -1, -1)
    for place, speed, size in (([0.2, 0.5, 0.8], 1, 0.22), ([-0.6, -0.2, 0.7], 2, -0.15), ([0.5, -0.6, 0.5], 1, 0.18)):
        centre = torch.nn.functional.normalize(points.new_tensor(place), dim=0)
        near = torch.exp(-4 * (points - centre).square().sum(-1))
        moved = moved + size * (near * torch.sin(speed * time + place[0] + number))[..., None] * points
    turn = 0.25 * torch.sin(time) * moved[..., 1]
    x, y, z = moved.unbind(-1)
    twisted = torch.stack([x * turn.cos() + z * turn.sin(), y, z * turn.cos() - x * turn.sin()], -1)
    turned = camera.rotation_matrix(points.new_tensor([1, 0.06 * number, -0.05 * number, 0.03 * number]))
    return twisted @ turned.T + points.new_tensor([0.1, -0.05, 0]) * number


def rig(count: int) -> Tensor:
    """(C, 3, 3): rotations of cameras on the front half of a sphere."""
    turn = torch.arange(count) * (math.pi * (3 - math.sqrt(5)))
    height = (torch.arange(count) + 0.5) / count
    tilt = torch.stack([turn.cos(), turn.sin(), torch.zeros(count)], -1) * 0.9 * height.sqrt()[:, None]
    half = tilt.norm(dim=-1, keepdim=True) / 2
    return camera.rotation_matrix(torch.cat([half.cos(), torch.nn.functional.normalize(tilt, dim=-1) * half.sin()], -1))


def render(
    glctx: dr.RasterizeCudaContext, texture: Tensor, base: meshes.Mesh, points: Tensor, rotation: Tensor, size: int
) -> Tensor:
    """(1, size, size, 1): points (V, 3) of a mesh that wears a cube map by where its base has them."""
    pos = camera.to_clip(points, rotation[None], distance=4.0, slope=0.4)
    rast, rast_db = dr.rasterize(glctx, pos, base.triangles, (size, size))
    uv, uv_da = dr.interpolate(base.positions[None], rast, base.triangles, rast_db, diff_attrs="all")
    color = dr.texture(texture, uv, uv_da, filter_mode="linear-mipmap-linear", boundary_mode="cube")
    return dr.antialias(color * (rast[..., 3:] > 0), rast, pos, base.triangles)


def filtered(
    glctx: dr.RasterizeCudaContext, texture: Tensor, base: meshes.Mesh, points: Tensor, rotation: Tensor, size: int
) -> Tensor:
    """(size, size, 1): the same from four pixels for each."""
    image = render(glctx, texture, base, points, rotation, 2 * size)
    return torch.nn.functional.avg_pool2d(image.permute(0, 3, 1, 2), 2)[0, 0, ..., None]


def high_pass(image: Tensor) -> Tensor:
    """x - 0.3 blur(x), blurred by averages over 1 / 94 of the picture, the paper's 32 pixels of 3008, and back."""
    channels, size = image.permute(0, 3, 1, 2), image.shape[1]
    few = torch.nn.functional.adaptive_avg_pool2d(channels, max(8, size // 32))
    blurred = torch.nn.functional.interpolate(few, (size, size), mode="bicubic")
    return image - 0.3 * blurred.permute(0, 2, 3, 1)


def neighbours(mesh: meshes.Mesh) -> Tensor:
    """(V, V) sparse: 1 / |N_j| where two vertices share an edge."""
    edges = torch.cat(
        [mesh.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]
    ).long()  # both ways, being closed
    count = len(mesh.positions)
    degree = torch.bincount(edges[:, 0], minlength=count).float()
    return torch.sparse_coo_tensor(edges.T, 1 / degree[edges[:, 0]], (count, count), check_invariants=False).coalesce()


@dataclass(frozen=True)
class Captured:
    """What a capture came to: the texture, (iteration, mean distance of vertices), that of the base mesh, pictures."""

    texture: Tensor
    curve: list[tuple[int, float]]
    still: float
    rows: list[list[Tensor]]


def capture(settings: Settings, performances: int, generator: torch.Generator, start: Tensor | None) -> Captured:
    """Captures performances together, with R_j where they are several, from a texture or from black."""
    device, cameras, size = settings.device, settings.cameras, settings.resolution
    frames = settings.frames * performances
    base, fine = meshes.sphere(settings.steps).to(device), meshes.sphere(FINER * settings.steps).to(device)
    glctx = dr.RasterizeCudaContext(device=device)
    rotations = rig(cameras).to(device)
    worn = textures.planet(settings.texture_size).mean(-1, keepdim=True).to(device)
    contrast_of, brightness_of = torch.randn(2, cameras, generator=generator).to(device) * 0.1

    def acted(mesh: meshes.Mesh) -> Tensor:
        return torch.cat([performance(mesh.positions, settings.frames, number) for number in range(performances)])

    @torch.no_grad()
    def picture(points: Tensor, c: int) -> Tensor:
        return filtered(glctx, worn, fine, points, rotations[c], size) * (1 + contrast_of[c]) + brightness_of[c]

    truth = acted(base)
    images = torch.stack([torch.stack([picture(points, c) for c in range(cameras)]) for points in acted(fine)])

    texture = (torch.zeros_like(worn) if start is None else start.clone()).requires_grad_(True)
    first, second = (torch.eye(frames, device=device, requires_grad=True) for _ in range(2))
    third = torch.zeros(base.positions.numel(), frames, device=device, requires_grad=True)
    contrast, brightness = (torch.full((cameras,), v, device=device, requires_grad=True) for v in (1.0, 0.0))
    rigid = torch.eye(3, 4, device=device).repeat(performances, 1, 1).requires_grad_(performances > 1)
    learned = [texture, first, second, third, contrast, brightness]
    optimiser = torch.optim.Adam(learned + [rigid] * (performances > 1), lr=settings.rate)
    mean = neighbours(base)
    points_of_base = torch.nn.functional.pad(base.positions, (0, 1), value=1)

    def placed(i: int) -> Tensor:
        return points_of_base @ rigid[i // settings.frames].T

    def vertices(i: int) -> Tensor:
        return placed(i) + (third @ (second @ first[:, i])).view_as(base.positions)

    @torch.no_grad()
    def error() -> float:
        found = torch.stack([vertices(i) for i in range(frames)])
        return float((found - truth).norm(dim=-1)[:, seen].mean())

    # Vertices that no camera sees are left out: of a sphere those behind the outermost views.
    seen = (base.positions @ rotations[:, 2].T > 0.3).any(-1)
    measured, curve = report.checkpoints(settings.iterations), []
    for iteration in range(settings.iterations):
        if iteration in measured:
            curve.append((iteration, error()))
        late = max(0.0, iteration / settings.iterations - 0.75) * 4
        for group in optimiser.param_groups:
            group["lr"] = settings.rate * 0.1**late
        i, c = (int(torch.randint(count, (), generator=generator)) for count in (frames, cameras))
        points = vertices(i)
        shown = render(glctx, texture, base, points, rotations[c], size) * contrast[c] + brightness[c]
        change = points - placed(i)
        stiff = (change - mean @ change).square().sum(-1).mean()
        loss = (high_pass(shown) - high_pass(images[i, c][None])).square().mean() + settings.stiffness * stiff
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    curve.append((settings.iterations, error()))

    rows = []
    with torch.no_grad():
        for i in (frames // 4, frames // 2, frames * 3 // 4):
            shown = render(glctx, texture, base, vertices(i), rotations[0], size) * contrast[0] + brightness[0]
            rows.append([images[i, 0], shown[0], (shown[0] - images[i, 0]).abs() * 4])
    return Captured(texture.detach(), curve, curve[0][1], rows)


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = report.parse(__doc__, Settings(), FULL, arguments)
    log = report.Report("capture", settings, folder)
    generator = torch.Generator().manual_seed(settings.seed)
    one = capture(settings, 1, generator, None)
    several = capture(settings, settings.performances, generator, one.texture)
    for name, found in (("one performance", one), (f"{settings.performances} performances", several)):
        figures = {"mean distance": found.curve[-1][1], "of the base mesh": found.still, "convergence": found.curve}
        log.add(
            f"{name}: vertices are off by {found.curve[-1][1]:.4f} in the mean, where the base mesh is off by "
            f"{found.still:.4f}",
            **{name: figures},
        )
    rows = one.rows + several.rows
    log.save(report.mosaic([[report.upright(image.expand(-1, -1, 3)) for image in row] for row in rows]))


if __name__ == "__main__":
    main()
