"""The renderer `three`: three.js in headless Chromium, a shader that nobody would differentiate.

three.js is not a part of mipbake: npm brings it. A page in `three_page` draws with it. The page asks a server in this
process for jobs, which `page.js` says the bytes of, and sends back what it drew. Only processes of this machine reach
the server, and only who knows the address, which holds a secret.
"""

from __future__ import annotations

import json
import os
import queue
import secrets
import shutil
import struct
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import RendererError, UsageError
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.fitting.program import Frame, SharedMaps, serve
from mipbake.fitting.protocol import check_model, view_of
from mipbake.fitting.renderer import write_bytes

THREE = "0.187.0"
"""The version of the npm package `three` that this was tried with."""

MATERIALS = ("physical", "cloth", "standard")
"""What the material has beside the maps. `physical`: clear coat over iridescence. `cloth`: sheen. `standard`: nothing.
`three_page/scene.js` has the numbers."""

_CHROMIUM = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)
_FLAGS = (
    "--headless=new",
    "--use-angle=swiftshader",  # on the processor: no GPU and no driver has a say in the picture
    "--enable-unsafe-swiftshader",
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
_ROLES: Mapping[str, Mapping[str, int]] = {
    "base_color": {"base_color": 0},
    "normal": {"normal": 0},
    "orm": {"roughness": 1, "metallic": 2},
    "anisotropy": {"anisotropy_direction": 0, "anisotropy_strength": 2},
}
"""Textures of three.js to the maps in them, each with its first channel there."""

_KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript"}
_IDLE_SECONDS = 20.0  # until the page asks again; a guess that is well below every limit of a browser


class ThreeRenderer:
    """Renders levels on a mesh with three.js: MeshPhysicalMaterial under directional lights, linear, not tone mapped.

    Maps are rounded to 8 bits a channel, as files are, and looked up trilinearly. Both sides of a triangle are drawn.

    Args:
        material: one of MATERIALS.
    """

    def __init__(self, material: str) -> None:
        self._material = material
        self._jobs: queue.Queue[bytes] = queue.Queue()
        self._results: queue.Queue[bytes | str] = queue.Queue()
        self._meshes: dict[Mesh, int] = {}
        self._shape: object = None
        self._where: dict[str, NDArray[np.float32]] = {}
        self._chromium: subprocess.Popen[bytes] | None = None

    def start(self, folder: str) -> str:
        """Starts Chromium, which keeps its files in a folder, and returns what this is called.

        Raises:
            UsageError: three.js or Chromium is missing, or there is no such material.
            RendererError: Chromium does not start, or three.js does not start in it.
        """
        if self._material not in MATERIALS:
            raise UsageError(f"three.js has no material {self._material!r} here: expected {', '.join(MATERIALS)}")
        root = f"/{secrets.token_urlsafe()}/"
        own = {"root": root, "three": three_folder(), "jobs": self._jobs, "results": self._results}
        handler = type("Handler", (_Handler,), own)
        server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}{root}page.html"
        command = [_program(), *_FLAGS, f"--user-data-dir={folder}/profile", address]
        try:
            self._chromium = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=sys.stderr)
        except OSError as error:
            raise RendererError(f"{command[0]} does not start ({error}): expected Chromium") from error
        threading.Thread(target=self._watch, args=[self._chromium], daemon=True).start()
        self._answer()  # the page is ready
        return f"three ({self._material})"

    def render(self, maps: SharedMaps, content: dict[str, Any]) -> Frame:
        """The frame of a view, with `lod` and `id`.

        The level of detail is the one that WebGL took, because a texture whose levels hold their numbers tells it. It
        is log2 of the longer one of the two steps, in texels of level 0, from a pixel to its neighbours to the right
        and above. A footprint whose steps are not at right angles has a longer axis than that, so what mipbake itself
        looks up is up to half a level coarser.

        Raises:
            UsageError: a model that glTF does not have.
            RendererError: the page failed.
        """
        view, sizes = view_of(content), maps.sizes
        check_model("three", maps.model)
        roles = [role for role, own in _ROLES.items() if set(own) <= set(maps.maps)]
        shape = maps.model, sizes, maps.wrap
        changed = [(level, *part) for level, parts in enumerate(maps.changed) for part in parts]
        arrays: dict[str, NDArray[Any]] = {
            f"{role} {index}": _texels(maps, part, role) for index, part in enumerate(changed) for role in roles
        }
        if (mesh := view.mesh) not in self._meshes:
            attributes = {"position": mesh.positions, "normal": mesh.normals, "uv": mesh.uv, "tangent": mesh.tangents}
            arrays |= {name: values.astype(np.float32) for name, values in attributes.items()}
            arrays["index"] = mesh.triangles.astype(np.uint32)
            self._meshes[mesh] = len(self._meshes)
        # Where pixels look up is the same whatever the texels are. Views that are moved for references come once.
        key = str((content, shape))
        where = self._where.get(key)
        eye = view.camera.view_matrix()
        projection = view.matrix() @ np.linalg.inv(eye)  # the offset is in it
        header = {
            "size": view.size,
            "view": eye.T.ravel().tolist(),
            "projection": projection.T.ravel().tolist(),
            "lights": np.concatenate([view.lighting.direction, view.lighting.radiance], -1).tolist(),
            "mesh": self._meshes[mesh],
            "fresh": shape != self._shape,
            "sizes": sizes,
            "wrap": maps.wrap,
            "roles": roles,
            "changed": changed,
            "material": self._material,
            "where": where is None,
        }
        self._shape = shape
        self._jobs.put(_packed(header, arrays))
        image, *rest = np.frombuffer(self._answer(), "<f4").reshape(-1, *view.size, 4)[:, ::-1]  # rows from the top
        if where is None:
            [where] = rest
            if view.offset == (0.0, 0.0):
                self._where[key] = where
        return Frame(image[..., :3], where[..., :2], lod=where[..., 2], id=where[..., 3])

    def close(self) -> None:
        """Ends Chromium."""
        if self._chromium is not None:
            self._chromium.kill()
            self._chromium.wait()

    def _watch(self, chromium: subprocess.Popen[bytes]) -> None:
        self._results.put(f"Chromium ended with status {chromium.wait()}")

    def _answer(self) -> bytes:
        """What the page sends."""
        found = self._results.get()
        if isinstance(found, str):
            raise RendererError(found)
        return found


