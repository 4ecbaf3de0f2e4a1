"""Films of texture sets, and what people see in them: every method, both samplers, with accumulation and without.

    python docs/remake.py --measure films --materials MATERIALS   measures, and makes the blocks of RESULTS-films.md
    python benchmarks/films.py MATERIALS FOLDER --plans SET SET   measures some sets

MATERIALS is a folder of texture sets, FOLDER takes a file a set. A run that was stopped goes on from these files, and
several runs with different sets may share one FOLDER: the folder of docs/remake.py is build/records/films. New
code is not noticed: it wants a new FOLDER. Every set is filmed as floor, wall and sphere, under one of three lightings
in turn. Methods that take a sampler make a stack for each sampler. The films of a set share their references.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from results_sets import folder_sets

from mipbake.aim import ANISOTROPIC, FRAMES, TRILINEAR
from mipbake.compare.candidates import Candidate, bake_all, chosen
from mipbake.compare.film_figures import ShownReference, film_figures
from mipbake.compare.filming import FilmSettings, Take, taken
from mipbake.compare.films import standard_films
from mipbake.compare.pictures import RenderSettings
from mipbake.metrics import check_color_video_vdp, snr_db
from mipbake.metrics.visible import visible_error
from mipbake.prefilter import OPTIONS
from mipbake.prefilter.neural import Neural
from mipbake.reference.source import FilteredSource
from mipbake.render.environment import lighting_named
from mipbake.render.film import Frames
from mipbake.texture_set import TextureSet

MODEL, FILTER = "gltf", "gaussian"

LIGHTINGS = ("studio", "sky", "lamps")
"""In turn, a set after the other."""

METHODS = (
    "auto", "neural", "linear (box)", "linear (gaussian)", "lean (gaussian)", "vmf (gaussian)", "godot (gaussian)",
    "unreal (gaussian)", "toksvig (gaussian)", "filament (gaussian)",
)  # fmt: skip
"""What is filmed once a pixel."""

ACCUMULATED = ("auto", "neural", "linear (box)", "lean (gaussian)", "godot (gaussian)")
"""What is filmed as the mean of jittered frames in addition."""

SEED = 0
DIGITS = 5
"""Significant ones of the figures that are kept."""


@dataclass(frozen=True)
class FilmsEffort:
    """How thoroughly.

    Args:
        height: of films, pixels; they are half as wide again.
        frames: of a film. passes: samples of each pixel of a reference, at most.
    """

    height: int = 160
    frames: int = 16
    passes: int = 256


def measured(texture_set: TextureSet, lighting: str, work: Path, effort: FilmsEffort) -> dict[str, Any]:
    """The figures of one set: its films, each with figures by method and measure.

    Args:
        work: a folder for the references of this set.
    """
    started = time.process_time()
    source = FilteredSource(texture_set.material(MODEL), MODEL, texture_set.wrap, FILTER)
    height, width = source.stored.shape[:2]
    resolution = effort.height, effort.height * 3 // 2
    films = []
    for sampler, by_name in _baked(texture_set):
        last = len(by_name[METHODS[0]].levels) - 1
        looks = RenderSettings(SEED, effort.passes, sampler, work)
        scenes = standard_films(
            (height, width), lighting_named(lighting), last, frames=effort.frames, resolution=resolution
        )
        for frames, names in zip(FRAMES, (METHODS, ACCUMULATED), strict=True):
            settings = FilmSettings(replace(looks, sampler=replace(sampler, frames=frames)))
            takes = (taken(scene, source, [by_name[n] for n in names], settings) for scene in scenes)
            films += [_figures(take, str(sampler), frames > 1) for take in takes]
    return {
        "lighting": lighting,
        "network": Neural().weights(MODEL, FILTER, texture_set.source_model).name,
        "size": [height, width],
        "effort": asdict(effort),
        "films": films,
        "processor_seconds": round(time.process_time() - started),
    }


def _baked(texture_set: TextureSet) -> Iterator[tuple[Any, Mapping[str, Candidate]]]:
    """Sampler, and name of a method to the stack that the sampler looks up."""
    with _bakes(texture_set, [name for name in METHODS if not _takes_sampler(name)], None) as shared:
        for sampler in (TRILINEAR, ANISOTROPIC):
            with _bakes(texture_set, [name for name in METHODS if _takes_sampler(name)], sampler) as made:
                yield sampler, {**shared, **made}


@contextmanager
def _bakes(texture_set: TextureSet, names: Sequence[str], sampler: Any) -> Iterator[dict[str, Candidate]]:
    with bake_all(texture_set, MODEL, FILTER, names, sampler=sampler) as found:
        yield {each.name: each for each in found}


def _takes_sampler(name: str) -> bool:
    return chosen([name], FILTER)[name][0] in OPTIONS["sampler"]


def _figures(take: Take, sampler: str, accumulated: bool) -> dict[str, Any]:
    """A film as the record has it.

    Args:
        sampler: that its stacks were made for, and were looked up with in every frame.
    """
    scene = take.scene
    return {
        "scene": scene.name,
        "sampler": sampler,
        "accumulated": accumulated,
        "passes": scene.passes,
        "noise": _rounded(scene.noise),
        "candidate_error": _rounded(scene.candidate_error),
        "converged": scene.converged,
        "figures": {name: _measures(frames, take.shown) for name, frames in take.frames.items()},
    }


def _measures(frames: Frames, shown: ShownReference) -> dict[str, float]:
    """Every measure of films by its name, the SNR of what is displayed (dB) as `snr-displayed`, and `visible`."""
    inside, film = shown.interior, shown.shown(frames)
    found = {
        **film_figures(frames, shown).by_measure,
        "snr-displayed": snr_db(film[inside], shown.first[inside], shown.second[inside]),
        "visible": visible_error(film, shown.mean),
    }
    return {name: _rounded(value) for name, value in found.items()}


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def main() -> None:
    """Measures all sets that FOLDER does not hold yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("materials", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--results", type=Path, help="file for the figures of all these sets together")
    parser.add_argument("--plans", nargs="+", help="names of the sets that are measured; all without it")
    for each in fields(FilmsEffort):
        parser.add_argument(f"--{each.name}", type=int, default=each.default)
    options = parser.parse_args()
    effort = FilmsEffort(**{each.name: getattr(options, each.name) for each in fields(FilmsEffort)})
    check_color_video_vdp()
    sets = folder_sets(options.materials)
    unknown = [name for name in options.plans or [] if name not in sets]
    if unknown:
        parser.error(f"{options.materials} has no set {', '.join(unknown)}: expected some of {', '.join(sets)}")
    options.folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for index, name in enumerate(sorted(sets)):
        if options.plans and name not in options.plans:
            continue
        file = options.folder / f"{name}.json"
        if not _holds(file, effort):
            references = options.folder / "references" / name
            data = measured(sets[name](), LIGHTINGS[index % len(LIGHTINGS)], references, effort)
            shutil.rmtree(references, ignore_errors=True)
            partial = file.with_suffix(".partial")
            partial.write_text(json.dumps(data), encoding="utf-8")
            partial.replace(file)
        found[name] = json.loads(file.read_text(encoding="utf-8"))
        print(f"{name}: {found[name]['processor_seconds']:.0f} s", flush=True)
    if options.results:
        options.results.write_text(json.dumps({"effort": asdict(effort), "sets": found}), encoding="utf-8")


def _holds(file: Path, effort: FilmsEffort) -> bool:
    """Whether the file has a set's figures, measured as thoroughly."""
    try:
        return bool(json.loads(file.read_text(encoding="utf-8"))["effort"] == asdict(effort))
    except (OSError, ValueError, KeyError):
        return False


if __name__ == "__main__":
    main()
