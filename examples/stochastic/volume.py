"""A volume of coloured smoke from pictures of it, beside exact gradients.

After figure 8 and section 4.4 of Deliot, Heitz and Belcour (2024). A voxel has a colour and an opacity for light that
passes a voxel's length. The renderer marches along rays, reads the volume trilinearly, and lists the voxels that it
comes through as long as they can be seen. What counts are pictures from sides that nobody showed.

  stochastic  estimates per pixel, opacities perturbed by a step of 8 bits (section 4.3)
  exact       torch's gradients through the same renderer, until it is as good, and for as many seconds of the processor

    python examples/stochastic/volume.py                      on a CPU, in minutes
    python examples/stochastic/volume.py --full               the paper's size
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from shared import camera, parse, report, textures
from torch import Tensor

from mipbake.stochastic import Channels, Descent, Group, Shown

DISTANCE, SLOPE = 4.0, 0.42
STEPS = (8 / 255, 8 / 255, 8 / 255, 1 / 255)
"""How far a voxel is perturbed. A colour shows through its opacity alone, and with the step of 8 bits it would be lost
in what opacities do."""
LEAST_SEEN = 1 / 255
"""Voxels behind which less light comes through are not listed."""
RAYS = 8192
"""That are marched at once, which bounds the memory."""
EXACT_RATE = 0.04
"""Adam's rate with exact gradients: the best of 1/255, 0.01, 0.02 and 0.04 after 60 steps."""


@dataclass(frozen=True)
class Settings:
    voxels: int = 32
    side: int = 64
    views: int = 24
    test_views: int = 4
    steps: int = 400
    estimates: int = 2
    measured: int = 20
    seed: int = 0


FULL = Settings(voxels=128, side=256, views=64, steps=1000, estimates=16)


def smoke(voxels: int) -> Tensor:
    """(N, 4), numbered along z, then y, then x: a ball of smoke with a glowing core, before a dense ring."""
    axis = (np.arange(voxels) + 0.5) / voxels * 2 - 1
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij")[::-1], -1)  # x is last in memory
    x, y, z = np.moveaxis(points, -1, 0)
    radius = np.sqrt(x * x + y * y + z * z)
    noise = textures.fractal_noise(points, 1.5, voxels / 6, 0.6, seed=7)
    cloud = np.clip(0.5 + noise - np.clip((radius - 0.5) * 4, 0, None), 0, 1) * (radius > 0.35)
    ring = np.exp(-(((np.hypot(x, y) - 0.8) / 0.1) ** 2 + (z / 0.1) ** 2))
    core = np.exp(-((radius / 0.22) ** 4))
    parts = np.stack([cloud * 5, ring * 12, core * 8], -1)  # of opacity, for each unit of length
    colors = np.array([[0.75, 0.8, 0.9], [0.15, 0.55, 0.35], [1.0, 0.55, 0.1]])
    color = (parts @ colors) / np.maximum(parts.sum(-1, keepdims=True), 1e-3)
    color *= (0.65 + 0.35 * np.clip(y + 0.5 * noise, -1, 1))[..., None]
    opacity = 1 - np.exp(-parts.sum(-1, keepdims=True) * 2 / voxels)
    return torch.tensor(np.concatenate([color, opacity], -1).clip(0, 1).reshape(-1, 4), dtype=torch.float32)


def render(values: Tensor, view: Tensor, voxels: int, side: int, list_voxels: bool = False) -> tuple[Tensor, Tensor]:
    """(P, 3) picture before black of a volume (N, 4) turned by `view` (3, 3), and (P, S) int32 voxels; S may be 0."""
    grid = values.T.reshape(1, 4, voxels, voxels, voxels)
    across = ((torch.arange(side) + 0.5) / side * 2 - 1) * SLOPE
    y, x = torch.meshgrid(across, across, indexing="ij")
    rays = torch.nn.functional.normalize(torch.stack([x, y, -torch.ones_like(x)], -1).reshape(-1, 3), dim=-1) @ view
    eye = torch.tensor([0.0, 0.0, DISTANCE]) @ view
    steps = math.ceil(math.sqrt(3) * voxels)
    along = DISTANCE + ((torch.arange(steps) + 0.5) / steps * 2 - 1) * (steps / voxels)
    images, lists = [], []
    for some in rays.split(RAYS):
        points = eye + along[:, None] * some[:, None]
        color, opacity = torch.nn.functional.grid_sample(
            grid, points[None, ..., None, :], align_corners=False, padding_mode="zeros"
        )[0, ..., 0].split((3, 1))
        before = torch.cumprod(torch.nn.functional.pad(1 - opacity[0, :, :-1], (1, 0), value=1.0), -1)
        images.append((color * (opacity * before)).sum(-1).T)
        if list_voxels:
            place = (points + 1) * (voxels / 2)
            near = (place > -0.5) & (place < voxels + 0.5)  # half a voxel outside, its border is read
            cell = place.floor().int().clamp(0, voxels - 1)
            inside = near.all(-1) & (before >= LEAST_SEEN)
            number = (cell[..., 2] * voxels + cell[..., 1]) * voxels + cell[..., 0]
            lists.append(torch.where(inside, number, -1))
    return torch.cat(images), torch.cat(lists) if lists else torch.empty(side * side, 0, dtype=torch.int32)


