"""`mipbake inspect`: what is read, and why."""

from __future__ import annotations

from functools import partial
from typing import Any

import mipbake
from mipbake.cli import options
from mipbake.cli.session import Session
from mipbake.cli.sources import Sources, over_sets
from mipbake.cli.tables import description, remarks_of
from mipbake.found import set_report
from mipbake.io.options import LoadOptions
from mipbake.jobs import Job
from mipbake.texture_set import TextureSet


@partial(options.reads_sets, without=("normal_length", "wrap_u", "wrap_v"))
def inspect(session: Session, sources: Sources, load: LoadOptions) -> None:
    """Show what is found in texture sets and why.

    Every map is decoded, so that damaged files are found. Nothing is written.
    """

    def show(job: Job, found: TextureSet, _alone: bool) -> dict[str, Any]:
        session.print(*description(job, found), *remarks_of(job))
        return vars(set_report(found, job))

    results = over_sets(session, sources, load, show)
    session.dump({"version": mipbake.__version__, "exit_code": session.exit_code, "results": results})
