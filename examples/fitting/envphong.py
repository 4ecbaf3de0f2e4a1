"""The surroundings that a shining object reflects, and its highlight, learned from pictures of the object.

After section 4.3 of Laine et al. (2020). A bumpy knot of known shape mirrors an unknown environment (a cube map)
and has a highlight of Phong's model, of unknown colour and exponent, by a light of known direction. Every iteration
shows it from a new side with the light elsewhere. The reflection vectors are made at the vertices and interpolated
with their derivatives by pixel, so that the lookup in the cube map is filtered as a curved mirror demands. Adam with a
fixed rate; the exponent is learned by its logarithm, since a step of one rate must suit 5 and 100 alike.

    python examples/fitting/envphong.py                       on a CPU
    python examples/fitting/envphong.py --full --device cuda  the paper's size
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import camera
import meshes
import numpy as np
import report
import textures
import torch
from torch import Tensor
from torch.nn.functional import normalize

import mipbake.nvdiffrast as dr

DISTANCE = 2.8
TRUE_COLOR, TRUE_EXPONENT = (0.9, 0.7, 0.35), 25.0
SHOWN = (0, 10, 100)


@dataclass(frozen=True)
class Settings:
    texture_size: int = 64
    resolution: int = 128
    iterations: int = 2000
    rate: float = 1e-2
    seed: int = 0
    device: str = "cpu"
    opengl: bool = False


FULL = Settings(texture_size=512, resolution=512, iterations=5000)


@dataclass
class Look:
    """What is unknown."""

    environment: Tensor
    """(1, 6, S, S, 3)"""
    color: Tensor
    """(3,) of the highlight"""
    log_exponent: Tensor
    """()"""


class Knot:
    """The object, and how it is drawn."""

    def __init__(self, settings: Settings) -> None:
        context = dr.RasterizeGLContext if settings.opengl else dr.RasterizeCudaContext
        self.glctx = context(device=settings.device)
        mesh, normals = meshes.bumpy_knot()
        self.mesh, self.normals = mesh.to(settings.device), normals.to(settings.device)
        self.resolution = (settings.resolution, settings.resolution)

    def render(self, look: Look, rotation: Tensor, light: Tensor) -> Tensor:
        """(1, H, W, 3); the camera's rotation (1, 3, 3), the direction to the light (3,)."""
        points, tri = self.mesh.positions, self.mesh.triangles
        pos = camera.to_clip(points, rotation, DISTANCE)
        rast, rast_db = dr.rasterize(self.glctx, pos, tri, self.resolution)
        eye = DISTANCE * rotation[:, 2]  # where the camera is, in the object's space
        incoming = normalize(points - eye, dim=-1)
        mirrored = incoming - 2 * (incoming * self.normals).sum(-1, keepdim=True) * self.normals
        vector, vector_da = dr.interpolate(mirrored[None], rast, tri, rast_db, diff_attrs="all")
        reflected = dr.texture(
            look.environment, vector, vector_da, filter_mode="linear-mipmap-linear", boundary_mode="cube"
        )
        cosine = (normalize(vector, dim=-1) @ light)[..., None].clamp(min=1e-4)
        highlight = look.color * cosine ** look.log_exponent.exp()
        return (reflected + highlight) * (rast[..., 3:] > 0)


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = report.parse(__doc__, Settings(), FULL, arguments)
    log = report.Report("envphong", settings, folder)
    generator = torch.Generator().manual_seed(settings.seed)
    knot, device = Knot(settings), settings.device
    truth = Look(
        textures.surroundings(settings.texture_size).to(device),
        torch.tensor(TRUE_COLOR, device=device),
        torch.tensor(TRUE_EXPONENT, device=device).log(),
    )
    learned = Look(
        torch.full_like(truth.environment, 0.5, requires_grad=True),
        torch.rand(3, generator=generator).to(device).requires_grad_(True),
        torch.empty((), device=device).fill_(1 + 2 * float(torch.rand((), generator=generator))).requires_grad_(True),
    )
    optimiser = torch.optim.Adam([learned.environment, learned.color, learned.log_exponent], lr=settings.rate)
    measured = report.checkpoints(settings.iterations)
    curves: dict[str, list[tuple[float, float]]] = {"texture, dB": [], "colour, error": [], "exponent, error": []}

    def scene() -> tuple[Tensor, Tensor]:
        rotation = camera.rotation_matrix(camera.random_quaternions(1, generator))
        light = normalize(torch.randn(3, generator=generator), dim=0)
        return rotation.to(device), light.to(device)

    front = camera.rotation_matrix(torch.tensor([[0.9, -0.35, 0.25, 0.1]])).to(device)
    front_light = normalize(front[0].T @ torch.tensor([0.3, 0.4, 1.0], device=device), dim=0)
    pictures: list[np.ndarray] = []

    @torch.no_grad()
    def measure(iteration: int) -> None:
        exponent = float(learned.log_exponent.exp())
        curves["texture, dB"].append((iteration, report.psnr(learned.environment, truth.environment)))
        curves["colour, error"].append((iteration, float((learned.color - truth.color).abs().max())))
        curves["exponent, error"].append((iteration, abs(exponent - TRUE_EXPONENT)))
        if iteration in (*SHOWN, settings.iterations):
            pictures.append(report.upright(knot.render(learned, front, front_light)[0]))

    for iteration in range(settings.iterations):
        if iteration in measured or iteration in SHOWN:
            measure(iteration)
        rotation, light = scene()
        with torch.no_grad():
            wanted = knot.render(truth, rotation, light)
        loss = (knot.render(learned, rotation, light) - wanted).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    measure(settings.iterations)

    exponent, color = float(learned.log_exponent.detach().exp()), learned.color.tolist()
    log.add(
        f"texture {curves['texture, dB'][-1][1]:.2f} dB; highlight's colour {', '.join(f'{c:.3f}' for c in color)} "
        f"(true {', '.join(f'{c:.3f}' for c in TRUE_COLOR)}); exponent {exponent:.3f} (true {TRUE_EXPONENT})",
        **{
            "psnr": curves["texture, dB"][-1][1],
            "color": color,
            "true color": TRUE_COLOR,
            "exponent": exponent,
            "true exponent": TRUE_EXPONENT,
            "convergence": curves,
        },
    )
    with torch.no_grad():
        pictures.append(report.upright(knot.render(truth, front, front_light)[0]))
    maps = [report.enlarged(textures.unfolded(t), 300) for t in (learned.environment, truth.environment)]
    log.save(report.mosaic([pictures, maps]))


if __name__ == "__main__":
    main()
