"""What mipbake and a renderer in a process of its own say to each other: docs/fit-protocol.md, as Python."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from mipbake.base import disk, json_text
from mipbake.base.errors import InputError, MipbakeError, RendererError, UsageError
from mipbake.comparing.meshes.camera import Camera
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_gltf import read_gltf
from mipbake.fitting.program import VERSION
from mipbake.fitting.views import View
from mipbake.material import GLTF_MODELS
from mipbake.quality.environment import directional

_MEANT = re.compile(rb'\s*\{\s*"mipbake"')  # how a line begins that is meant as an answer
_UNREADABLE = "unreadable"


@dataclass(frozen=True, eq=False)
class JsonView:
    """A view that mipbake hands to the renderer and knows nothing more of.

    Args:
        content: any JSON object. "name" is what messages call the view, and "scale" which row of a table its errors
            count in, where they are texts.
        offset: how far the sampling points of all pixels are moved, (right, up) in pixels. It is added to the "offset"
            of the content, where there is one, [right, up].
    """

    content: Mapping[str, Any]
    offset: tuple[float, float] = (0.0, 0.0)

    def moved(self, right: float, up: float) -> JsonView:
        return replace(self, offset=(self.offset[0] + right, self.offset[1] + up))

    @property
    def name(self) -> str:
        return self._text("name", "view")

    @property
    def scale(self) -> str:
        return self._text("scale", "other")

    def as_json(self) -> dict[str, Any]:
        """What the renderer gets. UsageError: its content has an offset that is not two numbers."""
        own = _offset(self.content, f"the view {self.name}", UsageError)
        if self.offset == (0.0, 0.0):
            return dict(self.content)
        return {**self.content, "offset": [float(a + b) for a, b in zip(own, self.offset, strict=True)]}

    def _text(self, key: str, otherwise: str) -> str:
        found = self.content.get(key)
        return found if isinstance(found, str) and found else otherwise


def read_views(path: Path | str) -> list[JsonView]:
    """The views of a JSON file: a list of at least one object. InputError: it holds something else."""
    path = Path(path)
    expected = "a JSON list of objects, one for each view"
    try:
        found = json_text.parsed(disk.read_bytes(path, expected))
    except ValueError as error:
        raise InputError(f"{path} is not JSON ({error}): expected {expected}") from None
    if not isinstance(found, list) or not found or not all(isinstance(each, dict) for each in found):
        raise InputError(f"{path} does not hold views: expected {expected}")
    for number, each in enumerate(found):
        _offset(each, f"view {number} of {path}", InputError)
    return [JsonView(each) for each in found]


def _offset(content: Mapping[str, Any], who: str, kind: type[MipbakeError]) -> Sequence[float]:
    """The "offset" of a view of a user's own, [right, up] in pixels; an error where it is something else."""
    own = content.get("offset", (0.0, 0.0))
    if not isinstance(own, (list, tuple)) or [type(each) in (int, float) for each in own] != [True, True]:
        raise kind(f"{who} has the offset {own!r}: expected two numbers, right and up in pixels")
    return own


def view_as_json(view: Any, mesh_file: Callable[[Mesh], Path]) -> dict[str, Any]:
    """What a renderer gets of a view, whose mesh is in a file. UsageError: it is something else."""
    if isinstance(view, JsonView):
        return view.as_json()
    if not isinstance(view, View):
        raise UsageError(
            f"a renderer in a process of its own cannot get a view of the type {type(view).__name__}: expected "
            "a View or a JsonView"
        )
    camera = view.camera
    lights = zip(view.lighting.direction.tolist(), view.lighting.radiance.tolist(), strict=True)
    return {
        "name": view.name,
        "scale": view.scale,
        "size": [int(side) for side in view.size],
        "offset": [float(side) for side in view.offset],
        "camera": {
            **{key: [float(x) for x in getattr(camera, key)] for key in ("position", "looks_at", "up")},
            **{key: float(getattr(camera, key)) for key in ("field_of_view", "near", "far")},
            "matrix": view.matrix().tolist(),
        },
        "lights": [{"direction": direction, "radiance": radiance} for direction, radiance in lights],
        "mesh": str(mesh_file(view.mesh)),
    }


@lru_cache(4096)
def _mesh_in(file: str) -> Mesh:
    return read_gltf(Path(file))


def view_of(content: Mapping[str, Any]) -> View:
    """The view that `view_as_json` was made of, on the side of a program; the mesh of a file is always one object."""
    camera = Camera(**{key: value for key, value in content["camera"].items() if key != "matrix"})
    lights = directional("lights", *([each[key] for each in content["lights"]] for key in ("direction", "radiance")))
    height, width = content["size"]
    right, up = content["offset"]
    return View(
        content["name"], content["scale"], _mesh_in(content["mesh"]), camera, lights, (height, width), (right, up)
    )


def request_line(request: str, content: Mapping[str, Any]) -> bytes:
    """A request as the line that a program gets. UsageError: views of a user's own have something that JSON has not."""
    try:
        text = json.dumps({"mipbake": VERSION, "request": request, **content}, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise UsageError(f"the request {request} cannot be written as JSON ({error}): expected plain values") from None
    return text.encode("ascii") + b"\n"


def as_answer(line: bytes) -> dict[str, Any] | None:
    """The answer that a printed line is; None for whatever else a program prints.

    An answer that cannot be read has the key `unreadable`, which says why.
    """
    if b'"mipbake"' not in line:
        return None
    try:
        found = json_text.parsed(line)
    except ValueError as error:
        return {"mipbake": VERSION, _UNREADABLE: str(error)} if _MEANT.match(line) else None
    return found if isinstance(found, dict) and "mipbake" in found else None


def check_answer(answer: Mapping[str, Any], expected: str) -> None:
    """RendererError where an answer is not the expected one, "hello" or "frame". UsageError where the program reports
    that what it was given is of no use."""
    if _UNREADABLE in answer:
        raise RendererError(
            f"the answer of the renderer cannot be read ({answer[_UNREADABLE]}): expected one JSON object on a line, "
            "and finite numbers"
        )
    version, kind = answer["mipbake"], answer.get("answer")
    if isinstance(version, bool) or version != VERSION:
        raise RendererError(
            f"the renderer speaks version {version!r} of the protocol, and this mipbake speaks version {VERSION}: "
            f"expected a program of version {VERSION} (docs/fit-protocol.md), or another version of mipbake"
        )
    if kind == "error":
        sentence, *lines = [line for line in str(answer.get("message")).splitlines() if line.strip()] or [""]
        if answer.get("usage") is True:
            raise UsageError("\n".join([sentence, *lines]))
        raise RendererError("\n".join([f"the renderer reports an error: {sentence}", *lines]))
    if kind != expected:
        raise RendererError(f'the renderer gave the answer {kind!r}: expected "{expected}"')
    if expected == "hello" and not isinstance(answer.get("renderer"), str):
        raise RendererError('the renderer did not say its name: expected a text as "renderer" of its answer "hello"')


def check_model(renderer: str, model: str) -> None:
    """UsageError for a material model that glTF does not have: no renderer that comes with mipbake shades it."""
    if model not in GLTF_MODELS:
        raise UsageError(f"the renderer {renderer} knows no model {model!r}: expected {' or '.join(GLTF_MODELS)}")
