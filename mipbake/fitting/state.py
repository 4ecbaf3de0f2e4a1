"""How far a fit is, and how that is kept in a file: a fit that is stopped goes on from there."""

from __future__ import annotations

import hashlib
import json
import math
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.checkpoints import DAMAGED, read_arrays, write_arrays
from mipbake.base.errors import InputError, RendererError
from mipbake.base.publish import check_file, writing
from mipbake.fitting.renderer import Array
from mipbake.stochastic import Moments

_FORMAT = 6
_SAME = 0.25
"""dB by which scores of the same stack may differ in the same renderer, which may be a little noisy."""

_ARRAYS = ("values", "best", "begun", "gains", "rates", "waited", "origins")
_MOMENTS = ("first", "second", "steps")
_COUNTS = ("started", "step", "checked", "seconds")


@dataclass(eq=False)
class FitState:
    """How far a fit is. It changes as the fit goes on.

    Args:
        values: (texels, channels) now.
        moments: of Adam.
        best: of each level the values that were best on the views that are held out.
        begun: (levels, 2) float64, mean SNR in dB of these views at the start; NaN for a level that none shows.
        gains: (levels,) float64, how many dB more `best` has, as `prepared.worth` counts them.
        rates: (levels,) float64, factors of the rates, which fall. waited: (levels,) int64, checks since the best.
        origins: (levels,) int64, number of the stack that each level started from.
        started: scores over the views that are held out, of the stack that the fit started from.
        step: steps that were made. checked: how many there were at the last check. seconds: that were spent on
            them, with the checks.
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
    step: int = 0
    checked: int = 0
    seconds: float = 0.0

    @staticmethod
    def first(
        values: Array, begun: NDArray[np.float64], started: dict[str, float], origins: NDArray[np.int64]
    ) -> FitState:
        """The state before the first step. A level that no view shows which is held out does not move."""
        rates = np.where(np.isfinite(begun).all(-1), 1.0, 0.0)
        waited = np.zeros(len(begun), np.int64)
        moments, gains = Moments.of(values), np.zeros(len(begun))
        return FitState(values.copy(), moments, values.copy(), begun, gains, rates, waited, origins, started)


@dataclass(frozen=True)
class Checkpoint:
    """A file that a state is kept in.

    Args:
        path: of the file.
        key: what the fit is of. A file of another fit is not continued.
    """

    path: Path
    key: str = field(repr=False)

    def save(self, state: FitState) -> None:
        """Replaces the file, as a whole. OutputError: the file cannot be written."""
        about = {"format": _FORMAT, "key": self.key, **{name: getattr(state, name) for name in _COUNTS}}
        arrays = {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)}
        arrays |= {name: getattr(state, name) for name in _ARRAYS}
        arrays |= {name: getattr(state.moments, name) for name in _MOMENTS}
        with writing(f"the checkpoint {self.path} cannot be written"):
            write_arrays(self.path, arrays)

    def load(self) -> FitState | None:
        """The state in the file; None where there is none.

        Raises:
            InputError: a file that is broken, or of another fit.
        """
        if not self.path.exists():
            return None
        try:
            arrays = read_arrays(self.path, lambda _: None)
            about = json.loads(arrays["about"].tobytes())
            of = about["format"], about["key"]
            kept: dict[str, Any] = {name: arrays[name] for name in _ARRAYS} | {name: about[name] for name in _COUNTS}
            moments = Moments(*(arrays[name] for name in _MOMENTS))
        except DAMAGED as error:
            raise InputError(f"the checkpoint {self.path} cannot be read ({error}): delete it to begin anew") from error
        if of != (_FORMAT, self.key):
            raise InputError(
                f"the checkpoint {self.path} is of another fit (another stack, other views or settings): delete it, or "
                "choose another file"
            )
        return FitState(moments=moments, **kept)

    def check_started(self, state: FitState, scores: Mapping[str, float]) -> None:
        """Checks that held-out views show the stack that the fit started from as they did then.

        Args:
            scores: of that stack, now.

        Raises:
            InputError: they show something else.
        """
        for scale, score in scores.items():
            then = state.started.get(scale, math.nan)
            if not abs(score - then) <= _SAME:
                raise InputError(
                    f"the checkpoint {self.path} is of another fit: views held out ({scale}) showed its start with "
                    f"{then:.1f} dB, and show it with {score:.1f} dB now, so the renderer, its shader, the views or "
                    "the references changed: delete it, or choose another file"
                )


def check_checkpoint(path: Path) -> None:
    """OutputError where a file is in the way that is no checkpoint of a fit. For before long work."""
    check_file(path, _is_checkpoint, "checkpoint of a fit")


def _is_checkpoint(path: Path) -> bool:
    """Whether it says so, whatever of it is damaged."""
    try:
        with zipfile.ZipFile(path) as file:
            return {f"{name}.npy" for name in ("about", *_ARRAYS, *_MOMENTS)} <= {*file.namelist()}
    except DAMAGED:
        return False


@contextmanager
def kept_in(file: Checkpoint | None, state: FitState) -> Iterator[None]:
    """Keeps the state in the file, where there is one, whatever ends what is done with it.

    Raises:
        RendererError: the renderer failed; it names the file.
    """
    try:
        yield
    except BaseException as error:
        if file is not None:
            file.save(state)
        if file is None or not isinstance(error, RendererError):
            raise
        raise RendererError(f"{error}\nWhat was fitted so far is kept in {file.path}.") from error


def key_of(starts: Iterable[Array], *settings: object) -> str:
    """Names a fit by what it may start from, and by how it goes on."""
    found = hashlib.sha256()
    for values in starts:
        found.update(values.tobytes())
    found.update(json.dumps([str(each) for each in settings]).encode())
    return found.hexdigest()
