"""Options of `mipbake bake` for batches: libraries, several processes, and what has not changed."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mipbake.base.errors import UsageError
from mipbake.base.options import option
from mipbake.base.publish import check_file
from mipbake.source.layout import PROJECT

_BATCH = "Batches"
CONFIG_OTHERWISE = f"{PROJECT} here, without SOURCE"


@dataclass(frozen=True)
class BatchFlags:
    """What the command line says of batches. Any of these options makes the bake a batch, which leaves what has not
    changed.

    Raises:
        UsageError: options that contradict each other, or files that cannot be written.
    """

    recursive: bool = option(
        False, "Bake everything below the sources that has changed, into a tree like theirs.", short="r"
    )
    jobs: int | None = option(
        None,
        "Bake so many sources at once.\n\nThey share threads and --memory.",
        short="j",
        metavar="N",
        otherwise="1",
    )
    force: bool = option(False, "Bake in a batch what has not changed as well.", group=_BATCH)
    dry_run: bool = option(False, "Say what a batch would bake and why; write nothing.", group=_BATCH)
    check: bool = option(False, "As --dry-run, and end with exit code 5 where something would be baked.", group=_BATCH)
    watch: bool = option(
        False, "Bake a batch again whenever files below its sources change, until Ctrl-C.", group=_BATCH
    )
    depfile: Path | None = option(
        None,
        "Write what each stack.json and GLB was made from, as a rule of Make, which Ninja takes as well. A file that "
        "is no such rule is not replaced.",
        group=_BATCH,
        metavar="FILE",
    )
    json_log: Path | None = option(
        None,
        "Write a line of JSON for each set of a batch, when it is done. A file that does not begin with such a line is "
        "not replaced.",
        group=_BATCH,
        metavar="FILE",
    )
    cluster: str | None = option(
        None,
        "Bake a batch on a Ray cluster: HOST:PORT of its head, or `auto` on one of its machines. --jobs and --memory "
        "are then for the whole cluster, and for each process.",
        group=_BATCH,
        metavar="ADDRESS",
    )
    shard: str | None = option(
        None, "Bake part I of N of a batch, for machines that share the work.", group=_BATCH, metavar="I/N"
    )
    config: Path | None = option(
        None,
        "Bake the library of a project file, as `mipbake init` writes it, or the SOURCEs in it alone. Options that are "
        "given count more than the file.",
        group=_BATCH,
        metavar="FILE",
        otherwise=CONFIG_OTHERWISE,
    )

    def __post_init__(self) -> None:
        """Checks what does not go together."""
        if self.plans and self.depfile is not None:
            raise UsageError("a dry run bakes nothing that --depfile could tell of: expected one of the two")
        if self.watch and self.depfile is not None:
            raise UsageError(
                "--watch goes on without end, and --depfile is written at the end: expected one of the two"
            )
        _check_files(self.depfile, self.json_log)

    @property
    def any(self) -> bool:
        """Whether the bake is a batch."""
        return self != BatchFlags()

    @property
    def plans(self) -> bool:
        """Whether nothing is written."""
        return self.dry_run or self.check


def _check_files(depfile: Path | None, json_log: Path | None) -> None:
    """Errors for files that cannot be written, or that mipbake did not write, such as sources."""
    for flag, file in (("--depfile", depfile), ("--json-log", json_log)):
        if file is not None and (not file.name or file.is_dir()):
            raise UsageError(f"{flag} {file} is a folder: expected a file to write")
    if depfile is not None:
        from mipbake.library.depfile import check_depfile

        check_depfile(depfile)
    if json_log is not None:
        check_log(json_log)
        if depfile is not None and os.path.realpath(depfile) == os.path.realpath(json_log):
            raise UsageError(f"--depfile and --json-log are both {depfile}: expected two files")


_LONGEST = 1 << 26
"""Bytes of a line of a log at most: what is longer is none of ours."""


def check_log(path: Path) -> None:
    """OutputError where a file is in the way that is no log."""
    check_file(path, _is_log, "log")


def _is_log(path: Path) -> bool:
    """Whether the first line of a file is one that a log has."""
    with path.open("rb") as file:
        first = file.readline(_LONGEST)
    try:
        found = json.loads(first)
    except (ValueError, RecursionError):
        return False
    return isinstance(found, dict) and {"entry", "source", "ok", "exit_code"} <= found.keys()


def with_project(flags: BatchFlags, sources: Sequence[str] | None) -> BatchFlags:
    """The same, with the project file of the working directory where neither it nor a source was named."""
    return flags if sources or flags.config or not Path(PROJECT).is_file() else replace(flags, config=Path(PROJECT))
