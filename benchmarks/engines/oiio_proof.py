"""EXR and .tx files through OpenImageIO's TextureSystem, as film renderers look them up: the levels read are ours.

    python benchmarks/engines/oiio_proof.py

Exits with 1 where a level is not honoured.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import OpenImageIO
from browser import exit_code
from engine_textures import level_colours
from numpy.typing import NDArray

from mipbake import MipStack
from mipbake.material.pixel_filter import level_sizes
from mipbake.stack.stack import Provenance

SIDE = 256
_TEXELS = 64  # looked up a level
_TOLERANCE = 2e-3  # half floats, and the filter's own rounding

Image = NDArray[np.float32]
Writer = Callable[[Sequence[Image], Path], Path]


def main(writers: Mapping[str, Writer] | None = None) -> int:
    """0 where every level is honoured, of what each writer makes; None for WRITERS."""
    rng = np.random.default_rng(5)
    sizes = level_sizes(SIDE, SIDE)
    colours = level_colours(len(sizes))[:, :3].astype(np.float32) / 255
    coloured = [np.broadcast_to(colour, (*size, 3)) for colour, size in zip(colours, sizes, strict=True)]
    # Levels that have nothing to do with each other: whatever is made from another level is told apart.
    independent = [rng.random((*size, 3), np.float32) for size in sizes]
    complaints = []
    with tempfile.TemporaryDirectory() as scratch:
        for name, write in (writers or WRITERS).items():
            folder = Path(scratch) / name
            complaints += _coloured_seen(write(coloured, folder / "coloured"), name, colours)
            complaints += _texels_seen(write(independent, folder / "independent"), name, independent, rng)
    return exit_code(complaints)


def _coloured_seen(path: Path, name: str, colours: Image) -> list[str]:
    """What is wrong with the colours at whole levels and between them; prints the worst error."""
    last = len(colours) - 1
    worst, complaints = 0.0, []
    for lod in np.arange(-2, 2 * last + 4) / 2:
        low = min(max(int(np.floor(lod)), 0), last)
        # Between two levels OpenImageIO mixes linearly in the footprint, where graphics cards do in its logarithm.
        share = 2 ** (lod - low) - 1 if 0 <= lod < last else 0.0
        wanted = colours[low] + share * (colours[min(low + 1, last)] - colours[low])
        found = _lookup(path, 0.3, 0.6, lod)
        error = float(np.abs(found - wanted).max())
        worst = max(worst, error)
        if error > _TOLERANCE:
            complaints.append(
                f"{name}: a footprint of 2^{lod:g} texels shows {found.round(3)}, expected {wanted.round(3)}"
            )
    print(f"{name}: {last + 1} level-coloured levels, largest error {worst:.5f}")
    return complaints


def _texels_seen(path: Path, name: str, levels: Sequence[Image], rng: np.random.Generator) -> list[str]:
    """What is wrong with single texels of every level; prints the worst error."""
    worst, complaints = 0.0, []
    for index, level in enumerate(levels):
        height, width = level.shape[:2]
        for row, column in zip(rng.integers(0, height, _TEXELS), rng.integers(0, width, _TEXELS), strict=True):
            found = _lookup(path, (column + 0.5) / width, (row + 0.5) / height, index)
            error = float(np.abs(found - level[row, column]).max())
            worst = max(worst, error)
            if error > _TOLERANCE:
                complaints.append(
                    f"{name}: texel ({row}, {column}) of level {index} is {found}, expected {level[row, column]}"
                )
                break
    print(f"{name}: {_TEXELS} texels of each of {len(levels)} independent levels, largest error {worst:.5f}")
    return complaints


def _lookup(path: Path, s: float, t: float, lod: float) -> NDArray[np.float64]:
    """A trilinear lookup with a square footprint of 2^lod texels of level 0; t runs down."""
    options = OpenImageIO.TextureOpt()
    options.mipmode = OpenImageIO.MipMode.Trilinear
    options.interpmode = OpenImageIO.InterpMode.Bilinear
    options.swrap = options.twrap = OpenImageIO.Wrap.Periodic
    footprint = 2.0**lod / SIDE
    found = _SYSTEM.texture(str(path), options, float(s), float(t), footprint, 0.0, 0.0, footprint, 3)
    complaint = _SYSTEM.geterror()
    if complaint:
        raise RuntimeError(f"OpenImageIO cannot look up {path}: {complaint}")
    return np.array(found, np.float64)


def _saved(levels: Sequence[Image], folder: Path, container: str) -> Path:
    """The map of base colours as `MipStack.save` writes it: float files hold linear colours."""
    rest = np.array([0, 0.5, 0, 0, 1], np.float32)
    stored = [np.concatenate([level, np.broadcast_to(rest, (*level.shape[:2], 5))], -1) for level in levels]
    stack = MipStack("proof", "gltf", stored, {}, ("wrap", "wrap"), Provenance("proof", "gaussian"))
    stack.save(folder, container)
    return folder / f"base_color.{container}"


WRITERS: Mapping[str, Writer] = {name: partial(_saved, container=name) for name in ("exr", "tx")}


_SYSTEM = OpenImageIO.TextureSystem()

if __name__ == "__main__":
    sys.exit(main())
