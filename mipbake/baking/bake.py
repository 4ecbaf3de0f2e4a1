"""The pipeline: a texture set in, a MIP stack out."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mipbake.baking.methods import METHODS, OPTIONS, LongRun, Prefilter, Stop, check_takes, discard, method_named
from mipbake.baking.prefilter import say
from mipbake.baking.search.long_run import BEST
from mipbake.base.device import PROCESSOR
from mipbake.base.names import known_name
from mipbake.base.options import one_of, option
from mipbake.base.timings import PhaseProgress
from mipbake.base.version import __version__
from mipbake.material import GLTF_MODELS, MODELS
from mipbake.material.aim import DEFAULT_AIM, DEFAULT_SAMPLER, MOST_BIAS, SAMPLERS, Sampler, sampler_of
from mipbake.material.pixel_filter import FILTERS, filter_named, filtered_levels
from mipbake.source.layout import channels_of
from mipbake.source.loading import PathLike, as_texture_set
from mipbake.source.opacity import covering, keeping_coverage, opacity_of, shown
from mipbake.source.options import with_overrides
from mipbake.source.texture_set import TextureSet
from mipbake.stack.packing import source_files
from mipbake.stack.presets import PRESETS, preset_named
from mipbake.stack.stack import MipStack, Provenance, not_finite

if TYPE_CHECKING:
    from typing_extensions import Self

DEFAULT_METHOD = "auto"
DEFAULT_FILTER = "gaussian"
AUTO_TARGET = "auto"
"""`gltf-anisotropic` for a set with an anisotropy map, `gltf` for any other."""

TARGETS = (AUTO_TARGET, *MODELS)

STOPPED = "the search was stopped before it was done"
"""What the provenance of a stack says then."""


class _Prefiltering:
    """Progress of the prefilter as the progress of a phase, which notes go to (mipbake.baking.prefilter.Notes)."""

    def __init__(self, progress: PhaseProgress) -> None:
        self._progress = progress

    def __call__(self, share: float) -> None:
        self._progress("prefilter", share)

    def note(self, text: str) -> None:
        say(self._progress, text)


def some_of(option: str) -> str:
    """The methods that have an option, as a sentence lists them."""
    *others, last = OPTIONS[option]
    return f"{', '.join(others)} or {last}" if others else last


_METHOD = "Method"


@dataclass(frozen=True)
class Recipe:
    """How levels are made. `resolved` checks it, and puts in what its preset chooses.

    Args:
        sampler: a `mipbake.Sampler`, or what one is called, such as "anisotropic 4x" or "accumulated, bias -1".
    """

    method: str = option(
        DEFAULT_METHOD,
        "auto tries blends and keeps the best one; linear averages, as other tools do; there are more.\n\n"
        + "; ".join(f"{name}: {method.summary}" for name, method in METHODS.items())
        + ".",
        metavar=one_of(METHODS),
    )
    target: str | None = option(
        None,
        f"Material model of the stack; {AUTO_TARGET} means gltf-anisotropic for sets with an anisotropy map, and gltf "
        "for others.",
        group=_METHOD,
        metavar=one_of(TARGETS),
        otherwise=f"as the preset chooses, else {AUTO_TARGET}",
    )
    pixel_filter: str = option(
        DEFAULT_FILTER,
        "Pixel filter of the renderer that shows the stack.",
        name="filter",
        group=_METHOD,
        metavar=one_of(FILTERS),
    )
    preset: str | None = option(
        None,
        f"Engine that loads the files: {', '.join(PRESETS)}.\n\nIts preset chooses target, sampler, formats, packing, "
        "normals and names unless you do; see `mipbake presets`.",
        metavar=one_of(PRESETS),
    )
    weights: str | None = option(
        None,
        f"Trained weights, for {some_of('weights')}.",
        group=_METHOD,
        metavar="NAME",
        otherwise="the weights for the target and the filter",
    )
    budget: str | None = option(
        None,
        f"Time to optimise single texels as well.\n\nWhat {some_of('budget')} may spend on that: a number of seconds, "
        f"minutes or hours, or {BEST}, which goes on until nothing improves. Ctrl-C ends it sooner, with the best so "
        "far, but not in a batch.",
        metavar=f"30s|2m|1h|{BEST}",
        otherwise="none, or that of the method",
    )
    sampler: Sampler | str | None = option(
        None,
        "How the engine looks the stack up where a pixel covers more of it in one direction than in another, for "
        f"{some_of('sampler')}: once; with 16x anisotropic filtering ('anisotropic 4x' for 4x); or once in each of the "
        "frames that it accumulates ('accumulated, anisotropic' for both).",
        group=_METHOD,
        metavar=one_of(SAMPLERS),
        otherwise=f"as the preset chooses, else {DEFAULT_SAMPLER}",
    )
    lod_bias: float | None = option(
        None,
        "MIP bias of the sampler, added to the level of detail: engines that accumulate frames or upscale have a "
        "negative one.",
        group=_METHOD,
        metavar=f"-{MOST_BIAS:g}..{MOST_BIAS:g}",
        otherwise="as the preset chooses with the sampler, else 0",
    )
    aim: float | None = option(
        None,
        f"What {some_of('aim')} aim at: 1 is pictures as people see them, 0 is decibels under single lights, and a "
        "number between them weighs the two.",
        group=_METHOD,
        metavar="0..1",
        otherwise=f"{DEFAULT_AIM:g}",
    )
    device: str | None = option(
        None,
        f"Where networks run, for {some_of('device')}: on the processor, or on a graphics card that torch reaches with "
        "CUDA, which needs the extra `train`. What searches does so on the processor. Levels differ by rounding. "
        "mipbake's tests have never run this on a graphics card.",
        group=_METHOD,
        metavar="cpu|cuda|cuda:N",
        otherwise=PROCESSOR,
    )

    def resolved(self) -> Self:
        """The same with the target and the sampler that it means. UsageError for what no set can be baked with."""
        preset = preset_named(self.preset) if self.preset else None
        method = known_name("method", self.method, METHODS)
        sampler = sampler_of(self.sampler)
        # A preset gives no sampler to methods that take none, unless the user gave it a bias.
        if sampler is None and preset and (method in OPTIONS["sampler"] or self.lod_bias is not None):
            sampler = preset.sampler
        made = replace(
            self,
            method=method,
            target=known_name("target", self.target or (preset.target if preset else AUTO_TARGET), TARGETS),
            pixel_filter=filter_named(self.pixel_filter).name,
            preset=preset.name if preset else None,
            sampler=sampler_of(sampler, self.lod_bias),
            lod_bias=None,
        )
        made.prefilter()
        return made

    def prefilter(self, long_run: LongRun | None = None) -> Prefilter:
        """The method, with what was chosen for it. UsageError where it does not take that; see `method_named`."""
        return method_named(self.method, self.weights, self.budget, self.sampler, self.aim, self.device, long_run)

    def model(self, texture_set: TextureSet) -> str:
        """The material model that the target means for a set."""
        target = known_name("target", self.target or AUTO_TARGET, TARGETS)
        return texture_set.source_model if target == AUTO_TARGET else target

    def by(self, method: str, pixel_filter: str) -> Self:
        """The same by another method under another filter, without what that method does not take."""
        others = {name: None for name, methods in OPTIONS.items() if method not in methods}
        return replace(self, method=method, pixel_filter=pixel_filter, **others)


def bake(
    source: TextureSet | PathLike | Sequence[PathLike],
    method: str = DEFAULT_METHOD,
    target: str | None = None,
    pixel_filter: str = DEFAULT_FILTER,
    progress: PhaseProgress = lambda _phase, _share: None,
    checkpoint: str | Path | None = None,
    stop: Stop | None = None,
    **options: Any,
) -> MipStack:
    """Prefilters a texture set into a complete MIP stack of the target material model, level 0 included.

        stack = mipbake.bake("textures/wood", preset="unreal")
        stack.save("baked/wood")  # the files that this engine imports

        enough = threading.Event()  # which another thread sets
        mipbake.bake(texture_set, "refine", budget="2h", checkpoint="wood.search", stop=enough.is_set)

    Args:
        source: from `mipbake.load` or `TextureSet.from_arrays`; or what `mipbake.load` takes, such as a folder.
        method, target, pixel_filter, options: as the options of `mipbake bake` say it:
            preset: an engine, which chooses target and sampler unless you do. `MipStack.save` then writes for it.
            strength, keep_level0, min_roughness: how levels are changed afterwards (`Adjustments`).
            weights, budget, sampler, lod_bias, aim, device: see `Recipe`.
        progress: takes phase and share as the work goes on. Where it has a method `note`, that takes the SNR that
            methods which optimise have reached.
        checkpoint: a folder that a method with a budget keeps its search in from time to time. The same bake goes on
            from there after it was stopped or its process ended, and the time that was spent counts. The folder is
            removed when the search is done. None: nothing is kept. `auto` without a budget keeps nothing.
        stop: is called many times a second while texels are optimised; where it says True, the search ends with the
            best that it has. `auto` without a budget does not call it.

    Returns:
        The stack: the model's stored channels at every level down to 1 x 1, and plain box-filtered levels of the maps
        that do not shade (ambient occlusion, height, emissive, opacity), whose level 0 is never altered. Where there is
        opacity, what it hides has no part in the levels; where the set has an `alpha_cutoff`, opacity keeps its
        coverage on every level.

    Raises:
        UsageError: an unknown option, method, target, filter, preset, weights or sampler, a choice that the method does
            not have, a budget that cannot be read, an aim that is no number from 0 to 1, or a device that cannot be
            used; a checkpoint or a stop for a method without a budget.
        InputError, OutputError: as `mipbake.load`, where the source is no texture set.
    """
    from mipbake.baking.adjust import AdjustedRecipe, Adjustments, adjusted

    asked = AdjustedRecipe(method=method, target=target, pixel_filter=pixel_filter)
    recipe = with_overrides(asked, options).resolved()
    for what, given in (("checkpoint", checkpoint), ("stop", stop)):
        if given is not None:
            check_takes(recipe.method, "budget", what)
    texture_set, changes = as_texture_set(source), Adjustments.of(recipe)
    changes.check(recipe.model(texture_set))
    kept = None if checkpoint is None else Path(checkpoint)
    long_run = LongRun(kept, lambda: nullcontext(stop or (lambda: False)), partial(say, progress))
    stack, stopped = bake_stoppable(texture_set, recipe, progress, long_run)
    if kept is not None and not stopped:
        discard(kept)
    return adjusted(stack, texture_set, changes)


def bake_stoppable(
    texture_set: TextureSet, recipe: Recipe, progress: PhaseProgress, long_run: LongRun
) -> tuple[MipStack, bool]:
    """As `bake`, for a recipe that is resolved and a search that may be kept and stopped; a checkpoint is left to the
    caller.

    Returns:
        The stack, and whether the search was stopped before it was done.
    """
    model = recipe.model(texture_set)
    kernel = filter_named(recipe.pixel_filter).name
    source = texture_set.source_model
    seen = shown(texture_set)
    stored, opacity = seen.material(source), opacity_of(texture_set)
    result = recipe.prefilter(long_run)(stored, source, model, kernel, texture_set.wrap, _Prefiltering(progress))
    if any(not_finite(level) for level in result.levels):
        raise AssertionError(f"{recipe.method} produced values that are not finite for {texture_set.name!r}")
    levels, measured = result.levels, result.measured
    if opacity is not None and model in GLTF_MODELS:
        # Models of glTF store base colours first, as the source does. The figures were measured before.
        levels = covering(levels, stored, opacity, channels_of(model, "base_color"), kernel, texture_set.wrap)
        measured = None
    extra = {}
    for index, (role, texture) in enumerate(texture_set.plain_maps.items()):
        extra[role] = filtered_levels(texture.pixels, "box", texture_set.wrap)
        if role == "opacity" and texture_set.alpha_cutoff is not None:
            extra[role] = keeping_coverage(extra[role], texture_set.alpha_cutoff)
        progress("other maps", (index + 1) / len(texture_set.plain_maps))
    warnings = (*texture_set.warnings, *([STOPPED] if result.stopped else []))
    stack = MipStack(
        name=texture_set.name,
        model=model,
        levels=levels,
        extra=extra,
        wrap=texture_set.wrap,
        provenance=Provenance(
            method=recipe.method,
            pixel_filter=kernel,
            weights=result.weights,
            weights_sha256=result.weights_sha256,
            budget=recipe.budget,
            sampler=result.sampler,
            aim=result.aim,
            tool_version=__version__,
            sources={m.source.path.name: m.source.sha256 for m in texture_set.maps.values() if m.source.path},
            source_hash=texture_set.source_hash,
            preset=recipe.preset,
            warnings=warnings,
            promise=measured,
            alpha_cutoff=texture_set.alpha_cutoff,
        ),
        source_files=source_files(texture_set),
    )
    return stack, result.stopped
