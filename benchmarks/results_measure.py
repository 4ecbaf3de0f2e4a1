"""The kinds of measurements of benchmarks/results.py: each takes a set and gives what its JSON file holds.

All methods of a set share one reference in texture space and one of each render, so a method more costs little.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from results_methods import Spec, bakes, named_weights, specs
from results_sets import (
    CAPTURED,
    Sets,
    boosted,
    bumps,
    captured,
    correlated_sets,
    directional,
    folder_sets,
    in_model,
    middle,
)

from mipbake import TextureSet
from mipbake.baking.pipeline import DEFAULT_FILTER
from mipbake.baking.search.methods import REFINE_SECONDS
from mipbake.comparing.candidates import closed_forms, label
from mipbake.comparing.pictures import RenderSettings, render_view
from mipbake.comparing.scenes import View, standard_views
from mipbake.comparing.validate import DEFAULT_LODS
from mipbake.quality import environment, texture_space
from mipbake.quality.figures import SCALES, Candidate

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
FOUR = tuple(label(method, kernel) for method in ("linear", "lean") for kernel in ("box", DEFAULT_FILTER))
FORMS = tuple(label(*each) for each in closed_forms(DEFAULT_FILTER))
_PAPERS_SCALES = ("near", "middle", "far")


@dataclass(frozen=True)
class ResultsEffort:
    """How thoroughly.

    Args:
        points, samples: pixels a level of detail, and samples of each in either estimate of the reference.
        side, passes: pixels of the side of a sphere's render, and samples of each at most.
        crop: texels of the side of the middle where the optimum is measured.
        generated, generated_size: sets of the project's generators, directional or of Beckmann lobes, and their side in
            texels.
        pairs, pairs_size: correlated sets, each with its twin, and their side in texels.
    """

    points: int = 8192
    samples: int = 48
    side: int = 192
    passes: int = 256
    crop: int = 256
    generated: int = 8
    generated_size: int = 512
    pairs: int = 4
    pairs_size: int = 256


@dataclass(frozen=True)
class Plan:
    """One set of one kind.

    Args:
        name: of the set, and of its file.
        source: reads or makes it.
        methods: that are measured.
        scales: of spheres that are rendered. in_texture_space: of what else than the SNR is measured there.
        extra: what else the file says of the set.
        pixel_filter: of the reference.
    """

    name: str
    source: Callable[[], TextureSet]
    methods: Sequence[Spec]
    scales: Sequence[str] = ()
    in_texture_space: Sequence[str] = ()
    extra: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    pixel_filter: str = DEFAULT_FILTER


@dataclass(frozen=True)
class Asked:
    """What the command line asks for: the sets, methods of the isotropic table, folders of more weights, the effort."""

    sets: Sets
    methods: Sequence[str]
    folders: Sequence[Path]
    effort: ResultsEffort


def measured(plan: Plan, effort: ResultsEffort) -> dict[str, Any]:
    """Bakes and measures."""
    source = plan.source()
    candidates = bakes(source, plan.methods)
    methods = [
        dataclasses.asdict(spec) | {"processor_seconds": each.method.seconds, "model": spec.target}
        for spec, each in zip(plan.methods, candidates, strict=True)
    ]
    drawn = texture_space.MeasureEffort(points=effort.points, samples=effort.samples)
    filtered = source.filtered(plan.pixel_filter)
    found = texture_space.measure(filtered, candidates, DEFAULT_LODS, plan.in_texture_space, drawn)
    figures, scenes = _spheres(source, candidates, plan, effort)
    return {
        "name": plan.name,
        "methods": methods,
        "size": [source.height, source.width],
        "curve": [dataclasses.asdict(figure) for figure in found.curve],
        "figures": [dataclasses.asdict(figure) for figure in found.figures] + figures,
        "scenes": scenes,
        "notes": list(found.notes),
        **plan.extra,
    }


def sphere_views(source: TextureSet, scales: Sequence[str], side: int) -> list[View]:
    """The standard views of spheres under a studio's lights, `side` pixels high and wide."""
    size = (source.height, source.width)
    views = standard_views(size, environment.studio(), int(texture_space.last_lod(size)), (side, side))
    return [view for view in views if view.view == "sphere" and view.scale in scales]


