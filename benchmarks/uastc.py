"""What the textures of a GLB lose of the shaded result, set by set: where the loss comes from, and what prevents it.

    python docs/remake.py --measure uastc --materials MATERIALS    measures, and makes RESULTS-uastc.md
    python benchmarks/uastc.py MATERIALS --only SET,SET  measures some sets, and prints the page of them

MATERIALS is a folder of texture sets. Losses are in dB of SNR, in the mean of the levels of detail that `mipbake bake`
measures, near the mirror / over the hemisphere.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from results_sets import folder_sets, middle
from timing import cpu_name, table

import mipbake
from mipbake import MipStack, TextureSet
from mipbake.source.images import uastc
from mipbake.stack.compression import chosen, losses
from mipbake.stack.containers import Container
from mipbake.stack.file_levels import stored_channels
from mipbake.stack.gltf.glb import encoded, output
from mipbake.stack.gltf.ranges import Ranges, usual_ranges
from mipbake.stack.gpu_files import KTX2, GpuFile
from mipbake.stack.map_files import MapFile, quantised_levels, stood_for
from mipbake.stack.output import GLB_TEXELS
from mipbake.stack.ranges import chosen_ranges
from mipbake.stack.written import opened

Loss = Mapping[str, float]
Levels = list[NDArray[np.float32]]
TABLES = ("whole", "parts", "encoder")

Columns = Callable[[TextureSet, MipStack], tuple[dict[str, Levels], dict[str, str]]]
"""For a set and its stack: name of a column to the levels that are measured, and what stands in further columns."""


SIDE = 256
"""Texels a side of the crops on which files and efforts are measured one by one."""

EFFORTS = (0, 3, 5)
"""Efforts of Basis Universal's encoder that are measured on EFFORT_SETS."""

EFFORT_SETS = ("acg_leather036b", "acg_metal007")


@dataclass(frozen=True)
class Row:
    """What the stack of one set loses.

    Args:
        losses: column to the losses of all pair sets, dB. further: what stands in further columns.
    """

    set: str
    losses: Mapping[str, Loss]
    further: Mapping[str, str]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("materials", type=Path)
    parser.add_argument(
        "work", type=Path, nargs="?", help="a folder: a run that was stopped goes on from what it holds"
    )
    parser.add_argument("--results", type=Path, help="a JSON file of what was measured")
    parser.add_argument("--only", default="", help="names of sets, separated by commas")
    given = parser.parse_args()
    data: dict[str, Any] = {"machine": cpu_name(), **{table: [] for table in TABLES}}
    for name, read in folder_sets(given.materials).items():
        if given.only and name not in given.only.split(","):
            continue
        kept = given.work / f"{name}.json" if given.work else None
        if kept and kept.exists():
            found = json.loads(kept.read_text(encoding="utf-8"))
        else:
            found = {table: [asdict(row) for row in rows] for table, rows in measured(name, read()).items()}
            if kept:
                kept.write_text(json.dumps(found), encoding="utf-8")
        for which, rows in found.items():
            data[which] += rows
        print(name, file=sys.stderr, flush=True)
    if given.results:
        given.results.write_text(json.dumps(data), encoding="utf-8")
    else:
        print(page_of(data))


def measured(name: str, texture_set: TextureSet) -> dict[str, list[Row]]:
    """Rows of every table that a set is in."""

    def rows(source: TextureSet, columns: Columns) -> list[Row]:
        stack = mipbake.bake(source, "neural", "gltf")
        variants, further = columns(source, stack)
        return [Row(name, losses(source, opened(stack), variants), further)]

    crop = middle(texture_set, SIDE)
    return {
        "whole": rows(texture_set, before_and_after),
        "parts": rows(crop, parts),
        "encoder": rows(crop, encoder) if name in EFFORT_SETS else [],
    }


def page_of(data: Mapping[str, Any]) -> str:
    """The Markdown page of what `main` writes."""
    tables = {table: [Row(**row) for row in data[table]] for table in TABLES}
    return f"""# What the textures of a GLB cost

The losses on this page are dB of SNR of the shaded result, in the mean of levels of detail 0, 1 and 3, near the mirror
or over the hemisphere, where the loss is greater. The sets are test sets, which no network has seen. They were measured
on {data["machine"]}. The [record](records/uastc.json) has the figures of each set.

## Whole sets

The stacks were baked by `neural`. `plain` is UASTC with the values as they are. `glb` stretches normals and roughness
over the eight bits. `glb:{GLB_TEXELS[1]}` gives 8 bits to the textures that blocks cost too much.

{summarised(tables["whole"])}

## Where the loss comes from

Each row has one file in blocks or in 8 bits, and the other files as they are. Nothing is stretched. The stacks were
baked from the middle {SIDE} x {SIDE} texels of each set.

{summarised(tables["parts"])}

## What the encoder's effort brings

The normals of such stacks, alone, were encoded with several efforts of the encoder. They were stretched by the rule for
stacks that nobody measures. A GLB is written with effort {uastc._EFFORT}.

{listed(tables["encoder"])}
"""


def summarised(rows: Sequence[Row]) -> str:
    """By column: how many sets are within which loss."""
    worst: dict[str, dict[str, float]] = {}
    for row in rows:
        for column, loss in row.losses.items():
            worst.setdefault(column, {})[row.set] = max(loss.values())
    lines = []
    for column, of in worst.items():
        few, some = (sum(value <= limit for value in of.values()) for limit in (0.5, 1.5))
        most = max(of, key=lambda name: of[name])
        lines.append(
            [column, *map(str, (len(of), few, some)), f"{np.mean([*of.values()]):.2f}", f"{of[most]:.2f} ({most})"]
        )
    return table(["files", "sets", "at most 0.5 dB", "at most 1.5 dB", "mean", "most"], lines)


def listed(rows: Sequence[Row]) -> str:
    """A line for each row: both losses, near the mirror first."""
    if not rows:
        return ""
    lines = [
        [row.set, *(" / ".join(f"{value:.2f}" for value in loss.values()) for loss in row.losses.values()),
         *row.further.values()]
        for row in rows
    ]  # fmt: skip
    return table(["set", *rows[0].losses, *rows[0].further], lines)


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
        f"{name}, {texels}": _decoded(stack, GpuFile(KTX2, texels), Ranges(), (name,))
        for texels in ("rgba8", "uastc")
        for name in names
    }, {}


def encoder(texture_set: TextureSet, stack: MipStack) -> tuple[dict[str, Levels], dict[str, str]]:
    """The encoder's own efforts, on normals alone, and the seconds that they took."""
    del texture_set
    ranges, usual = usual_ranges(stack.levels, stack.model), uastc._EFFORT
    variants, seconds = {}, {}
    for effort in EFFORTS:
        uastc._EFFORT = effort
        start = time.perf_counter()
        variants[f"{effort}"] = _decoded(stack, GpuFile(KTX2, "uastc"), ranges, ("normal",))
        seconds[f"seconds of {effort}"] = f"{time.perf_counter() - start:.1f}"
    uastc._EFFORT = usual
    return variants, seconds


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
