"""A planet's texture, learned from views at many distances, with and without mipmaps.

After section 4.2 of Laine et al., "Modular Primitives for High-Performance Differentiable Rendering" (2020). A unit
sphere wears a cube map and stands at a random distance, so that a pixel covers less than a texel or hundreds of them.
Every iteration shows one new view: the reference is rendered with `supersampling` squared samples a pixel and
filtered down, the training image directly, one lookup a pixel. Both textures, with and without mipmaps, see the same
views, start from the same grey and are fitted by Adam (0.9, 0.99) to the least mean squared difference.

The ratio of pixels to texels at a given distance depends on resolution / texture_size alone, so a small texture in
small images is the paper's task, with fewer texels. One thing would not scale: in a small image most of the planet's
pixels lie at its outline. A reference pixel is therefore the mean over what it shows of the planet, and what it shows
of the sky counts nowhere.

    python examples/fitting/earth.py                          on a CPU
    python examples/fitting/earth.py --full --device cuda     the paper's size
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

VARIANTS = {"with mipmaps": "linear-mipmap-linear", "without mipmaps": "linear"}
SLOPE = 0.4
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
    opengl: bool = False


FULL = Settings(texture_size=512, resolution=512)


@dataclass(frozen=True)
class View:
    """The planet from a side and a distance, and of the picture the square of whole pixels that holds it."""

    pos: Tensor
    """(1, V, 4): clip space of the square"""
    pixels: int
    """The square's width; what lies outside is black in every image and costs nothing."""


def view(mesh: meshes.Mesh, distance: float, resolution: int, generator: torch.Generator) -> View:
    across = resolution / (SLOPE * math.sqrt(distance * distance - 1))
    pixels = min(resolution, 2 * math.ceil(across / 2 + 1))
    rotation = camera.rotation_matrix(camera.random_quaternions(1, generator)).to(mesh.positions)
    return View(camera.to_clip(mesh.positions, rotation, distance, SLOPE * pixels / resolution), pixels)


def render(
    glctx: dr.RasterizeCudaContext | dr.RasterizeGLContext,
    texture: Tensor,
    mesh: meshes.Mesh,
    seen: View,
    filter_mode: str,
    samples: int = 1,
) -> tuple[Tensor, Tensor]:
    """Colours (1, n, n, 3), one lookup a sample, n = samples x pixels, and whether the planet is there (1, n, n, 1)."""
    size = seen.pixels * samples
    rast, rast_db = dr.rasterize(glctx, seen.pos, mesh.triangles, (size, size))
    uv, uv_da = dr.interpolate(mesh.positions[None], rast, mesh.triangles, rast_db, diff_attrs="all")
    derivatives = None if filter_mode == "linear" else uv_da
    color = dr.texture(texture, uv, derivatives, filter_mode=filter_mode, boundary_mode="cube")
    return color, (rast[..., 3:] > 0).to(color)


def filtered_down(image: Tensor, samples: int) -> Tensor:
    """(1, n, n, C) to (1, pixels, pixels, C): a tent, two pixels wide, over every pixel's centre."""
    margin = (samples + 1) // 2
    offset = (torch.arange(samples + 2 * margin, device=image.device) + 0.5 - margin) / samples - 0.5
    tent = (1 - offset.abs()).clamp(min=0) / samples
    channels = torch.nn.functional.pad(image.permute(3, 0, 1, 2), (margin,) * 4, mode="replicate")
    columns = torch.nn.functional.conv2d(channels, tent[None, None, None], stride=(1, samples))
    rows = torch.nn.functional.conv2d(columns, tent[None, None, :, None], stride=(samples, 1))
    return rows.permute(1, 2, 3, 0)


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = report.parse(__doc__, Settings(), FULL, arguments)
    if not 1 < settings.nearest <= settings.farthest:
        raise SystemExit(f"--nearest is {settings.nearest:g}: expected more than 1, the planet's radius, and at most "
                         f"--farthest, {settings.farthest:g}")  # fmt: skip
    log = report.Report("earth", settings, folder)
    generator = torch.Generator().manual_seed(settings.seed)
    mesh = meshes.sphere(16).to(settings.device)
    target = textures.planet(settings.texture_size).to(settings.device)
    samples = settings.supersampling
    context = dr.RasterizeGLContext if settings.opengl else dr.RasterizeCudaContext
    glctx = context(device=settings.device)

    @torch.no_grad()
    def reference(seen: View) -> tuple[Tensor, Tensor]:
        """The mean over what each pixel shows of the planet, and how much that is, 0 to 1."""
        color, there = render(glctx, target, mesh, seen, "linear-mipmap-linear", samples)
        share = filtered_down(there, samples)
        return filtered_down(color * there, samples) / share.clamp(min=1e-6), share

    learned = {name: torch.full_like(target, 0.5, requires_grad=True) for name in VARIANTS}
    optimiser = torch.optim.Adam(learned.values(), betas=(0.9, 0.99))
    measured = report.checkpoints(settings.iterations)
    curves: dict[str, list[tuple[float, float]]] = {name: [] for name in VARIANTS}
    for iteration in report.falling_rate(optimiser, settings.first_rate, settings.last_rate, settings.iterations):
        if iteration in measured:
            for name, texture in learned.items():
                curves[name].append((iteration, report.psnr(texture, target)))
        distance = settings.nearest + (settings.farthest - settings.nearest) * torch.rand((), generator=generator)
        seen = view(mesh, float(distance), settings.resolution, generator)
        wanted, _ = reference(seen)
        loss = torch.zeros((), device=settings.device)
        for name, texture in learned.items():
            color, there = render(glctx, texture, mesh, seen, VARIANTS[name])
            loss = loss + ((color - wanted) * there).square().sum() / settings.resolution**2
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    for name, texture in learned.items():
        value = report.psnr(texture, target)
        curves[name].append((settings.iterations, value))
        log.add(f"texture {name}: {value:.2f} dB (paper {PAPER[name]} dB)", **{f"psnr {name}": value})
    log.add("the convergence is in the figures", paper={f"psnr {k}": v for k, v in PAPER.items()}, convergence=curves)

    rows = [[textures.unfolded(texture) for texture in (target, *learned.values())]]
    for distance in (1.9, 8.0):
        seen = view(mesh, distance, settings.resolution, generator)
        images = [torch.mul(*render(glctx, texture, mesh, seen, VARIANTS[name])) for name, texture in learned.items()]
        rows.append([report.upright(image[0]) for image in (torch.mul(*reference(seen)), *images)])
    width = rows[0][0].shape[1]
    rows[1:] = [[report.enlarged(image, width) for image in row] for row in rows[1:]]
    log.save(report.mosaic(rows))


if __name__ == "__main__":
    main()
