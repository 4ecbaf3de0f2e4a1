"""What the commands share that read texture sets: what they take, and the run over all sets in it."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from mipbake import InputError, MipbakeError
from mipbake.base import disk
from mipbake.base.publish import temporary_folder
from mipbake.cli.session import Session, counted, succeeded
from mipbake.source.archives import GLTF, MATERIALX, SUFFIX
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.layout import manifests
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet
from mipbake.source.tiles import name_without

_SOURCES = typer.Argument(
    metavar="SOURCE",
    help="Folders with maps, .zip archives, .gltf, .glb or .mtlx documents.\n\nA folder holds the maps of one set or "
    "of several, or UDIM tiles, which a pattern with <UDIM> names as well. A glob names several sources; @FILE names a "
    "list of paths, and @- a list on stdin.",
    show_default=False,
)
Sources = Annotated[list[str], _SOURCES]
SourcesOrProject = Annotated[Optional[list[str]], _SOURCES]  # noqa: UP045
"""Sources that may be left out where a project file names a library."""


def out_option(metavar: str, text: str) -> Any:
    """The option --out, without a default in its help."""
    return typer.Option("--out", "-o", metavar=metavar, help=text, show_default=False)


stacks_folder = out_option("OUT", "Folder for the stacks, each in OUT/<set>/.")
"""The option --out of commands that write stacks."""


def over_sets(
    session: Session,
    sources: Sequence[str],
    load: LoadOptions,
    act: Callable[[Job, TextureSet, bool], dict[str, Any]],
) -> list[dict[str, Any]]:
    """Does something with every texture set of all sources; one that fails does not keep others from it.

    Args:
        act: what is done; it is told whether the set is the only one, and returns what it did, for JSON.

    Returns what was done, or went wrong, for each.
    """
    results: list[dict[str, Any]] = []
    with temporary_folder() as scratch:
        found = jobs(sources, load, scratch)
        alone = len(found) == 1 and isinstance(found[0], Job) and len(found[0].parts) == 1
        for job in found:
            try:
                if isinstance(job, Failure):
                    raise job.error
                with job.naming():
                    for texture_set in job.sets():
                        done = act(job, texture_set, alone)
                        results.append(succeeded(job.source, **done))
            except MipbakeError as error:
                results.append(session.failed(job.source, error))
    return results


def suggest_recursive(session: Session, sources: Iterable[Path], out: Path | None = None) -> bool:
    """Says what lies below folders and was passed over, and what to type to bake it.

    Args:
        out: where the command bakes to; None for a command that bakes nothing.

    Returns whether there is anything.
    """
    said = False
    for folder in dict.fromkeys(sources):
        with suppress(MipbakeError):  # why it cannot be read was said
            if not disk.is_dir(folder) or not (disk.folders_in(folder) or _packed(disk.files_in(folder))):
                continue
            from mipbake.library.listing import found_library

            entries = found_library([folder], out or Path("baked"), lambda _: LoadOptions()).entries
            below = [entry.source for entry in entries if entry.source != folder]
            sets, archives = sum(map(disk.is_dir, below)), sum(each.suffix.lower() == SUFFIX for each in below)
            kinds = {"texture set": sets, "archive": archives, "document": len(below) - sets - archives}
            parts = [counted(count, kind) for kind, count in kinds.items() if count]
            typed = f"mipbake bake {shlex.quote(str(folder))} -o baked --recursive"
            told = "the same command with --recursive bakes all of it" if out else typed
            session.print(*([f"{' and '.join(parts)} below {folder}: {told}"] if parts else []))
            said |= bool(parts)
    return said


def _packed(files: Iterable[Path]) -> list[Path]:
    """Documents and archives."""
    return [file for file in files if file.suffix.lower() in (*GLTF, MATERIALX, SUFFIX)]


def stack_of(given: Path, job: Job, texture_set: TextureSet, alone: bool) -> Path:
    """Where the stack of a texture set lies: a folder, or the file that declares the stack of a tile.

    Args:
        given: a stack, where the set is the only one, or what stacks were baked into.
        job: that the set is of. alone: whether it is the only one.

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
