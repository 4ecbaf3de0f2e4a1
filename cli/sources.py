"""What the commands share that read texture sets: what they take, and the run over all sets in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Optional

import typer

from mipbake import MipbakeError
from mipbake.base.publish import temporary_folder
from mipbake.cli.session import Session
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet

_SOURCES = typer.Argument(
    metavar="SOURCE",
    help="Texture sets: folders with the maps of one set or of several, UDIM tiles in a folder or as a pattern "
    "with <UDIM>, .gltf, .glb and .mtlx documents, .zip archives of all these. A glob names several sources; @FILE "
    "names a list of paths, and @- a list on stdin.",
    show_default=False,
)
Sources = Annotated[list[str], _SOURCES]
SourcesOrProject = Annotated[Optional[list[str]], _SOURCES]  # noqa: UP045
"""Sources that may be left out where a project file names a library."""

stacks_folder = typer.Option(
    "--out", "-o", metavar="OUT", help="Folder for the stacks, each in OUT/<set>/.", show_default=False
)
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
                        results.append({"source": job.source, "ok": True, "exit_code": 0, **done})
            except MipbakeError as error:
                results.append(session.failed(job.source, error))
    return results