def _spheres(
    source: TextureSet, candidates: Sequence[Candidate], plan: Plan, effort: ResultsEffort
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Every measure of renders but flicker, which texture space measures without a camera's noise."""
    if not plan.scales:
        return [], []
    filtered = source.filtered(plan.pixel_filter)
    figures, scenes = [], []
    for view in sphere_views(source, plan.scales, effort.side):
        made = render_view(view, filtered, candidates, RenderSettings(max_passes=effort.passes), flicker=False)
        figures += [dataclasses.asdict(figure) for figure in made.figures]
        scenes.append(dataclasses.asdict(made.rendered.scene))
    return figures, scenes


def whole(asked: Asked) -> list[Plan]:
    """The isotropic table: every measure of every method, on whole sets."""
    methods = specs((*asked.methods, *FORMS), "gltf", DEFAULT_FILTER, asked.folders)
    return [Plan(name, load, methods, tuple(SCALES), tuple(SCALES)) for name, load in asked.sets.items()]


def crop(asked: Asked) -> list[Plan]:
    """The limit: the middle of every set with its optimum, which would take hours on whole ones.

    `refine` has the time that two minutes for a 512 x 512 set leave for so many texels; sets are expected to have them.
    """
    named = [name for name in asked.methods if not name.startswith("auto")]  # refine, which begins with it, is there
    side = asked.effort.crop
    refine = f"refine@{REFINE_SECONDS * (side / 512) ** 2:g}s"
    methods = specs(("optimum", *named, refine, *FORMS), "gltf", DEFAULT_FILTER, asked.folders)
    return [
        Plan(name, lambda load=load: middle(load(), side), methods, extra={"crop": side})  # type: ignore[misc]
        for name, load in asked.sets.items()
    ]


def directed(asked: Asked) -> list[Plan]:
    """The anisotropic target beside the isotropic one, on sets with directional bumps."""
    plans = []
    forms = (*FOUR[2:], FOUR[1])
    known = {**asked.sets, **folder_sets(EXAMPLES, "normal.png")}
    effort = asked.effort
    for name, texture_set in directional(known, effort.generated, effort.generated_size):
        methods = []
        for target in ("gltf", "gltf-anisotropic"):
            source = texture_set.source_model
            found = specs((*asked.methods, *forms), target, DEFAULT_FILTER, asked.folders, source)
            methods += [dataclasses.replace(spec, name=f"{spec.name} as {target}") for spec in found]
        kept = texture_set if name not in known else None  # many sets read at once would fill the memory
        load = known.get(name, lambda kept=kept: kept)
        plans.append(Plan(name, load, methods, extra=bumps(texture_set)))
    return plans


def models(asked: Asked) -> list[Plan]:
    """The paper's two models: sets converted to them, as they are and boosted, and sets of Beckmann lobes; references
    in the model, and the networks that make it."""
    plans = []
    for model in ("ggx", "beckmann"):
        methods = specs(_of_models(asked), model, DEFAULT_FILTER, asked.folders, model)
        sources: list[tuple[str, str, str, Callable[[], TextureSet]]] = []  # file, set, kind of set, what makes it
        for name, load in asked.sets.items():
            plain = partial(lambda load, model: in_model(load(), model), load, model)
            sources.append((f"{model}--{name}", name, "plain", plain))
            sources.append((f"{model}--{name}--boosted", name, "boosted", partial(lambda of: boosted(of()), plain)))
        for seed in range(asked.effort.generated if model == CAPTURED else 0):
            name = f"captured-{seed}"
            sources.append((name, name, "captured", partial(captured, seed, asked.effort.generated_size)))
        plans += [
            Plan(file, load, methods, _PAPERS_SCALES, ("near",), {"model": model, "set": name, "kind": kind})
            for file, name, kind, load in sources
        ]
    return plans


def correlations(asked: Asked) -> list[Plan]:
    """Generated materials whose channels depend on each other, and twins where they do not."""
    methods = specs((*_of_models(asked), *asked.methods), "ggx", DEFAULT_FILTER, asked.folders)
    return [
        Plan(name, load, methods, ("middle",), extra={"together": name.startswith("correlated")})
        for name, load in correlated_sets(asked.effort.pairs, asked.effort.pairs_size).items()
    ]


def _of_models(asked: Asked) -> tuple[str, ...]:
    """The paper's comparison for `ggx` and `beckmann`; of networks, those that are there."""
    named = [name for prefix in ("paper-", "mipnet-") for name in named_weights(prefix, asked.folders)]
    return (*named, "neural", *FOUR)


KINDS: Mapping[str, Callable[[Asked], list[Plan]]] = {
    "whole": whole,
    "crop": crop,
    "directional": directed,
    "models": models,
    "correlated": correlations,
}
