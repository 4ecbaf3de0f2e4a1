"""Films of texture sets, judged by ColorVideoVDP: every method, under every sampler.

    python docs/remake.py --measure films --materials MATERIALS   measures, and makes the blocks of RESULTS-films.md
    python benchmarks/films.py MATERIALS FOLDER --plans SET SET   measures some sets
    python examples/showcase.py SETS && python benchmarks/films.py SETS FOLDER --methods neural "linear (box)"

MATERIALS is a folder of texture sets, FOLDER takes a file a set. A run that was stopped goes on from these files, and
several runs with different sets may share one FOLDER: the folder of docs/remake.py is build/records/films. New
code is not noticed: it wants a new FOLDER. Every set is filmed as floor, low floor, wall and sphere, under one of three
lightings in turn. Methods that take a sampler make a stack for each sampler. The films of a set share their references.
The last of these commands films the generated sets that shimmer, and prints their JOD. The verdict of each bake of
`auto`, which knows nothing of films, is printed beside what its films gain over plain MIP maps.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from results_sets import bumps, folder_sets
from timing import arguments, effort_of, expect, holds, keep

import mipbake
from mipbake.baking.methods import OPTIONS
from mipbake.baking.neural import Neural
from mipbake.baking.pipeline import DEFAULT_METHOD, Recipe
from mipbake.comparing.candidates import bake_all, chosen
from mipbake.comparing.filming import MOST_PASSES, FilmReference, Frames, Take, film_figures, taken
from mipbake.comparing.films import FRAMES, RESOLUTION, films_of
from mipbake.comparing.pictures import RenderSettings
from mipbake.material.aim import sampler_named
from mipbake.quality.environment import lighting_named
from mipbake.quality.figures import Candidate, Method
from mipbake.quality.metrics import check_color_video_vdp, snr_db
from mipbake.quality.metrics.visible import visible_error
from mipbake.source.texture_set import TextureSet
from mipbake.stack.measured import Measured
from mipbake.stack.verdict import verdict

MODEL, FILTER = "gltf", "gaussian"

PLAIN, JUDGE = "linear (box)", "jod-37"
"""What verdicts compare with, and the measure that they are held against."""

LIGHTINGS = ("studio", "sky", "lamps")
"""In turn, a set after the other."""

SAMPLERS = ("trilinear", "anisotropic", "accumulated", "accumulated, bias -1")
"""What looks stacks up; with accumulation a MIP bias of -1 is what engines recommend."""

METHODS = (
    "auto", "neural", "linear (box)", "linear (gaussian)", "lean (gaussian)", "vmf (gaussian)", "godot (gaussian)",
    "unreal (gaussian)", "godot (box)", "unreal (box)",
)  # fmt: skip
"""What is filmed."""

ACCUMULATED = ("auto", "neural", "linear (box)", "godot (gaussian)")
"""What of it is filmed under samplers that accumulate, whose frames take eight times as long."""

PIXELS_PER_DEGREE = (37,)
"""At which films are judged."""

SEED = 0
DIGITS = 5
"""Significant ones of the figures that are kept."""


@dataclass(frozen=True)
class FilmsEffort:
    """How thoroughly.

    Args:
        height: of films, pixels; they are half as wide again.
        frames: of a film. passes: samples of each pixel of a reference, at most.
        methods: names in METHODS.
    """

    height: int = RESOLUTION[0]
    frames: int = FRAMES
    passes: int = MOST_PASSES
    methods: tuple[str, ...] = METHODS

    def filmed(self, sampler: str) -> list[str]:
        """The methods that are filmed under a sampler."""
        return [name for name in self.methods if name in ACCUMULATED or not sampler_named(sampler).frames > 1]


def measured(texture_set: TextureSet, lighting: str, work: Path, effort: FilmsEffort) -> dict[str, Any]:
    """The figures of one set: its films, each with figures by method and measure.

    Args:
        work: a folder for the references of this set.
    """
    started = time.process_time()
    source = texture_set.filtered(FILTER)
    height, width = source.stored.shape[:2]
    films, verdicts = [], {}
    for sampler, candidates, looks in _baked(texture_set, effort):
        if looks is not None:
            verdicts[sampler] = asdict(verdict(looks))
        last = len(candidates[0].levels) - 1
        settings = RenderSettings(SEED, effort.passes, sampler_named(sampler), work)
        lights = lighting_named(lighting)
        for scene in films_of((height, width), lights, last, height=effort.height, frames=effort.frames):
            films.append(_figures(taken(scene, source, candidates, settings)))
    return {
        "lighting": lighting,
        "network": Neural().weights(MODEL, FILTER, texture_set.source_model).name,
        "size": [height, width],
        "roughness": _rounded(float(texture_set.maps["roughness"].pixels.mean())),
        "slope": _rounded(bumps(texture_set)["slope"]),
        "effort": asdict(effort),
        "films": films,
        "verdicts": verdicts,
        "processor_seconds": round(time.process_time() - started),
    }


def _baked(texture_set: TextureSet, effort: FilmsEffort) -> Iterator[tuple[str, list[Candidate], Measured | None]]:
    """Sampler, the stacks that it looks up, and what the bake of DEFAULT_METHOD measured."""
    with _bakes(texture_set, [name for name in effort.methods if not _takes_sampler(name)], None) as shared:
        for sampler in SAMPLERS:
            names, found = effort.filmed(sampler), None
            some = [name for name in names if _takes_sampler(name) and name != DEFAULT_METHOD]
            with _bakes(texture_set, some, sampler) as made:
                if DEFAULT_METHOD in names:
                    stack = mipbake.bake(texture_set, DEFAULT_METHOD, MODEL, FILTER, sampler=sampler_named(sampler))
                    method = Method(DEFAULT_METHOD, DEFAULT_METHOD, FILTER, MODEL)
                    made[DEFAULT_METHOD] = Candidate(method, stack.levels)
                    found = stack.provenance.promise
                yield sampler, [(shared | made)[name] for name in names], found


@contextmanager
def _bakes(texture_set: TextureSet, names: Sequence[str], sampler: str | None) -> Iterator[dict[str, Candidate]]:
    aimed = sampler_named(sampler) if sampler else None
    with bake_all(texture_set, Recipe(target=MODEL, pixel_filter=FILTER, sampler=aimed), names) as found:
        yield {each.name: each for each in found}


def _takes_sampler(name: str) -> bool:
    return chosen([name], FILTER)[name][0] in OPTIONS["sampler"]


def _figures(take: Take) -> dict[str, Any]:
    """A film as the record has it."""
    scene = take.scene
    return {
        "scene": scene.name,
        "sampler": scene.sampler,
        "passes": scene.passes,
        "noise": _rounded(scene.noise),
        "candidate_error": _rounded(scene.candidate_error),
        "converged": scene.converged,
        "figures": {name: _measures(frames, take.shown) for name, frames in take.frames.items()},
    }


def _measures(frames: Frames, shown: FilmReference) -> dict[str, float]:
    """Every measure of films by its name, the SNR of what is displayed (dB) as `snr-displayed`, and `visible`."""
    inside, film = shown.interior, shown.shown(frames)
    found = {
        **film_figures(frames, shown, PIXELS_PER_DEGREE),
        "snr-displayed": snr_db(film[inside], shown.first[inside], shown.second[inside]),
        "visible": visible_error(film, shown.mean),
    }
    return {name: _rounded(value) for name, value in found.items()}


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def main() -> None:
    """Measures all sets that FOLDER does not hold yet."""
    options = arguments(__doc__, "materials", "folder", results=None, plans=(), **asdict(FilmsEffort()))
    effort = effort_of(FilmsEffort, options)
    check_color_video_vdp()
    sets = folder_sets(options.materials)
    expect("set", options.plans, sets)
    expect("method", options.methods, METHODS)
    options.folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for index, name in enumerate(sorted(sets)):
        if options.plans and name not in options.plans:
            continue
        file = options.folder / f"{name}.json"
        if not holds(file, "effort", asdict(effort)):
            references = options.folder / "references" / name
            data = measured(sets[name](), LIGHTINGS[index % len(LIGHTINGS)], references, effort)
            shutil.rmtree(references, ignore_errors=True)
            keep(data, file)
        found[name] = json.loads(file.read_text(encoding="utf-8"))
        print(f"{name}: {found[name]['processor_seconds']:.0f} s, {found[name]['lighting']}")
        for film in found[name]["films"]:
            judged = ", ".join(f"{method} {each['jod-37']:.2f}" for method, each in film["figures"].items())
            print(f"  {film['scene']}, {film['sampler']}: JOD of {judged}", flush=True)
        for sampler, said in found[name].get("verdicts", {}).items():
            figures = [film["figures"] for film in found[name]["films"] if film["sampler"] == sampler]
            gain = fmean(each[DEFAULT_METHOD][JUDGE] - each[PLAIN][JUDGE] for each in figures if PLAIN in each)
            print(f"  {sampler}: {gain:+.2f} JOD; verdict: {said['sentence']} {said['advice']}", flush=True)
    if options.results:
        keep({"effort": asdict(effort), "sets": found}, options.results)


if __name__ == "__main__":
    main()
