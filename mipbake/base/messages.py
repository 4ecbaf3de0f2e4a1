"""Making one short sentence of what there is to say."""

from __future__ import annotations

from collections.abc import Callable, Iterable


def one_line(message: str) -> str:
    """The first line of an error message, without the full stop, or that there is none."""
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return lines[0].rstrip(".") if lines else "no reason given"


def listed(names: Iterable[object]) -> str:
    """The first four names, and how many more there are."""
    every = [str(name) for name in names]
    return ", ".join(every[:4]) + (f" and {len(every) - 4} more" if len(every) > 4 else "")


def told_by(geterror: Callable[[], str]) -> str:
    """The first line of what OpenImageIO's `geterror` tells, which may quote bytes of a file that are not text."""
    try:
        return one_line(geterror())
    except UnicodeDecodeError as error:
        return one_line(error.object.decode("utf-8", "backslashreplace"))


def time_text(seconds: float) -> str:
    """A time for people, in two digits: `45 s`, `12 min`, `1.5 h`, `14 h`."""
    hours, minutes, whole = (float(f"{max(seconds, 0.0) / size:.2g}") for size in (3600, 60, 1))
    return f"{hours:g} h" if hours >= 1 else f"{minutes:g} min" if minutes >= 1 else f"{whole:g} s"
