"""Options of `mipbake bake` for batches: libraries, several processes, and what has not changed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from mipbake.base.errors import UsageError
from mipbake.cli.options import OptionalPath
from mipbake.source.layout import PROJECT

if TYPE_CHECKING:
    from mipbake.library import Shard


@dataclass(frozen=True)
class BatchAsked:
    """What the command line says of batches. Each option that is given makes the bake a batch."""

    recursive: bool = False
    jobs: int | None = None
    force: bool = False
    dry_run: bool = False
    json_log: Path | None = None
    config: Path | None = None
    watch: bool = False
    check: bool = False
    depfile: Path | None = None
    depfile_for: str | None = None
    cluster: str | None = None
    shard: Shard | None = None

    @property
    def any(self) -> bool:
        """Whether the bake is a batch."""
        return self != BatchAsked()


def project_file(meaning: str) -> Any:
    """The option --config.

    Args:
        meaning: what it is for, as a sentence.
    """
    return typer.Option("--config", metavar="FILE", help=meaning, show_default=f"{PROJECT} here, without SOURCE")


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
    check: Annotated[
        bool, typer.Option("--check", help="A --dry-run that ends with exit code 5 where something would be baked.")
    ] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Go on, and bake what somebody saves below the sources, until Ctrl-C.")
    ] = False,
    depfile: Annotated[
        OptionalPath,
        typer.Option(
            "--depfile",
            metavar="FILE",
            help="Write what results were made from, as a rule of Make, which Ninja takes as well. A file that is no "
            "such rule is not replaced.",
            show_default=False,
        ),
    ] = None,
    depfile_for: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="NAME",
            help="What the rule of --depfile is about.",
            show_default="each stack.json, and GLB files",
        ),
    ] = None,
    json_log: Annotated[
        OptionalPath,
        typer.Option(
            "--json-log",
            metavar="FILE",
            help="Write a line of JSON for each set of a batch, when it is done. A file that does not begin with such "
            "a line is not replaced.",
            show_default=False,
        ),
    ] = None,
    cluster: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="ADDRESS",
            help="Bake a batch on a Ray cluster: HOST:PORT of its head, or `auto` on one of its machines. --jobs and "
            "--memory are then for the whole cluster, and for each process.",
            show_default=False,
        ),
    ] = None,
    shard: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="I/N",
            help="Bake part I of N of a batch, for machines that share the work.",
            show_default=False,
        ),
    ] = None,
    config: Annotated[
        OptionalPath,
        project_file(
            "Bake the library of a project file, as `mipbake init` writes it, or the SOURCEs in it alone. Options that "
            "are given count more than the file."
        ),
    ] = None,
) -> BatchAsked:
    """What was said of batches. Any of these options makes the bake a batch, which leaves what has not changed."""
    if depfile_for is not None and depfile is None:
        raise UsageError("--depfile-for is the name in a --depfile, which is missing: give both, or none")
    if (dry_run or check) and depfile is not None:
        raise UsageError("a dry run bakes nothing that --depfile could tell of: expected one of the two")
    if watch and depfile is not None:
        raise UsageError("--watch goes on without end, and --depfile is written at the end: expected one of the two")
    _check_files(depfile, json_log)
    if shard is not None:
        from mipbake.library import Shard

        part = Shard.parsed(shard)
    logs = (json_log, config, watch, check, depfile, depfile_for)
    return BatchAsked(recursive, jobs, force, dry_run or check, *logs, cluster, part if shard is not None else None)


def _check_files(depfile: Path | None, json_log: Path | None) -> None:
    """Errors for files that cannot be written, or that mipbake did not write, such as sources."""
    for option, file in (("--depfile", depfile), ("--json-log", json_log)):
        if file is not None and (not file.name or file.is_dir()):
            raise UsageError(f"{option} {file} is a folder: expected a file to write")
    if depfile is not None:
        from mipbake.library.depfile import check_depfile

        check_depfile(depfile)
    if json_log is not None:
        from mipbake.cli.json_log import check_log

        check_log(json_log)
        if depfile is not None and os.path.realpath(depfile) == os.path.realpath(json_log):
            raise UsageError(f"--depfile and --json-log are both {depfile}: expected two files")


def with_project(asked: BatchAsked, sources: Sequence[str] | None) -> BatchAsked:
    """The same, with the project file of the working directory where neither it nor a source was named."""
    return asked if sources or asked.config or not Path(PROJECT).is_file() else replace(asked, config=Path(PROJECT))
