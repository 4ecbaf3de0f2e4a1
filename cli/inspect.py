"""`mipbake inspect`: what is read, and why."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from mipbake.base.errors import UsageError
from mipbake.cli import options
from mipbake.cli.batch_options import CONFIG_OTHERWISE, BatchFlags, with_project
from mipbake.cli.session import Session
from mipbake.cli.sources import SourcesOrProject, over_sets, suggest_recursive
from mipbake.cli.tables import describe, remark, table
from mipbake.source.jobs import Job
from mipbake.source.layout import PROJECT
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet


@partial(options.reads_sets, without=("alpha_cutoff", "wrap_u", "wrap_v"))
def inspect(
    sources: SourcesOrProject = None,
    config: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            metavar="FILE",
            help="Show what a project file says of the sets in its library, or of the SOURCEs alone, and where.",
            show_default=CONFIG_OTHERWISE,
        ),
    ] = None,
    *,
    session: Session,
    load: LoadOptions,
) -> None:
    """Show what is found in texture sets and why.

    Every map is decoded, so that damaged files are found. With a project file, options are shown in place of maps.
    Nothing is written.
    """
    session.verbose = True  # the command has no other purpose
    config = with_project(BatchFlags(config=config), sources).config
    if config is not None:
        _show_project(session, config, sources or [])
        return
    if not sources:
        raise UsageError(f"missing argument 'SOURCE': expected one or more, or a {PROJECT} in this folder")

    def show(job: Job, found: TextureSet, _alone: bool) -> dict[str, Any]:
        describe(session, job, found)
        remark(session, job)
        return vars(job.named(found.found))

    results = over_sets(session, sources, load, show)
    below = suggest_recursive(session, map(Path, sources))
    if len(sources) == 1 and results and not (below or session.exit_code or load != LoadOptions()):
        session.print(f"to bake what was found: mipbake bake {shlex.quote(sources[0])} -o baked")
    session.results(results)


def _show_project(session: Session, config: Path, sources: Sequence[str]) -> None:
    """Prints what applies to the sets of a library, and where that is said."""
    from mipbake.library.listing import found_library
    from mipbake.library.project import read_project

    project = read_project(config)
    within = tuple(map(Path, sources))
    library = found_library([project.library], project.out, lambda label: project.chosen(label).load, within=within)
    idle = [] if sources else project.idle([entry.label for entry in library.entries])
    session.print(*(f"note: {note}" for note in (*library.notes, *idle)))
    results = []
    for entry in library.entries:
        settings = project.chosen(entry.label).settings
        told = table("option", "value", "from")
        for option, setting in sorted(settings.items()):
            told.add_row(option, json.dumps(setting.value), setting.origin)
        session.print(f"{entry.label}:" if settings else f"{entry.label}: the defaults", *([told] if settings else []))
        results.append({"entry": entry.label, "source": entry.source, "settings": dict(settings)})
    session.results(results)
