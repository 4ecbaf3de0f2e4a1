"""Bakes: a texture set in, a MIP stack out."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from mipbake.baking.adjust import AdjustedRecipe, Adjustments, adjusted
from mipbake.baking.methods import LongRun, Stop, check_takes, discard
from mipbake.baking.pipeline import DEFAULT_FILTER, DEFAULT_METHOD, bake_stoppable
from mipbake.baking.prefilter import say
from mipbake.base.timings import PhaseProgress
from mipbake.source.loading import PathLike, as_texture_set
from mipbake.source.options import with_overrides
from mipbake.source.texture_set import TextureSet
from mipbake.stack.stack import MipStack


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