class _Handler(BaseHTTPRequestHandler):
    """Serves the page and three.js, and passes jobs and results on.

    Args:
        root: how all paths begin. three: the folder of three.js.
        jobs: for the page. results: what it sends; a text where there will be none.
    """

    root: str
    three: Path
    jobs: queue.Queue[bytes]
    results: queue.Queue[bytes | str]
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # else small answers wait for 40 ms

    def do_GET(self) -> None:
        """The page, its scripts, and three.js's."""
        folder, _, name = self._asked_for().rpartition("/")
        place = {"": files("mipbake.fitting") / "three_page", "three": self.three}.get(folder)
        known = place is not None and Path(name).suffix in _KINDS and "\\" not in name
        if place is None or not known or not (file := place / name).is_file():
            self._send(404, b"")
        else:
            self._send(200, file.read_bytes(), _KINDS[Path(name).suffix])

    def do_POST(self) -> None:
        """`next` brings a result, if there is one, and gets a job, if there is one; `error` and `note` bring words."""
        body, path = self.rfile.read(int(self.headers.get("Content-Length", 0))), self._asked_for()
        status, answer = 200, b""
        if path == "next":
            if body:
                self.results.put(body)
            with suppress(queue.Empty):
                answer = self.jobs.get(timeout=_IDLE_SECONDS)
        elif path == "error":
            self.results.put(f"the page of three.js failed ({_words(body)})")
        elif path == "note":
            print(_words(body), file=sys.stderr, flush=True)
        else:
            status = 404
        self._send(status, answer)

    def log_message(self, format: str, *args: Any) -> None:
        """Nobody reads it."""

    def _asked_for(self) -> str:
        return self.path[len(self.root) :] if self.path.startswith(self.root) else "no such file"

    def _send(self, status: int, body: bytes, kind: str = "application/octet-stream") -> None:
        self.send_response(status)
        for name, value in (("Content-Type", kind), ("Content-Length", len(body)), ("Cache-Control", "no-store")):
            self.send_header(name, str(value))
        self.end_headers()
        self.wfile.write(body)


def three_folder() -> Path:
    """The folder `build` of the npm package three, where Node would find it: in the nearest `node_modules` from the
    working folder up, or in a folder that the environment variable NODE_PATH names.

    Raises:
        UsageError: there is none.
    """
    here = Path.cwd()
    others = [Path(each) for each in os.environ.get("NODE_PATH", "").split(os.pathsep) if each]
    for modules in (*(folder / "node_modules" for folder in (here, *here.parents)), *others):
        if (modules / "three/build/three.module.js").is_file():
            return (modules / "three/build").resolve()
    raise UsageError(
        f"three.js is missing ({here / 'node_modules/three'} is no folder): type `npm install three@{THREE}` in the "
        "working folder, or let NODE_PATH name another folder node_modules"
    )


def _program() -> str:
    for name in _CHROMIUM:
        found = shutil.which(name)
        if found:
            return found
    raise UsageError(
        f"three.js runs in Chromium, and none of {', '.join(_CHROMIUM)} is a program here: install Chromium or Chrome "
        "(on Debian: apt-get install chromium)"
    )


def _words(body: bytes) -> str:
    return " ".join(body.decode("utf-8", "replace").split())


def _texels(maps: SharedMaps, part: tuple[int, int, int, int, int], role: str) -> NDArray[np.uint8]:
    """(H, W, 4) bytes of a part (level, row, column, height, width) of a texture: what files of 8 bits hold."""
    level, row, column, height, width = part
    texels = np.full((height, width, 4), 255, np.uint8)
    for name, first in _ROLES[role].items():
        write_bytes(texels[..., first:], maps.maps[name][level][row : row + height, column : column + width])
    return texels


def _packed(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    listed = [(name, str(values.dtype), values.size) for name, values in arrays.items()]
    text = json.dumps({**header, "arrays": listed}).encode()
    text += b" " * (-(4 + len(text)) % 8)
    return b"".join([struct.pack("<I", len(text)), text, *(np.ascontiguousarray(v).data for v in arrays.values())])


def main() -> None:
    """The program: its argument is the material, the first of MATERIALS without one."""
    renderer = ThreeRenderer(sys.argv[1] if sys.argv[1:] else MATERIALS[0])
    try:
        serve(renderer.render, renderer.start)
    finally:
        renderer.close()
