"""The server of `mipbake gui`: the page, and what it asks for, on this computer alone.

Threads answer requests. What reads and bakes texture sets is work for the main thread, one piece after the other: there
Ctrl-C ends it, and what is half-written goes.
"""

from __future__ import annotations

import json
import queue
import shutil
import sys
import threading
from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, NoReturn
from urllib.parse import parse_qs, urlsplit

from mipbake.base.errors import InputError, MipbakeError
from mipbake.cli.gui_bakes import Bench, Tell
from mipbake.comparing.viewer import viewer_module, viewer_style
from mipbake.source.options import MapChoice
from mipbake.stack.presets import PRESETS

HERE = "127.0.0.1"

_PAGES = "page"
"""What the build calls the folder web/page in the package."""

_RESULT = "/api/result/"

_TYPES = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
    ".zip": "application/zip",
    ".glb": "model/gltf-binary",
}
_HEADERS = {
    "Connection": "close",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_MOST_JSON = 1 << 20
_LOOK_UP = 0.2  # seconds after which the main thread looks up from waiting: Windows hears Ctrl-C only then
_ROUGH = 0.5  # where there is no map, which a set cannot do without
_STEP = 0.01  # of progress that is worth a message

Message = dict[str, Any]


class _GoneError(Exception):
    """The page does not wait for an answer any more."""


class Server(ThreadingHTTPServer):
    """Serves the page on a free port of this computer, or on the port that is given."""

    daemon_threads = True

    def __init__(self, bench: Bench, port: int = 0) -> None:
        self.bench = bench
        self.work: queue.Queue[Callable[[], None]] = queue.Queue()
        self.pages = files(f"mipbake.{_PAGES}")
        super().__init__((HERE, port), _Handler)

    @property
    def url(self) -> str:
        """Of the page."""
        return f"http://{HERE}:{self.server_port}/"

    def run(self) -> NoReturn:
        """Serves, until a signal raises an exception. For the main thread, which does the work."""
        threading.Thread(target=self.serve_forever, daemon=True).start()
        try:
            while True:
                try:
                    work = self.work.get(timeout=_LOOK_UP)
                except queue.Empty:
                    continue
                work()
        finally:
            self.shutdown()
            self.server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that went away needs no answer, and nobody needs to know."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)

    def ask(self, act: Callable[[Tell], Message], send: Callable[[Message], None]) -> None:
        """Has something done by the main thread, and sends what it tells and returns, a message each."""
        told: queue.Queue[Message | None] = queue.Queue()
        gone = threading.Event()
        last: list[Any] = [None, 0.0]  # phase and share

        def tell(phase: str, share: float) -> None:
            if gone.is_set():
                raise _GoneError
            if phase != last[0] or abs(share - last[1]) >= _STEP:
                last[:] = phase, share
                told.put({"phase": phase, "share": share})

        def work() -> None:
            try:
                if not gone.is_set():
                    told.put({"done": act(tell)})
            except MipbakeError as error:
                told.put({"error": str(error)})
            except _GoneError:
                pass
            except Exception as error:
                told.put({"error": f"sorry, this is a defect ({type(error).__name__}: {error}); please report it"})
            finally:
                told.put(None)

        self.work.put(work)
        try:
            while (message := told.get()) is not None:
                send(message)
        except OSError:
            gone.set()


class _Handler(BaseHTTPRequestHandler):
    """One connection."""

    server: Server
    protocol_version = "HTTP/1.1"  # which says where an answer of unknown length ends
    timeout = 60  # of a connection on which nothing happens

    def log_message(self, format: str, *args: Any) -> None:
        """Says nothing in the terminal."""

    def do_GET(self) -> None:
        """The page, its parts, and the file of a result."""
        if not self._allowed():
            return
        path = urlsplit(self.path).path
        if path == "/api/start":
            given = self.server.bench.given
            engines = [[name, preset.engine] for name, preset in PRESETS.items()]
            self._send_json({"presets": engines, "source": None if given is None else given.name})
        elif path.startswith(_RESULT):
            self._send_result(path.removeprefix(_RESULT))
        else:
            self._send_page(path.lstrip("/") or "index.html")

    def do_POST(self) -> None:
        """Files, and what is to be done with them."""
        if not self._allowed(posted=True):
            return
        parts = urlsplit(self.path)
        actions: dict[str, Callable[[], None]] = {
            "/api/clear": self._clear,
            "/api/file": partial(self._file, parts.query),
            "/api/sets": self._sets,
            "/api/bake": partial(self._bake, self.server.bench.bake),
            "/api/plain": partial(self._bake, self.server.bench.plain),
        }
        action = actions.get(parts.path)
        if action is None:
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such page")
        else:
            action()

    def _allowed(self, posted: bool = False) -> bool:
        """Whether a request comes from the page itself: another page has another origin, and a name that leads here
        from elsewhere is another host."""
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        ours = [f"{name}:{self.server.server_port}" for name in (HERE, "localhost")]
        if host in ours and (origin == f"http://{host}" if posted or origin else True):
            return True
        self._refuse(HTTPStatus.FORBIDDEN, "this page answers to itself alone: open it by the address in the terminal")
        return False

    # ---- what is asked for

    def _clear(self) -> None:
        self._body()

        def clear(_: Tell) -> Message:
            self.server.bench.clear()
            return {}

        self._answer(clear)

    def _file(self, query: str) -> None:
        name = parse_qs(query).get("name", [""])[0]
        try:
            self.server.bench.add(name, self.rfile, self._length())
        except MipbakeError as error:
            self.close_connection = True  # the rest of the file may still be under way
            self._send_json({"error": str(error)})
        else:
            self._send_json({"done": {}})

    def _sets(self) -> None:
        self._body()
        self._answer(lambda _: {"sets": self.server.bench.sets()})

    def _bake(self, bake: Callable[[int, Message, Tell], Message]) -> None:
        try:
            wanted = _wanted(self._body())
        except InputError as error:
            self._send_json({"error": str(error)})
            return
        self._answer(lambda tell: bake(wanted["index"], wanted, tell))

    def _body(self) -> bytes:
        """What was posted: what nobody reads would break the connection off."""
        return self.rfile.read(min(self._length(), _MOST_JSON))

    def _length(self) -> int:
        length = self.headers.get("Content-Length", "")
        return int(length) if length.isdecimal() else 0

    # ---- answers

    def _answer(self, act: Callable[[Tell], Message]) -> None:
        """Has something done, and sends a line of JSON for each message until it is done."""
        self._head(HTTPStatus.OK, "application/x-ndjson")

        def send(message: Message) -> None:
            self._send_part(json.dumps(message, allow_nan=False).encode() + b"\n")

        self.server.ask(act, send)
        self._send_part(b"")

    def _send_part(self, content: bytes) -> None:
        """A part of an answer whose length nobody knows yet; an empty one is its end."""
        self.wfile.write(b"%x\r\n%b\r\n" % (len(content), content))

    def _send_page(self, name: str) -> None:
        pages = self.server.pages
        made = {"viewer.js": viewer_module, "viewer.css": viewer_style}
        file = pages.joinpath("server_baker.js" if name == "baker.js" else name)
        if name in made:
            self._send(made[name]().encode(), name)
        elif "/" in name or "\\" in name or name == "sw.js" or not file.is_file():
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such page")
        else:
            self._send(file.read_bytes(), name)

    def _send_result(self, kind: str) -> None:
        result = self.server.bench.results.get(kind)
        if result is None or not result.file.is_file():
            self._refuse(HTTPStatus.NOT_FOUND, "there is no result yet")
            return
        with result.file.open("rb") as file:
            size = result.file.stat().st_size
            self._head(HTTPStatus.OK, _TYPES[result.file.suffix], size)
            shutil.copyfileobj(file, self.wfile)

    def _send_json(self, content: Message) -> None:
        self._send(json.dumps(content).encode(), "")

    def _refuse(self, status: HTTPStatus, sentence: str) -> None:
        self._send(f"{sentence}\n".encode(), ".txt", status)

    def _send(self, content: bytes, name: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        suffix = name[name.rfind(".") :] if "." in name else ""
        self._head(status, _TYPES.get(suffix, "text/plain" if suffix else "application/json"), len(content))
        self.wfile.write(content)

    def _head(self, status: HTTPStatus, kind: str, size: int | None = None) -> None:
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8" if kind.startswith("text/") else kind)
        known = ("Transfer-Encoding", "chunked") if size is None else ("Content-Length", str(size))
        self.send_header(*known)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()


def _wanted(content: bytes) -> Message:
    """What the page wants to have baked. InputError for anything that it would not send."""
    try:
        given = json.loads(content)
        maps: dict[str, MapChoice] = {}
        for role, file in dict(given["maps"]).items():
            maps[str(role)] = str(file) if file is not None else _ROUGH if role == "roughness" else None
        return {
            "index": int(given["index"]),
            "maps": maps,
            "convention": str(given["convention"]),
            "preset": str(given["preset"]),
        }
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError("the page sent something that is no choice of maps: load the page again") from error
