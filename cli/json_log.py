"""The file of --json-log: a line of JSON for each set of a batch, written when the set is done."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from mipbake.base.errors import OutputError
from mipbake.base.publish import check_file, reason
from mipbake.cli.bake_output import told
from mipbake.cli.session import Session, plain
from mipbake.library import EntryResult

_LONGEST = 1 << 26
"""Bytes of a line at most: what is longer is none of ours."""


@dataclass
class JsonLog:
    """The file, which is made when a batch begins.

    Args:
        path: None where no log is asked for.
    """

    session: Session
    path: Path | None
    _file: TextIO | None = None

    def open(self) -> None:
        """Empties the file. OutputError where it cannot be written, or mipbake did not write it."""
        if self.path is None or self._file is not None:
            return
        check_log(self.path)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("w", encoding="utf-8")
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {reason(error)}") from error

    def write(self, result: EntryResult) -> None:
        """Adds the lines of an entry. Where that fails, it is said, and the batch goes on without the log."""
        if self._file is None or self._file.closed:
            return
        try:
            self._file.writelines(json.dumps(plain(line), allow_nan=False) + "\n" for line in lines_of(result))
            self._file.flush()
        except OSError as error:  # the sets are more than the log
            self.session.fail(f"cannot write {self.path}: {reason(error)}", OutputError.exit_code)
            self.close()

    def close(self) -> None:
        """Closes the file where it is open."""
        if self._file is not None:
            with suppress(OSError):  # what could not be written was told
                self._file.close()


@contextmanager
def json_log(session: Session, path: Path | None) -> Iterator[JsonLog]:
    """A log that is closed when the block ends."""
    log = JsonLog(session, path)
    try:
        yield log
    finally:
        log.close()


def lines_of(result: EntryResult) -> list[dict[str, Any]]:
    """What became of an entry, for JSON: an object for each set or document."""
    about = {"entry": result.entry.label}
    same = {"source": result.entry.source, "ok": True, "exit_code": 0, "unchanged": True}
    return [{**about, **told(each)} for each in result.results] + [{**about, **same}] * result.unchanged


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
