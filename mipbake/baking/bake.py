"""The pipeline: a texture set in, a MIP stack out."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path

from mipbake.baking.methods import METHODS, OPTIONS, Sitting, Stop, discard, method_named
from mipbake.baking.prefilter import say
from mipbake.base.errors import UsageError
from mipbake.base.version import __version__
from mipbake.material import GLTF_MODELS, MODELS
from mipbake.material.aim import Sampler
from mipbake.material.pixel_filter import filter_named, filtered_levels
from mipbake.source.layout import channels_of
from mipbake.source.opacity import covering, keeping_coverage, opacity_of, shown
from mipbake.source.texture_set import TextureSet
from mipbake.stack.packing import source_files
from mipbake.stack.stack import MipStack, Provenance, not_finite

DEFAULT_METHOD = "auto"
DEFAULT_FILTER = "gaussian"
AUTO_TARGET = "auto"
"""`gltf-anisotropic` for a set with an anisotropy map, `gltf` for any other."""

TARGETS = (AUTO_TARGET, *MODELS)

STOPPED = "the search was stopped before it was done"
"""What the provenance of a stack says then."""

PhaseProgress = Callable[[str, float], None]
"""Is told the name of the phase and its finished share, from 0 to 1."""


class _Prefiltering:
    """Progress of the prefilter as the progress of a phase; notes go through (mipbake.baking.prefilter.Notes)."""

    def __init__(self, progress: PhaseProgress) -> None:
        self._progress = progress

    def __call__(self, share: float) -> None:
        self._progress("prefilter", share)

    def note(self, text: str) -> None:
        say(self._progress, text)


def resolve_target(texture_set: TextureSet, target: str) -> str:
    """The material model that a target means for this set; UsageError with the list of names for an unknown one."""
    if target not in TARGETS:
        raise UsageError(f"unknown target {target!r}: expected one of {', '.join(TARGETS)}")
    if target == AUTO_TARGET:
        return texture_set.source_model
    return target


def bake(
    texture_set: TextureSet,
    method: str = DEFAULT_METHOD,
    target: str = AUTO_TARGET,
    pixel_filter: str = DEFAULT_FILTER,
    progress: PhaseProgress = lambda _phase, _share: None,
    weights: str | None = None,
    budget: str | None = None,
    sampler: Sampler | str | None = None,
    aim: float | None = None,
    device: str | None = None,
    checkpoint: str | Path | None = None,
    stop: Stop | None = None,
) -> MipStack:
    """Prefilters a texture set into a complete MIP stack of the target material model, level 0 included.

        enough = threading.Event()  # which another thread sets
        mipbake.bake(texture_set, "refine", budget="2h", checkpoint="wood.search", stop=enough.is_set)

    Args:
        texture_set: from `mipbake.load` or `TextureSet.from_arrays`.
        method: a name in `mipbake.baking.methods.METHODS`.
        target: a material model in `mipbake.material.MODELS`, or "auto".
        pixel_filter: a name in `mipbake.material.pixel_filter.FILTERS`, for the filter of the engine's pixels.
        progress: told phase and share as the work goes on. Where it has a method `note`, methods that optimise tell it
            the SNR they have reached.
        weights: trained weights by name, for methods that use some; None for the default ones.
        budget: time for methods that optimise: `30s`, `2m`, `1h`, or `best`; None for the default of the method.
        sampler: of the engine that will look the stack up: a `mipbake.Sampler`, or what one is called, such as
            "anisotropic 4x" or "accumulated, bias -1"; None for the default one, "trilinear".
        aim: from 0, SNR under single lights, to 1, what people see in moving pictures; None for the default one.
        device: where a network runs: `cpu`, or `cuda` or `cuda:1` for a graphics card, which needs torch; None for
            `cpu`. Levels of different devices differ by rounding. All but the network runs on the processor.
        checkpoint: a folder that a method with a budget keeps its search in from time to time. The same bake goes on
            from there after it was stopped or its process ended, and the time that was spent counts. The folder is
            removed when the search is done. None: nothing is kept. `auto` without a budget keeps nothing.
        stop: asked many times a second while texels are optimised; where it says True, the search ends with the best
            that it has. `auto` without a budget does not ask.

    Returns:
        The stack: the model's stored channels at every level down to 1 x 1, and plain box-filtered levels of the maps
        that do not shade (ambient occlusion, height, emissive, opacity), whose level 0 is never altered. Where there is
        opacity, what it hides has no part in the levels; where the set has an `alpha_cutoff`, opacity keeps its
        coverage on every level.

    Raises:
        UsageError: an unknown method, target, filter, weights or sampler, a choice that the method does not have, a
            budget that cannot be read, an aim that is no number from 0 to 1, or a device that cannot be used; a
            checkpoint or a stop for a method without a budget.
    """
    if (checkpoint is not None or stop is not None) and method in METHODS and method not in OPTIONS["budget"]:
        what = "stop" if checkpoint is None else "checkpoint"
        raise UsageError(
            f"method {method} takes no {what}: leave it out, or choose one of {', '.join(OPTIONS['budget'])}"
        )
    kept = None if checkpoint is None else Path(checkpoint)
    sitting = Sitting(kept, lambda: nullcontext(stop or (lambda: False)), partial(say, progress))
    options = weights, budget, sampler, aim, device
    stack, stopped = bake_in_sitting(texture_set, method, target, pixel_filter, progress, *options, sitting)
    if kept is not None and not stopped:
        discard(kept)
    return stack


def bake_in_sitting(
    texture_set: TextureSet,
    method: str,
    target: str,
    pixel_filter: str,
    progress: PhaseProgress,
    weights: str | None,
    budget: str | None,
    sampler: Sampler | str | None,
    aim: float | None,
    device: str | None,
    sitting: Sitting,
) -> tuple[MipStack, bool]:
    """As `bake`, for a search that may be kept and stopped; a checkpoint is left to the caller.

    Returns:
        The stack, and whether the search was stopped before it was done.
    """
    prefilter = method_named(method, weights, budget, sampler, aim, device, sitting)
    model = resolve_target(texture_set, target)
    kernel = filter_named(pixel_filter).name
    source = texture_set.source_model
    seen = shown(texture_set)
    stored, opacity = seen.material(source), opacity_of(texture_set)
    result = prefilter(stored, source, model, kernel, texture_set.wrap, _Prefiltering(progress))
    if any(not_finite(level) for level in result.levels):
        raise AssertionError(f"{method} produced values that are not finite for {texture_set.name!r}")
    levels, promise = result.levels, result.promise
    if opacity is not None and model in GLTF_MODELS:
        # Models of glTF store base colours first, as the source does. What was promised was measured before.
        levels = covering(levels, stored, opacity, channels_of(model, "base_color"), kernel, texture_set.wrap)
        promise = None
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
            method=method,
            pixel_filter=kernel,
            weights=result.weights,
            weights_sha256=result.weights_sha256,
            budget=budget,
            sampler=result.sampler,
            aim=result.aim,
            tool_version=__version__,
            sources={m.source.path.name: m.source.sha256 for m in texture_set.maps.values() if m.source.path},
            source_hash=texture_set.source_hash,
            warnings=warnings,
            promise=promise,
            alpha_cutoff=texture_set.alpha_cutoff,
        ),
        source_files=source_files(texture_set),
    )
    return stack, result.stopped
