"""What every experiment needs around it: options, a learning rate that falls, figures as JSON, pictures as PNG."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import OpenImageIO
import torch
from torch import Tensor

Settings = TypeVar("Settings")
COLORS = np.array([[0.9, 0.3, 0.2], [0.2, 0.5, 0.9], [0.2, 0.65, 0.3], [0.6, 0.35, 0.75], [0.85, 0.6, 0.1], [0.3] * 3])
"""Colours of the curves of a chart, in their order."""


def parse(
    description: str, small: Settings, full: Settings | None, arguments: Sequence[str] | None
) -> tuple[Settings, Path]:
    """Settings, and the folder for the results, of the command line: `small` (or `full` with --full), with changes.

    Every field of the settings is an option: a number, a word or a tuple of such, or a switch that is off.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    if full is not None:
        parser.add_argument("--full", action="store_true", help="the paper's size; meant for a GPU")
    parser.add_argument("--output", type=Path, default=Path("fitting"), help="folder for the picture and the figures")
    for field in dataclasses.fields(small):  # type: ignore[arg-type]
        one, large = getattr(small, field.name), getattr(full or small, field.name)
        option = f"--{field.name.replace('_', '-')}"
        if isinstance(one, bool):
            parser.add_argument(option, action="store_true", default=None)
            continue
        kind = type(one[0]) if isinstance(one, tuple) else type(one)
        parser.add_argument(
            option,
            type=kind,
            nargs="+" if isinstance(one, tuple) else None,
            help=f"default {one}" + (f", with --full {large}" if large != one else ""),
        )
    given = vars(parser.parse_args(arguments))
    output, base = given.pop("output"), full if given.pop("full", False) else small
    changes = {name: tuple(v) if isinstance(v, list) else v for name, v in given.items() if v is not None}
    return dataclasses.replace(base, **changes), output  # type: ignore[type-var]


def falling_rate(optimiser: torch.optim.Optimizer, first: float, last: float, iterations: int) -> Iterator[int]:
    """The iterations 0, 1, ..., with the optimiser's rate falling exponentially from `first` to `last` over them."""
    for iteration in range(iterations):
        for group in optimiser.param_groups:
            group["lr"] = first * (last / first) ** (iteration / max(iterations - 1, 1))
        yield iteration


def checkpoints(iterations: int, count: int = 40) -> set[int]:
    """Iterations at which to measure, evenly spaced on a logarithmic axis, the last one included."""
    return {0, *(int(i) for i in np.geomspace(1, iterations, count) - 1)}


def psnr(image: Tensor, reference: Tensor) -> float:
    """Peak signal-to-noise ratio in dB, of values whose peak is 1."""
    return float(-10 * torch.log10((image.detach() - reference).square().mean()))


class Report:
    """Figures of one experiment, told on the console while they arise and kept with the settings and the time."""

    def __init__(self, name: str, settings: object, folder: Path) -> None:
        self.name, self.folder, self.settings = name, folder, settings
        self.figures: dict[str, object] = {}
        self.start, self.processor_start = time.perf_counter(), time.process_time()
        # Images and textures are small here: torch's own threads would wait for each other more than they work. The
        # primitives have threads of their own.
        torch.set_num_threads(1)
        folder.mkdir(parents=True, exist_ok=True)
        print(f"{name}: {', '.join(f'{k} {v}' for k, v in dataclasses.asdict(settings).items())}")  # type: ignore[call-overload]

    def add(self, sentence: str, **figures: object) -> None:
        self.figures.update(figures)
        print(f"{self.name}: {sentence}  [{time.perf_counter() - self.start:.0f} s]", flush=True)

    def save(self, picture: np.ndarray) -> None:
        """Writes NAME.json and NAME.png; the picture (H, W, 3) holds values 0 to 1, top row first."""
        device = str(getattr(self.settings, "device", "cpu"))
        machine = (
            torch.cuda.get_device_name(device) if device.startswith("cuda") else f"CPU with {os.cpu_count()} cores"
        )
        content: Mapping[str, object] = {
            "settings": dataclasses.asdict(self.settings),  # type: ignore[call-overload]
            "figures": self.figures,
            "seconds": round(time.perf_counter() - self.start, 1),
            "processor seconds": round(time.process_time() - self.processor_start, 1),
            "machine": machine,
        }
        (self.folder / f"{self.name}.json").write_text(json.dumps(content, indent=2) + "\n")
        file = self.folder / f"{self.name}.png"
        write_picture(file, picture)
        print(f"{self.name}: {file} and {file.with_suffix('.json').name}")


