"""A page that draws with three.js, in a headless Chromium of its own.

The page asks a server in this process for jobs, and sends back what it drew, as plain bytes: `page.js` says how they
are laid out. Only processes of this machine reach the server, and only who knows the address, which holds a secret.
"""

from __future__ import annotations

import json
import os
import queue
import secrets
import signal
import struct
import subprocess
import threading
import time
import weakref
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import RendererError
from mipbake.base.publish import temporary_folder

__all__ = ["START_SECONDS", "Page"]

START_SECONDS = 60.0
"""How long Chromium may take to start. A guess: it takes 1 to 3 seconds on two busy cores."""

_FLAGS = (
    "--headless=new",
    "--no-sandbox",  # containers lack what the sandbox needs; the page holds nothing from elsewhere
    "--disable-dev-shm-usage",  # containers have little of it
    "--disable-gpu-watchdog",  # a picture may take longer than its patience; there is a limit here
    "--disable-quic",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-breakpad",
    "--disable-extensions",
    "--disable-sync",
    "--no-proxy-server",
    "--password-store=basic",
    "--use-mock-keychain",
)
_KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript"}
_IDLE_SECONDS = 20.0  # until the page asks again; a guess that is well below every limit of a browser
_LOOK_SECONDS = 0.2  # between two looks whether Chromium still runs
_NOTES = 10  # what the page said last, that errors quote
_HEAD = 4  # bytes of the number before a header


