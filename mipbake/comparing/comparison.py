"""The whole comparison: stacks, figures in texture space, renders with their figures, the paper's plots for one
material."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from mipbake.baking.neural import Neural
from mipbake.baking.pipeline import Recipe
from mipbake.base.errors import UsageError
from mipbake.base.extras import check_extra
from mipbake.base.timings import PhaseProgress, Timings
from mipbake.comparing import plots
from mipbake.comparing.candidates import bake_all, check_options, chosen, default_names, mismatch
from mipbake.comparing.cautions import limits, made_for_others, not_converged
from mipbake.comparing.conditions import Condition
from mipbake.comparing.filming import film, film_measures, missing_judge
from mipbake.comparing.films import MOTIONS, RESOLUTION, Film, Motion, films_of
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_file import read_mesh
from mipbake.comparing.pictures import SHIFTED_SCALES, RenderSettings, render_view
from mipbake.comparing.result import LINEAR, Comparison
from mipbake.comparing.scenes import SMALLEST, SPHERE_RESOLUTION, View, mesh_views, standard_views
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.pixel_filter import filter_named
from mipbake.quality import environment, texture_space
from mipbake.quality.environment import Lighting
from mipbake.quality.figures import SCALES, SNR_GAIN, Candidate, Figure, Method
from mipbake.quality.metrics import MEASURES, PAIR_SETS, check_color_video_vdp
from mipbake.quality.samplers import RenderSampler, baked_for
from mipbake.quality.texture_space import DEFAULT_SEED, MeasureEffort, TextureSpace
from mipbake.source.loading import PathLike, as_texture_set
from mipbake.source.options import with_overrides
from mipbake.source.texture_set import TextureSet
from mipbake.stack.saving import as_stack
from mipbake.stack.stack import MipStack, Provenance
from mipbake.stack.written import opened

IN_MOTION = ("flicker", "flicker-snr")
"""Measures of what changes from one picture to the next."""

_IN_TEXTURE_SPACE = ("snr", "tonemapped", *IN_MOTION)
"""Measures that have figures for pair sets."""


@dataclass(frozen=True, eq=False)
class Settings:
    """What is compared, and how.

    Args:
        methods: labels or names of methods (`mipbake.comparing.candidates.chosen`), the subject first where no stack is
            compared; None for auto (where there is no stack), neural and all closed forms.
        recipe: what is baked, except for its method. Methods that take a sampler make their stacks for `sampler`.
        lighting: of renders and films, or its name as `mipbake compare --light` takes it; None for the studio.
        mesh: what is rendered and filmed, in place of spheres, planes and walls; or its file.
        sampler: how stacks are looked up.
        side: of a square render, in pixels; the plane is 7/4 as wide. Films are no higher than it, nor than
            `mipbake.comparing.films.RESOLUTION`.
        films: whether films are made and judged.
        motion: what moves in films.
        seed: seed of everything that is drawn.
        cache: folder where references of renders and films are kept for the next comparison; None for nowhere.

    Raises:
        UsageError: numbers that no comparison can be made with.
    """

    methods: Sequence[str] | None = None
    recipe: Recipe = field(default_factory=Recipe)
    lighting: Lighting | None = None
    mesh: Mesh | None = None
    sampler: RenderSampler = DEFAULT_SAMPLER
    side: int = SPHERE_RESOLUTION[0]
    films: bool = True
    motion: Motion = MOTIONS[0]
    seed: int = DEFAULT_SEED
    cache: Path | None = None

    def __post_init__(self) -> None:
        lighting, mesh = cast(object, self.lighting), cast(object, self.mesh)
        if isinstance(lighting, str):
            object.__setattr__(self, "lighting", environment.lighting_named(lighting))
        if isinstance(mesh, (str, Path)):
            object.__setattr__(self, "mesh", read_mesh(Path(mesh)))
        for name, value, low in (("seed", self.seed, 0), ("size (side)", self.side, SMALLEST)):
            if value < low:
                raise UsageError(f"{name} of the comparison is {value}: expected {low} or more")
        if not self.films and self.motion != MOTIONS[0]:
            raise UsageError("the comparison has no films, and motion is for films: leave it out, or make films")

    @property
    def lights(self) -> Lighting:
        """The lighting of renders and films."""
        return self.lighting or environment.studio()

    @property
    def effort(self) -> MeasureEffort:
        """Of figures in texture space."""
        return MeasureEffort(self.seed)

    @property
    def renders(self) -> RenderSettings:
        """Of renders and films."""
        return RenderSettings(self.seed, sampler=self.sampler, cache=self.cache)

    def to_dict(self) -> dict[str, Any]:
        """Plain types; lighting and mesh by name, without the cache, a place on this machine."""
        return {
            "lighting": self.lights.name,
            "mesh": self.mesh.name if self.mesh else None,
            "sampler": dataclasses.asdict(self.sampler) if isinstance(self.sampler, Sampler) else self.sampler,
            "side": self.side,
            "max_passes": self.renders.max_passes,
            "films": self.films,
            "motion": self.motion,
            "points": self.effort.points,
            "samples": self.effort.samples,
            "seed": self.seed,
        }


def compare(
    texture_set: TextureSet | PathLike | Sequence[PathLike],
    settings: Settings | None = None,
    stack: MipStack | PathLike | None = None,
    path: Path | None = None,
    conditions: Sequence[Condition] = (),
    progress: PhaseProgress = lambda _phase, _share: None,
    begun: Callable[[Comparison], None] = lambda _unmeasured: None,
    **overrides: Any,
) -> Comparison:
    """Measures prefilters of one texture set against the supersampled, pixel-filtered reference, and each other.

        mipbake.compare("textures/wood", films=False).save("report")

    Args:
        texture_set: the source, or what `mipbake.load` takes, such as its folder.
        settings: what is compared, and how; None for the defaults.
        stack: one that was baked earlier, or its folder, the subject then: its model and pixel filter take the place of
            the recipe's. It stays as it is, whatever sampler it was made for.
        path: the folder that the stack came from, for readers.
        conditions: that will be checked: those that cannot be decided are found before any work.
        begun: called with the stacks of the subject and of `linear (box)`, before anything is measured.
        overrides: single fields of `Settings`, on top of `settings`: methods, films, side and others.

    Raises:
        UsageError: unknown names, settings that are impossible, a condition on what is not measured, or a package that
            measures or writes pictures is not installed.
        InputError: a mesh that cannot be seen; or as `mipbake.load` and `mipbake.open_stack`, where paths are given.
        OutputError: temporary files cannot be written.
    """
    check_extra("compare", "a comparison")
    settings, clock = with_overrides(settings or Settings(), overrides), Timings(progress)
    if not (stack is None or isinstance(stack, MipStack)):
        path, stack = path or Path(str(stack)), as_stack(stack)
    texture_set = as_texture_set(texture_set)
    source = texture_set.source_model
    model = stack.model if stack else settings.recipe.model(texture_set)
    kernel = stack.provenance.pixel_filter if stack else filter_named(settings.recipe.pixel_filter).name
    names, notes = default_names(source, model, kernel, stack is not None)
    if settings.methods is not None:
        given = settings.methods
        names, notes = tuple(map(str.strip, given.split(",")) if isinstance(given, str) else given), ()
    wanted = chosen(names, kernel)
    if next(iter(wanted), "") == LINEAR:  # it is what others are compared with: the next one is the subject
        wanted[LINEAR] = wanted.pop(LINEAR)
    check_options([method for method, _ in wanted.values()], settings.recipe)
    earlier = [opened(stack, path)] if stack else []
    methods = [each.method for each in earlier] + [Method(label, *form, model) for label, form in wanted.items()]
    if not methods:
        raise UsageError("no method was named: expected at least one to compare")
    views, films = _scenes(texture_set, settings)
    empty = Comparison(
        name=texture_set.name,
        subject=methods[0].name,
        model=model,
        pixel_filter=kernel,
        methods=tuple(methods),
        source=dataclasses.asdict(texture_set.found),
        texture_set=texture_set,
        settings=settings.to_dict(),
    )
    planned = _planned(texture_set, empty, views, films) if conditions else empty
    for condition in conditions:
        if any(name in MEASURES and MEASURES[name].needs == "film" for name in condition.values):
            check_color_video_vdp()
        condition.check(planned)
    foreign = mismatch(stack, texture_set) if stack else None
    recipe = dataclasses.replace(
        settings.recipe, target=model, pixel_filter=kernel, sampler=baked_for(settings.sampler), lod_bias=None
    )
    notes = (*notes, *limits(source, model, stack is not None))
    warnings = (*texture_set.warnings, *([foreign] if foreign else []))
    early = [name for name in wanted if name in (empty.subject, LINEAR)]
    with bake_all(texture_set, recipe, early, clock) as shown:
        stacks = {each.name: _stack(texture_set, each) for each in shown}
        if stack:
            stacks = {earlier[0].name: stack} | stacks
        empty = dataclasses.replace(empty, stacks=stacks, foreign=foreign is not None)
        begun(dataclasses.replace(empty, notes=notes, warnings=warnings))
        with bake_all(texture_set, recipe, [name for name in wanted if name not in early], clock) as others:
            by_name = {each.name: each for each in (*shown, *others)}
            candidates = [*earlier, *(by_name[name] for name in wanted)]
            empty = dataclasses.replace(empty, methods=tuple(each.method for each in candidates))
            named = _named(empty, conditions) if settings.methods is None else None
            found = _compared(texture_set, candidates, empty, settings, views, films, clock, named)
    return dataclasses.replace(
        found,
        notes=(*notes, *found.notes),
        warnings=(*warnings, *made_for_others(found.methods, settings.sampler), *found.warnings),
        seconds=clock.seconds,
    )


def preview(
    texture_set: TextureSet,
    method: str = Neural.name,
    recipe: Recipe | None = None,
    progress: PhaseProgress = lambda _phase, _share: None,
) -> Comparison:
    """The stacks of a method and of plain MIP maps, of which nothing is measured: for the view of a page alone.

    Args:
        texture_set: the source.
        method: label or name of a method (`mipbake.comparing.candidates.chosen`).
        recipe: what is baked, except for its method; None for the defaults.

    Raises:
        UsageError: unknown names, or a method that does not have the model or the pixel filter.
    """
    recipe = recipe or Recipe()
    model, kernel = recipe.model(texture_set), filter_named(recipe.pixel_filter).name
    forms = chosen([method], kernel)
    wanted = [next((name for name, form in forms.items() if form[1] == kernel), next(iter(forms))), LINEAR]
    with bake_all(texture_set, dataclasses.replace(recipe, target=model), wanted, progress) as baked:
        return Comparison(
            name=texture_set.name,
            subject=baked[0].name,
            model=model,
            pixel_filter=kernel,
            methods=tuple(each.method for each in baked),
            stacks={each.name: _stack(texture_set, each) for each in baked},
            warnings=texture_set.warnings,
        )


def _compared(
    texture_set: TextureSet,
    candidates: Sequence[Candidate],
    empty: Comparison,
    settings: Settings,
    views: Sequence[View],
    films: Sequence[Film],
    clock: Timings,
    named: Collection[str] | None,
) -> Comparison:
    """Texture space, then renders, then films, then the paper's plots.

    Args:
        named: methods that renders and films measure in any case, as `looked_at` takes them.
    """
    source, renders = texture_set.filtered(empty.pixel_filter), settings.renders
    measured = texture_space.measure(
        source, candidates, effort=settings.effort, progress=clock, sampler=baked_for(settings.sampler)
    )
    clock("texture space", 1.0)
    figures = [*measured.figures, *_gains(measured, candidates)]
    found = dataclasses.replace(empty, curve=measured.curve, figures=tuple(figures), notes=measured.notes)
    drawn = {found.best_closed_form, f"linear ({found.pixel_filter})"} | set(named or ())
    few = [each for each in candidates if named is None or each.name in drawn]
    rendered, filmed, changes = [], [], []
    for view in views:
        made = render_view(view, source, candidates, renders, partial(clock, view.name), named=named)
        clock(view.name, 1.0)
        rendered.append(made.rendered)
        figures += made.figures
        changes += [made.change] if made.change else []
    for scene in films:
        shown, in_film = film(scene, source, candidates, renders, partial(clock, scene.name), named)
        clock(scene.name, 1.0)
        filmed.append(shown)
        figures += in_film
    turning, in_motion = plots.temporal_slice(
        source, few, settings.lights, renders, progress=partial(clock, "temporal slice")
    )
    lobe = plots.apparent_brdf(source, few, settings.seed)
    clock("apparent BRDF", 1.0)
    missing = missing_judge() if films else ""
    return dataclasses.replace(
        found,
        figures=(*figures, *in_motion),
        rendered=tuple(rendered),
        films=tuple(filmed),
        # Of the changes only the nearest view's, where shimmer is the worst.
        plots=(turning, *changes[:1], lobe),
        notes=(*found.notes, *not_converged([each.scene for each in rendered], [each.scene for each in filmed])),
        warnings=(f"{missing}.",) if missing else (),
    )


def _named(empty: Comparison, conditions: Sequence[Condition]) -> set[str]:
    """The subject, `linear (box)`, every method that is no closed form, and what conditions are on."""
    said = {word for each in conditions for word in (*each.values, each.other) if word}
    closed = {*empty.closed_forms} - {LINEAR} - said
    return {each.name for each in empty.methods} - closed


def _scenes(texture_set: TextureSet, settings: Settings) -> tuple[tuple[View, ...], tuple[Film, ...]]:
    """What is rendered, and what is filmed."""
    size, side = (texture_set.height, texture_set.width), settings.side
    lights, mesh, last = settings.lights, settings.mesh, int(texture_space.last_lod(size))
    square, wide = (side, side), (side, side * 7 // 4)
    views = mesh_views(mesh, size, lights, square) if mesh else standard_views(size, lights, last, square, wide)
    height = min(RESOLUTION[0], side)
    return views, films_of(size, lights, last, mesh, settings.motion, height) if settings.films else ()


def _planned(texture_set: TextureSet, empty: Comparison, views: Sequence[View], films: Sequence[Film]) -> Comparison:
    """A comparison with everything that will be measured, all nan: what conditions can be on."""

    def unknown(method: Method, measure: str, view: str, scale: str, lod: float = math.nan) -> Figure:
        return Figure(method.name, measure, view, scale, lod, math.nan)

    lods = texture_space.curve_lods((texture_set.height, texture_set.width))
    places = [(measure, view, scale) for measure in _IN_TEXTURE_SPACE for view in PAIR_SETS for scale in SCALES]
    pictured = [name for name, measure in MEASURES.items() if measure.needs != "film"]
    for view in views:
        moves = view.scale in SHIFTED_SCALES
        places += [(name, view.view, view.scale) for name in pictured if moves or name not in IN_MOTION]
    places += [(name, each.name, "") for each in films for name in film_measures()]
    places += [(measure, "rotation", "1:1") for measure in IN_MOTION]
    methods = empty.methods
    return dataclasses.replace(
        empty,
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
