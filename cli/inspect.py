"""`mipbake inspect`: what would be read, and why."""

from __future__ import annotations

from functools import partial

import mipbake
from mipbake.cli import options
from mipbake.cli.session import Session
from mipbake.cli.tables import map_table, remarks, set_report, sources_of
from mipbake.io.discover import discover
from mipbake.io.options import LoadOptions


@partial(options.reads_sets, without=("normal_length", "wrap_u", "wrap_v"))
def inspect(session: Session, folder: options.Folder, load: LoadOptions) -> None:
    """Show what is found in a texture set and why. Writes nothing."""
    found = discover(folder, load)
    session.print(f"{folder}: {found.width} x {found.height}", map_table(sources_of(found)), *remarks(found))
    session.dump({"version": mipbake.__version__, "folder": folder, **set_report(found)})
