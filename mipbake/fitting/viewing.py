"""The views of a fit, of three kinds, which there are more of as it goes on, with references that get less noise."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mipbake.fitting.frames import Looked, looked
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import Prepared
from mipbake.fitting.references import Supersampled, named
from mipbake.fitting.renderer import Array, Levels, Renderer

LEARNED, HELD_OUT, APART = "learned", "held out", "apart"
"""Views that steps learn from; views that choose between states; and views that only judge the result."""

CHOOSING = LEARNED, HELD_OUT

_FIRST = 10
"""Views that are prepared at once, to begin with: some of each kind."""

_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class _Effort:
    """Renders of the references of a kind of views: the first ones, and how much noise is left in the end.

    Noise in what is learned from averages out over views (Lehtinen et al. 2018, *Noise2Noise*), so that more views are
    better than less noise.

    Args:
        first, most: renders of a reference. noise: share of the error that the fit begins with.
    """

    first: int
    most: int
    noise: float


_EFFORTS = {LEARNED: _Effort(8, 256, 0.5), HELD_OUT: _Effort(16, 1024, 0.1), APART: _Effort(16, 1024, 0.1)}


@dataclass(eq=False)
class _Kind:
    """Views of a kind, in the order in which they are prepared, and those that are."""

    views: Sequence[tuple[int, Any]]
    effort: _Effort
    prepared: list[Prepared] = field(default_factory=list)
    references: list[Supersampled | None] = field(default_factory=list)


Reference = Callable[[int, Any, Looked], Array | Supersampled]
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
        resting: Levels,
        parameters: Parameters,
        kinds: Mapping[str, Sequence[tuple[int, Any]]],
        reference_of: Reference,
        passes: int | None = None,
    ) -> None:
        self._renderer, self._resting, self._parameters = renderer, resting, parameters
        self._reference_of = reference_of
        self._kinds: dict[str, _Kind] = {}
        for name, given in kinds.items():
            effort = _EFFORTS[name]
            if passes is not None:
                effort = _Effort(min(effort.first, max(2, passes)), max(2, passes), effort.noise)
            self._kinds[name] = _Kind([given[at] for at in _spread(len(given))], effort)
        self.pace = 0.0
        """Seconds of a render of the last reference."""

    def of(self, name: str) -> list[Prepared]:
        """The prepared views of a kind."""
        return self._kinds[name].prepared

    def passes(self) -> dict[str, list[int]]:
        """Kind to the renders of the reference of each of its prepared views; 0 where the reference was given."""
        return {
            name: [0 if each is None else each.passes for each in kind.references] for name, kind in self._kinds.items()
        }

    def share(self, *names: str) -> float:
        """How many of the views of these kinds are prepared, from 0 to 1."""
        kinds = [self._kinds[name] for name in names]
        return sum(len(kind.prepared) for kind in kinds) / sum(len(kind.views) for kind in kinds)

    def rebuild(self, passes: Mapping[str, Sequence[int]]) -> None:
        """Prepares the same views as before, with the same references."""
        self._prepare([(self._kinds[name], count) for name, counts in passes.items() for count in counts])

    def add(self, names: Sequence[str], left: Callable[[], float], each: Callable[[], None] = lambda: None) -> None:
        """Prepares more views, in turn of each kind, until all are prepared or the time is over.

        Args:
            left: seconds that are left. each: called after each batch.
        """
        kinds = [self._kinds[name] for name in names]
        waiting = [
            (kind, kind.effort.first)
            for _, kind in sorted(
                (
                    ((at + 1) / len(kind.views), kind)
                    for kind in kinds
                    for at in range(len(kind.prepared), len(kind.views))
                ),
                key=lambda turn: turn[0],
            )
        ]
        batch = _FIRST if np.isfinite(left()) else len(waiting)
        if self.pace:
            batch = int(np.clip(left() / (self.pace * max(kind.effort.first for kind in kinds)), len(kinds), batch))
        while waiting and (left() > 0 or not all(kind.prepared for kind in kinds)):
            began = time.monotonic()
            self._prepare(waiting[:batch])
            pace = (time.monotonic() - began) / min(batch, len(waiting))
            waiting = waiting[batch:]
            each()
            # Renderers go from the stack to the source and back with each batch.
            batch = max(1, int(min(2.0 * batch, left() / pace)))

    def refine(self, names: Sequence[str], left: Callable[[], float]) -> None:
        """Renders more of the references whose noise matters most, until none does or the time is over."""
        while True:
            open_ = [
                (kind.prepared[at].uncertainty / kind.effort.noise, kind, at, reference)
                for kind in (self._kinds[name] for name in names)
                for at, reference in enumerate(kind.references)
                if reference is not None and reference.passes < kind.effort.most
            ]
            open_ = sorted((each for each in open_ if each[0] > 1), key=lambda each: -each[0])
            if not open_:
                return
            for _, kind, at, reference in open_:
                if self.pace * reference.passes > left():
                    return
                self._refine(kind, at, min(2 * reference.passes, kind.effort.most))

    def _prepare(self, turns: Sequence[tuple[_Kind, int]]) -> None:
        """Prepares the next view of each of these kinds, with so many renders of its reference.

        All of them are looked at before the renderer gets the source.
        """
        counts = {id(kind): len(kind.prepared) for kind, _ in turns}
        found = []
        for kind, passes in turns:
            index, view = kind.views[counts[id(kind)]]
            counts[id(kind)] += 1
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

    def _refine(self, kind: _Kind, at: int, passes: int) -> None:
        reference = kind.references[at]
        assert reference is not None
        self._render(reference, passes)
        kind.prepared[at] = kind.prepared[at].aiming_at(reference.halves())

    def _render(self, reference: Supersampled, passes: int) -> None:
        began, before = time.monotonic(), reference.passes
        reference.refine(passes)
        self.pace = (time.monotonic() - began) / max(1, reference.passes - before)


def _spread(count: int) -> list[int]:
    """An order of so many places, of which the first ones of any number are spread evenly over all of them."""
    ranks = np.argsort(np.argsort(np.arange(count) * _GOLDEN % 1.0))
    return [int(rank) for rank in ranks]
