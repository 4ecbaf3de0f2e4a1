"""Level 0, baked and as it came, in Blender's Cycles: one sample a pixel against Cycles with a thousand.

    python benchmarks/engines/cycles_proof.py SETS --count 5 --python PYTHON

SETS is a folder of texture sets: the first ones by name that have a normal and a roughness map are measured. PYTHON is
an interpreter that has the package `bpy`; the default is $BPY_PYTHON, or this one.
Cycles knows no levels: level 0 is what a render from near reads, one texel a pixel here.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from browser import HERE
from engine_sets import first_sets
from numpy.typing import NDArray
from three_table import arguments, keep

import mipbake
from mipbake import TextureSet
from mipbake.quality.metrics import snr_db

PIXELS = 96
"""Pixels a side of a picture."""

TEXELS = 256
"""Texels a side of what is baked: the middle of a set, repeated like the set itself."""

SAMPLES = 128
"""A pixel in each half of the reference."""

METHODS = {
    "as it came": ("linear", "box"),
    "linear, filtered": ("linear", "gaussian"),
    "neural": ("neural", "gaussian"),
}
"""Level 0 of `linear` under a box is the source's own."""

DIRECTIONS = ((0.1, 0.15, 1.0), (-0.5, 0.3, 1.0), (1.2, -0.8, 1.0))
"""Towards the sun of each render; seen from (0, 0, 1)."""

_WIDTH = 2.0  # Cycles' number for a Gaussian with sigma 0.5, which is measured first
_POINT = 0.01  # the narrowest box that Cycles takes: a sample in the middle

Image = NDArray[np.float32]


def main() -> int:
    """0 where Cycles filters as it is asked to."""
    options = arguments(__doc__, "sets", count=5, python=os.environ.get("BPY_PYTHON", sys.executable), results=None)
    with tempfile.TemporaryDirectory() as scratch:
        sigma, version = _measured_sigma(options.python, Path(scratch))
    print(f"Cycles' Gaussian of width {_WIDTH:g} has sigma {sigma:.3f} pixels")
    if not abs(sigma - 0.5) <= 0.02:
        print("error: expected 0.5", file=sys.stderr)
        return 1
    rows: dict[str, list[float]] = {}
    about = {"version": version, "sigma": sigma}
    sizes = {"pixels": PIXELS, "texels": TEXELS, "suns": len(DIRECTIONS), "samples": 2 * SAMPLES}
    for texture_set in first_sets(options.sets, options.count, TEXELS):
        with tempfile.TemporaryDirectory() as scratch:
            rows[texture_set.name] = _measured(texture_set, options.python, Path(scratch))
        print(texture_set.name, *(f"{figure:.1f}" for figure in rows[texture_set.name]), flush=True)
        columns = [*METHODS, "reference"]
        keep(about | sizes | {"columns": columns, "rows": rows}, options.results)
    return 0


def _measured(texture_set: TextureSet, python: str, folder: Path) -> list[float]:
    """SNR of every method in dB over all suns, then the SNR of the reference itself."""
    renders: list[dict[str, Any]] = []
    for index, (method, pixel_filter) in enumerate(METHODS.values()):
        level = mipbake.bake(texture_set, method, "gltf", pixel_filter).levels[0]
        maps = _written(level, folder, f"method{index}")
        renders += [_render(maps, d, "BOX", _POINT, 1, 0) for d in DIRECTIONS]
    source = _written(texture_set.material("gltf"), folder, "source")
    for seed in (1, 2):
        renders += [_render(source, d, "GAUSSIAN", _WIDTH, SAMPLES, seed) for d in DIRECTIONS]
    images = _run(python, folder, texture_set.width, renders).reshape(
        len(METHODS) + 2, len(DIRECTIONS), PIXELS, PIXELS, 3
    )
    *candidates, first, second = images
    noise = np.square(first - second).sum() / 4
    return [*(snr_db(each, first, second) for each in candidates), 10 * math.log10((first * second).sum() / noise)]


def _measured_sigma(python: str, folder: Path) -> tuple[float, str]:
    """Standard deviation of Cycles' pixel filter, from a rendered edge, which is the filter's integral; and Blender's
    version."""
    edge = np.zeros((PIXELS, PIXELS, 3), np.float32)
    edge[:, PIXELS // 2 :] = 1
    _write(edge.repeat(16, 0).repeat(16, 1), folder / "edge.exr")  # 16 texels a pixel: the edge is sharp
    renders = [_render({"edge": str(folder / "edge.exr")}, (0, 0, 1), "GAUSSIAN", _WIDTH, SAMPLES, 1)]
    row = _run(python, folder, PIXELS, renders)[0, ..., 0].mean(0)
    steps = np.diff(row[PIXELS // 4 : 3 * PIXELS // 4])  # the texture repeats: its borders are edges, too
    place = np.arange(len(steps)) - (len(steps) - 1) / 2
    # The differences between pixels are the filter widened by a box of one pixel, whose variance is 1/12.
    sigma = float(np.sqrt((steps * place**2).sum() / steps.sum() - 1 / 12))
    return sigma, (folder / "version").read_text(encoding="utf-8")


def _render(
    maps: dict[str, str], direction: Sequence[float], kind: str, width: float, samples: int, seed: int
) -> dict[str, Any]:
    filtered = {"filter": kind, "width": width, "samples": samples, "seed": seed}
    return {"maps": maps, "direction": list(direction), **filtered}


def _run(python: str, folder: Path, side: int, renders: list[dict[str, Any]]) -> NDArray[np.float64]:
    """(renders, PIXELS, PIXELS, 3) linear radiance."""
    outs = [folder / f"render{index}.exr" for index in range(len(renders))]
    job = {
        "side": side,
        "pixels": PIXELS,
        "renders": [{**render, "out": str(out)} for render, out in zip(renders, outs, strict=True)],
    }
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    command = [python, str(HERE / "cycles/scene.py"), str(folder / "job.json")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode or not all(out.exists() for out in outs):
        raise RuntimeError(f"Cycles did not render: {done.stderr[-2000:]}")
    return np.stack([_read(out) for out in outs])


def _written(level: Image, folder: Path, name: str) -> dict[str, str]:
    """The maps of (H, W, 8) stored channels as float files."""
    parts = {
        "base_color": level[..., 0:3],
        "metallic": level[..., 3:4],
        "roughness": level[..., 4:5],
        "normal": (level[..., 5:8] + 1) / 2,
    }
    paths = {role: folder / f"{name}-{role}.exr" for role in parts}
    for role, values in parts.items():
        _write(np.broadcast_to(values, (*level.shape[:2], 3)), paths[role])
    return {role: str(path) for role, path in paths.items()}


def _write(image: Image, path: Path) -> None:
    buffer = OpenImageIO.ImageBuf(np.ascontiguousarray(image, np.float32))
    if not buffer.write(str(path)):
        raise RuntimeError(f"cannot write {path}: {buffer.geterror()}")


def _read(path: Path) -> NDArray[np.float64]:
    pixels = OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.FLOAT)
    return np.asarray(pixels, np.float64)[..., :3]


if __name__ == "__main__":
    sys.exit(main())
