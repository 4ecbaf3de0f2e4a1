"""The files that this process and a renderer in another one share: levels, meshes and frames."""

from __future__ import annotations

import json
import math
import mmap
import os
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import OutputError, RendererError
from mipbake.base.leftovers import tidy
from mipbake.base.publish import reason
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.fitting.program import ARRAYS, Frame
from mipbake.fitting.renderer import Array, Levels
from mipbake.source.gltf.container import packed

_MEMORY = Path("/dev/shm")
"""Where files of Linux lie in memory."""

_ROOM = 4 << 30
"""Bytes that must be free there: more than the maps of 8192 texels a side take."""

_MESHES = 512
"""Meshes whose files are kept for later views."""

_ATTRIBUTES = ("POSITION", "NORMAL", "TEXCOORD_0", "TANGENT")
_FLOAT, _UINT = 5126, 5125  # component types, section 3.6.2.2 of the specification of glTF 2.0


class Exchange:
    """The files of one program, in a folder that is there; best in memory."""

    def __init__(self, folder: Path) -> None:
        self.frame = folder / "frame.f32"
        self._folder = folder
        self._counts: Counter[str] = Counter()
        self._layout: object = None
        self._stamps: tuple[NDArray[np.int64], ...] | None = None
        self._map: mmap.mmap | None = None
        self._file = folder
        self._meshes: dict[Mesh, Path] = {}

    def hand(self, levels: Levels) -> dict[str, Any]:
        """Writes the texels that the program has not got, and returns what the request says of all of them.
        OutputError: there is no room."""
        widths = {name: each[0].shape[2] for name, each in levels.maps.items()}
        layout = levels.model, tuple(levels.wrap), widths, levels.sizes
        if self._map is None or layout != self._layout:
            self.close()
            self._layout, self._stamps = layout, None
            self._file = self._new("maps", "f32")
            self._map = _mapped(self._file, sum(4 * level.size for each in levels.maps.values() for level in each))
        changed, self._stamps = levels.changed(self._stamps), levels.stamps
        at = 0
        for index, parts in enumerate(changed):
            for maps in levels.maps.values():
                values = maps[index]
                out = np.frombuffer(self._map, "<f4", values.size, at).reshape(values.shape)
                for part in parts:
                    np.copyto(part.of(out), part.of(values), casting="same_kind")
                del out  # else the file could not be let go of
                at += 4 * values.size
        stack = [
            {"size": list(size), "changed": [list(part) for part in parts]}
            for size, parts in zip(levels.sizes, changed, strict=True)
        ]
        about = {"model": levels.model, "wrap": list(levels.wrap), "maps": widths, "stack": stack}
        return {**about, "file": str(self._file)}

    def mesh(self, mesh: Mesh) -> Path:
        """The file of a mesh, which is written where it is not there. OutputError: there is no room."""
        if mesh not in self._meshes:
            file = self._new("mesh", "glb")
            try:
                if len(self._meshes) >= _MESHES:
                    self._meshes.pop(next(iter(self._meshes))).unlink(missing_ok=True)
                file.write_bytes(glb_of(mesh))
            except OSError as error:
                raise OutputError(f"cannot hand a mesh to the renderer in {file}: {reason(error)}") from error
            self._meshes[mesh] = file
        return self._meshes[mesh]

    def taken(self, answer: Mapping[str, Any]) -> Frame:
        """The frame that an answer is about; its file is removed. RendererError: there is none, or it is cut short."""
        shapes = answer.get("arrays")
        if not isinstance(shapes, dict) or "image" not in shapes:
            raise RendererError('the frame of the renderer shows nothing: expected an object "arrays" with an image')
        try:
            numbers = np.fromfile(self.frame, "<f4").astype(np.float32, copy=False)
        except OSError as error:
            raise RendererError(
                f"the frame of the renderer cannot be read ({error.strerror or error}): expected the file "
                f"{self.frame}, complete before the answer"
            ) from error
        finally:
            with suppress(OSError):
                self.frame.unlink()
        found: dict[str, Array] = {}
        at = 0
        for name, shape in shapes.items():
            if not isinstance(shape, list) or not all(type(each) is int and each >= 0 for each in shape):
                raise RendererError(
                    f"the renderer gave {name} of its frame the shape {shape!r}: expected whole numbers"
                )
            count = math.prod(shape)
            if at + count > numbers.size:
                raise RendererError(
                    f"the frame that the renderer wrote is cut short: expected {4 * count} bytes of {name} from byte "
                    f"{4 * at} on, found {4 * numbers.size} bytes"
                )
            if name in ARRAYS:
                found[name] = numbers[at : at + count].reshape(shape)
            at += count
        return Frame(found["image"], *(found.get(name) for name in ARRAYS[1:]))

    def close(self) -> None:
        """Lets go of the file of the maps. Twice is once."""
        if self._map is not None:
            with suppress(BufferError):  # an error still holds what it was about to write; it goes with that
                self._map.close()
            self._map = None
            with suppress(OSError):  # a program may still hold it, where systems mind that
                self._file.unlink()

    def _new(self, what: str, suffix: str) -> Path:
        self._counts[what] += 1
        return self._folder / f"{what}-{self._counts[what]}.{suffix}"


def _mapped(file: Path, size: int) -> mmap.mmap:
    """A new file of zeros, mapped into memory, which takes its room on the disk at once: a page that finds none later
    would end the process."""
    try:
        with file.open("w+b") as opened:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(opened.fileno(), 0, size)
            else:
                opened.write(bytes(size))
                opened.flush()
            return mmap.mmap(opened.fileno(), size)
    except OSError as error:
        raise OutputError(f"cannot hand levels to the renderer in {file}: {reason(error)}") from error


def place() -> Path:
    """Beside which path a folder for the exchange is made: in memory where there is room, or among temporary files.

    What killed processes left there is removed.
    """
    found = Path(tempfile.gettempdir())
    if sys.platform == "linux":
        with suppress(OSError):
            if shutil.disk_usage(_MEMORY).free >= _ROOM:
                with tempfile.TemporaryFile(dir=_MEMORY):  # there may be room, and no permission
                    found = _MEMORY
    tidy(found / "mipbake-fit")
    return found / "mipbake-fit"


def glb_of(mesh: Mesh) -> bytes:
    """A mesh as a GLB file: one node without a transform, one primitive with indices, all numbers of 32 bits."""
    arrays: list[NDArray[Any]] = [np.asarray(mesh.triangles, "<u4").reshape(-1)]
    arrays += [np.asarray(each, "<f4") for each in (mesh.positions, mesh.normals, mesh.uv, mesh.tangents)]
    accessors: list[dict[str, Any]] = []
    views, data = [], b""
    for index, array in enumerate(arrays):
        component, kind = (_FLOAT, f"VEC{array.shape[1]}") if index else (_UINT, "SCALAR")
        accessors.append({"bufferView": index, "componentType": component, "count": len(array), "type": kind})
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        data += array.tobytes()
    accessors[1] |= {"min": arrays[1].min(0).tolist(), "max": arrays[1].max(0).tolist()}
    attributes = {name: index for index, name in enumerate(_ATTRIBUTES, 1)}
    document = {
        "asset": {"version": "2.0", "generator": "mipbake"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"name": mesh.name, "primitives": [{"attributes": attributes, "indices": 0, "mode": 4}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    return packed(json.dumps(document).encode(), data)
