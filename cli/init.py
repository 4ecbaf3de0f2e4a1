"""`mipbake init`: a project file for a library."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from mipbake.base import disk
from mipbake.base.errors import OutputError
from mipbake.base.publish import replaced_file
from mipbake.cli.session import Session
from mipbake.library.project import TEMPLATE
from mipbake.source.layout import PROJECT


def init(
    context: typer.Context,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where it is written.", readable=False)] = Path(),
    library: Annotated[str, typer.Option(metavar="FOLDER", help="The library, relative to the file.")] = "textures",
    out: Annotated[str, typer.Option("--out", "-o", metavar="OUT", help="Folder of all results.")] = "baked",
) -> None:
    """Write a project file, mipbake.toml, for a library of texture sets.

    Its comments say what can stand in it. `mipbake bake` in that folder bakes the library.
    """
    session: Session = context.obj
    session.in_files = True
    file = folder / PROJECT
    if disk.exists(file):
        raise OutputError(f"{file} exists: change it, or remove it first")
    text = TEMPLATE
    for name, value in {"library": library, "out": out}.items():
        text = text.replace(f'"{{{name}}}"', json.dumps(value, ensure_ascii=False))  # as TOML has strings, too
    replaced_file(file, text.encode())
    session.print(f"wrote {file}: change it as you like, then run `mipbake bake` in {folder}")
