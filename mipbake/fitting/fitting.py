"""`mipbake.fit`: a stack, a renderer and views in, a stack that was fitted in this renderer out."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.base.checkpoints import alone_with
from mipbake.base.errors import UsageError
from mipbake.fitting.frames import named
from mipbake.fitting.loop import FitSettings, Loop, Progress
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import scores, shown, started
from mipbake.fitting.probing import probe
from mipbake.fitting.program import Frame
from mipbake.fitting.references import Supersampled, given
from mipbake.fitting.renderer import Array, Levels, Renderer
from mipbake.fitting.schedule import CLOSING, FIRST, GROWING, LAST, ROUNDS, STAGES, Clock, Timed
from mipbake.fitting.shared import Rounds
from mipbake.fitting.state import FitFile, FitState
from mipbake.fitting.viewing import APART, CHOOSING, HELD_OUT, LEARNED, Reference, Views
from mipbake.material.pixel_filter import PixelFilter, filter_named
from mipbake.source.loading import PathLike, as_texture_set
from mipbake.source.texture_set import TextureSet
from mipbake.stack.saving import as_stack
from mipbake.stack.stack import MipStack
from mipbake.stochastic import Moments

References: TypeAlias = "Sequence[Any] | Callable[[Any], Any]"
"""An image (H, W, 3) for each view, in order; or a function from a view to its image."""

_HELD_OUT_EVERY, _APART_EVERY = 5, 10  # of so many views one is held out, and one apart, where none are given


def fit(
    stack: MipStack | PathLike,
    renderer: Renderer[Any],
    views: Sequence[Any],
    *,
    others: Sequence[MipStack] = (),
    source: TextureSet | PathLike | Sequence[PathLike] | None = None,
    reference: References | None = None,
    held_out: Sequence[Any] | None = None,
    apart: Sequence[Any] | None = None,
    steps: int | None = None,
    budget: float | None = None,
    renders: int = 1,
    rate: float = 1.0,
    passes: int | None = None,
    rounds: int = 1,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    progress: Callable[[Progress], None] = lambda _now: None,
    working: Callable[[float, float | None], None] = lambda _share, _left: None,
) -> MipStack:
    """Optimises every texel of a stack in a renderer that only renders, so that it shows what the reference shows.

    docs/fit.md says how. A level that gained nothing stays as it was. Images are compared as linear radiance, and as a
    display shows them: sRGB of x / (1 + x), exposed by the median of the reference.

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
            Images of `held_out` and of `apart` follow.
        held_out: views that choose between states. None: every fifth of `views`, which then is not learned from.
        apart: views that judge the result, and do nothing else. None: every tenth of `views`.
        steps: how many at most; None: 2000, where no budget is given either. With 0, starts are chosen and rounds
            are made alone.
        budget: seconds for all of it, from the call to the return. None: all views are prepared before the first step.
        renders: how often a step is rendered, each time with new signs and with their opposites: N of equation 9.
        rate: of Adam, in quantisation steps.
        passes: renders of a supersampled reference at most, 2 or more; None: 256 to learn from, 1024 of other views. A
            reference has fewer where more would not matter.
        rounds: of Gauss-Newton steps of what all texels of a level share, after the other steps; 0: none, as in the
            paper.
        seed: of all that is random.
        checkpoint: a file that the state is kept in after checks, and when the renderer fails. Where it is there, the
            fit goes on from it, after its views have been prepared once more, beside the budget.
        progress: called after every check. working: called after each render with the share of the fit that is done,
            and the seconds that are left of the budget, or None.

    Returns:
        A stack of the same model, sizes and other maps, whose provenance says that it was fitted, and what it gained.

    Raises:
        UsageError: settings that make no sense, others of another model or size, no reference, or no renderer.
        RendererError: the renderer failed, gave something that is no frame, or its pictures do not follow the maps.
        InputError, OutputError: a checkpoint of another fit, renderer or reference, or one that cannot be written.

    Warns:
        UserWarning: views that show nothing of the maps, or other texels than their frames name; a level that no view
            shows which is held out; or a budget that leaves no time for a step.
    """
    if not callable(getattr(renderer, "render", None)):
        raise UsageError(f"the renderer is a {type(renderer).__name__}: expected an object with render(levels, view)")
    settings = FitSettings(steps, budget, renders, rate, passes, seed, rounds)
    kinds = _split(views, held_out, apart)
    clock = Clock(budget, working)
    stack = as_stack(stack)
    stacks = (stack, *others)
    original = None if source is None else _source_levels(as_texture_set(source))
    parameters = Parameters.of(stack.model, *stack.size, len(stack.levels))
    starts = _starts(stacks, parameters)
    path = None if checkpoint is None else Path(checkpoint)
    names = [(kind, [named(view) for _, view in each]) for kind, each in kinds.items()]
    file = FitFile.of(path, starts, stack.model, names, replace(settings, steps=None, budget=None, rounds=0))

    def tell(now: FitState, found: Mapping[str, float]) -> None:
        moving, kept = int(np.count_nonzero(now.rates)), partial(_finished, stacks, starts, parameters, now.best)
        progress(Progress(clock.share, now.step, now.seconds, moving, found, now.gains.tolist(), kept))

    loop = Loop(Timed(renderer, clock), parameters, stack.wrap, settings, clock, file, tell)
    reference_of = _references(
        reference, original, loop, filter_named(stack.provenance.pixel_filter), sum(map(len, kinds.values()))
    )
    prepared = Views(loop.renderer, clock, loop.levels(starts[0]), parameters, kinds, reference_of, passes)
    with nullcontext() if path is None else alone_with(path):
        state = _resumed(loop, prepared) or _begun(loop, starts, prepared)
        last = _stages(loop, state, prepared, starts)
        if clock.budget is not None and state.step == 0 and settings.last != 0:
            warnings.warn(
                f"the budget of {clock.budget:g} s left no time for a step in {stack.name}, because views are rendered "
                "first: expected more time or a faster renderer",
                stacklevel=2,
            )
        checking, judging = prepared.of(HELD_OUT), prepared.of(APART)
        still = [str(level) for level, there in enumerate(shown(checking)) if not there]
        if still:
            warnings.warn(
                f"no view that is held out shows level {', '.join(still)} of {stack.name}, so that nothing is fitted "
                "there: expected more views",
                stacklevel=2,
            )
        with file.keeping(state):
            best = loop.without_losses(state.best, parameters.joined(starts, state.origins), checking)
            best, rounds_made = last.run(best)
            prepared.add((APART,), LAST)
            prepared.refine((APART,), LAST)
            reached = scores(judging, loop.errors(loop.levels(best), judging))
        gained = ", ".join(
            f"{scale} {score:.1f} to {reached[scale]:.1f} dB" for scale, score in started(judging).items()
        )
        name = getattr(renderer, "called", type(renderer).__name__)
        of_rounds = f" and {rounds_made} round{'s' * (rounds_made > 1)} of least squares" if rounds_made else ""
        adjustment = (
            f"levels were fitted in the renderer {name} to {len(prepared.of(LEARNED))} views by {state.step} steps"
            f"{of_rounds} with seed {seed}{_origins(stacks, state.origins)}; SNR of {len(judging)} views that nothing "
            f"was learned from or chosen by: {gained}"
        )
        return _finished(stacks, starts, parameters, best, adjustment)


def _resumed(loop: Loop, prepared: Views) -> FitState | None:
    """The state in the file, with its views, where there is one."""
    state = loop.file.load()
    if state is not None:
        prepared.rebuild(state.passes)
        loop.file.check_started(state, started(prepared.of(HELD_OUT)))
        loop.clock.resume(state.seconds)
    return state


def _begun(loop: Loop, starts: Sequence[Array], prepared: Views) -> FitState:
    """The state before the first step: each level is that of the stack which shows it best."""
    prepared.add(CHOOSING, FIRST)
    prepared.refine(CHOOSING, FIRST)
    for sentence in probe(loop, starts[0], prepared.of(LEARNED)):
        warnings.warn(sentence, stacklevel=3)
    checking = prepared.of(HELD_OUT)
    origins = np.zeros(len(loop.parameters.sizes), np.int64)
    if len(starts) > 1:
        # No step has learned from any view yet, so that all of them are fair judges.
        origins = loop.chosen(starts, [*prepared.of(LEARNED), *checking])
    begun = loop.parameters.joined(starts, origins)
    errors = np.array([view.started for view in checking])
    if origins.any():
        errors = loop.errors(loop.levels(begun), checking)
    state = FitState(
        begun.copy(),
        Moments.of(begun),
        begun,
        errors,
        gains=np.zeros(len(origins)),
        rates=shown(checking).astype(np.float64),
        waited=np.zeros(len(origins), np.int64),
        origins=origins,
        started=started(checking),
        passes=prepared.passes(),
    )
    loop.file.save(state)
    return state


def _stages(loop: Loop, state: FitState, prepared: Views, starts: Sequence[Array]) -> Rounds:
    """All steps, with more views before each stage of them but the first one; returns the rounds that follow."""
    begun, clock, file = loop.parameters.joined(starts, state.origins), loop.clock, loop.file
    learned, checking = prepared.of(LEARNED), prepared.of(HELD_OUT)
    first = state.stage if clock.budget is not None else len(STAGES) - 1
    limit = math.inf if clock.budget is None else ROUNDS * clock.budget
    rounds = Rounds(loop, (), (), (), (), 0)
    end = CLOSING
    for stage in range(first, len(STAGES)):
        if stage > first and loop.settings.stepped(state.step) < 1:
            with file.keeping(state):
                before = clock.share
                growing = before + GROWING * (STAGES[stage] * CLOSING - before)
                passes = prepared.passes()
                prepared.add(CHOOSING, (before + growing) / 2)
                prepared.refine(CHOOSING, growing)
                if prepared.passes() != passes:
                    loop.judge_anew(state, begun, checking)
                state.stage, state.turned, state.checked = stage, state.step, state.step
                state.passes, state.seconds = prepared.passes(), clock.seconds
        with file.keeping(state):
            if stage == state.step == 0 and clock.budget is not None:
                # Few numbers, which all pixels of a level show, gain from few renders; texels take many.
                early = Rounds.planned(loop, state.best, learned, checking, limit=clock.left(STAGES[0]))
                found, made = early.run(state.best)
                if made:
                    state.values[...] = state.best[...] = found
                    now, state.seconds = loop.judge_anew(state, begun, checking), clock.seconds
                    file.save(state)
                    loop.tell(state, now)
            if stage + 1 == len(STAGES):
                rounds = Rounds.planned(loop, state.best, learned, checking, starts, limit)
                if clock.budget is not None:
                    end -= rounds.seconds / clock.budget
        loop.run(state, learned, checking, min(STAGES[stage] * CLOSING, end), end)
    return rounds


def _split(
    views: Sequence[Any], held_out: Sequence[Any] | None, apart: Sequence[Any] | None
) -> dict[str, list[tuple[int, Any]]]:
    """Kind to views, each with its number."""
    least = 1 + (held_out is None) + (apart is None)
    if len(views) < least:
        raise UsageError(
            f"{len(views)} views are given: expected {least} or more, to learn from, to choose by, and to judge with"
        )
    for name, each in (("held_out", held_out), ("apart", apart)):
        if each is not None and not each:
            raise UsageError(f"{name} is empty: expected views, or None")
    found: dict[str, list[tuple[int, Any]]] = {LEARNED: [], HELD_OUT: [], APART: []}
    every = max(2, min(_HELD_OUT_EVERY, len(views)))
    for index, view in enumerate(views):
        is_held_out = held_out is None and index % every == every - 1
        is_apart = apart is None and index % _APART_EVERY == every // 2
        found[HELD_OUT if is_held_out else APART if is_apart else LEARNED].append((index, view))
    found[HELD_OUT] += enumerate(held_out or (), len(views))
    found[APART] += enumerate(apart or (), len(views) + len(held_out or ()))
    return found


def _references(
    reference: References | None, original: Levels | None, loop: Loop, kernel: PixelFilter, count: int
) -> Reference:
    """What so many views should show."""
    if reference is not None and not callable(reference) and len(reference) != count:
        raise UsageError(f"reference has {len(reference)} images: expected {count}, one for each view")

    def reference_of(index: int, view: Any, found: Frame) -> Array | Supersampled:
        size, seed = found.id.shape, loop.settings.seed
        if reference is not None:
            return given(reference(view) if callable(reference) else reference[index], named(view), size)
        if original is not None:
            return Supersampled(loop.renderer, original, view, kernel, seed, bool(found.id.all()), size)
        raise UsageError(
            "neither source nor reference is given: expected the texture set that the stack was baked from, or "
            "reference images"
        )

    return reference_of


def _source_levels(source: TextureSet) -> Levels:
    """Level 0 of a texture set alone, as a renderer gets it."""
    stored = source.material(source.source_model)
    parameters = Parameters.of(source.source_model, stored.shape[0], stored.shape[1], 1)
    return parameters.levels(parameters.values([stored]), source.wrap)


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


def _finished(
    stacks: Sequence[MipStack],
    starts: Sequence[Array],
    parameters: Parameters,
    values: Array,
    adjustment: str = "levels were fitted in a renderer, and the fit was stopped",
) -> MipStack:
    """The stack of fitted values. Where a level has the values of a stack, it is the stack's level, bit for bit."""
    stored = parameters.stored(values)
    for level in range(len(stored)):
        own = parameters.texels(level)
        for stack, start in zip(stacks, starts, strict=True):
            if np.array_equal(values[own], start[own]):
                stored[level] = stack.levels[level]
                break
    first = stacks[0]
    provenance = replace(first.provenance, promise=None, adjustments=(*first.provenance.adjustments, adjustment))
    return replace(first, levels=stored, provenance=provenance)


def _origins(stacks: Sequence[MipStack], origins: NDArray[np.integer]) -> str:
    """Which levels started from which of the other stacks; empty where none did."""
    parts = [
        f"level {', '.join(map(str, np.flatnonzero(origins == number)))} from {stack.provenance.method}"
        for number, stack in enumerate(stacks)
        if number and (origins == number).any()
    ]
    return f" (starting with {' and '.join(parts)})" if parts else ""
