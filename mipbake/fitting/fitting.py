"""`mipbake.fit`: a stack, a renderer and views in, a stack that was fitted in this renderer out."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mipbake.base.checkpoints import alone_with
from mipbake.base.errors import UsageError
from mipbake.fitting.comparisons import ERRORS
from mipbake.fitting.loop import FitSettings, Loop, Progress
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import TEXELS, Preparation, References, scores, scores_of_levels
from mipbake.fitting.probing import Trial, probe
from mipbake.fitting.renderer import Levels, Renderer, new_stamps
from mipbake.fitting.shared import Rounds, rounds_told
from mipbake.fitting.starts import Starts
from mipbake.fitting.state import Checkpoint, FitState, kept_in, key_of
from mipbake.fitting.supersampled import named
from mipbake.material.pixel_filter import filter_named
from mipbake.source.texture_set import TextureSet
from mipbake.stack.stack import MipStack

_HELD_OUT_EVERY = 5  # of so many views one is held out, where none are given


def fit(
    stack: MipStack,
    renderer: Renderer[Any],
    views: Sequence[Any],
    *,
    others: Sequence[MipStack] = (),
    source: TextureSet | None = None,
    reference: References | None = None,
    held_out: Sequence[Any] | None = None,
    steps: int | None = None,
    budget: float | None = None,
    renders: int = 1,
    texels: str = TEXELS[0],
    rate: float = 1.0,
    passes: int | None = None,
    rounds: int = 1,
    seed: int = 0,
    error: str = ERRORS[0],
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

    Args:
        stack: where the fit starts; of any material model.
        renderer: see `mipbake.fitting.Renderer`.
        views: what the renderer takes as views. Where a view has the attributes `name` and `scale`, messages and scores
            use them.
        others: stacks of the same model and sizes, such as bakes by other methods. A level starts from the one that the
            views show best.
        source: the texture set that the stack was baked from. It makes the references: the same renderer shows its
            level 0, supersampled under the stack's pixel filter. For that, views have a method `moved(right, up)`, in
            pixels.
        reference: in place of that, an image (H, W, 3) for each view, in order; or a function from a view to its image.
            With `held_out` the images of these views follow.
        held_out: views to check with. None: every fifth of `views`, which then is not learned from.
        steps: how many at most; None: 2000, where no budget is given either. With 0, starts are chosen and rounds
            are made alone.
        budget: seconds for the steps, checks included, and for the rounds, which take a third of it at most; preparing
            the views comes on top.
        renders: how often a step is rendered, each time with new signs and with their opposites: N of equation 9.
        texels: "all" that a pixel's lookup reads are credited, or the "nearest" alone, as in the paper.
        rate: of Adam, in quantisation steps.
        passes: renders of a supersampled reference; None: 16 at level of detail 0, up to 256 at coarser ones, and four
            times as many for views that are held out.
        rounds: of Gauss-Newton steps of what all texels of a level share, after the other steps; 0: none, as in the
            paper.
        seed: of all that is random.
        error: what is compared. "displayed": images are linear radiance, and are compared as a display shows them, as
            sRGB of x / (1 + x), exposed by the median of the reference (docs/conventions.md, section 4). "both": also
            as linear radiance; what one of the two loses counts several times what the other one gains. "plain": the
            numbers of images are compared as they are, which suits renderers that show what a display gets.
        checkpoint: a file that the state is kept in after every check, and when the renderer fails. Where it is there,
            the fit goes on from it, after its views have been prepared once more.
        progress: told how far the fit is, after every check. preparing: told the share of views that are prepared.

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
    settings = FitSettings(steps, budget, renders, texels, rate, passes, seed, error, rounds)
    learned, checked = _split(views, held_out)
    images = _images(reference, [*views, *(held_out or [])])
    starts = Starts.of(stack, others)
    parameters, values = starts.parameters, starts.values[0]
    loop = Loop(renderer, parameters, stack.wrap, settings)
    original, kernel = None if source is None else _source_levels(source), filter_named(stack.provenance.pixel_filter)
    preparation = Preparation(renderer, parameters, stack.wrap, texels, original, kernel, passes, seed, error)
    both = [*learned, *checked]
    with nullcontext() if checkpoint is None else alone_with(Path(checkpoint)):
        file = state = None
        if checkpoint is not None:
            of = starts.values, stack.model, [named(view) for _, view in both]
            file = Checkpoint(Path(checkpoint), key_of(*of, replace(settings, steps=None, budget=None, rounds=0)))
            state = file.load(starts.values, len(stack.levels))
        resting, prepared = loop.levels_of(values), []
        seen = [preparation.seen(view, resting) for _, view in both]  # all, before the renderer gets the source
        for done, (index, view) in enumerate(both):
            prepared.append(preparation.of(view, seen[done], images(index, view), held_out=done >= len(learned)))
            preparing((done + 1) / len(both))
        training, checking = prepared[: len(learned)], prepared[len(learned) :]
        if file is not None and state is not None:
            file.check_started(state, scores(checking, np.array([view.started for view in checking])))
        if state is None:
            for sentence in probe(Trial(renderer, parameters, stack.wrap, values, seed), training):
                warnings.warn(sentence, stacklevel=2)
            errors = loop.errors(values, checking)
            first, origins = scores(checking, errors), np.zeros(len(stack.levels), np.int64)
            if others:
                # No step has learned from any view yet, so that all of them are fair judges.
                origins = loop.chosen(starts.values, prepared)
                errors = loop.errors(parameters.joined(starts.values, origins), checking)
            begun = parameters.joined(starts.values, origins)
            state = FitState.first(begun, scores_of_levels(checking, errors), first, origins)
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
        last = Rounds.planned(loop, state.best, (training, checking), movable, settings, starts.values)
        left = None if budget is None else budget - last.seconds
        loop.run(state, training, checking, file, progress, left, 1 - last.share)
        best = loop.settled(state.best, parameters.joined(starts.values, state.origins), checking)
        with kept_in(file, state):
            best, rounds_made = last.run(loop, best, prepared)
        reached = scores(checking, loop.errors(best, checking))
        gained = ", ".join(f"{scale} {state.started[scale]:.1f} to {score:.1f} dB" for scale, score in reached.items())
        told = (
            f"levels were fitted in the renderer {_called(renderer)} to {len(training)} views by {state.step} steps"
            f"{rounds_told(rounds_made)} with error {error} and seed {seed}{starts.told(state.origins)}; SNR of "
            f"{len(checking)} other views: {gained}"
        )
        provenance = replace(stack.provenance, promise=None, adjustments=(*stack.provenance.adjustments, told))
        return replace(stack, levels=starts.levels(best), provenance=provenance)


def _called(renderer: Any) -> str:
    return str(getattr(renderer, "called", type(renderer).__name__))


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
    is_checked = [index % every == every - 1 for index, _ in numbered]
    return (
        [each for each, out in zip(numbered, is_checked, strict=True) if not out],
        [each for each, out in zip(numbered, is_checked, strict=True) if out],
    )


def _images(reference: References | None, views: Sequence[Any]) -> Callable[[int, Any], Any]:
    """From a view's number and the view to its image; None for one that is to be supersampled."""
    if reference is None:
        return lambda _index, _view: None
    if callable(reference):
        return lambda _index, view: reference(view)
    if len(reference) != len(views):
        raise UsageError(f"reference has {len(reference)} images: expected {len(views)}, one for each view")
    return lambda index, _view: reference[index]


def _source_levels(source: TextureSet) -> Levels:
    """Level 0 of a texture set alone, as a renderer gets it."""
    stored = source.material(source.source_model)
    parameters = Parameters.of(source.source_model, stored.shape[0], stored.shape[1], 1)
    return parameters.levels(parameters.values([stored]), source.wrap, new_stamps(parameters.sizes))
