"""Options of `mipbake bake` for batches: libraries, several processes, and what has not changed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Optional

import typer

from mipbake.cli.options import OptionalPath


@dataclass(frozen=True)
class BatchAsked:
    """What the command line says of batches. Each option that is given makes the bake a batch."""

    recursive: bool = False
    jobs: int | None = None
    force: bool = False
    dry_run: bool = False
    json_log: Path | None = None

    @property
    def any(self) -> bool:
        """Whether the bake is a batch."""
        return self != BatchAsked()


def batching(
    recursive: Annotated[
        bool,
        typer.Option(
            "--recursive",
            "-r",
            help="Bake every set, document and archive below the sources, into a tree like theirs.",
        ),
    ] = False,
    jobs: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--jobs",
            "-j",
            min=1,
            metavar="N",
            help="Bake so many sources at once, in processes that share threads and --memory.",
            show_default="1",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Bake in a batch what has not changed as well.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what a batch would bake and why; write nothing.")
    ] = False,
    json_log: Annotated[
        OptionalPath,
        typer.Option(
            "--json-log",
            metavar="FILE",
            help="Write a line of JSON for each set of a batch, when it is done.",
            show_default=False,
        ),
    ] = None,
) -> BatchAsked:
    """What was said of batches. Any of these options makes the bake a batch, which leaves what has not changed."""
    return BatchAsked(recursive, jobs, force, dry_run, json_log)
