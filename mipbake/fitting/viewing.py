"""The views of a fit, of three kinds, which there are more of as it goes on, with references that get less noise."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mipbake.fitting.frames import looked, named
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import Prepared
from mipbake.fitting.program import Frame
from mipbake.fitting.references import Supersampled
from mipbake.fitting.renderer import Array, Levels, Renderer
from mipbake.fitting.schedule import TICK, Clock

LEARNED, HELD_OUT, APART = "learned", "held out", "apart"
"""Views that steps learn from; views that choose between states; and views that only judge the result."""

CHOOSING = LEARNED, HELD_OUT

_FIRST = 10
"""Views that are prepared at once, to begin with: some of each kind."""

_GOLDEN = (5**0.5 - 1) / 2

_EFFORTS = {LEARNED: (8, 256, 0.5), HELD_OUT: (16, 1024, 0.1), APART: (16, 1024, 0.1)}
"""Renders of a reference, the first ones and at most, and how much noise is left, as `_Kind` has them. Noise in what is
learned from averages out over views (Lehtinen et al. 2018, *Noise2Noise*), so that more views are better than less
noise."""


@dataclass(eq=False)
class _Kind:
    """Views of a kind.

    Args:
        waiting: those that are not prepared, each with its number, in the order in which they will be.
        first, most: renders of a reference.
        noise: of a reference that needs no more renders, as a share of the error that the fit begins with.
        prepared: the others. references: of these; None where the reference was given.
    """

    waiting: list[tuple[int, Any]]
    first: int
    most: int
    noise: float
    prepared: list[Prepared] = field(default_factory=list)
    references: list[Supersampled | None] = field(default_factory=list)


Reference = Callable[[int, Any, Frame], Array | Supersampled]
"""From the number of a view, the view, and what the renderer shows of it, to an image (H, W, 3) or one that grows."""


class Views:
    """All views, of which some are prepared.

    Args:
        renderer: what renders. resting: the stack that the fit starts from.
        kinds: kind to its views, each with its number.
        reference_of: what views should show.
        passes: renders of a reference at most; None: by the kind of the view.
    """

    def __init__(
        self,
        renderer: Renderer[Any],
        clock: Clock,
        resting: Levels,
        parameters: Parameters,
        kinds: Mapping[str, Sequence[tuple[int, Any]]],
        reference_of: Reference,
        passes: int | None = None,
    ) -> None:
        self._renderer, self._clock, self._resting, self._parameters = renderer, clock, resting, parameters
        self._reference_of = reference_of
        self._kinds: dict[str, _Kind] = {}
        for name, given in kinds.items():
            first, most, noise = _EFFORTS[name]
            if passes is not None:
                most = max(2, passes)
            self._kinds[name] = _Kind([given[at] for at in _spread(len(given))], min(first, most), most, noise)
        self._pace = 0.0  # seconds of a render of the last reference

    def of(self, name: str) -> list[Prepared]:
        """The prepared views of a kind."""
        return self._kinds[name].prepared

    def passes(self) -> dict[str, list[int]]:
        """Kind to the renders of the reference of each of its prepared views; 0 where the reference was given."""
        return {
            name: [0 if each is None else each.passes for each in kind.references] for name, kind in self._kinds.items()
        }

    def rebuild(self, passes: Mapping[str, Sequence[int]]) -> None:
        """Prepares the same views as before, with the same references."""
        self._prepare([(self._kinds[name], count) for name, counts in passes.items() for count in counts])

    def add(self, names: Sequence[str], until: float) -> None:
        """Prepares more views, in turn of each kind, until all are prepared or a share of the budget is spent."""
        kinds = [self._kinds[name] for name in names]
        turns = []
        for kind in kinds:
            done, count = len(kind.prepared), len(kind.prepared) + len(kind.waiting)
            turns += [((at + 1) / count, kind) for at in range(done, count)]
        waiting = [(kind, kind.first) for _, kind in sorted(turns, key=lambda turn: turn[0])]
        batch = _FIRST if np.isfinite(self._left(until)) else len(waiting)
        if self._pace:
            most = self._left(until) / (self._pace * max(kind.first for kind in kinds))
            batch = int(np.clip(most, len(kinds), batch))
        while waiting and (self._left(until) > 0 or not all(kind.prepared for kind in kinds)):
            began = time.monotonic()
            self._prepare(waiting[:batch])
            pace = max(time.monotonic() - began, TICK) / min(batch, len(waiting))
            waiting = waiting[batch:]
            prepared = sum(len(kind.prepared) for kind in kinds)
            self._clock.viewed(prepared / (prepared + len(waiting)))
            # Renderers go from the stack to the source and back with each batch.
            batch = max(1, int(min(2.0 * batch, self._left(until) / pace)))

    def refine(self, names: Sequence[str], until: float) -> None:
        """Renders more of the references whose noise matters most, until none does or that share is spent."""
        while True:
            noisy = [
                (kind.prepared[at].uncertainty / kind.noise, kind, at, reference)
                for kind in (self._kinds[name] for name in names)
                for at, reference in enumerate(kind.references)
                if reference is not None and reference.passes < kind.most
            ]
            noisy = sorted((each for each in noisy if each[0] > 1), key=lambda each: -each[0])
            if not noisy:
                return
            for _, kind, at, reference in noisy:
                if self._pace * reference.passes > self._left(until):
                    return
                self._render(reference, min(2 * reference.passes, kind.most))
                kind.prepared[at] = kind.prepared[at].aiming_at(reference.halves())

    def _left(self, until: float) -> float:
        """Seconds until then, less what it takes to judge the result by the views that are apart."""
        return self._clock.left(until) - self._pace * len(self.of(APART))

    def _prepare(self, turns: Sequence[tuple[_Kind, int]]) -> None:
        """Prepares the next view of each of these kinds, with so many renders of its reference.

        All of them are looked at before the renderer gets the source.
        """
        found = []
        for kind, passes in turns:
            index, view = kind.waiting.pop(0)
            found.append((kind, passes, index, view, looked(self._renderer.render(self._resting, view), named(view))))
        for kind, passes, index, view, seen in found:
            reference = self._reference_of(index, view, seen)
            if isinstance(reference, Supersampled):
                self._render(reference, passes)
                halves, kept = reference.halves(), reference
            else:
                halves, kept = np.stack([reference, reference]), None
            kind.prepared.append(Prepared.of(view, seen, halves, self._parameters, self._resting.wrap))
            kind.references.append(kept)

    def _render(self, reference: Supersampled, passes: int) -> None:
        began, before = time.monotonic(), reference.passes
        reference.refine(passes)
        self._pace = (time.monotonic() - began) / max(1, reference.passes - before)


def _spread(count: int) -> list[int]:
    """An order of so many places, of which the first ones of any number are spread evenly over all of them."""
    ranks = np.argsort(np.argsort(np.arange(count) * _GOLDEN % 1.0))
    return [int(rank) for rank in ranks]
