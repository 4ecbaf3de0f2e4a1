"""`mipbake bake`: texture sets in, MIP stacks out."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Optional

from mipbake.baking import BakeOptions, NotBaked, bake_sources
from mipbake.base.errors import UsageError
from mipbake.cli import options
from mipbake.cli.bake_output import Printer, told
from mipbake.cli.batch_options import BatchFlags, with_project
from mipbake.cli.session import Session
from mipbake.cli.sources import SourcesOrProject, stacks_folder, suggest_recursive
from mipbake.source.layout import PROJECT
from mipbake.source.options import LoadOptions
from mipbake.stack.presets import preset_named


@partial(options.reads_sets, without=())
def bake(
    *,
    session: Session,
    load: LoadOptions,
    wanted: BakeOptions,
    batch: BatchFlags,
    memory: Optional[int],  # noqa: UP045
    sources: SourcesOrProject = None,
    out: Annotated[Optional[Path], stacks_folder] = None,  # noqa: UP045
) -> None:
    """Bake texture sets into MIP stacks. They look like their source from afar, too: calm, and as glossy as it is.

    A set that cannot be baked is reported, and the other sets are baked all the same. A search with a budget is
    kept in OUT/.<set>.search from time to time: after Ctrl-C or a crash, the same command goes on from there.
    With --recursive, or any option that says so, it is a batch, which leaves what has not changed since the last
    time. Ctrl-C ends a batch at once, and its searches go on the next time.
    """
    session.in_files = True
    batch = with_project(batch, sources)
    if batch.config is None:
        if not sources:
            raise UsageError(f"missing argument 'SOURCE': expected one or more, or a {PROJECT} in this folder")
        if out is None:
            raise UsageError("missing option '--out' / '-o': expected a folder for the stacks")
        if Path(PROJECT).is_file():
            session.print(
                f"note: the {PROJECT} of this folder is not used, because sources are named; --config {PROJECT} uses it"
            )
    if out is None or not sources or batch.any:
        from mipbake.cli.bake_batch import bake_batch

        bake_batch(session, sources or [], out, wanted, load, batch, memory)
        return
    made = bake_sources(sources, out, wanted, load, Printer(session))
    results = [told(each) for each in made]
    sets = [result["ok"] for result in results if "document" not in result]
    if len(sets) > 1:
        session.print(f"{sum(sets)} of {len(sets)} sets baked")
    if wanted.preset and any(sets):
        engine = preset_named(wanted.preset)
        session.print(*(f"in {engine.engine}: {note}" for note in engine.notes))
    suggest_recursive(session, [each.source for each in made if isinstance(each, NotBaked)], out)
    session.results(results)
