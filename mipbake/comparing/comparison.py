"""The whole comparison: stacks, figures in texture space, renders with their figures, the paper's plots for one
material."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mipbake.baking.bake import Recipe
from mipbake.base.errors import UsageError
from mipbake.base.extras import check_extra
from mipbake.base.timings import Timings
from mipbake.comparing import plots
from mipbake.comparing.candidates import bake_all, check_options, chosen, default_names, mismatch
from mipbake.comparing.cautions import limits, made_for_others, not_converged, unjudged
from mipbake.comparing.conditions import Condition
from mipbake.comparing.film_figures import film_measures
from mipbake.comparing.filming import FilmSettings, film, film_view, films_of
from mipbake.comparing.films import MOTIONS, FilmScene, Motion
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.render_file import write_render
from mipbake.comparing.pictures import MAX_PASSES, SHIFTED_SCALES, RenderSettings, render_view
from mipbake.comparing.ranking import best_closed_form
from mipbake.comparing.result import Comparison, Filmed, Plot, Rendered, file_stem
from mipbake.comparing.scenes import SMALLEST, SPHERE_RESOLUTION, View, mesh_views, standard_views
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.pixel_filter import filter_named
from mipbake.quality import environment, texture_space
from mipbake.quality.environment import Lighting
from mipbake.quality.figures import SCALES, SNR_GAIN, Candidate, Figure, Method
from mipbake.quality.metrics import MEASURES, PAIR_SETS, check_color_video_vdp
from mipbake.quality.samplers import RenderSampler, baked_for
from mipbake.quality.texture_space import DEFAULT_POINTS, DEFAULT_SAMPLES, DEFAULT_SEED, MeasureEffort, TextureSpace
from mipbake.source.texture_set import TextureSet
from mipbake.stack.stack import MipStack, Provenance
from mipbake.stack.written import opened

PhaseProgress = Callable[[str, float], None]
"""Is told the name of the phase and its finished share, from 0 to 1."""

IN_MOTION = ("flicker", "flicker-snr")
"""Measures of what changes from one picture to the next."""

_IN_TEXTURE_SPACE = ("snr", "tonemapped", *IN_MOTION)
"""Measures that have figures for pair sets."""

_SPOKEN = {"side": "size (side)", "max_passes": "passes (max_passes)"}  # where the command line has another name

_SLICE, _LOBE = "temporal slice", "apparent BRDF"  # phases


@dataclass(frozen=True, eq=False)
class Settings:
    """How a comparison is made.

    Args:
        lighting: of renders and films; None for the studio.
        mesh: what is rendered and filmed, in place of spheres, planes and walls.
        sampler: how stacks are looked up.
        side: of a square render, in pixels; the plane is 7/4 as wide. Films are no higher than it, nor than
            `mipbake.comparing.films.RESOLUTION`.
        max_passes: most samples for each pixel in the reference of a render; of a film no more than
            `mipbake.comparing.filming.MOST_PASSES`.
        films: whether films are made and judged.
        motion: what moves in films.
        points, samples: pixels per level of detail in texture space, and samples of a pixel in each estimate there.
        seed: seed of everything that is drawn.
        cache: folder where references of renders and films are kept for the next comparison; None for nowhere.

    Raises:
        UsageError: numbers that no comparison can be made with.
    """

    lighting: Lighting | None = None
    mesh: Mesh | None = None
    sampler: RenderSampler = DEFAULT_SAMPLER
    side: int = SPHERE_RESOLUTION[0]
    max_passes: int = MAX_PASSES
    films: bool = True
    motion: Motion = MOTIONS[0]
    points: int = DEFAULT_POINTS
    samples: int = DEFAULT_SAMPLES
    seed: int = DEFAULT_SEED
    cache: Path | None = None

    def __post_init__(self) -> None:
        least = {"seed": 0, "points": 1, "samples": 1, "side": SMALLEST, "max_passes": 32}
        for name, low in least.items():
            if getattr(self, name) < low:
                raise UsageError(
                    f"{_SPOKEN.get(name, name)} of the comparison is {getattr(self, name)}: expected {low} or more"
                )
        if not self.films and self.motion != MOTIONS[0]:
            raise UsageError("the comparison has no films, and motion is for films: leave it out, or make films")
        if self.max_passes % 2:
            raise UsageError(f"{_SPOKEN['max_passes']} of the comparison is {self.max_passes}: expected an even number")

    def to_dict(self) -> dict[str, Any]:
        """Plain types; lighting and mesh by name, without the cache, a place on this machine."""
        sampler = dataclasses.asdict(self.sampler) if isinstance(self.sampler, Sampler) else self.sampler
        named = {"lighting": self.lights.name, "mesh": self.mesh.name if self.mesh else None, "sampler": sampler}
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in (*named, "cache")}
        return named | fields

    @property
    def lights(self) -> Lighting:
        """The lighting of renders and films."""
        return self.lighting or environment.studio()


@dataclass(frozen=True, eq=False)
class Subjects:
    """What is compared: methods that are baked, and at most one stack that is there.

    Args:
        stack: one that was baked earlier, the subject then: its model and pixel filter take the place of the recipe's.
            path: the folder it came from, for readers.
        methods: labels or names of methods (`mipbake.comparing.candidates.chosen`), the subject first where there is no
            stack; None for auto (where there is no stack), neural and all closed forms.
        recipe: what is baked, except for its method. Methods that take a sampler make their stacks for the sampler of
            `Settings`; what a stack that is there was made for stays as it is.
    """

    stack: MipStack | None = None
    path: Path | None = None
    methods: Sequence[str] | None = None
    recipe: Recipe = field(default_factory=Recipe)


@dataclass(frozen=True, eq=False)
class _Shots:
    """What is rendered and filmed."""

    views: Sequence[View]
    films: Sequence[FilmScene]


@dataclass(frozen=True, eq=False)
class Compared:
    """A comparison and what a report shows beside it.

    Args:
        comparison: the figures and images.
        stacks: of the subject, the best closed form and `linear (box)`, by method name.
    """

    comparison: Comparison
    stacks: Mapping[str, MipStack]


def compare(
    texture_set: TextureSet,
    compared: Subjects | None = None,
    settings: Settings | None = None,
    conditions: Sequence[Condition] = (),
    renders: Path | None = None,
    progress: PhaseProgress = lambda _phase, _share: None,
) -> Compared:
    """Measures prefilters of one texture set against the supersampled, pixel-filtered reference, and each other.

    Args:
        texture_set: the source.
        compared: what is compared; None for auto, neural and all closed forms.
        settings: how thoroughly, and what is rendered; None for the defaults.
        conditions: that the figures will be asked for; those that cannot be decided are found before any work.
        renders: an existing folder for every render as a multi-part EXR file, SCENE--METHOD.exr; None keeps none.
        progress: told phase and share as the work goes on.

    Raises:
        UsageError: unknown names, settings that are impossible, a condition on what is not measured, or a package that
            measures or writes pictures is not installed.
        InputError: a mesh that cannot be seen.
        OutputError: temporary files cannot be written.
    """
    check_extra("compare", "a comparison")
    settings, asked = settings or Settings(), compared or Subjects()
    clock, stack, path = Timings(progress), asked.stack, asked.path
    model = stack.model if stack else asked.recipe.model(texture_set)
    kernel = stack.provenance.pixel_filter if stack else filter_named(asked.recipe.pixel_filter).name
    names, notes = (
        default_names(texture_set.source_model, model, kernel, stack is not None)
        if asked.methods is None
        else (tuple(asked.methods), ())
    )
    wanted = chosen(names, kernel)
    check_options([method for method, _ in wanted.values()], asked.recipe)
    labels = tuple(wanted)
    shots = _Shots(_views(texture_set, settings), _films(texture_set, settings))
    rivals = [opened(stack, path).method] if stack else []
    rivals += [Method(label, *form, model) for label, form in wanted.items()]
    if not rivals:
        raise UsageError("no method was named: expected at least one to compare")
    planned = _planned(texture_set, rivals, kernel, shots)
    for condition in conditions:
        _decidable(condition, settings)
        condition.check(planned)
    foreign = mismatch(stack, texture_set) if stack else None
    warnings = [*texture_set.warnings, *([foreign] if foreign else [])]
    recipe = dataclasses.replace(
        asked.recipe, target=model, pixel_filter=kernel, sampler=baked_for(settings.sampler), lod_bias=None
    )
    with bake_all(texture_set, recipe, labels, clock) as baked:
        candidates = [*([opened(stack, path)] if stack else []), *baked]
        comparison = _compared(texture_set, candidates, kernel, settings, shots, renders, clock)
        shown = (comparison.subject, best_closed_form(comparison), "linear (box)")
        stacks = {
            each.name: _stack(texture_set, each) if each.method.path is None or stack is None else stack
            for each in candidates
            if each.name in shown
        }
    told = dataclasses.replace(
        comparison,
        notes=(
            *notes,
            *limits(texture_set.source_model, model, stack is not None),
            *made_for_others(comparison.methods, settings.sampler),
            *comparison.notes,
        ),
        warnings=(*warnings, *comparison.warnings),
        foreign=foreign is not None,
        seconds=clock.seconds,
    )
    return Compared(told, stacks)


def _compared(
    texture_set: TextureSet,
    candidates: Sequence[Candidate],
    pixel_filter: str,
    settings: Settings,
    shots: _Shots,
    renders: Path | None,
    clock: Timings,
) -> Comparison:
    subject = candidates[0].method
    effort, made_for = MeasureEffort(settings.seed, settings.points, settings.samples), baked_for(settings.sampler)
    source = texture_set.filtered(pixel_filter)
    measured = texture_space.measure(source, candidates, effort=effort, progress=clock, sampler=made_for)
    clock("texture space", 1.0)
    comparison = Comparison(
        name=texture_set.name,
        subject=subject.name,
        model=subject.model,
        pixel_filter=pixel_filter,
        methods=tuple(each.method for each in candidates),
        curve=measured.curve,
        figures=(*measured.figures, *_gains(measured, candidates)),
        notes=measured.notes,
        settings=settings.to_dict(),
    )
    best = best_closed_form(comparison)
    drawn = (subject.name, best, "linear (box)", f"linear ({pixel_filter})", "optimum")
    few = [each for each in candidates if each.name in drawn]
    looks = RenderSettings(settings.seed, settings.max_passes, settings.sampler, settings.cache)
    rendered: list[Rendered] = []
    figures: list[Figure] = []
    pictures: list[Plot] = []
    for view in shots.views:
        made = render_view(view, source, candidates, looks, clock)
        clock(view.name, 1.0)
        rendered.append(made.rendered)
        figures += made.figures
        if renders is not None:
            for name, frame in made.frames.items():
                write_render(
                    renders / f"{file_stem(view.name, name)}.exr", frame, made.reference, method=name,
                    pixel_filter=pixel_filter, source_hash=texture_set.source_hash,
                )  # fmt: skip
        if made.change is not None and not pictures:  # only the nearest view, where shimmer is the worst
            pictures.append(plots.half_pixel_shift(made.change))
    filmed: list[Filmed] = []
    for scene in shots.films:
        told = FilmSettings(looks, settings.motion)
        shown, measured_film = film(scene, source, candidates, told, partial(clock, film_view(scene.name)))
        clock(film_view(scene.name), 1.0)
        filmed.append(shown)
        figures += measured_film
    turning = plots.temporal_slice(
        source, candidates, settings.lights, looks, progress=lambda share: clock(_SLICE, share)
    )
    lobe = plots.apparent_brdf(source, few, settings.seed)
    clock(_LOBE, 1.0)
    return dataclasses.replace(
        comparison,
        figures=(*comparison.figures, *figures, *turning.figures),
        rendered=tuple(rendered),
        films=tuple(filmed),
        plots=(_only(turning.plot, few), *pictures, lobe),
        notes=(*comparison.notes, *unjudged(filmed)),
        warnings=not_converged([each.scene for each in rendered], [each.scene for each in filmed]),
    )


def _only(plot: Plot, shown: Sequence[Candidate]) -> Plot:
    """A plot with the images of some methods."""
    return dataclasses.replace(plot, images={each.name: plot.images[each.name] for each in shown})


def _views(texture_set: TextureSet, settings: Settings) -> tuple[View, ...]:
    size, square = (texture_set.height, texture_set.width), (settings.side, settings.side)
    if settings.mesh:
        return mesh_views(settings.mesh, size, settings.lights, square)
    last = int(texture_space.last_lod(size))
    return standard_views(size, settings.lights, last, square, (settings.side, settings.side * 7 // 4))


def _films(texture_set: TextureSet, settings: Settings) -> tuple[FilmScene, ...]:
    if not settings.films:
        return ()
    size = texture_set.height, texture_set.width
    last = int(texture_space.last_lod(size))
    return films_of(size, settings.lights, last, settings.mesh, settings.motion, settings.side)


def _decidable(condition: Condition, settings: Settings) -> None:
    """UsageError where a condition is on a film and no film is made, or where nothing is installed that judges it."""
    judged = any(name in MEASURES and MEASURES[name].needs == "film" for name in condition.values)
    if not settings.films and (judged or any(name.startswith(film_view("")) for name in condition.values)):
        raise UsageError(
            f"condition {condition.text!r}: it is on a film, and the comparison has no films: leave it out, or make "
            "films"
        )
    if judged:
        check_color_video_vdp()


def _planned(texture_set: TextureSet, methods: Sequence[Method], pixel_filter: str, shots: _Shots) -> Comparison:
    """A comparison with everything that will be measured, all nan: what conditions can ask for."""

    def unknown(method: Method, measure: str, view: str, scale: str, lod: float = math.nan) -> Figure:
        return Figure(method.name, measure, view, scale, lod, math.nan, math.nan, math.nan)

    lods = texture_space.curve_lods((texture_set.height, texture_set.width))
    places = [(measure, view, scale) for measure in _IN_TEXTURE_SPACE for view in PAIR_SETS for scale in SCALES]
    for view in shots.views:
        moves = view.scale in SHIFTED_SCALES
        pictured = [name for name, measure in MEASURES.items() if measure.needs != "film"]
        places += [(name, view.view, view.scale) for name in pictured if moves or name not in IN_MOTION]
    places += [(name, film_view(scene.name), "") for scene in shots.films for name in film_measures()]
    places += [(measure, "rotation", "1:1") for measure in IN_MOTION]
    return Comparison(
        name=texture_set.name,
        subject=methods[0].name,
        model=methods[0].model,
        pixel_filter=pixel_filter,
        methods=tuple(methods),
        curve=tuple(unknown(each, "snr", pairs, "", lod) for each in methods for pairs in PAIR_SETS for lod in lods),
        figures=tuple(unknown(each, *place) for each in methods for place in places),
    )


def _gains(measured: TextureSpace, candidates: Sequence[Candidate]) -> Iterator[Figure]:
    """The subject's SNR minus the SNR of every other method, over the same light-view pairs."""
    subject, *others = (each.name for each in candidates)
    for figure in measured.figures:
        if figure.measure == "snr" and figure.method in others:
            gain = measured.gain(subject, figure.method, figure.view, figure.scale)
            yield dataclasses.replace(figure, measure=SNR_GAIN, value=gain.estimate, low=gain.low, high=gain.high)


def _stack(texture_set: TextureSet, candidate: Candidate) -> MipStack:
    """A candidate as a stack of its own, which outlives temporary files."""
    made = candidate.method
    return MipStack(
        name=texture_set.name,
        model=made.model,
        levels=[np.array(level, np.float32) for level in candidate.levels],
        extra={},
        wrap=texture_set.wrap,
        provenance=Provenance(
            made.method, made.kernel, sampler=made.sampler, aim=made.aim, source_hash=texture_set.source_hash
        ),
    )
