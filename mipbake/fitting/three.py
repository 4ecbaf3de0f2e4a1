"""three.js in headless Chromium as a renderer of `mipbake fit`: a shader that nobody would differentiate.

three.js is not a part of mipbake: npm brings it. A page in `three_page` draws with it.
"""

from __future__ import annotations

import math
import shutil
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.fitting.renderer import Array, Frame, Levels, Rectangle
from mipbake.fitting.three_page import Page
from mipbake.fitting.views import View
from mipbake.material import GLTF_MODELS

THREE = "0.187.0"
"""The version of the npm package `three` that this was tried with."""

MATERIALS = ("physical", "cloth", "standard")
"""What the material has beside the maps. `physical`: clear coat over iridescence. `cloth`: sheen. `standard`: nothing.
`three_page/scene.js` has the numbers."""

SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Flags of Chromium with which it draws on the processor: no GPU and no driver has a say in the picture."""

_CHROMIUM = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)
_ROLES: Mapping[str, Mapping[str, int]] = {
    "base_color": {"base_color": 0},
    "normal": {"normal": 0},
    "orm": {"roughness": 1, "metallic": 2},
    "anisotropy": {"anisotropy_direction": 0, "anisotropy_strength": 2},
}
"""Textures of three.js to the maps in them, each with its first channel there."""

_KEPT = 2  # stacks whose textures the page keeps: the one that is fitted, and level 0 that references are made of

_TOGETHER = 64  # renders that one request sums; what else a request costs is then little beside them. A guess


@dataclass(eq=False)
class _Set:
    """Textures that the page keeps. stamps: of the tiles that it has; None where it has none."""

    number: int
    roles: list[str]
    stamps: tuple[NDArray[np.int64], ...] | None = None


class ThreeRenderer:
    """Renders levels on a mesh with three.js: MeshPhysicalMaterial under directional lights, linear, not tone mapped.

    Maps are rounded to 8 bits a channel, as files are, and looked up trilinearly. A light's radiance of a view is the
    colour of three's DirectionalLight at intensity 1: the irradiance of a surface that faces it. Both sides of a
    triangle are drawn, and lit.

    It starts Chromium, and keeps it until `close` or the end of Python. A renderer that has raised a RendererError is
    closed. One thread at a time may use it.

    Args:
        three: the folder `build` of the npm package three. None: `node_modules/three/build` in the working folder, or
            in the nearest folder above it that has it.
        material: one of MATERIALS.
        anisotropy: most samples that an anisotropic lookup takes; 1 is a trilinear lookup.
        seconds: how long a render may take before Chromium is stopped.
        chromium: the program. None: Chromium or Chrome, where the system finds programs.
        flags: how Chromium draws. With () it takes a GPU where it finds one.

    Raises:
        UsageError: three.js or Chromium is missing, or a value is none of these.
        RendererError: Chromium does not start, or three.js does not start in it.
    """

    def __init__(
        self,
        three: Path | None = None,
        material: str = "physical",
        anisotropy: int = 1,
        seconds: float = 60.0,
        chromium: Path | None = None,
        flags: Sequence[str] = SOFTWARE,
    ) -> None:
        if material not in MATERIALS:
            raise UsageError(f"three.js has no material {material!r} here: expected one of {', '.join(MATERIALS)}")
        if anisotropy < 1 or not 0 < seconds < math.inf:
            raise UsageError(
                f"a renderer with anisotropy {anisotropy} and a limit of {seconds} seconds: expected anisotropy from 1 "
                "on, and a limit above 0"
            )
        self._material, self._anisotropy, self._seconds = material, anisotropy, seconds
        self.called = f"three ({material})"
        """What provenance calls it."""
        self._sets: dict[Any, _Set] = {}
        self._meshes: weakref.WeakKeyDictionary[Mesh, int] = weakref.WeakKeyDictionary()
        self._where: weakref.WeakKeyDictionary[View, dict[Any, Array]] = weakref.WeakKeyDictionary()
        self._count = 0
        self._page = Page(three_folder(three), _program(chromium), flags)
        self.gpu: str = self._page.described["gpu"]
        """What WebGL says of the device that draws."""

    def render(self, levels: Levels, view: View) -> Frame:
        """The frame of a view: `Frame` with `image`, `uv`, `lod` and `id`; 0 where no mesh is, and id is 1 where it is.

        The level of detail is the one that WebGL took, from 0 to the last level, because a texture whose levels hold
        their numbers tells it. It is log2 of the longer one of the two steps, in texels of level 0, from a pixel to its
        neighbours to the right and above. A footprint whose steps are not at right angles has a longer axis than that,
        so what mipbake itself looks up is up to half a level coarser.

        What does not depend on texels is rendered once for each view object. uv and lod are the same arrays from one
        call to the next, and cannot be written to.

        Raises:
            UsageError: a model that glTF does not have, or levels whose sizes do not halve.
            RendererError: it took too long, the page failed, or the renderer is closed.
        """
        known = self._where.setdefault(view, {})
        key = (tuple(levels.sizes), levels.wrap)
        found = self._drawn(levels, view, key not in known)
        if key not in known:
            known[key] = _image(found["where"], view).copy()
            known[key].flags.writeable = False
        where = known[key]
        return Frame(_rgb(found, view), where[..., :2], lod=where[..., 2], id=where[..., 3].astype(np.int32))

    def image(self, levels: Levels, view: View) -> Array:
        """(H, W, 3) float32, the image of `render` alone, rows from the top: samples of references need no more.

        Raises:
            UsageError, RendererError: as `render`.
        """
        return _rgb(self._drawn(levels, view, False), view)

    def summed(self, levels: Levels, views: Sequence[View], weights: Sequence[float]) -> tuple[Array, Array]:
        """A weighted sum of images: see `Renderer`. The page adds them up, in float32.

        One request draws many of them, and one picture is read back for all.

        Raises:
            UsageError, RendererError: as `render`; it may take as long as so many renders.
        """
        total = np.zeros((*views[0].size, 4), np.float64)
        for first in range(0, len(views), _TOGETHER):
            some = views[first : first + _TOGETHER]
            what = {
                "projections": [_camera(view)["projection"] for view in some],
                "weights": list(weights[first : first + _TOGETHER]),
            }
            total += _image(self._asked(levels, some[0], what, self._seconds * len(some))["sum"], some[0])
        found = total.astype(np.float32)
        return found[..., :3], found[..., 3]

    def close(self) -> None:
        """Ends Chromium. May be called again."""
        self._page.close()

    def __enter__(self) -> ThreeRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _drawn(self, levels: Levels, view: View, where: bool) -> Mapping[str, NDArray[Any]]:
        return self._asked(levels, view, {"where": where}, self._seconds)

    def _asked(self, levels: Levels, view: View, what: Mapping[str, Any], seconds: float) -> Mapping[str, NDArray[Any]]:
        """What the page makes of a view, in so many seconds at most; it gets what it does not have yet."""
        kept = self._set(levels)
        changed = [(level, part) for level, parts in enumerate(levels.changed(kept.stamps)) for part in parts]
        arrays: dict[str, NDArray[Any]] = {
            f"{role} {index}": _texels(levels, level, part, role)
            for index, (level, part) in enumerate(changed)
            for role in kept.roles
        }
        if view.mesh not in self._meshes:
            arrays |= _geometry(view.mesh)
            self._meshes[view.mesh] = self._numbered()
        header = {
            "size": view.size,
            "camera": _camera(view),
            "lights": np.concatenate([view.lighting.direction, view.lighting.radiance], -1).tolist(),
            "mesh": self._meshes[view.mesh],
            "meshes": list(self._meshes.values()),
            "set": kept.number,
            "sets": [each.number for each in self._sets.values()],
            "sizes": levels.sizes,
            "wrap": levels.wrap,
            "roles": kept.roles,
            "changed": [[level, *part] for level, part in changed],
            "material": self._material,
            "anisotropy": self._anisotropy,
            **what,
        }
        found = self._page.asked(header, arrays, seconds)
        kept.stamps = levels.stamps
        return found

    def _set(self, levels: Levels) -> _Set:
        """The textures that the page keeps for stacks of this shape. The oldest ones of other shapes make room."""
        key = (levels.model, tuple(levels.sizes), levels.wrap)
        kept = self._sets.pop(key, None)
        if kept is None:
            _check(levels)
            roles = [role for role, maps in _ROLES.items() if set(maps) <= set(levels.maps)]
            kept = _Set(self._numbered(), roles)
        self._sets[key] = kept
        while len(self._sets) > _KEPT:
            del self._sets[next(iter(self._sets))]
        return kept

    def _numbered(self) -> int:
        self._count += 1
        return self._count


def three_folder(three: Path | None = None) -> Path:
    """The folder `build` of the npm package three: the one that is given, or the nearest from the working folder up.

    Raises:
        UsageError: it holds no three.module.js, or there is none.
    """
    here = Path.cwd()
    places = [three] if three else [folder / "node_modules/three/build" for folder in (here, *here.parents)]
    for place in places:
        if (place / "three.module.js").is_file():
            return place.resolve()
    raise UsageError(
        f"three.js is missing ({places[0] / 'three.module.js'} is no file): type `npm install three@{THREE}` in the "
        "working folder, or name the folder node_modules/three/build of another place"
    )


def _program(chromium: Path | None) -> str:
    for name in (str(chromium),) if chromium else _CHROMIUM:
        found = shutil.which(name)
        if found:
            return found
    raise UsageError(
        f"three.js runs in Chromium, and {chromium or 'none of ' + ', '.join(_CHROMIUM)} is a program here: install "
        "Chromium or Chrome (on Debian: apt-get install chromium), or name its program"
    )


def _check(levels: Levels) -> None:
    if levels.model not in GLTF_MODELS:
        raise UsageError(f"the renderer three knows no model {levels.model!r}: expected {' or '.join(GLTF_MODELS)}")
    height, width = levels.sizes[0]
    wanted = [(max(1, height >> level), max(1, width >> level)) for level in range(len(levels.sizes))]
    if levels.sizes != wanted:
        raise UsageError(f"levels measure {levels.sizes}: expected {wanted}, each half of the one before")


def _geometry(mesh: Mesh) -> dict[str, NDArray[Any]]:
    attributes = {"position": mesh.positions, "normal": mesh.normals, "uv": mesh.uv, "tangent": mesh.tangents}
    return {name: values.astype(np.float32) for name, values in attributes.items()} | {
        "index": mesh.triangles.astype(np.uint32)
    }


def _camera(view: View) -> dict[str, list[float]]:
    """Matrices, a column at a time. The projection holds the offset."""
    eye = view.camera.view_matrix()
    projection = view.matrix() @ np.linalg.inv(eye)
    return {"view": eye.T.ravel().tolist(), "projection": projection.T.ravel().tolist()}


def _texels(levels: Levels, level: int, part: Rectangle, role: str) -> NDArray[np.uint8]:
    """(H, W, 4) bytes of a part of a level of a texture: what files of 8 bits hold."""
    texels = np.full((part.height, part.width, 4), 255, np.uint8)
    for name, first in _ROLES[role].items():
        values = np.asarray(part.of(levels.maps[name][level]), np.float32)
        for channel in range(values.shape[-1]):  # at a time, which NumPy is quicker at than at short vectors
            scaled = values[..., channel] * np.float32(255) + np.float32(0.5)
            texels[..., first + channel] = np.clip(scaled, 0, 255, out=scaled)  # the integer below
    return texels


def _rgb(found: Mapping[str, NDArray[Any]], view: View) -> Array:
    return np.asarray(_image(found["image"], view)[..., :3].copy(), np.float32)


def _image(values: NDArray[Any], view: View) -> NDArray[Any]:
    """(H, W, channels), rows from the top."""
    return values.reshape(*view.size, -1)[::-1]
