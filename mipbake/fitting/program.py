"""The renderer's side of docs/fit-protocol.md, for programs in Python, such as Blender or Unreal. That page has an
example. This file may be copied out: it needs NumPy alone.
"""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

VERSION = 2
"""Of the protocol."""

ARRAYS = ("image", "uv", "lod", "uv_da", "id")
"""What a frame may hold."""


@dataclass(frozen=True, eq=False)
class SharedMaps:
    """A MIP stack to render with.

    Args:
        model: name of the material model.
        maps: name of each map to its levels, finest first: (H_L, W_L, channels) float32, encoded as 8-bit files are,
            from 0 to 1. They cannot be written to, and their values change after the call.
        wrap: addressing along u and v, each "wrap" or "clamp".
        changed: for each level rectangles (row, column, height, width) of texels that may be others than at the call
            before. All texels are where this is the first call, or other maps or sizes came before.
    """

    model: str
    maps: Mapping[str, Sequence[Any]]
    wrap: tuple[str, str]
    changed: Sequence[Sequence[tuple[int, int, int, int]]]

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(height, width) of each level."""
        return [level.shape[:2] for level in next(iter(self.maps.values()))]


@dataclass(frozen=True, eq=False)
class Frame:
    """What a renderer made of a view, rows from the top.

    Args:
        image: (H, W, 3), linear radiance; or what a display gets, for fits that compare it as it is.
        uv: (H, W, 2) where the pixel's centre looked the maps up; u to the right and v down, any real numbers where
            the maps repeat.
        lod: (H, W) level of detail of a trilinear lookup; or None, then `uv_da` is given.
        uv_da: (H, W, 4) du/dX, du/dY, dv/dX, dv/dY per pixel, X to the right and Y down, of an anisotropic lookup with
            up to 16 samples along the footprint; or None.
        id: (H, W) integers from 0 to 2^24, 0 where a pixel shows nothing of the maps. None: every pixel shows them.

    Any array of numbers will do, and the renderer may use it again for the next frame. A fit checks shapes, and that
    values are finite.
    """

    image: Any
    uv: Any
    lod: Any = None
    uv_da: Any = None
    id: Any = None


def serve(
    render: Callable[[SharedMaps, dict[str, Any]], Any], name: str | Callable[[str], str] = "a program in Python"
) -> None:
    """Answers the requests on the standard input, until they end. What `render` raises is reported to mipbake.

    Args:
        render: takes the maps and the view, and gives a `Frame`, or anything with the same attributes.
        name: what messages call the program; or a function that makes it ready to render and returns this name. The
            function takes a folder for files that go when the program ends.
    """
    file, numbers = "", np.empty(0, np.float32)
    for line in iter(sys.stdin.readline, ""):
        request = json.loads(line)
        try:
            if request["mipbake"] != VERSION:
                raise RuntimeError(f"mipbake speaks version {request['mipbake']!r}, and the renderer {VERSION}")
            if request["request"] == "end":
                return
            if request["request"] == "hello":
                _answer("hello", renderer=name(request["folder"]) if callable(name) else name)
                continue
            levels = request["levels"]
            if levels["file"] != file:
                file = levels["file"]
                numbers = np.memmap(file, "<f4", "r")
            frame = render(_maps(levels, numbers), request["view"])
            found = {each: getattr(frame, each, None) for each in ARRAYS}
            arrays = {each: np.asarray(values, "<f4") for each, values in found.items() if values is not None}
            with open(request["frame"], "wb") as out:  # noqa: PTH123  opens as C does, for whoever writes the same
                for values in arrays.values():
                    out.write(np.ascontiguousarray(values).data)
            _answer("frame", arrays={each: values.shape for each, values in arrays.items()})
        except Exception as error:  # the program goes on, and mipbake decides what becomes of it
            message, code = getattr(error, "full", f"{type(error).__name__}: {error}"), getattr(error, "exit_code", 0)
            if not code:
                traceback.print_exc()
                sys.stderr.flush()
            _answer("error", message=message, usage=code == 2)


def _maps(levels: dict[str, Any], numbers: Any) -> SharedMaps:
    maps: dict[str, list[Any]] = {name: [] for name in levels["maps"]}
    at = 0
    for each in levels["stack"]:
        for name, channels in levels["maps"].items():
            shape = (*each["size"], channels)
            maps[name].append(numbers[at : at + int(np.prod(shape))].reshape(shape))
            at += int(np.prod(shape))
    changed = [[tuple(part) for part in each["changed"]] for each in levels["stack"]]
    return SharedMaps(levels["model"], maps, (levels["wrap"][0], levels["wrap"][1]), changed)


def _answer(kind: str, **content: Any) -> None:
    """Prints an answer on a line of its own, whatever the program has printed before it."""
    sys.stdout.write("\n" + json.dumps({"mipbake": VERSION, "answer": kind, **content}) + "\n")
    sys.stdout.flush()
