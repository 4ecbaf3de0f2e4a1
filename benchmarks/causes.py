"""Why figures 5, 9, 10 and 11 of Kemppinen et al. 2023 come out otherwise here: one experiment for each cause.

    python benchmarks/causes.py SETS_FOLDER [--results FILE] [--sets 3] [--lobes 3] [--twins 3]

Data. Spheres of real sets, of generated lobes that stand for the paper's captures, and of materials with sharp
anisotropic lobes whose albedo, anisotropy and normals depend on each other; as they are, boosted once as section 4 of
the paper does, and boosted again and again. They say how sharp materials have to be for the paper's order of methods.

Measure. The same pictures are judged by FLIP and by shift-tolerant LPIPS (benchmarks/st_lpips.py says how to install
its weights).

Sharp lobes. The twins of figure 11 (results_sets.correlated) with the lobes that they have, and with sharp anisotropic
ones.

`python docs/remake.py --measure causes` runs it, and docs/paper-figures.md shows what came out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mipnet_network import register
from results_measure import sphere_views
from results_methods import bakes, specs
from results_sets import InModel, boosted, captured, correlated, folder_sets, in_model, middle
from st_lpips import INSTALL, ShiftTolerantLpips, weights_file
from timing import BASELINES, arguments, keep

from mipbake.baking.pipeline import DEFAULT_FILTER
from mipbake.comparing.pictures import RenderSettings, render_view
from mipbake.quality import texture_space
from mipbake.quality.figures import Candidate
from mipbake.quality.metrics.images import displayed

BOOSTS = (0, 1, 6)
"""How often materials are boosted. Alpha is multiplied by 0.78 and slopes by 1.1 each time."""

SCALES = ("near", "middle", "far")
TEXELS = 128
"""A side of what is rendered: level 7, the far scale, is its last one."""

LODS = (0.0, 1.0, 2.0, 3.0, 5.0)
EFFORT = texture_space.MeasureEffort(points=2048, samples=32)


@dataclass(frozen=True)
class Case:
    """A material that is measured.

    Args:
        model: `ggx` or `beckmann`. kind: `real`, `lobes` or `sharp`. boosts: how often it was boosted.
        source: the material.
    """

    model: str
    kind: str
    boosts: int
    source: InModel


def cases(sets: Path, real: int, lobes: int) -> Iterator[Case]:
    """Every material, boosted as often as BOOSTS says."""
    known = folder_sets(sets)
    names = sorted(known)[:: max(1, len(known) // real)][:real]
    for model in ("ggx", "beckmann"):
        sources = [("real", middle(in_model(known[name](), model), TEXELS)) for name in names]
        if model == "beckmann":
            sources += [("lobes", captured(seed, TEXELS)) for seed in range(lobes)]
        sources += [("sharp", in_model(correlated(seed, TEXELS, True, True), model)) for seed in range(lobes)]
        for kind, source in sources:
            changed = source
            for boosts in range(max(BOOSTS) + 1):
                if boosts in BOOSTS:
                    yield Case(model, kind, boosts, changed)
                changed = boosted(changed)


def stacks(source: InModel) -> list[Candidate]:
    """What the paper compares, and the default network."""
    model = source.model
    names = ("linear", "lean", f"neural:mipnet-{model}", f"neural:paper-{model}", "neural")
    wanted = [each for each in specs(names, model, DEFAULT_FILTER, [BASELINES], model) if "(gauss" not in each.name]
    return bakes(source, wanted)


def spheres(source: InModel, side: int, passes: int, perceptual: ShiftTolerantLpips) -> Iterator[dict[str, Any]]:
    """A row for each method, scale and measure."""
    candidates, settings = stacks(source), RenderSettings(max_passes=passes)
    for view in sphere_views(source, SCALES, side):
        made = render_view(view, source.filtered(DEFAULT_FILTER), candidates, settings, flicker=False)
        for figure in made.figures:
            if figure.measure in ("snr", "flip"):
                yield {"method": figure.method, "scale": view.scale, "measure": figure.measure, "value": figure.value}
        right = displayed(made.reference.image.astype(np.float64))
        for name, frame in made.frames.items():
            value = perceptual(displayed(frame.image.astype(np.float64)), right)
            yield {"method": name, "scale": view.scale, "measure": "st-lpips", "value": value}


def twins(count: int) -> list[dict[str, Any]]:
    """What each method has on materials whose channels go together, and on their twins; SNR by pair set and lod."""
    rows = []
    for sharp in (False, True):
        for seed in range(count):
            for together in (True, False):
                source = correlated(seed, TEXELS, together, sharp)
                filtered = source.filtered(DEFAULT_FILTER)
                found = texture_space.measure(filtered, stacks(source), LODS, (), EFFORT)
                for figure in found.curve:
                    rows.append({
                        "sharp": sharp, "seed": seed, "together": together, "method": figure.method,
                        "pairs": figure.view, "lod": figure.lod, "value": figure.value,
                    })  # fmt: skip
                print(source.name, flush=True)
    return rows


def kept(rows: list[dict[str, Any]]) -> list[Mapping[str, Any]]:
    """Rows with the values of all methods side by side."""
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in rows:
        shared = {name: value for name, value in row.items() if name not in ("method", "value")}
        found.setdefault(tuple(shared.values()), shared | {"values": {}})["values"][row["method"]] = row["value"]
    return list(found.values())


def main() -> None:
    options = arguments(__doc__, "sets_folder", results=None, sets=3, lobes=3, twins=3, side=96, passes=64)
    register()
    file = weights_file()
    if file is None:
        raise SystemExit(f"shift-tolerant LPIPS is not installed: {INSTALL}")
    perceptual = ShiftTolerantLpips(file)
    rows = []
    for case in cases(options.sets_folder, options.sets, options.lobes):
        own = {"model": case.model, "kind": case.kind, "boosts": case.boosts, "set": case.source.name}
        rows += [own | row for row in spheres(case.source, options.side, options.passes, perceptual)]
        print(*own.values(), flush=True)
    found = {"texels": TEXELS, "spheres": kept(rows), "twins": kept(twins(options.twins))}
    keep(found, options.results)


if __name__ == "__main__":
    main()
