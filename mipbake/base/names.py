"""Names of a list that users give: in any case, and with a guess where there is none of that name."""

from __future__ import annotations

from collections.abc import Iterable

from mipbake.base.errors import UsageError


def known_name(what: str, given: object, names: Iterable[str], otherwise: str = "") -> str:
    """The name in a list that a user means, whatever the case of its letters.

    Args:
        what: the things that have these names: "preset". given: by the user. names: all of them.
        otherwise: what else could have been given, as the end of a sentence.

    Raises:
        UsageError: there is none of that name; the sentence has the nearest one and all others.
    """
    known = {name.casefold(): name for name in names}
    wanted = str(given).strip().casefold()
    if wanted in known:
        return known[wanted]
    raise UsageError(unknown(what, given, known.values(), otherwise))


def unknown(what: str, given: object, names: Iterable[str], otherwise: str = "") -> str:
    """The sentence of `known_name` for a name that is in no list."""
    from difflib import get_close_matches

    known = {name.casefold(): name for name in names}
    near = get_close_matches(str(given).strip().casefold(), known, 1)
    several = f"{what[:1].upper()}{what[1:].removesuffix('s')}s"
    expected = f"did you mean {known[near[0]]}? {several}:" if near else "expected one of"
    return f"unknown {what} {given!r}: {expected} {', '.join(known.values()) or '(there are none)'}{otherwise}"
