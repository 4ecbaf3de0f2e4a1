"""What the textures of a GLB lose of the shaded result, set by set: where the loss comes from, and what prevents it.

    python benchmarks/uastc.py MATERIALS            whole sets, before and after
    python benchmarks/uastc.py MATERIALS --side 256 crops of 256 x 256 from the middle of every set
    python benchmarks/uastc.py MATERIALS --parts    file by file, 8 bits against UASTC
    python benchmarks/uastc.py MATERIALS --encoder  efforts of Basis Universal's encoder on the normals (takes hours)

MATERIALS is a folder of texture sets. Prints Markdown. Losses are in dB of SNR, in the mean of the levels of detail
that `mipbake bake` measures, near the mirror / over the hemisphere.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results_sets import folder_sets, middle
from timing import cpu_name

import mipbake
from mipbake import MipStack, TextureSet
from mipbake.compare.candidates import opened
from mipbake.compare.compression import chosen, losses, stored_channels
from mipbake.compare.ranges import chosen_ranges
from mipbake.glb import encoded, output
from mipbake.io import uastc
from mipbake.io.containers import Container
from mipbake.io.gltf.ranges import Ranges, usual_ranges
from mipbake.io.gpu_files import GpuFile
from mipbake.io.map_files import MapFile, quantised_levels, stood_for
from mipbake.output import GLB_TEXELS

Loss = Mapping[str, float]
Levels = list[NDArray[np.float32]]
Columns = Callable[[TextureSet, MipStack], tuple[dict[str, Levels], dict[str, str]]]
"""Of a set and its stack: name of a column to the levels that are measured, and what stands in further columns."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("materials", type=Path)
    parser.add_argument("--side", type=int, default=0, help="of crops; whole sets without it")
    parser.add_argument("--methods", default="linear,neural")
    parser.add_argument("--only", default="", help="names of sets, separated by commas")
    for table in _TABLES:
        parser.add_argument(f"--{table}", action="store_true")
    given = parser.parse_args()
    table = next((name for name in _TABLES if getattr(given, name)), "")
    columns = _TABLES.get(table, before_and_after)
    what = f"crops of {given.side} x {given.side}" if given.side else "whole sets"
    print(f"{what}, {cpu_name()}\n")
    header: list[str] = []
    worst: dict[str, list[float]] = {}
    for name, read in folder_sets(given.materials).items():
        if given.only and name not in given.only.split(","):
            continue
        texture_set = middle(read(), given.side) if given.side else read()
        for method in given.methods.split(","):
            stack = mipbake.bake(texture_set, method, "gltf")
            variants, further = columns(texture_set, stack)
            found = losses(texture_set, opened(stack), variants)
            if not header:
                header = ["set", "stack", *variants, *further]
                print(f"| {' | '.join(header)} |\n|{'---|' * len(header)}", flush=True)
            cells = [name, method, *(spoken(loss) for loss in found.values()), *further.values()]
            print(f"| {' | '.join(cells)} |", flush=True)
            for column, loss in found.items():
                worst.setdefault(f"{column}, {method}", []).append(max(loss.values()))
    print(
        "\n| greater of both losses | sets | at most 0.5 dB | at most 1.5 dB | mean | most |\n|---|---|---|---|---|---|"
    )
    for column, values in worst.items():
        few, some = (sum(value <= limit for value in values) for limit in (0.5, 1.5))
        print(f"| {column} | {len(values)} | {few} | {some} | {np.mean(values):.2f} | {max(values):.2f} |")


def spoken(loss: Loss) -> str:
    """Both losses, near the mirror first."""
    return " / ".join(f"{value:.2f}" for value in loss.values())


def before_and_after(texture_set: TextureSet, stack: MipStack) -> tuple[dict[str, Levels], dict[str, str]]:
    """UASTC with values as they are; stretched; and stretched, with 8 bits where blocks cost too much."""
    ranges = chosen_ranges(texture_set, stack)
    finer = chosen_ranges(texture_set, stack, texels=GLB_TEXELS[-1])
    texels = chosen(texture_set, stack, output(GLB_TEXELS[1:]), ranges=finer).texels
    made = {
        "plain": encoded(stack, ranges=Ranges()),
        "glb": encoded(stack, ranges=ranges),
        f"glb:{GLB_TEXELS[1]}": encoded(stack, ranges=finer, texels=texels),
    }
    further = {
        "normal scale": f"{ranges.normal:.3f} / {finer.normal:.3f}",
        "roughness factor": f"{ranges.roughness:.3f}",
    }
    further[f"in {GLB_TEXELS[1]}"] = ", ".join(texels) or "none"
    for name in ("glb", f"glb:{GLB_TEXELS[1]}"):
        further[f"MB, {name}"] = f"{sum(map(len, made[name].maps.values())) / 1e6:.2f}"
    variants = {
        name: stored_channels([each.ranges.shown(file) for file in each.files], stack) for name, each in made.items()
    }
    return variants, further


def parts(texture_set: TextureSet, stack: MipStack) -> tuple[dict[str, Levels], dict[str, str]]:
    """Every file alone, in 8 bits and in blocks, nothing stretched."""
    del texture_set
    names = [file.layout.name for file in stack.files(output()) if file.layout.shades]
    return {
        f"{name}, {texels}": _decoded(stack, GpuFile("ktx2", texels), Ranges(), (name,))
        for texels in ("rgba8", "uastc")
        for name in names
    }, {}


def encoder(texture_set: TextureSet, stack: MipStack) -> tuple[dict[str, Levels], dict[str, str]]:
    """The encoder's own efforts, on normals alone, and the seconds that they took."""
    del texture_set
    ranges, usual = usual_ranges(stack.levels, stack.model), uastc._EFFORT
    variants, seconds = {}, {}
    for effort in (0, 3, 5, 9):
        uastc._EFFORT = effort
        start = time.perf_counter()
        variants[f"{effort}"] = _decoded(stack, GpuFile("ktx2", "uastc"), ranges, ("normal",))
        seconds[f"seconds of {effort}"] = f"{time.perf_counter() - start:.1f}"
    uastc._EFFORT = usual
    return variants, seconds


_TABLES: Mapping[str, Columns] = {"parts": parts, "encoder": encoder}


def _decoded(stack: MipStack, container: Container, ranges: Ranges, names: Sequence[str] = ()) -> Levels:
    """The stack with files, or some of them, as a container gives them back."""
    found = []
    for file in stack.files(output()):
        if not file.layout.shades or (names and file.layout.name not in names):
            continue
        given = replace(ranges.stored(file), container=container)
        texels = _texels(given)
        levels = [stood_for(each, container, file.layout) for each in texels]
        found.append(ranges.shown(replace(given, levels=levels)))
    return stored_channels(found, stack)


def _texels(file: MapFile) -> list[NDArray[np.generic]]:
    container = file.container
    assert isinstance(container, GpuFile)
    return container.decoded(file.layout, quantised_levels(file))


if __name__ == "__main__":
    main()
