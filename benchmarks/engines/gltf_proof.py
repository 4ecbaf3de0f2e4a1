"""A GLB with baked KTX 2 textures: valid for Khronos's validator, its levels honoured by three.js and by Filament.

    python benchmarks/engines/gltf_proof.py             a file that is made here, whose squares show every level
    python benchmarks/engines/gltf_proof.py FILE.glb    validates a file of yours, and loads it in both engines

Exits with 1 where the file has errors or a level is not honoured.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from browser import HERE, MODULES, exit_code, numbers, opened
from engine_textures import level_colours, stack_maps
from glb_squares import PIXELS, lods, squares_glb
from numpy.typing import NDArray

import mipbake
from mipbake import MipStack, TextureSet

ENGINES = ("three", "filament")

_TOLERANCE = 0.03  # tolerance for a colour that is 0 or 1
_LOADED_SIDE = 256


def main() -> int:
    """0 where everything is as it should be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?", help="a GLB; without one, a file is made")
    given: Path | None = parser.parse_args().file
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        path = folder / "proof.glb"
        if given is None:
            path.write_bytes(squares_glb(stack_maps(_baked())))
        else:
            shutil.copyfile(given, path)
        complaints = validated(path)
        for engine in ENGINES:
            complaints += levels_seen(engine, folder) if given is None else loaded(engine, folder)
    return exit_code(complaints)


def validated(path: Path) -> list[str]:
    """Errors of Khronos's validator; prints how much it said."""
    if not MODULES.is_dir():
        raise RuntimeError(f"no {MODULES}: run `npm ci` in {HERE}")
    command = ["node", str(HERE / "gltf/validate.cjs"), str(path)]
    environment = {"NODE_PATH": str(MODULES), "PATH": str(Path(shutil.which("node") or "node").parent)}
    report = json.loads(subprocess.run(command, capture_output=True, check=True, text=True, env=environment).stdout)
    issues = report["issues"]
    print(
        f"gltf-validator {report['validatorVersion']}: {issues['numErrors']} errors, {issues['numWarnings']} warnings, "
        f"{issues['numInfos']} notes"
    )
    said = Counter((each["code"], each["message"]) for each in issues["messages"])
    for (code, message), count in said.items():
        print(f"  {code}, {count} times: {message}")
    return [f"{each['code']}: {each['message']}" for each in issues["messages"] if each["severity"] == 0]


def levels_seen(engine: str, folder: Path) -> list[str]:
    """What is wrong with the squares of the file that is made here; prints what each row shows."""
    rows, columns = len(lods()), len(lods()[0])
    size = columns * PIXELS, rows * PIXELS
    image, counts = rendered(engine, folder, "proof.glb", (0, columns, -rows, 0), size)
    middles = image[PIXELS // 2 :: PIXELS, PIXELS // 2 :: PIXELS, :3]
    colours = level_colours(columns)[:, :3] / 255
    whole, between, lit = middles
    if counts:
        print(f"{engine}: textures with {', '.join(map(str, counts))} levels")
    print(f"{engine}: whole levels show {_told(whole)}")
    print(f"{engine}: between them {_told(between)}")
    print(f"{engine}: the lit material shows {_told(lit)}")
    complaints = [
        f"{engine}: level {level} shows {_told(whole[level : level + 1])}, expected {_told(colours[level : level + 1])}"
        for level in range(columns)
        if np.abs(whole[level] - colours[level]).max() > _TOLERANCE
    ]
    for level in range(columns):
        ends = colours[level], colours[min(level + 1, columns - 1)]
        low, high = np.minimum(*ends), np.maximum(*ends)
        mixed = low < high  # engines encode a mix each in its way, so it shall only lie between its ends
        inside = (between[level] > low + 0.2) & (between[level] < high - 0.2)
        same = np.abs(between[level] - low) <= _TOLERANCE
        if not np.where(mixed, inside, same).all():
            complaints.append(f"{engine}: level {level + 0.5} shows {_told(between[level : level + 1])}: no such mix")
    squares = image[2 * PIXELS :, :, :3]
    if not (squares > 0).any(-1).all():
        complaints.append(f"{engine}: the lit material is black in places")
    return complaints


def loaded(engine: str, folder: Path) -> list[str]:
    """What is wrong with a file in an engine, seen from the front around its origin; prints how much of it is seen."""
    image, counts = rendered(engine, folder, "proof.glb", (-2, 2, -2, 2), (_LOADED_SIDE, _LOADED_SIDE))
    seen = (image[..., :3] > 0).any(-1)
    mean = image[seen][:, :3].mean(0) if seen.any() else np.zeros(3)
    levels = f", textures with {', '.join(map(str, counts))} levels" if counts else ""
    print(f"{engine}: {seen.mean():.0%} of the picture shows something, on average {_told(mean[None])}{levels}")
    return [] if seen.any() else [f"{engine}: nothing of the file is seen"]


def _baked() -> MipStack:
    """Bumps, gloss that changes, two metals and paint."""
    y, x = np.mgrid[0:256, 0:256] / 256 * 2 * np.pi
    slopes = 0.4 * np.stack([np.cos(16 * x) * np.cos(3 * y), np.sin(16 * y + x)], -1)
    normal = np.concatenate([-slopes, np.ones_like(slopes[..., :1])], -1)
    stripes = (np.sin(4 * x) > 0).astype(np.float64)
    colour = np.stack([0.9 - 0.4 * stripes, 0.6 + 0.1 * np.sin(y), 0.3 + 0.4 * stripes], -1)
    made = TextureSet.from_arrays(
        "proof",
        base_color=colour,
        normal=normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        roughness=0.35 + 0.15 * np.sin(2 * x + y),
        metallic=stripes,
    )
    return mipbake.bake(made, "vmf", "gltf")


def rendered(
    engine: str, folder: Path, file: str, box: tuple[float, float, float, float], size: tuple[int, int]
) -> tuple[NDArray[np.float64], list[int]]:
    """(height, width, 4) pixels of a GLB, top row first, and how many levels the engine's textures have."""
    width, height = size
    with opened(HERE / f"gltf/{engine}.html", folder) as page:
        call = "([file, box, width, height]) => proof.render(file, box, width, height)"
        found: dict[str, Any] = page.evaluate(call, [file, list(box), width, height])
    return numbers(found["pixels"], (height, width, 4))[::-1], found["levels"]


def _told(colours: NDArray[np.floating]) -> str:
    return " ".join("(" + ", ".join(f"{value:.2f}" for value in colour) + ")" for colour in colours)


if __name__ == "__main__":
    sys.exit(main())
