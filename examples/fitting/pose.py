"""The pose of a cube with six colours, found from one image, in three ways.

After section 4.4 of Laine et al. (2020). The unknown is a quaternion, started at random; the loss is the mean squared
difference of the antialiased images. It has many local minima: the right outline with the colours on the wrong sides.

  noise      Adam, with the pose mixed (slerp) with a random one in every iteration, less and less of it
  two phases without gradients first: a randomly mixed pose is kept where its image is nearer; then Adam from the best
  symmetry   the same, the random pose followed by a rotation that maps a cube to itself

All trials are items of one minibatch; nothing couples them. The error is the angle between found and true pose.

    python examples/fitting/pose.py                           on a CPU
    python examples/fitting/pose.py --full --device cuda      the paper's size
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import camera
import meshes
import numpy as np
import report
import torch
from torch import Tensor

import mipbake.nvdiffrast as dr

DISTANCE, SLOPE = 10.0, 0.14
"""A narrow view from far: views of a single face, which show no pose, are rare (1 in 200)."""
COLORS = torch.tensor(
    [[0.9, 0.1, 0.1], [0.1, 0.7, 0.2], [0.1, 0.3, 0.9], [0.95, 0.85, 0.1], [1, 1, 1], [0.9, 0.5, 0.1]]
)
PAPER = {"noise": 48.62, "two phases": 22.49, "symmetry": 2.61}


@dataclass(frozen=True)
class Settings:
    trials: int = 100
    resolution: int = 32
    iterations: int = 4000
    first_noise: float = 1.0
    last_noise: float = 0.003
    first_rate: float = 3e-2
    last_rate: float = 1e-3
    seed: int = 0
    device: str = "cpu"
    opengl: bool = False


FULL = Settings(resolution=256, iterations=10_000)


class Cube:
    """The cube, and the difference between its images.

    Every face has corners of its own. Antialiasing blends where an edge has nothing on its other side, so colours are
    blended, and give gradients, at every edge between two faces and not at the outline alone.
    """

    def __init__(self, settings: Settings) -> None:
        context = dr.RasterizeGLContext if settings.opengl else dr.RasterizeCudaContext
        self.glctx = context(device=settings.device)
        mesh, corners = meshes.cube()
        points = torch.empty(24, 3)
        points[corners.long()] = mesh.positions[mesh.triangles.long()]
        self.mesh = meshes.Mesh(points, corners).to(settings.device)
        self.topology = dr.antialias_construct_topology_hash(self.mesh.triangles)
        self.colors = COLORS.repeat_interleave(4, 0).to(settings.device)
        self.resolution = (settings.resolution, settings.resolution)

    def render(self, pose: Tensor) -> Tensor:
        """(B, H, W, 3) of poses (B, 4)."""
        tri = self.mesh.triangles
        pos = camera.to_clip(self.mesh.positions, camera.rotation_matrix(pose), DISTANCE, SLOPE)
        rast, _ = dr.rasterize(self.glctx, pos, tri, self.resolution)
        color, _ = dr.interpolate(self.colors[None], rast, tri)
        return dr.antialias(color, rast, pos, tri, self.topology)

    def loss(self, pose: Tensor, wanted: Tensor) -> Tensor:
        """(B,)"""
        return (self.render(pose) - wanted).square().mean((1, 2, 3))


class Noise:
    """Random poses to mix in, with a strength that falls exponentially over a number of iterations."""

    def __init__(self, settings: Settings, iterations: int, seed: int, symmetry: bool = False) -> None:
        self.settings, self.iterations = settings, iterations
        self.generator = torch.Generator().manual_seed(seed)
        self.symmetries = meshes.cube_symmetries() if symmetry else None

    def mixed(self, pose: Tensor, iteration: int) -> Tensor:
        s = self.settings
        strength = s.first_noise * (s.last_noise / s.first_noise) ** (iteration / max(self.iterations - 1, 1))
        pose = torch.nn.functional.normalize(pose, dim=-1)
        pose = camera.slerp(pose, camera.random_quaternions(len(pose), self.generator).to(pose), strength)
        if self.symmetries is None:
            return pose
        chosen = torch.randint(len(self.symmetries), (len(pose),), generator=self.generator)
        return camera.multiply(pose, self.symmetries[chosen].to(pose))


def descend(
    settings: Settings, cube: Cube, start: Tensor, wanted: Tensor, iterations: int, noise: Noise | None
) -> Tensor:
    """Adam on the poses; returns where it ends."""
    pose = start.clone().requires_grad_(True)
    optimiser = torch.optim.Adam([pose], betas=(0.9, 0.999))
    for iteration in report.falling_rate(optimiser, settings.first_rate, settings.last_rate, iterations):
        loss = cube.loss(noise.mixed(pose, iteration) if noise else pose, wanted).sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return pose.detach()


@torch.no_grad()
def seek(cube: Cube, start: Tensor, wanted: Tensor, iterations: int, noise: Noise) -> Tensor:
    """The greedy search without gradients: of every trial the pose whose image was nearest."""
    best, least = start, cube.loss(start, wanted)
    for iteration in range(iterations):
        tried = noise.mixed(best, iteration)
        loss = cube.loss(tried, wanted)
        best = torch.where((loss < least)[:, None], tried, best)
        least = torch.minimum(loss, least)
    return best


def figures(cube: Cube, pose: Tensor, truth: Tensor, wanted: Tensor, paper: float | None) -> dict[str, object]:
    error = camera.angle_degrees(pose, truth).cpu().numpy()
    with torch.no_grad():
        loss = float(cube.loss(pose, wanted).mean())
    return {
        "mean error": float(error.mean()),
        "paper": paper,
        "median error": float(np.median(error)),
        "above 10 degrees": int(np.count_nonzero(error > 10)),
        "mean loss": loss,
        "errors": [round(float(e), 3) for e in error],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = report.parse(__doc__, Settings(), FULL, arguments)
    log = report.Report("pose", settings, folder)
    generator = torch.Generator().manual_seed(settings.seed)
    cube, iterations = Cube(settings), settings.iterations
    truth = camera.random_quaternions(settings.trials, generator).to(settings.device)
    start = camera.random_quaternions(settings.trials, generator).to(settings.device)
    with torch.no_grad():
        wanted = cube.render(truth)

    def noisy() -> Tensor:
        return descend(settings, cube, start, wanted, iterations, Noise(settings, iterations, settings.seed + 1))

    def two_phases(symmetry: bool) -> Tensor:
        noise = Noise(settings, iterations // 2, settings.seed + 1, symmetry)
        best = seek(cube, start, wanted, iterations // 2, noise)
        return descend(settings, cube, best, wanted, iterations - iterations // 2, None)

    methods = {
        "start": lambda: start,
        "noise": noisy,
        "two phases": lambda: two_phases(symmetry=False),
        "symmetry": lambda: two_phases(symmetry=True),
    }
    shown = min(8, settings.trials)
    with torch.no_grad():
        rows = [wanted[:shown]]
    for method, run in methods.items():
        pose = run()
        result = figures(cube, pose, truth, wanted, PAPER.get(method))
        log.add(
            f"{method}: mean error {result['mean error']:.2f} degrees over {settings.trials} trials (paper "
            f"{result['paper']}), median {result['median error']:.2f}, {result['above 10 degrees']} above 10 degrees",
            **{method: result},
        )
        with torch.no_grad():
            rows.append(cube.render(pose[:shown]))
    log.save(report.mosaic([[report.enlarged(report.upright(image), 96) for image in row] for row in rows]))


if __name__ == "__main__":
    main()
