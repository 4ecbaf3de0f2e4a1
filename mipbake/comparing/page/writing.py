"""A report's folder: what lies in it, and how it comes to be there whole or not at all."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mipbake.base import json_text
from mipbake.base.errors import OutputError
from mipbake.base.publish import check_place, published
from mipbake.base.timings import PhaseProgress
from mipbake.base.version import __version__
from mipbake.comparing.page.document import RESULTS, document
from mipbake.comparing.result import Comparison
from mipbake.material.filtered_source import FilteredSource

SCHEMA = "mipbake-comparison"
SCHEMA_VERSION = 1

PAGE, WHOLE = "index.html", "whole.js"
"""The page, and a script that lies beside a whole one: first pages look for it, because scripts load from disk too."""


def write_report(
    comparison: Comparison,
    source: FilteredSource | None,
    folder: Path,
    progress: PhaseProgress = lambda _phase, _share: None,
    begun: bool = False,
) -> list[Path]:
    """Writes a report into a folder, which appears under its name when it is complete.

    An earlier report there is replaced; a folder that holds anything else is left alone. A browser that shows a first
    page loads it again once the whole report has taken its place.

    Args:
        comparison: what was found.
        source: what the reference of the interactive view filters; None for a view without one.
        folder: where to. Missing parent folders are made.
        begun: whether this is a first page, of stacks that are still to be measured.

    Returns:
        The files: index.html, results.json and, beside a whole page, the script that first pages wait for.

    Raises:
        OutputError: the folder cannot be written, or holds something else.
    """
    results = {"schema": SCHEMA, "schema_version": SCHEMA_VERSION, "tool_version": __version__}
    with published(folder, is_report) as partial:
        page = document(comparison, source, begun, lambda share: progress("report", share))
        text = json.dumps(_plain(results | comparison.to_dict()), indent=2, allow_nan=False, ensure_ascii=False)
        # Names of files need not be UTF-8: what cannot be encoded is escaped, as JSON escapes it.
        (partial / RESULTS).write_text(text + "\n", encoding="utf-8", errors="backslashreplace")
        (partial / PAGE).write_text(page, encoding="utf-8", errors="backslashreplace")
        if not begun:
            (partial / WHOLE).write_text("wholePage();\n")
    progress("report", 1.0)
    return [folder / name for name in (PAGE, RESULTS, *([] if begun else [WHOLE]))]


def check_report(folder: Path) -> None:
    """Raises OutputError when a report cannot be written to a folder; leaves nothing there. For before long work."""
    check_place(folder, is_report)


def check_preview(folder: Path) -> None:
    """The same before a report without figures is written, which must not take the place of one that has some."""
    check_report(folder)
    if is_report(folder) and json_text.parsed((folder / RESULTS).read_bytes()).get("figures"):
        raise OutputError(
            f"{folder} has a report whose figures were measured, and a preview would replace it: choose another "
            "folder, or remove it"
        )


def is_report(folder: Path) -> bool:
    """Whether a folder holds a report and nothing else."""
    try:
        if json_text.parsed((folder / RESULTS).read_bytes())["schema"] != SCHEMA:
            return False
        inside = list(folder.iterdir())
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return all(path.name in (PAGE, RESULTS, WHOLE) and path.is_file() for path in inside)


def _plain(value: Any) -> Any:
    """The value in types that JSON has: paths become text, what is not finite None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | int) else str(value)
