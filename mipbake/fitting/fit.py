"""The fit: steps of stochastic gradients, checked on views that are held out (Deliot et al. 2024, section 5)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mipbake import stochastic
from mipbake.errors import UsageError
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import TEXELS, Preparation, Prepared, errors_of_levels, render_pixels, scores
from mipbake.fitting.renderer import Array, Levels, Renderer, RendererError, new_stamp
from mipbake.fitting.state import Checkpoint, FitState, key_of
from mipbake.pixel_filter import filter_named
from mipbake.stack import MipStack
from mipbake.texture_set import TextureSet

DEFAULT_STEPS = 2000  # a guess

_HELD_OUT_EVERY = 5  # of so many views one is held out, where none are given; a guess
_PATIENCE = 3  # checks without a gain of a level, after which its rate is halved; a guess
_LEAST_RATE = 1 / 64  # a level whose factor of the rate would be smaller is left as it is; a guess
_LAST_RATE = 0.05  # factor that the rate falls to at the end of a budget; a guess


@dataclass(frozen=True)
class Progress:
    """What a fit tells of itself after each check.

    Args:
        share: of the budget or of the steps that is done, from 0 to 1.
        step, seconds: so far.
        moving: how many levels still gain.
        scores: mean SNR in dB over the views that are held out, by scale, now. What is kept may be better.
        errors: of each level the least error so far, as a share of 1: -10 log10 of it is an SNR in dB.
    """

    share: float
    step: int
    seconds: float
    moving: int
    scores: Mapping[str, float]
    errors: Sequence[float]


def fit(
    stack: MipStack,
    renderer: Renderer[Any],
    views: Sequence[Any],
    *,
    source: TextureSet | None = None,
    reference: Sequence[Any] | Callable[[Any], Any] | None = None,
    held_out: Sequence[Any] | None = None,
    steps: int | None = None,
    budget: float | None = None,
    renders: int = 1,
    texels: str = "all",
    rate: float = 1.0,
    passes: int | None = None,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    progress: Callable[[Progress], None] = lambda _now: None,
    preparing: Callable[[float], None] = lambda _share: None,
) -> MipStack:
    """Optimises every texel of a stack in a renderer that only renders, so that it shows what the reference shows.

    Each step takes a view. All texels that show in it are perturbed by random signs, up to the quantisation step of
    files of 8 bits, and the view is rendered twice. Each pixel's difference of errors is credited to the texels that this
    pixel looked up (equation 8), and Adam moves these. After each round over the views, views that are held out say of
    each level whether it is the best so far. The best ones are returned, and a level that gained nothing stays as it was.

    Args:
        stack: where the fit starts; of any material model.
        renderer: see `mipbake.fitting.Renderer`.
        views: what the renderer takes as views. Where a view has the attributes `name` and `scale`, messages and scores
            use them.
        source: the texture set that the stack was baked from. It makes the references: the same renderer shows its
            level 0, supersampled under the stack's pixel filter. For that, views have a method `moved(right, up)`, in
            pixels.
        reference: in place of that, an image (H, W, 3) for each view, in order; or a function from a view to its image.
            With `held_out` the images of these views follow.
        held_out: views to check with. None: every fifth of `views`, which then is not learned from.
        steps: how many at most; None: 2000, where no budget is given either.
        budget: seconds for the steps, checks included; preparing the views comes on top.
        renders: pairs of renders whose gradients are averaged for a step, N of equation 9.
        texels: "all" that a pixel's lookup reads are credited, or the "nearest" alone, as in the paper.
        rate: of Adam, in quantisation steps.
        passes: renders of a supersampled reference; None: 64 at level of detail 0, up to 1024 at coarser ones.
        seed: of all that is random.
        checkpoint: a file that the state is kept in after every check, and when the renderer fails. Where it is there, the
            fit goes on from it.
        progress: told how far the fit is, after every check. preparing: told the share of views that are prepared.

    Returns:
        A stack of the same model, sizes and other maps, whose provenance says that it was fitted.

    Raises:
        UsageError: settings that make no sense, or no reference.
        RendererError: the renderer failed, or gave something that is no frame: another size, values that are not finite,
            no uv, no lod; or its pictures do not follow the maps.
        InputError, OutputError: a checkpoint of another fit, or one that cannot be written.
    """
    _check(views, steps, budget, renders, texels, rate, passes)
    height, width = stack.size
    parameters = Parameters.of(stack.model, height, width, len(stack.levels))
    values = parameters.values(list(stack.levels))
    learned, checked = _split(views, held_out)
    images = _images(reference, [*views, *(held_out or [])])
    loop = _Loop(renderer, parameters, stack.wrap, renders, rate, seed)
    preparation = Preparation(
        renderer,
        parameters,
        stack.wrap,
        texels,
        None if source is None else _source_levels(source),
        filter_named(stack.provenance.pixel_filter),
        passes,
        seed,
    )
    resting = loop.levels_of(values)
    prepared: dict[int, Prepared] = {}
    for done, (index, view) in enumerate([*learned, *checked]):
        prepared[index] = preparation.of(view, resting, images(index, view), held_out=done >= len(learned))
        preparing((done + 1) / (len(learned) + len(checked)))
    training = [prepared[index] for index, _ in learned]
    checking = [prepared[index] for index, _ in checked]
    file = None
    if checkpoint is not None:
        names = [each.name for each in (*training, *checking)]
        file = Checkpoint(Path(checkpoint), key_of(values, stack.model, names, renders, texels, rate, seed))
    state = file.load() if file is not None else None
    if state is None:
        loop.probe(values, training[0])
        errors = loop.errors(values, checking)
        state = FitState.first(values, errors_of_levels(checking, errors), scores(checking, errors))
    last = steps if steps is not None else (DEFAULT_STEPS if budget is None else None)
    loop.run(state, training, checking, last, budget, file, progress)
    reached = scores(checking, loop.errors(state.best, checking))
    gained = ", ".join(f"{scale} {state.started[scale]:.1f} to {score:.1f} dB" for scale, score in reached.items())
    told = (
        f"all levels were fitted in the renderer {type(renderer).__name__} to {len(training)} views; SNR of {len(checking)} "
        f"other views: {gained}"
    )
    provenance = replace(stack.provenance, promise=None, adjustments=(*stack.provenance.adjustments, told))
    return replace(stack, levels=parameters.stored(state.best), provenance=provenance)


class _Loop:
    """Steps and checks of a fit, with the arrays that they work in."""

    def __init__(
        self,
        renderer: Renderer[Any],
        parameters: Parameters,
        wrap: tuple[str, str],
        renders: int,
        rate: float,
        seed: int,
    ) -> None:
        self.renderer, self.parameters, self.wrap = renderer, parameters, wrap
        self.renders, self.rate, self.seed = renders, rate, seed
        self.channels = parameters.channels
        self.still = replace(self.channels, magnitude=tuple(0.0 for _ in self.channels.magnitude))
        self.stamps = [0] * len(parameters.sizes)

    def levels_of(self, values: Array, changed: Sequence[int] | None = None) -> Levels:
        """What the renderer gets, with new stamps for the levels that changed; None: for all."""
        stamp = new_stamp()
        for level in range(len(self.stamps)) if changed is None else changed:
            self.stamps[level] = stamp
        return self.parameters.levels(values, self.wrap, tuple(self.stamps))

    def errors(self, values: Array, views: Sequence[Prepared]) -> list[float]:
        """The error of each view."""
        levels = self.levels_of(values)
        return [view.error(render_pixels(self.renderer, levels, view, len(view.shown))) for view in views]

    def probe(self, values: Array, view: Prepared) -> None:
        """Checks that pictures follow the maps: by far more than they differ where the maps are the same.

        Raises:
            RendererError: they do not.
        """
        size = len(view.shown)
        first, second = (
            render_pixels(self.renderer, self.levels_of(values), view, size) * view.shown[:, None] for _ in range(2)
        )
        plus, minus = stochastic.perturb(values, self.channels, 0, self.seed)
        sides = [
            render_pixels(self.renderer, self.levels_of(side), view, size) * view.shown[:, None] for side in (plus, minus)
        ]
        change = float(np.sum(np.square(sides[0] - sides[1], dtype=np.float64)))
        noise = float(np.sum(np.square(first - second, dtype=np.float64)))
        if change == 0:
            raise RendererError(
                f"{view.name}: the picture is the same when every texel is another one: expected a renderer that looks its "
                "maps up in `levels`"
            )
        if noise > change:
            raise RendererError(
                f"{view.name}: two renders of the same maps differ more ({math.sqrt(noise):.3g}) than renders of perturbed "
                f"maps do ({math.sqrt(change):.3g}): expected a renderer whose picture follows from its maps alone, so "
                "turn off its noise, temporal filters and animations"
            )

    def run(
        self,
        state: FitState,
        training: Sequence[Prepared],
        checking: Sequence[Prepared],
        last: int | None,
        budget: float | None,
        file: Checkpoint | None,
        progress: Callable[[Progress], None],
    ) -> None:
        """Steps until the budget or the steps are spent, or the views that are held out gain no more."""
        gradient = np.zeros_like(state.values)
        sides = (state.values.copy(), state.values.copy())
        begun, before = time.monotonic(), state.seconds

        def share() -> float:
            by_steps = 0.0 if last is None else state.step / last
            return min(1.0, max(by_steps, 0.0 if budget is None else state.seconds / budget))

        while share() < 1 and state.rates.any():
            order = np.random.default_rng([self.seed, state.step // len(training)]).permutation(len(training))
            for index in order[state.step % len(training) :]:
                falling = _LAST_RATE + (1 - _LAST_RATE) * 0.5 * (1 + math.cos(math.pi * share()))
                try:
                    self._step(state, training[index], gradient, sides, self.rate * falling)
                except RendererError as error:
                    if file is None:
                        raise
                    file.save(state)
                    raise RendererError(f"{error}\nWhat was fitted so far is kept in {file.path}.") from error
                state.seconds = before + time.monotonic() - begun
                if share() >= 1:
                    break
            now = self._check(state, checking, sides)
            moving = int(np.count_nonzero(state.rates))
            state.seconds = before + time.monotonic() - begun
            if file is not None:
                file.save(state)
            progress(Progress(share(), state.step, state.seconds, moving, now, state.errors.tolist()))

    def _step(
        self, state: FitState, view: Prepared, gradient: Array, sides: tuple[Array, Array], rate: float
    ) -> None:
        """Moves the texels that a view shows."""
        size = len(view.shown)
        try:
            for pair in range(self.renders):
                number = state.step * self.renders + pair + 1
                stochastic.perturb(state.values, self.channels, number, self.seed, view.visible, sides)
                plus, minus = (
                    render_pixels(self.renderer, self.levels_of(side, view.levels), view, size) for side in sides
                )
                differences = stochastic.pixel_differences(plus, minus, view.reference, view.shown)
                differences *= np.float32(view.weight * size)
                stochastic.add_gradient(gradient, differences, view.credited, self.channels, number, self.seed)
            elements = np.asarray(view.credited.elements)
            bounds = np.searchsorted(elements, self.parameters.starts)
            for level in view.levels:
                own = elements[bounds[level] : bounds[level + 1]]
                factor = rate * float(state.rates[level])
                stochastic.descend(state.values, gradient, state.moments, self.channels, factor, own)
            state.step += 1
        except RendererError:
            gradient[...] = 0
            raise
        finally:
            stochastic.perturb(state.values, self.still, 0, 0, view.visible, sides)

    def _check(self, state: FitState, checking: Sequence[Prepared], sides: tuple[Array, Array]) -> dict[str, float]:
        """Keeps the levels that are the best so far, and lowers the rate of those that were not for some time."""
        found = self.errors(state.values, checking)
        starts = self.parameters.starts
        for level, error in enumerate(errors_of_levels(checking, found)):
            own = slice(starts[level], starts[level + 1])
            if error < state.errors[level]:
                state.best[own], state.errors[level], state.waited[level] = state.values[own], error, 0
                continue
            state.waited[level] += 1
            if state.waited[level] >= _PATIENCE:
                halved = state.rates[level] / 2
                state.rates[level], state.waited[level] = halved if halved >= _LEAST_RATE else 0.0, 0
                for array in (state.values, *sides):
                    array[own] = state.best[own]
        return scores(checking, found)


def _check(
    views: Sequence[Any], steps: int | None, budget: float | None, renders: int, texels: str, rate: float, passes: int | None
) -> None:  # fmt: skip
    if len(views) < 2:
        raise UsageError(f"{len(views)} views are given: expected two or more, so that one can be held out")
    for name, number, least in (("steps", steps, 1), ("renders", renders, 1), ("passes", passes, 1)):
        if number is not None and number < least:
            raise UsageError(f"{name} is {number}: expected {least} or more")
    if budget is not None and not budget > 0:
        raise UsageError(f"budget is {budget}: expected seconds, more than 0")
    if not 0 < rate < math.inf:
        raise UsageError(f"rate is {rate}: expected more than 0")
    if texels not in TEXELS:
        raise UsageError(f"texels is {texels!r}: expected {' or '.join(TEXELS)}")


def _split(
    views: Sequence[Any], held_out: Sequence[Any] | None
) -> tuple[list[tuple[int, Any]], list[tuple[int, Any]]]:
    """Views to learn from and views to check with, each with its number."""
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


def _images(reference: Sequence[Any] | Callable[[Any], Any] | None, views: Sequence[Any]) -> Callable[[int, Any], Any]:
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
    parameters = Parameters.of(source.source_model, *stored.shape[:2], 1)
    return parameters.levels(parameters.values([stored]), source.wrap, (new_stamp(),))