class Page:
    """Chromium with the page, from its start until `close`, an error, or the end of Python.

    Args:
        three: the folder with three.module.js.
        chromium: the program.
        flags: more of its flags.

    Raises:
        RendererError: Chromium does not start, or the page does not.
        OutputError: there is no room for its files.
    """

    def __init__(self, three: Path, chromium: str, flags: Sequence[str]) -> None:
        held = ExitStack()
        folder = held.enter_context(temporary_folder())
        self._exchange = _Exchange()
        self._job, secret = 0, secrets.token_urlsafe()
        self._server = _Server(("127.0.0.1", 0), partial(_Handler, self._exchange, f"/{secret}/", three))
        thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        thread.start()
        self._printed = folder / "printed.txt"
        address = f"http://127.0.0.1:{self._server.server_port}/{secret}/page.html"
        command = [chromium, *_FLAGS, *flags, f"--user-data-dir={folder}/profile", address]
        try:
            with self._printed.open("wb") as printed:
                self._process = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, stdout=printed, stderr=printed, start_new_session=True
                )
        except OSError as error:
            _end(None, self._server, held)
            raise RendererError(f"{chromium} does not start ({error}): expected Chromium") from error
        self.close = weakref.finalize(self, _end, self._process, self._server, held)
        """Ends Chromium; may be called again."""
        self.described: Mapping[str, Any] = self._answer(START_SECONDS)[0]
        """What the page says of itself: `three`, its version, and `gpu`, the device that draws."""

    def asked(
        self, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], seconds: float
    ) -> dict[str, NDArray[Any]]:
        """What comes of a job: flat arrays by name.

        Args:
            header: what to do, as JSON has it (`scene.js`).
            arrays: float32, uint32, or uint8 of a number of values that 4 divides; by name.
            seconds: how long it may take. Longer, and Chromium is stopped.

        Raises:
            RendererError: it took too long, the page failed, or Chromium is stopped. The page is closed then.
        """
        if not self.close.alive:
            raise RendererError("the renderer three is closed: expected a new one after an error, and after close()")
        self._job += 1
        self._exchange.jobs.put(_packed({**header, "job": self._job}, arrays))
        return self._answer(seconds)[1]

    def _answer(self, seconds: float) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Header and arrays of what the page sends; the page is closed where it fails."""
        try:
            header, arrays = self._awaited(seconds)
            if "error" in header:
                raise self._failed(f"three.js could not render ({' '.join(header['error'].split())})")
            return header, arrays
        except BaseException:  # an interrupted job would answer the next one
            self.close()
            raise

    def _awaited(self, seconds: float) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        until = time.monotonic() + seconds
        while True:
            left = until - time.monotonic()
            if self._exchange.errors:
                raise self._failed(f"the page of three.js failed ({self._exchange.errors[0]})")
            if self._process.poll() is not None:
                raise self._failed(f"Chromium ended with status {self._process.returncode}{self._last_printed()}")
            if left <= 0:
                what = "render" if self._job else "start"
                raise self._failed(f"three.js did not {what} within {seconds:g} seconds, so Chromium was stopped")
            try:
                return _unpacked(self._exchange.results.get(timeout=min(left, _LOOK_SECONDS)))
            except queue.Empty:
                continue

    def _failed(self, sentence: str) -> RendererError:
        notes = "; ".join(self._exchange.notes)
        return RendererError(f"{sentence}; its console says: {notes}" if notes else sentence)

    def _last_printed(self) -> str:
        lines = self._printed.read_text(encoding="utf-8", errors="replace").split("\n")
        last = [line.strip() for line in lines if line.strip()][-1:]
        return f" ({last[0]})" if last else ""


@dataclass(frozen=True, eq=False)
class _Exchange:
    """What goes between the page and who waits for it."""

    jobs: queue.Queue[bytes] = field(default_factory=queue.Queue)
    results: queue.Queue[bytes] = field(default_factory=queue.Queue)
    errors: deque[str] = field(default_factory=deque)
    notes: deque[str] = field(default_factory=lambda: deque(maxlen=_NOTES))


class _Server(ThreadingHTTPServer):
    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that was stopped leaves requests unfinished."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # else small answers wait for 40 ms

    def __init__(self, exchange: _Exchange, root: str, three: Path, *arguments: Any) -> None:
        self._exchange, self._root, self._three = exchange, root, three
        super().__init__(*arguments)

    def do_GET(self) -> None:
        """The page, its scripts, and three.js's."""
        folder, _, name = self._asked_for().rpartition("/")
        place = {"": files("mipbake.fitting.three_page"), "three": self._three}.get(folder)
        known = place is not None and Path(name).suffix in _KINDS and "\\" not in name
        if place is None or not known or not (file := place / name).is_file():
            self._send(404, b"")
        else:
            self._send(200, file.read_bytes(), _KINDS[Path(name).suffix])

    def do_POST(self) -> None:
        """`next` brings a result, if there is one, and gets a job; `told/error` and `told/note` bring words."""
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        asked = self._asked_for()
        if asked == "next":
            if body:
                self._exchange.results.put(body)
            try:
                self._send(200, self._exchange.jobs.get(timeout=_IDLE_SECONDS))
            except queue.Empty:
                self._send(200, b"")
        elif asked in ("told/error", "told/note"):
            words = self._exchange.errors if asked == "told/error" else self._exchange.notes
            words.append(" ".join(body.decode("utf-8", "replace").split()))
            self._send(200, b"")
        else:
            self._send(404, b"")

    def log_message(self, format: str, *args: Any) -> None:
        """Nobody reads it."""

    def _asked_for(self) -> str:
        return self.path[len(self._root) :] if self.path.startswith(self._root) else "no such file"

    def _send(self, status: int, body: bytes, kind: str = "application/octet-stream") -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)


def _packed(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    listed = [(name, str(values.dtype), values.size) for name, values in arrays.items()]
    text = json.dumps({**header, "arrays": listed}).encode()
    text += b" " * (-(_HEAD + len(text)) % 8)
    return b"".join([struct.pack("<I", len(text)), text, *(np.ascontiguousarray(v).data for v in arrays.values())])


def _unpacked(body: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    (length,) = struct.unpack_from("<I", body)
    header = json.loads(body[_HEAD : _HEAD + length])
    arrays, at = {}, _HEAD + length
    for name, kind, count in header["arrays"]:
        arrays[name] = np.frombuffer(body, kind, count, at)
        at += arrays[name].nbytes
    return header, arrays


def _end(process: subprocess.Popen[bytes] | None, server: _Server, held: ExitStack) -> None:
    if process is not None:
        if os.name == "posix" and process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.wait()
    server.shutdown()
    server.server_close()
    held.close()
