"""Puts the page together: web/dist/site, a folder of files that any server hands out as they are.

python web/page_build.py     after web/build.py, with mipbake installed, which has the viewer
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from pathlib import Path

WEB = Path(__file__).resolve().parent
SITE = WEB / "dist" / "site"

_BAKES = (".wasm", ".json", ".safetensors")


def assemble(site: Path = SITE) -> None:
    """Writes the site: the page, the viewer, the bakes and what they are compiled to."""
    from mipbake.comparing.viewer import viewer_module, viewer_style

    shutil.rmtree(site, ignore_errors=True)
    shutil.copytree(WEB / "page", site, ignore=shutil.ignore_patterns("server_baker.js"))
    (site / "src").mkdir()
    for file in imported(WEB / "src" / "index.js"):
        shutil.copy(file, site / "src")
    (site / "dist").mkdir()
    for file in WEB.joinpath("dist").iterdir():
        if file.suffix in _BAKES:
            shutil.copy(file, site / "dist")
    (site / "viewer.js").write_text(viewer_module(), encoding="utf-8")
    (site / "viewer.css").write_text(viewer_style(), encoding="utf-8")
    _keep_offline(site)


def imported(module: Path) -> set[Path]:
    """A module, and all from beside it that it imports or starts as a worker."""
    found, left = set[Path](), [module]
    while left:
        file = left.pop()
        if file not in found:
            found.add(file)
            names = re.findall(r"(?:from |URL\()'\./([\w.]+)'", file.read_text(encoding="utf-8"))
            left += [module.parent / name for name in names]
    return found


def _keep_offline(site: Path) -> None:
    """Tells the service worker what the page loads, and names its cache after all of it."""
    worker = site / "sw.js"
    files = sorted(file for file in site.rglob("*") if file.is_file() and file != worker)
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]
    names = json.dumps(["./", *(file.relative_to(site).as_posix() for file in files if file.name != "index.html")])
    text = worker.read_text(encoding="utf-8")
    filled = text.replace("const VERSION = '', FILES = [];", f"const VERSION = 'mipbake {digest}', FILES = {names};")
    if filled == text:
        raise AssertionError(f"{worker} has no place for its files")
    worker.write_text(filled, encoding="utf-8")


if __name__ == "__main__":
    assemble()
