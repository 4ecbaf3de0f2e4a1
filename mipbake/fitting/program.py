"""The renderer's side of docs/fit-protocol.md, for programs in Python. It may be copied out: it needs NumPy alone.

A program with Python in it, as Blender or Unreal, renders for `mipbake fit` by a script such as this one:

    from mipbake.fitting.program import Rendered, serve

    def render(maps, view):
        for level, parts in enumerate(maps.changed_texels):
            for row, column, height, width in parts:
                rows, columns = slice(row, row + height), slice(column, column + width)
                for name, levels in maps.maps.items():
                    upload(name, level, row, column, levels[level][rows, columns])
        image, uv, lod = draw(view)
        return Rendered(image, uv, lod)

    serve(render, "my engine")

With the exchange "exr" it needs OpenImageIO, too.
"""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

VERSION = 1
"""Of the protocol."""

_ALIGNED = 64
"""Bytes that every array begins at a multiple of: a line of a processor's cache."""

_EXR_NAMES = {
    "image": ("R", "G", "B"),
    "uv": ("u", "v"),
    "lod": ("lod",),
    "uv_da": ("du.dX", "du.dY", "dv.dX", "dv.dY"),
    "id": ("id",),
}


@dataclass(frozen=True, eq=False)
class SharedMaps:
    """A MIP stack to render with: `mipbake.fitting.renderer.Levels`, with what is new in it.

    Args:
        model: name of the material model.
        maps: name of each map to its levels, finest first: (H_L, W_L, channels) float32, encoded as 8-bit files are,
            from 0 to 1. They cannot be written to, and their values change after the call.
        wrap: addressing along u and v, each "wrap" or "clamp".
        stamps: a number for each level, which is another one whenever the texels of that level are others.
        changed: whether the texels of each level are others than at the call before; all are at the first call.
        changed_texels: which texels of each level these are: rectangles (row, column, height, width). All others are as
            they were at the call before.
    """

    model: str
    maps: Mapping[str, Sequence[Any]]
    wrap: tuple[str, str]
    stamps: tuple[int, ...]
    changed: tuple[bool, ...]
    changed_texels: tuple[tuple[tuple[int, int, int, int], ...], ...]

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(height, width) of each level."""
        first = next(iter(self.maps.values()))
        return [(level.shape[0], level.shape[1]) for level in first]


@dataclass(frozen=True, eq=False)
class Rendered:
    """What was rendered, rows from the top: `mipbake.fitting.renderer.Frame`, which serves as well.

    Args:
        image: (H, W, 3) what is shown.
        uv: (H, W, 2) where each pixel's centre looked the maps up, v down.
        lod: (H, W) level of detail of trilinear lookups; or None, then `uv_da` is given.
        uv_da: (H, W, 4) du/dX, du/dY, dv/dX, dv/dY per pixel, X to the right and Y down, of anisotropic lookups; or
            None.
        id: (H, W) integers up to 2^24, 0 where a pixel shows nothing of the maps. None: every pixel shows them.
    """

    image: Any
    uv: Any
    lod: Any = None
    uv_da: Any = None
    id: Any = None


def serve(render: Callable[[SharedMaps, dict[str, Any]], Any], name: str = "a program in Python") -> None:
    """Answers the requests on the standard input, until they end.

    What `render` raises is told to mipbake, which then ends the program. The program may print what it likes.

    Args:
        render: takes the maps and the view, and gives a `Rendered`, or anything with the same attributes.
        name: what messages call the program.
    """
    files: Any = None
    for line in iter(sys.stdin.readline, ""):
        if not line.strip():
            continue
        request = json.loads(line)
        kind = request.get("request")
        try:
            if request.get("mipbake") != VERSION:
                raise RuntimeError(f"mipbake speaks version {request.get('mipbake')!r}, and the renderer {VERSION}")
            if kind == "end":
                return
            if kind == "hello":
                files = _MemoryFiles() if request["exchange"] == "memory" else _ExrFiles()
                _answer({"answer": "hello", "renderer": name})
            elif kind == "render":
                frame = render(files.maps(request["levels"]), request["view"])
                _answer({"answer": "frame", "id": request["id"], **files.write(request["frame"], frame)})
            else:
                raise RuntimeError(f"the renderer does not know the request {kind!r}")
        except Exception as error:  # the program goes on, and mipbake decides what becomes of it
            traceback.print_exc()
            sys.stderr.flush()
            _answer({"answer": "error", "id": request.get("id"), "message": f"{type(error).__name__}: {error}"})


class _MemoryFiles:
    """Maps and frames as raw numbers."""

    def __init__(self) -> None:
        self._name = ""
        self._numbers: Any = None

    def maps(self, told: dict[str, Any]) -> SharedMaps:
        if told["file"] != self._name:
            self._numbers = np.memmap(told["file"], "<f4", "r")
            self._name = told["file"]
        return shared_maps(told, [{name: self._array(a) for name, a in each["maps"].items()} for each in told["stack"]])

    def write(self, file: str, frame: Any) -> dict[str, Any]:
        about = {}
        with open(file, "wb") as out:  # noqa: PTH123  opens as C does, for whoever reads this to write the same
            for name, values in _arrays(frame).items():
                out.write(bytes(-out.tell() % _ALIGNED))
                about[name] = {"offset": out.tell(), "shape": list(values.shape)}
                out.write(np.ascontiguousarray(values, "<f4").data)
        return {"arrays": about}

    def _array(self, about: dict[str, Any]) -> Any:
        start = about["offset"] // 4
        return self._numbers[start : start + int(np.prod(about["shape"]))].reshape(about["shape"])


class _ExrFiles:
    """Maps and frames as EXR files."""

    def __init__(self) -> None:
        import OpenImageIO

        self._io: Any = OpenImageIO
        self._held: dict[int, dict[str, Any]] = {}

    def maps(self, told: dict[str, Any]) -> SharedMaps:
        for index, each in enumerate(told["stack"]):
            if each["changed"] or index not in self._held:
                self._held[index] = self._read(each)
        return shared_maps(told, [self._held[index] for index in range(len(told["stack"]))])

    def write(self, file: str, frame: Any) -> dict[str, Any]:
        arrays = {name: v.reshape(v.shape[0], v.shape[1], -1) for name, v in _arrays(frame).items()}
        texels = np.concatenate(list(arrays.values()), -1)
        spec = self._io.ImageSpec(texels.shape[1], texels.shape[0], texels.shape[2], "float")
        spec.channelnames = [channel for name in arrays for channel in _EXR_NAMES[name]]
        spec.attribute("compression", "none")
        out = self._io.ImageOutput.create(file)
        if out is None or not (out.open(file, spec) and out.write_image(texels) and out.close()):
            raise RuntimeError(f"cannot write {file}")
        return {}

    def _read(self, about: dict[str, Any]) -> dict[str, Any]:
        image = self._io.ImageInput.open(about["file"])
        if image is None:
            raise RuntimeError(f"cannot read {about['file']}: {self._io.geterror()}")
        texels, names = image.read_image("float"), list(image.spec().channelnames)
        image.close()
        return {name: texels[..., [names.index(c) for c in channels]] for name, channels in about["maps"].items()}


def shared_maps(told: dict[str, Any], stack: list[dict[str, Any]]) -> SharedMaps:
    """What a request tells of levels whose maps are at hand. Without rectangles in it, whole levels are changed."""
    maps = {name: [each[name] for each in stack] for name in stack[0]}
    stamps = tuple(each["stamp"] for each in told["stack"])
    changed = tuple(each["changed"] for each in told["stack"])
    changed_texels = tuple(tuple(map(tuple, _changed_texels(each))) for each in told["stack"])
    return SharedMaps(told["model"], maps, (told["wrap"][0], told["wrap"][1]), stamps, changed, changed_texels)


def _changed_texels(about: dict[str, Any]) -> Any:
    """Rectangles of a level; the whole level where an older mipbake does not tell them."""
    whole = [[0, 0, *about["size"]]] if about["changed"] else []
    return about.get("changed_texels", whole)


def _arrays(frame: Any) -> dict[str, Any]:
    """What a frame holds, by name."""
    found: dict[str, Any] = {name: getattr(frame, name, None) for name in _EXR_NAMES}
    return {name: np.asarray(values, np.float32) for name, values in found.items() if values is not None}


def _answer(content: dict[str, Any]) -> None:
    """Prints an answer on a line of its own, whatever the program has printed before it."""
    sys.stdout.write("\n" + json.dumps({"mipbake": VERSION, **content}) + "\n")
    sys.stdout.flush()
