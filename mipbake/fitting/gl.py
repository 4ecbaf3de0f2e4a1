"""The renderer `gl`: a view in OpenGL, shaded by a fragment shader that anyone may write.

It runs wherever there is OpenGL 3.3 over EGL, with a GPU or with Mesa's llvmpipe on a CPU. The user's part is one
function in GLSL 3.30. A whole one is this:

    vec3 shade(Surface s) {
        vec3 n = normalize(s.frame * (look_up(normal_map).xyz * 2.0 - 1.0));
        vec3 total = vec3(0.0);
        for (int i = 0; i < light_count; i++)
            total += max(dot(n, light_directions[i]), 0.0) * light_radiances[i];
        return look_up(base_color_map).rgb / 3.14159265 * total;
    }

What stands around it declares what the function may use:

- `struct Surface { vec2 uv; vec3 position; mat3 frame; vec3 view; }`. `uv` has v pointing down. `position` is in the
  world. `frame` takes vectors from the tangent frame to the world: its columns are t, b and n of the mesh, orthonormal,
  as glTF 2.0 defines them. `view` is a unit vector to the camera, in the world.
- `uniform sampler2D` for each map: `base_color_map` (rgb, linear once it is looked up), `metallic_map` (r),
  `roughness_map` (r) and `normal_map` (xyz as (n + 1) / 2). `gltf-anisotropic` also has `anisotropy_direction_map` (rg
  as (d + 1) / 2) and `anisotropy_strength_map` (r).
- `vec4 look_up(sampler2D map)`: the map at this pixel, trilinearly, at the level of detail that a fit is told.
- `uniform int light_count` and `uniform vec3 light_directions[MAX_LIGHTS], light_radiances[MAX_LIGHTS]`. Directions are
  unit vectors to the light, in the world. A radiance is the irradiance of a surface that faces the light.

Names that begin with `mipbake_` belong to what stands around. The `#version` line is written there, too.

`look_up` is recommended. `texture(map, s.uv)` works, as an engine has it, but a driver may choose its level of detail:
llvmpipe has one for every 2 x 2 pixels, and takes the longer derivative for the longer axis. Gradients then go to the
wrong share of levels. A lookup elsewhere than at `s.uv`, as parallax mapping does, leads gradients to the wrong texels.
A `discard` would leave pixels in the picture of places that show nothing.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from importlib.resources import files
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.fitting.gl_textures import TEXELS, GlTextures, loaded_moderngl
from mipbake.fitting.renderer import Array, Frame, Levels
from mipbake.fitting.views import View
from mipbake.material import GLTF_MODELS, MODELS

MAX_LIGHTS = 64
"""Most lights of a view: as many as an environment becomes. OpenGL 3.3 promises room for fewer than 128."""

SHADERS = ("gltf", "clearcoat", "ramp")
"""Shaders that come with mipbake: the metallic-roughness model as mipbake shades it, the same under a clear coat, and a
stylised one whose light falls in steps."""

_KEPT = 4
"""Stacks of other sizes whose textures are kept: a stack and its source, twice."""

_VERTICES = """
#version 330
in vec3 position, normal;
in vec4 tangent;
in vec2 uv;
uniform mat4 mipbake_clip;
out vec3 mipbake_place, mipbake_up;
out vec4 mipbake_along;
out vec2 mipbake_uv;
invariant gl_Position;
void main() {
    mipbake_place = position;
    mipbake_up = normal;
    mipbake_along = tangent;
    mipbake_uv = uv;
    gl_Position = mipbake_clip * vec4(position, 1.0);
}
"""

# u q and q = 1 / w are linear on the screen, so their differences are derivatives, and exact whichever pixels a driver
# takes them from; differences of u are not. It holds: du/dX = (d(u q)/dX - u dq/dX) / q.
_LEVEL_OF_DETAIL = """
#version 330
#line 90001
in vec2 mipbake_uv;
uniform vec2 mipbake_size;
uniform float mipbake_last;
float mipbake_level_of_detail() {
    float q = gl_FragCoord.w;
    vec2 p = mipbake_uv * q;
    vec2 x = (dFdx(p) - mipbake_uv * dFdx(q)) / q * mipbake_size;
    vec2 y = (dFdy(p) - mipbake_uv * dFdy(q)) / q * mipbake_size;
    float sum = 0.5 * (dot(x, x) + dot(y, y)), difference = 0.5 * (dot(x, x) - dot(y, y));
    float longer = sum + length(vec2(difference, dot(x, y)));  // the larger singular value, squared
    return clamp(0.5 * log2(max(longer, 1e-30)), 0.0, mipbake_last);
}
"""

_GEOMETRY = f"""{_LEVEL_OF_DETAIL}
out vec4 mipbake_found;
void main() {{ mipbake_found = vec4(mipbake_uv, mipbake_level_of_detail(), 1.0); }}
"""

_MAPS = tuple(dict.fromkeys(name for model in GLTF_MODELS for name in MODELS[model].maps))

_BEFORE = f"""{_LEVEL_OF_DETAIL}
#define MAX_LIGHTS {MAX_LIGHTS}
struct Surface {{ vec2 uv; vec3 position; mat3 frame; vec3 view; }};
uniform sampler2D {", ".join(f"{name}_map" for name in _MAPS)};
uniform int light_count;
uniform vec3 light_directions[MAX_LIGHTS], light_radiances[MAX_LIGHTS];
uniform vec3 mipbake_eye;
in vec3 mipbake_place, mipbake_up;
in vec4 mipbake_along;
out vec4 mipbake_seen;
float mipbake_lod = 0.0;
vec4 look_up(sampler2D map) {{ return textureLod(map, mipbake_uv, mipbake_lod); }}
#line 1
"""

_AFTER = """
#line 90101
void main() {
    mipbake_lod = mipbake_level_of_detail();
    vec3 n = normalize(mipbake_up), t = normalize(mipbake_along.xyz - dot(mipbake_along.xyz, n) * n);
    vec3 b = sign(mipbake_along.w) * cross(n, t), view = normalize(mipbake_eye - mipbake_place);
    mipbake_seen = vec4(shade(Surface(mipbake_uv, mipbake_place, mat3(t, b, n), view)), 1.0);
}
"""


def shipped_shader(name: str) -> str:
    """GLSL of a shader in `SHADERS`; UsageError, with the list of names, where there is none."""
    if name not in SHADERS:
        raise UsageError(f"no shader is called {name!r}: expected one of {', '.join(SHADERS)}")
    return (files("mipbake.fitting") / "shaders" / f"{name}.glsl").read_text(encoding="utf-8")


class GlRenderer:
    """Renders views with a fragment shader of the user's. It belongs to the thread that made it.

    Textures, meshes and pictures of the same sizes stay where they are from one call to the next.

    Args:
        shader: GLSL that defines `vec3 shade(Surface s)`, as the module says.
        texels: "rgba8", which rounds maps to 8 bits as files hold them, or "rgba32f", which does not. Lookups are
            equally precise with either.
        name: what messages call the shader: the path of its file.

    Raises:
        UsageError: moderngl or OpenGL 3.3 over EGL is missing, the shader does not compile, or no such texels.
    """

    def __init__(self, shader: str, texels: str = "rgba8", name: str = "the shader") -> None:
        if texels not in TEXELS:
            raise UsageError(f"no texels are called {texels!r}: expected one of {', '.join(TEXELS)}")
        self._texels, self._name = texels, name
        self.called = f"gl ({name})"
        """What provenance calls it."""
        self._context = _context()
        self._textures: dict[Any, GlTextures] = {}
        self._meshes: dict[Mesh, dict[str, Any]] = {}
        self._framebuffers: dict[tuple[int, int], Any] = {}
        self._looked: WeakKeyDictionary[View, dict[Any, tuple[NDArray[Any], ...]]] = WeakKeyDictionary()
        try:
            with self._context:
                geometry = self._context.program(_VERTICES, _GEOMETRY)
                self._programs = {"geometry": geometry, "image": self._compiled(shader)}
        except UsageError:
            self.close()
            raise

    def close(self) -> None:
        """Gives all memory of the driver back. Nothing can be rendered after it."""
        self._context.release()

    def render(self, levels: Levels, view: View) -> Frame:
        """The frame of a view: `Frame` with `image`, `uv`, `lod` and `id`.

        What does not depend on texels, which is all but the image, is rendered once for each view object. These arrays
        are the same ones from one call to the next, and cannot be written to.

        Raises:
            UsageError: a model that glTF does not have, a map that the shader looks up and the model does not have,
                levels whose sizes do not halve, or more than 64 lights.
        """
        image = self.image(levels, view)
        looked, key = self._looked.setdefault(view, {}), (levels.sizes[0], len(levels.sizes))
        if key not in looked:
            with self._context:
                found = self._drawn("geometry", levels, view)
            looked[key] = found[..., :2].copy(), found[..., 2].copy(), found[..., 3].astype(np.int32)
            for array in looked[key]:
                array.flags.writeable = False
        uv, lod, index = looked[key]
        return Frame(image, uv, lod=lod, id=index)

    def image(self, levels: Levels, view: View) -> Array:
        """(H, W, 3) float32, rows from the top: the image of `render` alone, as references need no more.

        Raises:
            UsageError: as `render`.
        """
        self._check(levels, view)
        program = self._programs["image"]
        with self._context:
            for unit, (name, texture) in enumerate(self._uploaded(levels).items()):
                if f"{name}_map" in program:
                    texture.use(unit)
                    program[f"{name}_map"] = unit
            _set(program, "mipbake_eye", view.camera.position)
            _set(program, "light_count", len(view.lighting.direction))
            _set(program, "light_directions", view.lighting.direction)
            _set(program, "light_radiances", view.lighting.radiance)
            return self._drawn("image", levels, view)[..., :3]

    def _drawn(self, what: str, levels: Levels, view: View) -> NDArray[np.float32]:
        """(H, W, 4) what a program makes of a view, 0 where nothing is, rows from the top."""
        moderngl = loaded_moderngl()
        (height, width), program = view.size, self._programs[what]
        if view.size not in self._framebuffers:
            colour = self._context.renderbuffer((width, height), 4, dtype="f4")
            depth = self._context.depth_renderbuffer((width, height))
            self._framebuffers[view.size] = self._context.framebuffer([colour], depth)
        framebuffer, array = self._framebuffers[view.size], self._mesh(view.mesh)[what]
        _set(program, "mipbake_clip", tuple(view.matrix().T.reshape(-1)))
        _set(program, "mipbake_size", levels.sizes[0][::-1])
        _set(program, "mipbake_last", len(levels.sizes) - 1)
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 0.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        array.render()
        pixels = np.empty((height, width, 4), np.float32)
        framebuffer.read_into(pixels, components=4, dtype="f4")
        return pixels[::-1]

    def _mesh(self, mesh: Mesh) -> dict[str, Any]:
        """The vertex array of each program."""
        if mesh not in self._meshes:
            arrays = {"position": mesh.positions, "normal": mesh.normals, "tangent": mesh.tangents, "uv": mesh.uv}
            buffers = {
                name: (self._context.buffer(np.ascontiguousarray(values, np.float32)), f"{values.shape[1]}f", name)
                for name, values in arrays.items()
            }
            indices = self._context.buffer(np.ascontiguousarray(mesh.triangles, np.int32))
            self._meshes[mesh] = {}
            for what, program in self._programs.items():
                used = [buffers[name] for name in buffers if name in program]  # compilers drop what is not used
                self._meshes[mesh][what] = self._context.vertex_array(program, used, indices, index_element_size=4)
        return self._meshes[mesh]

    def _uploaded(self, levels: Levels) -> Mapping[str, Any]:
        """Name of each map to its texture, which holds these levels."""
        key = (levels.model, tuple(levels.sizes))
        textures = self._textures.pop(key, None) or GlTextures(self._context, levels, self._texels)
        self._textures[key] = textures  # the last one in the order
        if len(self._textures) > _KEPT:
            self._textures.pop(next(iter(self._textures))).release()
        textures.update(levels)
        return textures.maps

    def _check(self, levels: Levels, view: View) -> None:
        if levels.model not in GLTF_MODELS:
            raise UsageError(
                f"the renderer gl knows no material model {levels.model!r}: expected {' or '.join(GLTF_MODELS)}"
            )
        for name in _MAPS:
            if name not in levels.maps and f"{name}_map" in self._programs["image"]:
                raise UsageError(
                    f"{self._name} looks up {name}_map, which the material model {levels.model} does not have: "
                    f"expected its maps alone, {', '.join(levels.maps)}, or another model"
                )
        if (count := len(view.lighting.direction)) > MAX_LIGHTS:
            raise UsageError(
                f"view {view.name} has {count} lights: expected at most {MAX_LIGHTS} for the renderer gl, so make "
                "fewer of its environment"
            )

    def _compiled(self, shader: str) -> Any:
        moderngl = loaded_moderngl()

        code = re.sub(r"//[^\n]*|/\*.*?\*/", " ", shader, flags=re.DOTALL)
        if re.search(r"^[ \t]*#[ \t]*version\b", code, re.MULTILINE):
            raise UsageError(f"{self._name} has a line #version: leave it out, mipbake writes `#version 330` before it")
        try:
            return self._context.program(_VERTICES, _BEFORE + shader + _AFTER)
        except moderngl.Error as error:
            if not re.search(r"\bvec3\s+shade\s*\(\s*((const|in)\s+)*Surface\b[^)]*\)\s*\{", code):
                raise UsageError(f"{self._name} has no function `shade`: expected `vec3 shade(Surface s)`") from None
            told = re.split(r"\n=+\n", str(error))[-1].strip()
            raise UsageError(
                f"{self._name} does not compile, so correct what the compiler of OpenGL complains of. 0:7 or 0(7) is "
                f"line 7 of the file, and lines from 90000 on are what stands around it:\n{told}"
            ) from None


def _context() -> Any:
    """A context of OpenGL without a window."""
    moderngl = loaded_moderngl()
    # Only EGL needs no display. moderngl has it for Linux alone; what it takes elsewhere was never tried.
    backend: dict[str, Any] = {"backend": "egl"} if sys.platform == "linux" else {}
    try:
        return moderngl.create_context(standalone=True, require=330, **backend)
    except Exception as error:  # loaders and drivers raise what they like
        raise UsageError(
            f"the renderer gl found no OpenGL 3.3 over EGL ({' '.join(str(error).split())}): install a driver, which "
            "without a GPU is Mesa's (Debian and Ubuntu: apt install libegl1 libgl1 libgl1-mesa-dri)"
        ) from None


def _set(program: Any, name: str, value: Any) -> None:
    """Sets a uniform, unless the compiler has dropped it: a number, a tuple, or (N, 3) for the first of an array."""
    if name not in program:
        return
    if isinstance(value, np.ndarray):
        padded = np.zeros((program[name].array_length, 3))  # compilers shorten an array to what is used of it
        padded[: len(value)] = value[: len(padded)]
        program[name].write(padded.astype(np.float32))
    else:
        program[name] = value
