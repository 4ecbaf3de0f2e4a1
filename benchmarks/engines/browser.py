"""Headless Chromium with a software WebGL 2, and a server of local folders to load pages from."""

from __future__ import annotations

import base64
import shutil
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).parent
MODULES = HERE / "node_modules"

_FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
_MINUTES = 60_000.0


class _Folders(SimpleHTTPRequestHandler):
    """Serves each folder under its name."""

    extensions_map = {  # noqa: RUF012  the base class has it so
        **SimpleHTTPRequestHandler.extensions_map,
        ".js": "text/javascript",
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
        ".ktx2": "image/ktx2",
        ".glb": "model/gltf-binary",
    }

    def __init__(self, folders: Mapping[str, Path], *arguments: Any) -> None:
        self._folders = folders
        super().__init__(*arguments)

    def translate_path(self, path: str) -> str:
        first, _, rest = unquote(path.partition("?")[0]).lstrip("/").partition("/")
        folder = self._folders.get(first)
        found = (folder / rest).resolve() if folder else None
        inside = folder is not None and found is not None and found.is_relative_to(folder.resolve())
        return str(found) if inside else str(HERE / "no such file")

    def log_message(self, format: str, *args: Any) -> None:
        pass


@contextmanager
def served(folders: Mapping[str, Path]) -> Iterator[str]:
    """The address of a server that shows each folder under its name; it ends with the block."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Folders, folders))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def opened(page: Path, files: Path) -> Iterator[Any]:
    """A page of playwright's with what `page` shows, once its script has set `window.proof`.

    Args:
        page: an .html file in this folder, which is served as `/engines/`, npm packages and all.
        files: a folder, served as `/files/`.

    Raises:
        RuntimeError: Chromium or the npm packages are missing, or the page complained: with every error.
    """
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None or not MODULES.is_dir():
        missing = "Chromium" if chromium is None else f"{MODULES}: run `npm ci` in {HERE}"
        raise RuntimeError(f"no {missing}")
    complaints: list[str] = []
    with served({"engines": HERE, "files": files}) as address, sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=_FLAGS)
        shown = browser.new_page()
        shown.set_default_timeout(2 * _MINUTES)
        shown.on("pageerror", lambda error: complaints.append(str(error)))
        shown.on("console", lambda m: complaints.append(m.text) if m.type == "error" else None)
        try:
            shown.goto(f"{address}/engines/{page.relative_to(HERE).as_posix()}")
            shown.wait_for_function("() => window.proof !== undefined")
            yield shown
        except Exception as error:
            raise RuntimeError("\n".join([*complaints, str(error)])) from error
        finally:
            browser.close()
    if complaints:
        raise RuntimeError("the page complained: " + "\n".join(complaints))


def exit_code(complaints: Sequence[str]) -> int:
    """1, and prints them, where there are complaints."""
    for complaint in complaints:
        print(f"error: {complaint}", file=sys.stderr)
    return int(bool(complaints))


def numbers(text: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """What a page returned as the base64 of float64 numbers."""
    return np.frombuffer(base64.b64decode(text), np.float64).reshape(shape)
