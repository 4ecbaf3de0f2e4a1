"""What every experiment needs around it: options, a learning rate that falls, figures as JSON, pictures as PNG."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import OpenImageIO
import torch
from torch import Tensor

Settings = TypeVar("Settings")


def number(kind: Callable[[str], Any], zero: bool = False) -> Callable[[str], Any]:
    """What reads a number of the command line, and refuses what is negative, infinite, or 0 unless that is allowed."""

    def read(text: str) -> Any:
        with suppress(ValueError):
            value = kind(text)
            if 0 < value < math.inf or (zero and value == 0):
                return value
        wanted = f"{'whole ' * (kind is int)}number {'of at least' if zero else 'above'} 0"
        raise argparse.ArgumentTypeError(f"expected a {wanted}, got {text!r}")

    return read


def device(name: str) -> str:
    """A device of the command line that torch can use."""
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:  # torch without CUDA asserts
        raise argparse.ArgumentTypeError(f"torch cannot use {name!r}: {str(error).partition(chr(10))[0]}") from error
    return name


def parse(
    description: str,
    small: Settings,
    full: Settings | None,
    arguments: Sequence[str] | None,
    folder: str = "fitting",
) -> tuple[Settings, Path]:
    """Settings, and the folder for the results, of the command line: `small` (or `full` with --full), with changes.

    Every field of the settings is an option: a number above 0, a tuple of such, a switch that is off, `seed`, which may
    be 0, or `device`.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    if full is not None:
        parser.add_argument("--full", action="store_true", help="the paper's size; meant for a GPU")
    parser.add_argument("--output", type=Path, default=Path(folder), help="folder for the picture and the figures")
    for field in dataclasses.fields(small):  # type: ignore[arg-type]
        one, large = getattr(small, field.name), getattr(full or small, field.name)
        option = f"--{field.name.replace('_', '-')}"
        if isinstance(one, bool):
            parser.add_argument(option, action="store_true", default=None)
            continue
        kind = type(one[0]) if isinstance(one, tuple) else type(one)
        parser.add_argument(
            option,
            type=device if field.name == "device" else number(kind, zero=field.name == "seed"),
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
    """Figures of one experiment, printed while they arise and kept with the settings and the time."""

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

    def table(self, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Prints a table as Markdown, and keeps its cells."""
        self.figures["table"] = [list(row) for row in (heads, *rows)]
        for row in (heads, ["---"] * len(heads), *rows):
            print(f"| {' | '.join(row)} |", flush=True)

    def save(self, picture: np.ndarray) -> None:
        """Writes NAME.json and NAME.png; the picture (H, W, 3) holds values 0 to 1, top row first."""
        name = str(getattr(self.settings, "device", "cpu"))
        machine = torch.cuda.get_device_name(name) if name.startswith("cuda") else f"CPU with {os.cpu_count()} cores"
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
