"""How levels are made of a texture set: the choices, and the pipeline."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mipbake.baking.methods import METHODS, OPTIONS, LongRun, Prefilter, method_named
from mipbake.baking.prefilter import say
from mipbake.baking.search.long_run import BEST, NOT_KEPT
from mipbake.base.device import PROCESSOR
from mipbake.base.names import known_name
from mipbake.base.options import one_of, option
from mipbake.base.timings import PhaseProgress
from mipbake.base.version import __version__
from mipbake.material import GLTF_MODELS, MODELS
from mipbake.material.aim import DEFAULT_AIM, DEFAULT_SAMPLER, MOST_BIAS, SAMPLERS, Sampler, sampler_of
from mipbake.material.pixel_filter import FILTERS, filter_named, filtered_levels
from mipbake.source.layout import channels_of
from mipbake.source.opacity import covering, keeping_coverage, opacity_of, shown
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


def bake_stoppable(
    texture_set: TextureSet,
    recipe: Recipe,
    progress: PhaseProgress = lambda _phase, _share: None,
    long_run: LongRun = NOT_KEPT,
) -> tuple[MipStack, bool]:
    """As `mipbake.bake`, without adjustments, for a recipe that is resolved; a checkpoint is left to the caller.

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
