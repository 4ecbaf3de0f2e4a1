"""What the files that engines load lose of a stack, and whether they are better than closed forms in the same files.

    python docs/remake.py --measure delivered --materials MATERIALS    measures, and makes the tables of docs/files.md
    python benchmarks/delivered.py MATERIALS [--only SET SET] [--presets unity glb] [--films]

MATERIALS is a folder of texture sets. Every set is baked for every preset, written, read back and measured, as are
`linear` and `lean` in the same files. Losses are in dB of SNR, in the mean of the levels of detail that `mipbake bake`
measures, near the mirror and over the hemisphere. With --films, a floor of the stack and one of its files are filmed
as the preset's engine looks them up, and judged by ColorVideoVDP.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from films import LIGHTINGS
from results_sets import folder_sets
from timing import arguments, expect, keep, table

import mipbake
from mipbake import TextureSet
from mipbake.comparing.filming import film_figures, taken
from mipbake.comparing.films import films_of
from mipbake.comparing.pictures import RenderSettings
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.quality.environment import lighting_named
from mipbake.quality.figures import Candidate
from mipbake.quality.metrics import PAIR_SETS
from mipbake.quality.texture_space import MeasureEffort, measure
from mipbake.source.opacity import shown
from mipbake.stack.compression import LODS
from mipbake.stack.file_levels import stored_channels
from mipbake.stack.gltf.glb import encoded
from mipbake.stack.manifest import manifest_path, read_back, read_manifest
from mipbake.stack.presets import PRESETS
from mipbake.stack.stack import MipStack
from mipbake.stack.written import opened

GLB = "glb"
FORMS = ("linear", "lean")
CELLS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)
"""Levels of detail of the cells."""

EFFORT = MeasureEffort(11, 8192, 16, intervals=False)
FILM_HEIGHT, FILM_FRAMES, FILM_PASSES, PIXELS_PER_DEGREE = 180, 24, 128, 37
JOD = f"jod-{PIXELS_PER_DEGREE}"

Row = Mapping[str, Any]
Bakes = dict[Sampler, dict[str, MipStack]]
"""Sampler to the stack of each method."""


def main() -> None:
    names = (*[each for each in PRESETS if each not in ("arnold", "renderman", "filament")], GLB)
    options = arguments(__doc__, "materials", results=None, only=(), presets=names, method="auto", films=False)
    sets, rows = folder_sets(options.materials), []
    expect("set", options.only, sets)
    expect("preset", options.presets, names)
    for index, (name, read) in enumerate(sets.items()):
        if options.only and name not in options.only:
            continue
        texture_set, bakes = read(), Bakes()
        for preset in options.presets:
            lighting = LIGHTINGS[index % len(LIGHTINGS)] if options.films else ""
            row = {"set": name, "preset": preset, **measured(texture_set, preset, options.method, lighting, bakes)}
            rows.append(row)
            print(_line(row), file=sys.stderr, flush=True)
    if options.results:
        keep({"whole": rows}, options.results)
    else:
        print(summarised({"whole": rows}))


def measured(texture_set: TextureSet, preset: str, method: str, lighting: str, bakes: Bakes) -> dict[str, Any]:
    """The figures of one set and preset. `lighting`: of the film; empty for none. `bakes`: of this set so far."""
    seen = shown(texture_set)
    sampler = DEFAULT_SAMPLER if preset == GLB else PRESETS[preset].sampler
    if sampler not in bakes:
        own = mipbake.bake(texture_set, method, "gltf", sampler=sampler)
        bakes[sampler] = {method: own, **{each: mipbake.bake(texture_set, each, "gltf") for each in FORMS}}
    stacks = bakes[sampler]
    first = stacks[method]
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        plain = _seconds(lambda: first.save(place / "exr", "exr"))
        written = {name: _delivered(stack, place / name, preset) for name, stack in stacks.items()}
        seconds, size = written[method][1:]
    files = {name: levels for name, (levels, *_) in written.items()}
    candidates = [opened(first)]
    for name, levels in files.items():
        candidates.append(Candidate(replace(opened(stacks[name]).method, name=name), levels))
    source = seen.filtered(first.provenance.pixel_filter)
    lods = sorted({*CELLS, *LODS} & {float(min(each, len(first.levels) - 1)) for each in (*CELLS, *LODS)})
    found = measure(source, candidates, lods, (), EFFORT, lambda _phase, _share: None, sampler)
    snr = {(f.method, f.view, f.lod): f.value for f in found.curve}
    baked = candidates[0].name
    cells = {
        view: [
            [round(snr[name, view, lod], 3) for name in (method, *FORMS)]
            for lod in lods
            if all(np.isfinite(snr[name, view, lod]) for name in (method, *FORMS))
        ]
        for view in PAIR_SETS
    }
    loss = {view: np.mean([snr[baked, view, lod] - snr[method, view, lod] for lod in LODS]) for view in PAIR_SETS}
    out: dict[str, Any] = {
        "loss": {view: round(float(value), 3) for view, value in loss.items()},
        "cells": cells,
        "bytes": size,
        "seconds": {"exr": round(plain, 2), "files": round(seconds, 2)},
    }
    if lighting:
        scene = films_of(
            source.stored.shape[:2], lighting_named(lighting), len(first.levels) - 1, height=FILM_HEIGHT,
            frames=FILM_FRAMES,
        )[0]  # fmt: skip
        take = taken(scene, source, candidates[:2], RenderSettings(0, FILM_PASSES, sampler))
        judged = (film_figures(frames, take.shown, (PIXELS_PER_DEGREE,)) for frames in take.frames.values())
        out["jod"] = [round(each[JOD], 4) for each in judged]
    return out


def _delivered(stack: MipStack, place: Path, preset: str) -> tuple[list[Any], float, int]:
    """Stored channels that files give back, the seconds that writing them took, and their bytes."""
    if preset == GLB:
        begun = time.monotonic()
        made = encoded(stack)
        files, seconds = [made.ranges.shown(file) for file in made.files], time.monotonic() - begun
        return stored_channels(files, stack), seconds, sum(map(len, made.maps.values()))
    seconds = _seconds(lambda: stack.save(place, preset=preset))
    output = read_manifest(manifest_path(place))["outputs"][0]
    size = sum(file.stat().st_size for file in place.iterdir())
    return stored_channels([f for f in read_back(place, output) if f.layout.shades], stack), seconds, size


def _seconds(work: Any) -> float:
    begun = time.monotonic()
    work()
    return time.monotonic() - begun


def _line(row: Row) -> str:
    near, hemisphere = row["loss"].values()
    behind = [max(each[1:]) - each[0] for of in row["cells"].values() for each in of]
    jod = f", JOD {row['jod'][1] - row['jod'][0]:+.3f}" if "jod" in row else ""
    took = row["seconds"]["files"] - row["seconds"]["exr"]
    return (
        f"{row['set']} {row['preset']}: {near:.2f} {hemisphere:.2f} dB, behind by {max(behind):.2f} at most, "
        f"{row['bytes'] / 1e6:.1f} MB, {took:+.1f} s{jod}"
    )


def summarised(data: Mapping[str, Sequence[Row]]) -> str:
    """Markdown of what `main` writes: by preset, how many sets are within which loss, and cells that are behind."""
    lines = []
    for preset in dict.fromkeys(row["preset"] for row in data["whole"]):
        rows = [row for row in data["whole"] if row["preset"] == preset]
        near = np.array([row["loss"]["near-mirror"] for row in rows])
        hemisphere = np.array([row["loss"]["hemisphere"] for row in rows])
        behind = np.array([max(c[1:]) - c[0] for row in rows for of in row["cells"].values() for c in of])
        took = [row["seconds"]["files"] - row["seconds"]["exr"] for row in rows]
        films = [row["jod"][0] - row["jod"][1] for row in rows if "jod" in row]
        lines.append(
            [
                f"`{preset}`",
                f"{(near <= 0.5).sum()} of {len(rows)}",
                f"{(near <= 1.5).sum()} of {len(rows)}",
                f"{near.mean():.2f} / {hemisphere.mean():.2f} dB",
                f"{max(near.max(), hemisphere.max()):.2f} dB",
                f"{100 * np.mean(behind > 0.5):.1f} %",
                f"{sum(each <= 0.03 for each in films)} of {len(films)}" if films else "not filmed",
                f"{np.mean([row['bytes'] for row in rows]) / 1e6:.1f} MB",
                f"{max(took):+.1f} s",
            ]
        )
    heads = ["preset", "at most 0.5 dB near the mirror", "at most 1.5 dB", "mean, near the mirror / hemisphere"]
    heads += ["most", "cells more than 0.5 dB behind", "films at most 0.03 JOD behind", "files", "longer than EXR"]
    return table(heads, lines)


if __name__ == "__main__":
    main()
