"""`mipbake gui`: the page for dropping a material, in the browser, with the whole of mipbake behind it."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated, Optional

import typer

from mipbake.base import disk, memory
from mipbake.base.errors import InputError, OutputError, UsageError
from mipbake.base.publish import temporary_folder
from mipbake.cli.gui_bakes import Bench
from mipbake.cli.gui_server import HERE, Server
from mipbake.cli.session import Session
from mipbake.cli.streams import has_screen

_LAST_PORT = 65535


def gui(
    context: typer.Context,
    source: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Argument(
            metavar="[SOURCE]",
            help="A folder, .zip or .glb that is opened at once.",
            show_default=False,
            readable=False,
        ),
    ] = None,
    port: Annotated[int, typer.Option(metavar="NUMBER", help="Port of the page.", show_default="a free one")] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
) -> None:
    """Open a page to drop materials on, which bakes them and shows them beside the truth.

    The page is served to this computer alone. Ctrl-C ends it.
    """
    session: Session = context.obj
    session.in_files = True
    if not 0 <= port <= _LAST_PORT:
        raise UsageError(f"--port is {port}: expected a number from 1 to {_LAST_PORT}, or 0 for a free port")
    if source is not None and not (disk.is_dir(source) or disk.is_file(source)):
        raise InputError(f"{source} is not there: expected a folder, a .zip archive or a .glb document")
    with temporary_folder() as folder, memory.limited(memory.default()):
        try:
            server = Server(Bench(folder, source), port)
        except OSError as error:
            raise OutputError(f"cannot listen on {HERE}:{port} ({error.strerror}): choose another --port") from error
        session.print(f"mipbake is at {server.url} (Ctrl-C ends it)")
        if browser and has_screen():
            webbrowser.open(server.url)
        server.run()
