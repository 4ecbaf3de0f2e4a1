"""A report's folder: what lies in it, and how it comes to be there whole or not at all."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

from mipbake.base import json_text
from mipbake.base.publish import check_place, published
from mipbake.base.version import __version__
from mipbake.comparing.page.document import RESULTS, document
from mipbake.comparing.page.pictures import IMAGES, Album
from mipbake.comparing.page.plain import plain
from mipbake.comparing.result import Comparison
from mipbake.comparing.viewer import Source
from mipbake.stack.stack import MipStack

SCHEMA = "mipbake-comparison"
SCHEMA_VERSION = 1

PAGE, RENDERS = "index.html", "renders"


def write_report(
    comparison: Comparison,
    stacks: Mapping[str, MipStack],
    source: Source | None,
    folder: Path,
    progress: Callable[[str, float], None] = lambda _phase, _share: None,
    renders: Path | None = None,
) -> list[Path]:
    """Writes a report into a folder, which appears under its name when it is complete.

    An earlier report there is replaced; a folder that holds anything else is left alone.

    Args:
        comparison: what was found.
        stacks: name of a method to its stack, as far as there are stacks. The interactive view holds the subject's, the
            best closed form's and the stack of `linear (box)`, cropped where they are large; levels of the subject and
            of `linear (box)` are shown as thumbnails.
        source: level 0 before prefiltering, for the view's reference.
        folder: where to. Missing parent folders are made.
        progress: told "report" and the finished share, from 0 to 1.
        renders: a folder of EXR files to copy into the report.

    Returns:
        The files: index.html, results.json, then the images.

    Raises:
        OutputError: the folder cannot be written, or holds something else.
    """
    results = {"schema": SCHEMA, "schema_version": SCHEMA_VERSION, "tool_version": __version__} | plain(
        comparison.to_dict()
    )
    with published(folder, is_report) as partial:
        album = Album(partial)
        if renders is not None:
            (partial / RENDERS).mkdir()
            for file in sorted(renders.glob("*.exr")):
                shutil.copyfile(file, partial / RENDERS / file.name)
                album.files[f"{RENDERS}/{file.name}"] = f"candidate, reference, error, lod and uv of {file.stem}"
        page = document(comparison, stacks, source, album, lambda share: progress("report", share))
        text = json.dumps(results, indent=2, allow_nan=False, ensure_ascii=False)
        # Names of files need not be UTF-8: what cannot be encoded is escaped, as JSON escapes it.
        (partial / RESULTS).write_text(text + "\n", encoding="utf-8", errors="backslashreplace")
        (partial / PAGE).write_text(page, encoding="utf-8", errors="backslashreplace")
    progress("report", 1.0)
    return [folder / name for name in (PAGE, RESULTS, *album.files)]


def check_report(folder: Path) -> None:
    """Raises OutputError when a report cannot be written to a folder; leaves nothing there. For before long work."""
    check_place(folder, is_report)


def is_report(folder: Path) -> bool:
    """Whether a folder holds a report (and the renders kept with it) and nothing else."""
    try:
        if json_text.parsed((folder / RESULTS).read_bytes())["schema"] != SCHEMA:
            return False
        kinds = {IMAGES: ".png", RENDERS: ".exr"}
        return all(
            (path.is_file() and path.name in (PAGE, RESULTS))
            or (path.is_dir() and path.name in kinds and _holds_only(path, kinds[path.name]))
            for path in folder.iterdir()
        )
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _holds_only(folder: Path, suffix: str) -> bool:
    return all(path.is_file() and path.suffix == suffix for path in folder.iterdir())