class Fit:
    """Pictures of the smoke, and ways to a volume that looks like them."""

    def __init__(self, settings: Settings) -> None:
        self.settings = s = settings
        self.generator = torch.Generator().manual_seed(s.seed)
        turns = camera.rotation_matrix(camera.random_quaternions(s.views + s.test_views, self.generator))
        truth = smoke(s.voxels)
        pictures = [render(truth, turn, s.voxels, s.side)[0] for turn in turns]
        everything = list(zip(turns, pictures, strict=True))
        self.train, self.test = everything[: s.views], everything[s.views :]

    def start(self) -> Tensor:
        """(N, 4): a grey haze."""
        return torch.tensor([0.5, 0.5, 0.5, 1 / self.settings.voxels]).repeat(self.settings.voxels**3, 1)

    @torch.no_grad()
    def psnr(self, values: Tensor) -> float:
        """Over the sides that nobody showed, in dB."""
        s = self.settings
        shown = torch.stack([render(values, view, s.voxels, s.side)[0] for view, _ in self.test])
        return report.psnr(shown, torch.stack([wanted for _, wanted in self.test]))

    def chosen(self) -> list[tuple[Tensor, Tensor]]:
        """Views of a step, with what they should show."""
        numbers = torch.randint(len(self.train), (self.settings.estimates,), generator=self.generator)
        return [self.train[int(i)] for i in numbers]

    def stochastic(self, values: Tensor) -> Iterator[None]:
        """Steps as large as the perturbations, falling to a tenth of that."""
        s = self.settings

        def shown(view: Tensor, given: Mapping[str, Tensor]) -> Shown:
            image, voxels = render(given["voxels"], view, s.voxels, s.side, list_voxels=True)
            return Shown(image, {"voxels": voxels})

        group = Group(values, Channels(STEPS, (0.0,) * 4, (1.0,) * 4))
        descent = Descent({"voxels": group}, s.seed)
        while True:
            rate = 0.1 ** (descent.estimates / (s.estimates * s.steps))
            descent.step([(partial(shown, view), wanted) for view, wanted in self.chosen()], rate)
            yield

    def exact(self, values: Tensor) -> Iterator[None]:
        """Steps of Adam by torch's gradients."""
        s = self.settings
        values.requires_grad_()
        optimiser = torch.optim.Adam([values], EXACT_RATE)
        while True:
            optimiser.zero_grad()
            for view, wanted in self.chosen():
                (render(values, view, s.voxels, s.side)[0] - wanted).square().sum().backward()
            optimiser.step()
            with torch.no_grad():
                values.clamp_(0, 1)
            yield

    def run(self, way: str, seconds: float = math.inf) -> tuple[Tensor, list[tuple[int, float, float]]]:
        """What a way ends with after `steps`, or after seconds of the processor; and (steps, seconds, PSNR) on the
        way."""
        s, values, spent = self.settings, self.start(), 0.0
        curve, steps = [(0, 0.0, self.psnr(values))], getattr(self, way)(values)
        every = max(s.steps // s.measured, 1)
        while spent < seconds and not (math.isinf(seconds) and curve[-1][0] >= s.steps):
            began = time.process_time()
            for _ in range(every):
                next(steps)
            spent += time.process_time() - began
            curve.append((curve[-1][0] + every, spent, self.psnr(values)))
        return values.detach(), curve


def main(arguments: Sequence[str] | None = None) -> None:
    settings, folder = parse(__doc__, Settings(), FULL, arguments)
    log = report.Report("volume", settings, folder)
    fit = Fit(settings)
    volume, stochastic = fit.run("stochastic")
    seconds = stochastic[-1][1]
    log.add(f"stochastic: {stochastic[-1][2]:.1f} dB after {seconds:.0f} s of the processor", stochastic=stochastic)
    after, exact = fit.run("exact", seconds)
    log.add(f"exact: {exact[-1][2]:.1f} dB after {exact[-1][1]:.0f} s", exact=exact)
    as_good = next((each for each in exact if each[2] >= stochastic[-1][2]), exact[-1])
    rows = [["at first", "", "", "", f"{stochastic[0][2]:.1f} dB"]]
    for name, (steps, spent, psnr) in (("stochastic", stochastic[-1]), ("exact", as_good), ("exact", exact[-1])):
        rows.append([name, str(steps), f"{1e3 * spent / steps:.0f} ms", f"{spent:.1f} s", f"{psnr:.1f} dB"])
    log.table(["gradients", "steps", "a step", "processor", "pictures from other sides"], rows)
    pictures = []
    for view, wanted in fit.test[:3]:
        with torch.no_grad():
            found = [render(values, view, settings.voxels, settings.side)[0] for values in (fit.start(), volume, after)]
        row = [each.reshape(settings.side, settings.side, 3) for each in (wanted, *found)]
        pictures.append([report.enlarged(report.upright(image), 128) for image in row])
    log.save(report.mosaic(pictures))


if __name__ == "__main__":
    main()
