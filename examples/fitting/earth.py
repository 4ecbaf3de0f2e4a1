"""A planet's texture, learned from views at many distances, with and without mipmaps.

After section 4.2 of Laine et al., "Modular Primitives for High-Performance Differentiable Rendering" (2020). A unit
sphere wears a cube map and stands at a random distance, so that a pixel covers less than a texel or hundreds of them.
Every iteration shows one new view: the reference is rendered with `supersampling` squared samples a pixel and
filtered down, the training image directly, one lookup a pixel. Both textures, with and without mipmaps, see the same
views, start from the same grey and are fitted by Adam (0.9, 0.99) to the least mean squared difference.

The ratio of pixels to texels at a given distance depends on resolution / texture_size alone, so a small texture in
small images is the paper's task, with fewer texels.

    python examples/fitting/earth.py                          on a CPU
    python examples/fitting/earth.py --full --device cuda     the paper's size
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import camera
import meshes
import report
import textures
import torch
from torch import Tensor

from mipbake import raster, sampling

VARIANTS = {"with mipmaps": "linear-mipmap-linear", "without mipmaps": "linear"}
PAPER = {"with mipmaps": 32.9, "without mipmaps": 25.6}


@dataclass(frozen=True)
class Settings:
    texture_size: int = 64
    resolution: int = 64
    supersampling: int = 8
    iterations: int = 20_000
    nearest: float = 1.5
    farthest: float = 50.0
    first_rate: float = 1e-2
    last_rate: float = 1e-3
    seed: int = 0
    device: str = "cpu"


FULL = Settings(texture_size=512, resolution=512)


def render(texture: Tensor, mesh: meshes.Mesh, pos: Tensor, resolution: int, filter_mode: str) -> Tensor:
    """(B, resolution, resolution, 3), one lookup a pixel, black where there is no planet."""
    rast, rast_db = raster.rasterize(None, pos, mesh.triangles, (resolution, resolution))
    uv, uv_da = raster.interpolate(mesh.positions[None], rast, mesh.triangles, rast_db, diff_attrs="all")
    derivatives = None if filter_mode == "linear" else uv_da
    color = sampling.texture(texture, uv, derivatives, filter_mode=filter_mode, boundary_mode="cube")
    return color * (rast[..., 3:] > 0)


def filtered_down(image: Tensor, factor: int) -> Tensor:
    """(B, H, W, C) to (B, H / factor, W / factor, C): the mean of every pixel's samples."""
    return torch.nn.functional.avg_pool2d(image.permute(0, 3, 1, 2), factor).permute(0, 2, 3, 1)


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = report.parse(__doc__, Settings(), FULL, arguments)
    log = report.Report("earth", settings, folder)
    generator = torch.Generator().manual_seed(settings.seed)
    mesh = meshes.sphere(16).to(settings.device)
    target = textures.planet(settings.texture_size).to(settings.device)
    fine = settings.resolution * settings.supersampling

    def view(distance: float) -> Tensor:
        rotation = camera.rotation_matrix(camera.random_quaternions(1, generator)).to(settings.device)
        return camera.to_clip(mesh.positions, rotation, distance)

    def reference(pos: Tensor) -> Tensor:
        return filtered_down(render(target, mesh, pos, fine, "linear-mipmap-linear"), settings.supersampling)

    learned = {name: torch.full_like(target, 0.5, requires_grad=True) for name in VARIANTS}
    optimiser = torch.optim.Adam(learned.values(), betas=(0.9, 0.99))
    measured = report.checkpoints(settings.iterations)
    curves: dict[str, list[tuple[float, float]]] = {name: [] for name in VARIANTS}
    for iteration in report.falling_rate(optimiser, settings.first_rate, settings.last_rate, settings.iterations):
        if iteration in measured:
            for name, texture in learned.items():
                curves[name].append((iteration, report.psnr(texture, target)))
        distance = settings.nearest + (settings.farthest - settings.nearest) * torch.rand((), generator=generator)
        pos = view(float(distance))
        with torch.no_grad():
            wanted = reference(pos)
        loss = sum(
            (render(texture, mesh, pos, settings.resolution, VARIANTS[name]) - wanted).square().mean()
            for name, texture in learned.items()
        )
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    for name, texture in learned.items():
        value = report.psnr(texture, target)
        curves[name].append((settings.iterations, value))
        log.add(f"texture {name}: {value:.2f} dB (paper {PAPER[name]} dB)", **{f"psnr {name}": value})
    log.add("the convergence is in the figures", paper={f"psnr {k}": v for k, v in PAPER.items()}, convergence=curves)

    with torch.no_grad():
        rows = [[textures.unfolded(target)], [], []]
        rows[0] += [textures.unfolded(learned[name]) for name in VARIANTS]
        for row, distance in zip(rows[1:], (1.9, 12.0), strict=True):
            pos = view(distance)
            row.append(report.upright(reference(pos)[0]))
            row += [
                report.upright(render(learned[n], mesh, pos, settings.resolution, VARIANTS[n])[0]) for n in VARIANTS
            ]
    width = rows[0][0].shape[1]
    rows[1:] = [[report.enlarged(image, width) for image in row] for row in rows[1:]]
    log.save(report.mosaic([*rows, [report.chart(curves, 3 * width + 8, 220)]]))


if __name__ == "__main__":
    main()
