"""Names of others made into names of files and folders that every system takes."""

from __future__ import annotations

import re
import unicodedata

_MOST = 120
"""Bytes of a name: what is added to it (levels, suffixes, tiles) stays below the 255 that file systems take."""

_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\.|$)", re.IGNORECASE)
"""Devices of Windows, whatever follows a dot."""


def safe_name(name: object, otherwise: str) -> str:
    """A name in the letters and digits of any script; `otherwise` for a name that has none, or is not text."""
    readable = unicodedata.normalize("NFC", name) if isinstance(name, str) else ""
    whole = re.sub(r"[^\w.-]+", "_", readable).strip("._-")
    short = whole.encode()[:_MOST].decode(errors="ignore").rstrip("._-")
    return (f"_{short}" if _RESERVED.match(short) else short) or otherwise


def unique_name(name: object, otherwise: str, taken: set[str]) -> str:
    """A safe name that is not taken, whatever the case; it is taken then.

    Args:
        name: as others have it. otherwise: what stands for a name that has no letters or digits, or is not text.
        taken: names, casefolded; the new one is added.
    """
    safe = safe_name(name, otherwise)
    found, count = safe, 2
    while found.casefold() in taken:
        found, count = f"{safe}_{count}", count + 1
    taken.add(found.casefold())
    return found