def write_picture(file: Path, picture: np.ndarray) -> None:
    """Writes an 8-bit PNG; the picture (H, W, 3) holds values 0 to 1, top row first."""
    pixels = (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)
    buffer = OpenImageIO.ImageBuf(np.ascontiguousarray(pixels))
    if not buffer.write(str(file)):
        raise OSError(f"{file} cannot be written: {buffer.geterror()}")


def upright(image: Tensor) -> np.ndarray:
    """(H, W, 3) for a picture: a rendered image has its lowest row first."""
    return image.detach().flip(0).cpu().numpy()


def enlarged(image: np.ndarray, width: int) -> np.ndarray:
    """About `width` pixels wide: every pixel becomes a square of a whole number of them."""
    scale = max(1, round(width / image.shape[1]))
    return image.repeat(scale, 0).repeat(scale, 1)


def mosaic(rows: Sequence[Sequence[np.ndarray]], gap: int = 4) -> np.ndarray:
    """Rows of images, each as wide as it is, on white; images of a row are aligned at the top."""
    height = [max(len(image) for image in row) for row in rows]
    width = max(sum(image.shape[1] + gap for image in row) for row in rows) - gap
    sheet = np.ones((sum(height) + gap * (len(rows) - 1), width, 3), np.float32)
    top = 0
    for row, tall in zip(rows, height, strict=True):
        left = 0
        for image in row:
            sheet[top : top + len(image), left : left + image.shape[1]] = image
            left += image.shape[1] + gap
        top += tall + gap
    return sheet


def chart(
    curves: Mapping[str, Sequence[tuple[float, float]]], width: int, height: int, log_y: bool = False
) -> np.ndarray:
    """(height, width, 3): curves of (iteration, value) over a logarithmic axis, their names in their colours.

    With `log_y` the values are on a logarithmic axis too, down to 1e-5.
    """
    points = np.array([point for curve in curves.values() for point in curve])
    low, high = points[:, 1].min(), points[:, 1].max()
    if log_y:
        low, high = np.log10(max(low, 1e-5)), np.log10(high)
    low, high = (low, high) if high > low else (low - 1, high + 1)
    last = np.log10(points[:, 0].max() + 1)
    scale, left, below = 2, 56, 22
    canvas = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(width * scale, height * scale, 3, "float"))
    OpenImageIO.ImageBufAlgo.fill(canvas, (1, 1, 1))

    def place(x: float, y: float) -> tuple[int, int]:
        y = np.log10(max(y, 1e-5)) if log_y else y
        across = left + (width - left - 8) * np.log10(x + 1) / last
        up = 8 + (height - below - 16) * (high - y) / (high - low)
        return int(scale * across), int(scale * up)

    def line(x0: int, y0: int, x1: int, y1: int, color: Sequence[float]) -> None:
        for dx, dy in ((0, 0), (1, 0), (0, 1)):
            OpenImageIO.ImageBufAlgo.render_line(canvas, x0 + dx, y0 + dy, x1 + dx, y1 + dy, (*color, 1), True)

    def text(x: int, y: int, words: str, color: Sequence[float] = (0.2, 0.2, 0.2)) -> None:
        # Where the library was built without a font there is no text; the curves stand in the JSON with their names.
        OpenImageIO.ImageBufAlgo.render_text(canvas, x, y, words, 12 * scale, "", (*color, 1))

    for power in range(int(last) + 1):
        x, label = place(10**power - 1, points[0, 1])[0], str(10**power)
        line(x, 8 * scale, x, (height - below - 8) * scale, (0.85, 0.85, 0.85))
        text(min(x - 4 * scale, (width - 8 * len(label)) * scale), (height - 6) * scale, label)
    for fraction in (0, 0.25, 0.5, 0.75, 1):
        y = low + (high - low) * fraction
        value = 10**y if log_y else y
        x, y = place(0, value)
        line(x, y, (width - 8) * scale, y, (0.85, 0.85, 0.85))
        text(2 * scale, y + 4 * scale, f"{value:.3g}")
    for index, (name, curve) in enumerate(curves.items()):
        color = COLORS[index % len(COLORS)]
        places = [place(x, y) for x, y in curve]
        for (x0, y0), (x1, y1) in itertools.pairwise(places):
            line(x0, y0, x1, y1, color)
        text((left + 10) * scale, (height - below - 18 - 15 * (len(curves) - 1 - index)) * scale, name, color)
    pixels = canvas.get_pixels("float")
    return pixels.reshape(height, scale, width, scale, 3).mean((1, 3))
