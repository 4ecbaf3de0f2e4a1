"""Films of texture sets, and what people see in them: every method, both samplers, with accumulation and without.

    python benchmarks/films.py MATERIALS FOLDER --results FILE    measures, and writes the figures of all sets as JSON

MATERIALS is a folder of texture sets, FOLDER takes a file a set, from which a stopped run goes on. Every set is filmed
as floor, wall and sphere, under one of three lightings in turn.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from results_sets import folder_sets

from mipbake.compare.candidates import Candidate, bake_all
from mipbake.compare.filming import FilmSettings, film, films_of
from mipbake.compare.pictures import RenderSettings
from mipbake.reference.source import FilteredSource
from mipbake.render.environment import lighting_named
from mipbake.render.samplers import Sampler
from mipbake.texture_set import TextureSet
from mipbake.timings import Timings

MODEL, FILTER = "gltf", "gaussian"

LIGHTINGS = ("studio", "sky", "lamps")
"""In turn, a set after the other."""

METHODS = (
    "auto", "neural", "linear (box)", "linear (gaussian)", "lean (gaussian)", "vmf (gaussian)", "godot (gaussian)",
    "unreal (gaussian)", "toksvig (gaussian)", "filament (gaussian)",
)  # fmt: skip
"""What is filmed once a pixel."""

ACCUMULATED = ("auto", "neural", "linear (box)", "lean (gaussian)", "godot (gaussian)")
"""What is filmed with temporal accumulation in addition."""

SAMPLERS: tuple[Sampler, ...] = ("trilinear", "anisotropic")
SIDE, SEED, PASSES = 160, 0, 256


def measured(texture_set: TextureSet, lighting: str, work: Path) -> dict[str, Any]:
    """The figures of one set: its films, each with figures by method and measure."""
    source = FilteredSource(texture_set.material(MODEL), MODEL, texture_set.wrap, FILTER)
    started, films = time.process_time(), []
    with bake_all(texture_set, MODEL, FILTER, METHODS, Timings(lambda *_: None)) as baked:
        for settings, candidates in _conditions(baked, work):
            last = len(baked[0].levels) - 1
            size = source.stored.shape[:2]
            for scene in films_of((size[0], size[1]), lighting_named(lighting), last, None, "camera", SIDE):
                filmed, figures = film(scene, source, candidates, settings)
                by_method: dict[str, dict[str, float]] = {}
                for each in figures:
                    by_method.setdefault(each.method, {})[each.measure] = each.value
                films.append({"scene": asdict(filmed.scene), "figures": by_method})
    return {"lighting": lighting, "films": films, "processor_seconds": time.process_time() - started}


def _conditions(baked: Sequence[Candidate], work: Path) -> Iterator[tuple[FilmSettings, Sequence[Candidate]]]:
    """How films are made, and with what."""
    by_name: Mapping[str, Candidate] = {each.name: each for each in baked}
    for sampler in SAMPLERS:
        looks = RenderSettings(SEED, PASSES, sampler, work)
        yield FilmSettings(looks), [by_name[name] for name in METHODS]
        yield FilmSettings(looks, accumulate=True), [by_name[name] for name in ACCUMULATED]


def main() -> None:
    """Measures all sets that FOLDER does not hold yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("materials", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--results", type=Path, required=True, help="file for the figures of all sets")
    parser.add_argument("--plans", nargs="+", help="names of the sets that are measured; all without it")
    options = parser.parse_args()
    sets = folder_sets(options.materials)
    options.folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for index, name in enumerate(sorted(sets)):
        if options.plans and name not in options.plans:
            continue
        file = options.folder / f"{name}.json"
        if not file.exists():
            cache = options.folder / "references"
            text = json.dumps(measured(sets[name](), LIGHTINGS[index % len(LIGHTINGS)], cache))
            shutil.rmtree(cache, ignore_errors=True)  # samplers share references; sets do not
            partial = file.with_suffix(".partial")
            partial.write_text(text, encoding="utf-8")
            partial.replace(file)
        found[name] = json.loads(file.read_text(encoding="utf-8"))
        print(f"{name}: {found[name]['processor_seconds']:.0f} s", flush=True)
    options.results.write_text(json.dumps({"sets": found}), encoding="utf-8")


if __name__ == "__main__":
    main()
