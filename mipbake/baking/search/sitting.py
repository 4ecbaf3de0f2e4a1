"""What a long search is given beside its work. It may take several sittings: each is one run of a program."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

Stop = Callable[[], bool]
"""Is asked, many times a second, whether a search shall end with the best that it has."""


def never() -> bool:
    """The `Stop` of a search that nobody stops."""
    return False


@contextmanager
def unstopped() -> Iterator[Stop]:
    """A descent that nobody stops."""
    yield never


@dataclass(frozen=True)
class Sitting:
    """One sitting of a long search.

    Args:
        checkpoint: folder that the search is kept in from time to time, and goes on from; None for nowhere.
        descending: entered while texels are optimised, when there is a stack to keep; yields who may stop that.
        told: hears sentences: where the search goes on, how long it will take, what is kept of it.
    """

    checkpoint: Path | None = None
    descending: Callable[[], AbstractContextManager[Stop]] = unstopped
    told: Callable[[str], None] = lambda _: None


ONLY = Sitting()
"""The sitting of a search that is neither stopped nor kept."""


def spoken_time(seconds: float) -> str:
    """A time for people, in two digits: `45 s`, `12 min`, `1.5 h`, `14 h`."""
    for size, unit in ((3600.0, "h"), (60.0, "min"), (1.0, "s")):
        count = float(f"{max(seconds, 0.0) / size:.2g}")
        if count >= 1 or unit == "s":
            return f"{count:g} {unit}"
    raise AssertionError("seconds are always told")
