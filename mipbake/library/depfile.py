"""What results were made from, in the words of Make, which Ninja reads as well."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from mipbake.base import disk
from mipbake.base.publish import check_file, replaced_file
from mipbake.library.listing import Entry
from mipbake.library.results import Summary, declares
from mipbake.library.state import Record
from mipbake.source.tiles import is_pattern

_MOST = 1 << 30
"""Bytes of a depfile at most: what is larger is none."""

_ESCAPED = str.maketrans({" ": "\\ ", "#": "\\#", "$": "$$", ":": "\\:"})
_PATTERN = "%"
"""What makes a pattern of a name before the colon, for Make, unless it is escaped. Elsewhere it stands for itself, as
it does for Ninja."""


def write_depfile(path: Path, summary: Summary, out: Path, roots: Sequence[Path], more: Sequence[Path] = ()) -> None:
    """Writes a rule that says which files the results of a batch were made from. It is about the files that declare
    results: each `stack.json`, and GLB files.

    Args:
        path: the file. out: the folder of all results. roots: the folders that were gone through.
        more: files that say how all of them are made, such as a project file.

    Folders are among what results were made from, so that a file that is added counts too. Each file that they were
    made from has an empty rule, so that Make goes on where it is gone; but for names with a %, which Make and Ninja
    write in different ways there.

    Raises:
        OutputError: it cannot be written, or is a file that is no depfile.
    """
    check_depfile(path)
    known = [(each.entry, each.record) for each in summary.entries if each.record is not None]
    results = [out / file.path for _, each in known for file in each.results if declares(Path(file.path))]
    files = [*(source for entry, each in known for source in _sources(entry, each, out, roots)), *more]
    sources = dict.fromkeys(os.path.normpath(file) for file in files)
    about = " ".join(os.fspath(file).translate(_ESCAPED).replace(_PATTERN, f"\\{_PATTERN}") for file in results)
    lines = [" \\\n  ".join([f"{about}:", *(source.translate(_ESCAPED) for source in sources)])]
    lines += [f"{source.translate(_ESCAPED)}:" for source in sources if _PATTERN not in source]
    replaced_file(path, ("\n\n".join(lines) + "\n").encode(errors="surrogateescape"))


def check_depfile(path: Path) -> None:
    """OutputError where a file is in the way that is no depfile of this form."""
    check_file(path, _is_depfile, "depfile")


def _is_depfile(path: Path) -> bool:
    """Whether a file is one rule, and an empty rule for each source in it, as `write_depfile` writes them."""
    with path.open("rb") as file:
        first, *rules = file.read(_MOST).removesuffix(b"\n").split(b"\n\n")
    about, *sources = first.split(b" \\\n  ")
    return about.endswith(b":") and rules == [b"%b:" % each for each in sources if _PATTERN.encode() not in each]


def _sources(entry: Entry, record: Record, out: Path, roots: Sequence[Path]) -> list[Path]:
    folder = entry.source.parent
    folders = [entry.source] if entry.source.is_dir() else [folder] if is_pattern(entry.source) else []
    for root in roots:
        around = (each for each in entry.source.parents if each == root or disk.lies_in(each, root))
        folders += [each for each in around if root.is_dir()]
    # Whatever is baked changes the time of the folder around the results.
    return [*(folder / file.path for file in record.files), *(each for each in folders if not disk.lies_in(out, each))]
