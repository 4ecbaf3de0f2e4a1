"""What the commands that write a folder for every set share."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from pathlib import Path

from mipbake import InputError, UsageError
from mipbake.cli.tables import sources_of
from mipbake.io.sources import Discovery
from mipbake.texture_set import TextureSet


def check_names(named: Iterable[tuple[str, Path]], what: str) -> None:
    """UsageError when two sources would be written to one place.

    Args:
        named: what each result is called, and where it comes from.
        what: is to be done with them, in a word.
    """
    names: dict[str, Path] = {}
    for name, source in named:
        if name in names:
            raise UsageError(
                f"{names[name]} and {source} are both called {name}: {what} them into different folders, one at a time"
            )
        names[name] = source


def names_of(folders: Iterable[Path], name_of: Callable[[Path], str]) -> list[tuple[str, Path]]:
    """Names and folders; an InputError of `name_of` is left for when a folder's turn comes."""
    named = []
    for folder in folders:
        with contextlib.suppress(InputError):
            named.append((name_of(folder), folder))
    return named


def file_hashes(found: Discovery | TextureSet) -> dict[str, str]:
    """Source file name to SHA-256, which is empty before the file is read."""
    return {source.path.name: source.sha256 for source in sources_of(found).values() if source.path}
