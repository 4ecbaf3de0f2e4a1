"""A cube's corners and colours, learned from images a few pixels wide.

After section 4.1 of Laine et al. (2020). The corners of a unit cube start moved by up to 1/2 along every axis, their
colours random; in every iteration the cube and the reference are seen from the same random side and Adam lowers the
mean squared difference of the two antialiased images. Colours are shared by the faces at a corner (continuous, 8 of
them) or every face has its own (discontinuous, 24).

All runs of a configuration are items of one minibatch: nothing couples them, since the loss is a sum over the items and
Adam works number by number. No run is left out: where the corners cross in the first steps the mesh is folded for
good, far from the truth (the paper excluded those by hand). So besides the mean over all runs there is the number of
runs that ended within `success` of the truth, in edge lengths of the cube, and the mean over those.

    python examples/fitting/cube.py                           the paper's size, on a CPU
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

DISTANCE = 3.5  # with the camera's opening, an average triangle covers 0.53 pixels of 4 x 4 (0.54 in the paper)
SHOWN = (0, 10, 100, 1000)


@dataclass(frozen=True)
class Settings:
    resolutions: tuple[int, ...] = (16, 8, 4, 2)
    runs: int = 20
    iterations: int = 5000
    first_rate: float = 1e-2
    last_rate: float = 1e-4
    success: float = 0.2
    seed: int = 0
    device: str = "cpu"
    opengl: bool = False


class Cube:
    """The true cube and the way it is drawn."""

    def __init__(self, continuous: bool, settings: Settings) -> None:
        device = settings.device
        context = dr.RasterizeGLContext if settings.opengl else dr.RasterizeCudaContext
        self.glctx = context(device=settings.device)
        mesh, corners = meshes.cube()
        self.mesh = mesh.to(device)
        self.topology = dr.antialias_construct_topology_hash(self.mesh.triangles)
        corner_colors = mesh.positions + 0.5
        if continuous:
            self.color_triangles = self.mesh.triangles
            self.colors = corner_colors.to(device)
        else:
            self.color_triangles = corners.to(device)
            self.colors = torch.empty(24, 3)
            self.colors[corners.flatten().long()] = corner_colors[mesh.triangles.flatten().long()]
            # Every face its own: the corner's colour, turned around the channels from face to face.
            for face in range(6):
                block = self.colors[4 * face : 4 * face + 4]
                self.colors[4 * face : 4 * face + 4] = (1 - block if face % 2 else block).roll(face // 2, -1)
            self.colors = self.colors.to(device)

    def render(self, positions: Tensor, colors: Tensor, rotation: Tensor, resolution: int) -> Tensor:
        """(B, resolution, resolution, 3), antialiased; positions and colours (V, 3) or (B, V, 3)."""
        pos = camera.to_clip(positions, rotation, DISTANCE)
        rast, _ = dr.rasterize(self.glctx, pos, self.mesh.triangles, (resolution, resolution))
        color, _ = dr.interpolate(colors.reshape(-1, *colors.shape[-2:]), rast, self.color_triangles)
        return dr.antialias(color, rast, pos, self.mesh.triangles, self.topology)


def fit(settings: Settings, cube: Cube, resolution: int) -> tuple[dict[int, list[float]], list[list[np.ndarray]]]:
    """Mean distance of the corners from the truth, of every run, by iteration; and pictures of the first run."""
    generator = torch.Generator().manual_seed(settings.seed)
    truth, shape = cube.mesh.positions, (settings.runs, *cube.mesh.positions.shape)
    positions = truth + (torch.rand(shape, generator=generator) - 0.5).to(truth)
    colors = torch.rand((settings.runs, *cube.colors.shape), generator=generator).to(truth)
    positions.requires_grad_(True), colors.requires_grad_(True)
    optimiser = torch.optim.Adam([positions, colors], betas=(0.9, 0.999))
    showing = camera.rotation_matrix(torch.tensor([[0.82, 0.35, -0.43, 0.12]])).to(truth)
    measured, errors = report.checkpoints(settings.iterations) | set(SHOWN), {}
    pictures: list[list[np.ndarray]] = []

    def show(iteration: int) -> None:
        errors[iteration] = (positions.detach() - truth).norm(dim=-1).mean(-1).tolist()
        if iteration in (*SHOWN, settings.iterations):
            with torch.no_grad():
                pair = [cube.render(positions[:1], colors[:1], showing, size)[0] for size in (resolution, 128)]
            pictures.append([report.enlarged(report.upright(image), 128) for image in pair])

    for iteration in report.falling_rate(optimiser, settings.first_rate, settings.last_rate, settings.iterations):
        if iteration in measured:
            show(iteration)
        rotation = camera.rotation_matrix(camera.random_quaternions(settings.runs, generator)).to(truth)
        with torch.no_grad():
            wanted = cube.render(truth, cube.colors, rotation, resolution)
        image = cube.render(positions, colors, rotation, resolution)
        loss = (image - wanted).square().mean((1, 2, 3)).sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    show(settings.iterations)
    return errors, pictures


def figures(errors: dict[int, list[float]], success: float) -> dict[str, object]:
    """What a configuration came to: all its runs, and those that ended within `success` of the truth."""
    table = np.array(list(errors.values()))
    good = table[-1] < success
    return {
        "runs": len(good),
        "successful": int(good.sum()),
        "mean error at the start": float(table[0].mean()),
        "mean error": float(table[-1].mean()),
        "mean error of the successful": float(table[-1, good].mean()) if good.any() else None,
        "errors": [round(float(error), 6) for error in table[-1]],
        "convergence of the successful": list(zip(errors, table[:, good].mean(1).tolist(), strict=True))
        if good.any()
        else [],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = report.parse(__doc__, Settings(), None, arguments)
    log = report.Report("cube", settings, folder)
    rows = []
    for continuous in (True, False):
        cube = Cube(continuous, settings)
        for resolution in settings.resolutions:
            name = f"{resolution} x {resolution}, {'continuous' if continuous else 'discontinuous'}"
            errors, pictures = fit(settings, cube, resolution)
            result = figures(errors, settings.success)
            of_those = result["mean error of the successful"]
            log.add(
                f"{name}: {result['successful']} of {settings.runs} runs within {settings.success:g} of the truth, "
                f"mean error {of_those and round(of_those, 5)} of those, {result['mean error']:.5f} of all",
                **{name: result},
            )
            if continuous:
                rows.append([picture[0] for picture in pictures] + [pictures[-1][1]])
    log.save(report.mosaic(rows))


if __name__ == "__main__":
    main()
