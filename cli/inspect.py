"""`mipbake inspect`: what would be read, and why."""

from __future__ import annotations

import typer

import mipbake
from mipbake.cli import options
from mipbake.cli.options import DEFAULTS
from mipbake.cli.session import Session
from mipbake.cli.tables import map_table, remarks, set_report, sources_of
from mipbake.io.discover import discover


def inspect(
    context: typer.Context,
    folder: options.Folder,
    maps: options.Maps = None,
    colour_space: options.ColourSpace = DEFAULTS.colour_space,
    normal_convention: options.Convention = DEFAULTS.normal_convention,
    normal_length: options.Length = DEFAULTS.normal_length,
    gloss: options.Gloss = DEFAULTS.roughness_is_gloss,
    wrap_u: options.WrapU = DEFAULTS.wrap[0],
    wrap_v: options.WrapV = DEFAULTS.wrap[1],
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Show what is found in a texture set and why. Writes nothing."""
    session: Session = context.obj
    session.configure(quiet, json)
    load = options.load_options(maps, colour_space, normal_convention, normal_length, gloss, wrap_u, wrap_v)
    found = discover(folder, load)
    session.print(f"{folder}: {found.width} x {found.height}", map_table(sources_of(found)), *remarks(found))
    session.dump({"version": mipbake.__version__, "folder": folder, **set_report(found)})
