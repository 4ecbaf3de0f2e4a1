"""How far a fit is, and how that is kept in a file: a fit that is stopped goes on from there."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.checkpoints import DAMAGED, Checkpoint
from mipbake.base.errors import InputError, RendererError
from mipbake.fitting.renderer import Array
from mipbake.stochastic import Moments

_FORMAT = 7
_SAME = 0.25
"""dB by which scores of the same stack may differ in the same renderer, which may be a little noisy."""

_ARRAYS = ("values", "best", "begun", "gains", "rates", "waited", "origins")
_MOMENTS = ("first", "second", "steps")
_COUNTS = ("started", "passes", "stage", "step", "turned", "checked", "seconds")


@dataclass(eq=False)
class FitState:
    """How far a fit is. It changes as the fit goes on.

    Args:
        values: (texels, channels) now.
        moments: of Adam.
        best: of each level the values that were best on the views that are held out.
        begun: (views, 2) float64, errors of these views where the steps began.
        gains: (levels,) float64, how many dB more `best` has, as `prepared.worth` counts them.
        rates: (levels,) float64, factors of the rates, which fall. waited: (levels,) int64, checks since the best.
        origins: (levels,) int64, number of the stack that each level started from.
        started: scores over the views that are held out, of the stack that the fit started from.
        passes: kind of views to the renders of the reference of each that is prepared, as `Views.passes` has it.
        stage: number of the stage that steps are made in.
        step: steps that were made. turned: how many there were when the views were gone through last, or when there
            were more of them. checked: the same of the last check. seconds: that were spent, on everything.
    """

    values: Array
    moments: Moments
    best: Array
    begun: NDArray[np.float64]
    gains: NDArray[np.float64]
    rates: NDArray[np.float64]
    waited: NDArray[np.int64]
    origins: NDArray[np.int64]
    started: dict[str, float]
    passes: dict[str, list[int]]
    stage: int = 0
    step: int = 0
    turned: int = 0
    checked: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class FitFile:
    """A file that a state is kept in.

    Args:
        path: of the file; None: nothing is kept.
        key: what the fit is of. A file of another fit is not continued.
    """

    path: Path | None
    key: str = field(repr=False)

    @staticmethod
    def of(path: Path | None, starts: Iterable[Array], *settings: object) -> FitFile:
        """The file of a fit, which is told from others by what it may start from, and by how it goes on."""
        found = hashlib.sha256()
        for values in starts if path is not None else ():
            found.update(values.tobytes())
        found.update(json.dumps([str(each) for each in settings]).encode())
        return FitFile(path, found.hexdigest())

    def save(self, state: FitState) -> None:
        """Replaces the file, as a whole. OutputError: the file cannot be written."""
        if self.path is not None:
            arrays = {name: getattr(state, name) for name in _ARRAYS}
            arrays |= {name: getattr(state.moments, name) for name in _MOMENTS}
            about = {"key": self.key, **{name: getattr(state, name) for name in _COUNTS}}
            checkpoint_at(self.path).save(about, arrays)

    def load(self) -> FitState | None:
        """The state in the file; None where there is none. InputError: a file that is broken, or of another fit."""
        if self.path is None or not self.path.exists():
            return None
        about, arrays = checkpoint_at(self.path).load()
        if about.get("key") != self.key:
            raise InputError(
                f"the checkpoint {self.path} is of another fit (another stack, other views or settings): delete it, or "
                "choose another file"
            )
        try:
            kept: dict[str, Any] = {name: arrays[name] for name in _ARRAYS} | {name: about[name] for name in _COUNTS}
            return FitState(moments=Moments(*(arrays[name] for name in _MOMENTS)), **kept)
        except DAMAGED as error:
            raise InputError(f"the checkpoint {self.path} cannot be read ({error}): delete it to begin anew") from error

    def check_started(self, state: FitState, scores: Mapping[str, float]) -> None:
        """InputError where held-out views show the stack that the fit started from with other scores than then."""
        for scale, score in scores.items():
            then = state.started.get(scale, math.nan)
            if not abs(score - then) <= _SAME:
                raise InputError(
                    f"the checkpoint {self.path} is of another fit: views held out ({scale}) showed its start with "
                    f"{then:.1f} dB, and show it with {score:.1f} dB now, so the renderer, its shader, the views or "
                    "the references changed: delete it, or choose another file"
                )

    @contextmanager
    def keeping(self, state: FitState) -> Iterator[None]:
        """Keeps the state, whatever ends what is done with it. A RendererError then names the file."""
        try:
            yield
        except BaseException as error:
            self.save(state)
            if self.path is None or not isinstance(error, RendererError):
                raise
            raise RendererError(f"{error}\nWhat was fitted so far is kept in {self.path}.") from error


def checkpoint_at(path: Path) -> Checkpoint:
    """A file that a fit is kept in."""
    return Checkpoint(path, "fit", _FORMAT)
