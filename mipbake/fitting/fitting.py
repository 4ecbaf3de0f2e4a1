"""`mipbake.fit`: a stack, a renderer and views in, a stack that was fitted in this renderer out."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.base.checkpoints import alone_with
from mipbake.base.errors import UsageError
from mipbake.fitting.frames import Looked, looked
from mipbake.fitting.loop import FitSettings, Loop, Progress
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import Prepared, scores, scores_of_levels
from mipbake.fitting.probing import probe
from mipbake.fitting.references import given, middle_lod, named, passes_for, supersampled
from mipbake.fitting.renderer import Array, Levels, Renderer, new_stamps
from mipbake.fitting.shared import Rounds
from mipbake.fitting.state import Checkpoint, FitState, kept_in, key_of
from mipbake.material.pixel_filter import PixelFilter, filter_named
from mipbake.source.loading import PathLike, as_texture_set
from mipbake.source.texture_set import TextureSet
from mipbake.stack.saving import as_stack
from mipbake.stack.stack import MipStack

References: TypeAlias = "Sequence[Any] | Callable[[Any], Any]"
"""An image (H, W, 3) for each view, in order; or a function from a view to its image."""

_HELD_OUT_EVERY = 5  # of so many views one is held out, where none are given


def fit(
    stack: MipStack | PathLike,
    renderer: Renderer[Any],
    views: Sequence[Any],
    *,
    others: Sequence[MipStack] = (),
    source: TextureSet | PathLike | Sequence[PathLike] | None = None,
    reference: References | None = None,
    held_out: Sequence[Any] | None = None,
    steps: int | None = None,
    budget: float | None = None,
    renders: int = 1,
    rate: float = 1.0,
    passes: int | None = None,
    rounds: int = 1,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    progress: Callable[[Progress], None] = lambda _now: None,
    preparing: Callable[[float], None] = lambda _share: None,
) -> MipStack:
    """Optimises every texel of a stack in a renderer that only renders, so that it shows what the reference shows.

    Each step takes a view. All texels that show in it are perturbed by random signs, up to the quantisation step of
    files of 8 bits, and the view is rendered twice. Each pixel's difference of errors is credited to the texels that
    this pixel looked up (equation 8), and Adam moves these. After each round over the views, views that are held out
    say of each level whether it is the best so far, and the best ones are kept. Then numbers that all texels of a level
    share are found by least squares, see `mipbake.fitting.shared`. A level that gained nothing stays as it was.

    Images are compared as linear radiance, and as a display shows them: sRGB of x / (1 + x), exposed by the median of
    the reference (docs/conventions.md, section 4). What one of the two loses counts several times what the other gains.

    Args:
        stack: where the fit starts; of any material model; or the folder that it was saved in.
        renderer: see `mipbake.fitting.Renderer`.
        views: what the renderer takes as views. Where a view has the attributes `name` and `scale`, messages and scores
            use them.
        others: stacks of the same model and sizes, such as bakes by other methods. A level starts from the one that the
            views show best.
        source: the texture set that the stack was baked from, or what `mipbake.load` takes. It makes the references:
            the same renderer shows its level 0, supersampled under the stack's pixel filter. For that, views have a
            method `moved(right, up)`, in pixels.
        reference: in place of that, an image (H, W, 3) for each view, in order; or a function from a view to its image.
            With `held_out` the images of these views follow.
        held_out: views to check with. None: every fifth of `views`, which then is not learned from.
        steps: how many at most; None: 2000, where no budget is given either. With 0, starts are chosen and rounds
            are made alone.
        budget: seconds for the steps, checks included, and for the rounds, which take a third of it at most; preparing
            the views comes on top.
        renders: how often a step is rendered, each time with new signs and with their opposites: N of equation 9.
        rate: of Adam, in quantisation steps.
        passes: renders of a supersampled reference; None: 16 at level of detail 0, up to 256 at coarser ones, and four
            times as many for views that are held out.
        rounds: of Gauss-Newton steps of what all texels of a level share, after the other steps; 0: none, as in the
            paper.
        seed: of all that is random.
        checkpoint: a file that the state is kept in after every check, and when the renderer fails. Where it is there,
            the fit goes on from it, after its views have been prepared once more.
        progress: called after every check. preparing: called with the share of views that are prepared.

    Returns:
        A stack of the same model, sizes and other maps, whose provenance says that it was fitted.

    Raises:
        UsageError: settings that make no sense, others of another model or size, no reference, or no renderer.
        RendererError: the renderer failed, or gave something that is no frame: another size, values that are not
            finite, no uv, no lod; or its pictures do not follow the maps.
        InputError, OutputError: a checkpoint of another fit, renderer or reference, or one that cannot be written.

    Warns:
        UserWarning: views that show nothing of the maps, or other texels than their frames name; or a level that no
            view shows which is held out.
    """
    if not callable(getattr(renderer, "render", None)):
        raise UsageError(f"the renderer is a {type(renderer).__name__}: expected an object with render(levels, view)")
    settings = FitSettings(steps, budget, renders, rate, passes, seed, rounds)
    learned, checked = _split(views, held_out)
    stack = as_stack(stack)
    stacks = (stack, *others)
    texture_set = None if source is None else as_texture_set(source)
    parameters = Parameters.of(stack.model, *stack.size, len(stack.levels))
    starts = _starts(stacks, parameters)
    loop = Loop(renderer, parameters, stack.wrap, settings)
    both = [*learned, *checked]
    reference_of = _references(reference, texture_set, loop, filter_named(stack.provenance.pixel_filter), len(both))
    with nullcontext() if checkpoint is None else alone_with(Path(checkpoint)):
        file = state = None
        if checkpoint is not None:
            of = starts, stack.model, [named(view) for _, view in both]
            file = Checkpoint(Path(checkpoint), key_of(*of, replace(settings, steps=None, budget=None, rounds=0)))
            state = file.load()
        resting = loop.levels_of(starts[0])
        # All of them, before the renderer gets the source.
        seen = [looked(renderer.render(resting, view), named(view)) for _, view in both]
        prepared: list[Prepared] = []
        for (index, view), found in zip(both, seen, strict=True):
            image = reference_of(index, view, found, len(prepared) >= len(learned))
            prepared.append(Prepared.of(view, found, image, parameters, stack.wrap))
            preparing(len(prepared) / len(both))
        training, checking = prepared[: len(learned)], prepared[len(learned) :]
        if file is not None and state is not None:
            file.check_started(state, scores(checking, np.array([view.started for view in checking])))
        if state is None:
            for sentence in probe(loop, starts[0], training):
                warnings.warn(sentence, stacklevel=2)
            state = _begun(loop, starts, prepared, checking)
            if file is not None:
                file.save(state)
        still = [str(level) for level, snr in enumerate(state.begun) if not np.isfinite(snr).all()]
        if still:
            warnings.warn(
                f"no view that is held out shows level {', '.join(still)} of {stack.name}, so that nothing is fitted "
                "there: expected more views",
                stacklevel=2,
            )
        movable = np.flatnonzero(np.isfinite(state.begun).all(-1)).tolist()
        last = Rounds.planned(loop, state.best, (training, checking), movable, starts)
        left = None if budget is None else budget - last.seconds
        loop.run(state, training, checking, file, progress, left, 1 - last.share)
        best = loop.without_losses(state.best, parameters.joined(starts, state.origins), checking)
        with kept_in(file, state):
            best, rounds_made = last.run(loop, best, prepared)
        reached = scores(checking, loop.errors(best, checking))
        gained = ", ".join(f"{scale} {state.started[scale]:.1f} to {score:.1f} dB" for scale, score in reached.items())
        name = getattr(renderer, "called", type(renderer).__name__)
        of_rounds = f" and {rounds_made} round{'s' * (rounds_made > 1)} of least squares" if rounds_made else ""
        adjustment = (
            f"levels were fitted in the renderer {name} to {len(training)} views by {state.step} steps{of_rounds} with "
            f"seed {seed}{_origins(stacks, state.origins)}; SNR of {len(checking)} other views: {gained}"
        )
        provenance = replace(stack.provenance, promise=None, adjustments=(*stack.provenance.adjustments, adjustment))
        return replace(stack, levels=_levels(stacks, starts, parameters, best), provenance=provenance)


def _begun(loop: Loop, starts: Sequence[Array], prepared: Sequence[Prepared], checking: Sequence[Prepared]) -> FitState:
    """The state before the first step: each level is that of the stack which shows it best."""
    errors = loop.errors(starts[0], checking)
    first, origins = scores(checking, errors), np.zeros(len(loop.parameters.sizes), np.int64)
    if len(starts) > 1:
        # No step has learned from any view yet, so that all of them are fair judges.
        origins = loop.chosen(starts, prepared)
        errors = loop.errors(loop.parameters.joined(starts, origins), checking)
    begun = loop.parameters.joined(starts, origins)
    return FitState.first(begun, scores_of_levels(checking, errors), first, origins)


def _split(views: Sequence[Any], held_out: Sequence[Any] | None) -> tuple[list[tuple[int, Any]], list[tuple[int, Any]]]:
    """Views to learn from and views to check with, each with its number."""
    if len(views) < 2:
        raise UsageError(f"{len(views)} views are given: expected two or more, so that one can be held out")
    numbered = list(enumerate(views))
    if held_out is not None:
        if not held_out:
            raise UsageError("held_out is empty: expected views to check with, or None")
        return numbered, list(enumerate(held_out, len(views)))
    every = min(_HELD_OUT_EVERY, len(views))
    return [each for each in numbered if each[0] % every != every - 1], numbered[every - 1 :: every]


def _references(
    reference: References | None, source: TextureSet | None, loop: Loop, kernel: PixelFilter, count: int
) -> Callable[[int, Any, Looked, bool], Array]:
    """From a view's number, the view, where it looks up, and whether it is held out, to what it should show (H, W, 3).

    Args:
        count: of all views.
    """
    if reference is not None and not callable(reference) and len(reference) != count:
        raise UsageError(f"reference has {len(reference)} images: expected {count}, one for each view")
    original = None if source is None else _source_levels(source)
    settings = loop.settings

    def reference_of(index: int, view: Any, found: Looked, held_out: bool) -> Array:
        if reference is not None:
            return given(reference(view) if callable(reference) else reference[index], named(view), found.size)
        if original is None:
            raise UsageError(
                "neither source nor reference is given: expected the texture set that the stack was baked from, or "
                "reference images"
            )
        passes = settings.passes or passes_for(middle_lod(found, loop.parameters.sizes[0]), held_out)
        whole = bool(found.seen.all())
        return supersampled(loop.renderer, original, view, kernel, passes, settings.seed, whole, found.size)

    return reference_of


def _source_levels(source: TextureSet) -> Levels:
    """Level 0 of a texture set alone, as a renderer gets it."""
    stored = source.material(source.source_model)
    parameters = Parameters.of(source.source_model, stored.shape[0], stored.shape[1], 1)
    return parameters.levels(parameters.values([stored]), source.wrap, new_stamps(parameters.sizes))


def _starts(stacks: Sequence[MipStack], parameters: Parameters) -> list[Array]:
    """(texels, channels) of each stack. UsageError: one is of another model or size than the first."""
    first = stacks[0]
    for other in stacks:
        if (other.model, other.size, len(other.levels)) != (first.model, first.size, len(first.levels)):
            raise UsageError(
                f"the fit starts from {_described(first)}, and others hold {_described(other)}: expected stacks of one "
                "material model and one size"
            )
    return [parameters.values(list(each.levels)) for each in stacks]


def _described(stack: MipStack) -> str:
    height, width = stack.size
    return f"{len(stack.levels)} levels of {stack.model} from {width} x {height}"


def _levels(stacks: Sequence[MipStack], starts: Sequence[Array], parameters: Parameters, values: Array) -> list[Array]:
    """Stored channels of each level. Where the values are a stack's own, it is the stack's level, bit for bit."""
    stored = parameters.stored(values)
    for level in range(len(stored)):
        own = parameters.texels(level)
        for stack, start in zip(stacks, starts, strict=True):
            if np.array_equal(values[own], start[own]):
                stored[level] = stack.levels[level]
                break
    return stored


def _origins(stacks: Sequence[MipStack], origins: NDArray[np.integer]) -> str:
    """Which levels started from which of the other stacks; empty where none did."""
    parts = [
        f"level {', '.join(map(str, np.flatnonzero(origins == number)))} from {stack.provenance.method}"
        for number, stack in enumerate(stacks)
        if number and (origins == number).any()
    ]
    return f" (starting with {' and '.join(parts)})" if parts else ""
