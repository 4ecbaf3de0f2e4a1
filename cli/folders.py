"""What the commands share that write or read a folder for every set."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mipbake import InputError, UsageError
from mipbake.source.jobs import Job
from mipbake.source.layout import manifests
from mipbake.source.texture_set import TextureSet
from mipbake.source.tiles import name_without


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


def stack_of(given: Path, job: Job, texture_set: TextureSet, alone: bool) -> Path:
    """Where the stack of a texture set lies: a folder, or the file that declares the stack of a tile.

    Args:
        given: a stack, where the set is the only one, or what stacks were baked into.
        job: that the set is of.
        texture_set: the set.
        alone: whether it is the only one.

    Raises:
        InputError: there is none.
    """
    tile = next((tile for tile, name in job.names.items() if name == texture_set.name and tile), 0)
    place = given / job.place / (name_without(texture_set.name, tile) if tile else texture_set.name)
    if tile:
        declared = [folder / f"stack.{tile}.json" for folder in (given, place)]
        found = next((file for file in declared if file.is_file()), None)
        if found is not None:
            return found
    elif place.is_dir() and manifests(place) and not manifests(given):
        return place
    if alone:
        return given
    raise InputError(
        f"{given} holds no stack of {texture_set.name}: expected {place}, as `mipbake bake ... -o {given}` writes it"
    )
