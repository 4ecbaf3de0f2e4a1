"""What the commands that write a folder for every set share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mipbake import InputError, UsageError
from mipbake.cli.tables import sources_of
from mipbake.io.sources import Discovery
from mipbake.texture_set import TextureSet


def check_names(folders: list[Path], name_of: Callable[[Path], str], what: str) -> None:
    """UsageError when two folders would be written to one place.

    Args:
        folders: what is to be read.
        name_of: the name that a folder's result gets; an InputError is left for when its turn comes.
        what: is to be done with them, in a word.
    """
    names: dict[str, Path] = {}
    for folder in folders:
        try:
            name = name_of(folder)
        except InputError:
            continue
        if name in names:
            raise UsageError(
                f"{names[name]} and {folder} are both called {name}: {what} them into different folders, one at a time"
            )
        names[name] = folder


def file_hashes(found: Discovery | TextureSet) -> dict[str, str]:
    """Source file name to SHA-256, which is empty before the file is read."""
    return {source.path.name: source.sha256 for source in sources_of(found).values() if source.path}
