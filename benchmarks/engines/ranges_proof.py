"""Stretched values in a GLB: engines bring them back by its factors, and three.js loads textures of 8 bits from one.

    python benchmarks/engines/ranges_proof.py

Draws a square with the same stack in three GLBs, in three.js and, where the standard allows for the file, in Filament:
values as they are, values that are stretched, and stretched values in 8 bits. Exits with 1 where pictures differ by
more than blocks explain, where they do not differ although the factors are taken out, or where a file is not valid.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from browser import exit_code
from gltf_proof import rendered, validated
from numpy.typing import NDArray

import mipbake
from mipbake import MipStack, TextureSet
from mipbake.stack.gltf.glb import encoded, square
from mipbake.stack.gltf.ranges import Ranges, ranges_of
from mipbake.stack.output import GLB_TEXELS

_SIDE = 256
_BOX = (-0.5, 0.5, -0.5, 0.5)
_NEAR, _FAR = 0.03, 0.1  # shares of the mean of the picture


def main() -> int:
    """0 where everything is as it should be."""
    stack = _baked()
    ranges = ranges_of(stack.levels, stack.model)
    print(f"normal scale {ranges.normal:g}, roughness factor {ranges.roughness:g}")
    plain, stretched = encoded(stack, ranges=Ranges()), encoded(stack, ranges=ranges)
    files = {
        "plain": plain,
        "stretched": stretched,
        GLB_TEXELS[-1]: encoded(stack, ranges=ranges, texels=GLB_TEXELS[-1]),
        "without its factors": replace(stretched, ranges=Ranges()),
    }
    complaints: list[str] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, made in files.items():
            (folder / f"{name}.glb").write_bytes(square(stack, made, None))
            print(name, end=": ")
            complaints += validated(folder / f"{name}.glb")
        for engine, names in (("three", list(files)), ("filament", [name for name in files if name != GLB_TEXELS[-1]])):
            complaints += _compared(engine, folder, names)
    return exit_code(complaints)


def _compared(engine: str, folder: Path, names: list[str]) -> list[str]:
    """What is wrong with the pictures of an engine; prints how far they are from the first."""
    complaints = []
    first: NDArray[np.float64] | None = None
    for name in names:
        picture = rendered(engine, folder, f"{name}.glb", _BOX, (_SIDE, _SIDE))[0][..., :3]
        first = picture if first is None else first
        apart = float(np.abs(picture - first).mean() / first.mean())
        print(f"{engine}, {name}: {apart:.2%} of the mean apart")
        if (apart > _NEAR) if name in ("plain", "stretched", *GLB_TEXELS[1:]) else (apart < _FAR):
            complaints.append(f"{engine} shows {name} {apart:.2%} from values as they are")
    return complaints


def _baked() -> MipStack:
    """Gentle waves, rough enough that the noise of blocks hardly shows."""
    y, x = np.mgrid[0:_SIDE, 0:_SIDE] / _SIDE * 2 * np.pi
    slopes = 0.2 * np.stack([np.cos(4 * x) * np.cos(3 * y), np.sin(4 * y + x)], -1)
    normal = np.concatenate([-slopes, np.ones_like(slopes[..., :1])], -1)
    made = TextureSet.from_arrays(
        "proof",
        base_color=0.7,
        normal=normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        roughness=0.65 + 0.1 * np.sin(2 * x + y),
        metallic=1.0,
    )
    return mipbake.bake(made, "linear", "gltf")


if __name__ == "__main__":
    sys.exit(main())
