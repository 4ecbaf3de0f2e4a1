"""The renderer `gl`: a view in OpenGL, shaded by a fragment shader that anyone may write.

It runs wherever there is OpenGL 3.3 over EGL, with a GPU or with Mesa's llvmpipe on a CPU. The user's part is one
function in GLSL 3.30, `vec3 shade(Surface s)`. docs/fit.md has one, and `shaders` has more. It may use:

- `struct Surface { vec2 uv; vec3 position; mat3 frame; vec3 view; }`. `uv` has v pointing down. `position` is in the
  world. `frame` takes vectors from the tangent frame to the world: its columns are t, b and n of the mesh, orthonormal,
  as glTF 2.0 defines them. `view` is a unit vector to the camera, in the world.
- `uniform sampler2D` for each map: `base_color_map` (rgb, linear once it is looked up), `metallic_map` (r),
  `roughness_map` (r) and `normal_map` (xyz as (n + 1) / 2). `gltf-anisotropic` also has `anisotropy_direction_map` (rg
  as (d + 1) / 2) and `anisotropy_strength_map` (r).
- `vec4 look_up(sampler2D map)`: the map at this pixel, trilinearly, at the level of detail that a fit gets, too.
- `uniform int light_count` and `uniform vec3 light_directions[MAX_LIGHTS], light_radiances[MAX_LIGHTS]`. Directions are
  unit vectors to the light, in the world. A radiance is the irradiance of a surface that faces the light.

Names that begin with `mipbake_` belong to what stands around, and so does the line `#version`.

`look_up` is recommended. `texture(map, s.uv)` works, but a driver may choose its level of detail: llvmpipe has one for
every 2 x 2 pixels, and takes the longer derivative for the longer axis. Gradients then go to the wrong share of levels.
A lookup elsewhere than at `s.uv` leads gradients to the wrong texels. A `discard` would leave pixels in the picture of
places that show nothing.
"""

from __future__ import annotations

import re
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.base.extras import extra
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.fitting.program import Frame, SharedMaps, serve
from mipbake.fitting.protocol import check_model, view_of
from mipbake.fitting.renderer import write_bytes
from mipbake.fitting.views import View
from mipbake.material import COLOUR, GLTF_MODELS, MODELS

MAX_LIGHTS = 64
"""Most lights of a view: as many as an environment becomes. OpenGL 3.3 promises room for fewer than 128."""

SHADERS = ("gltf", "clearcoat", "ramp")
"""Shaders that come with mipbake: the metallic-roughness model as mipbake shades it, the same under a clear coat, and a
stylised one whose light falls in steps."""

_SRGB8_ALPHA8 = 0x8C43

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


def shader_source(name: str) -> str:
    """GLSL of a shader in `SHADERS`, or of a file. UsageError: there is none, or it cannot be read."""
    if name in SHADERS:
        return (files("mipbake.fitting") / "shaders" / f"{name}.glsl").read_text(encoding="utf-8")
    try:
        return Path(name).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(
            f"the shader {name} cannot be read ({reason}): expected {', '.join(SHADERS)}, or a text file of GLSL"
        ) from error


class GlRenderer:
    """Renders views with a fragment shader of the user's. It belongs to the thread that started it.

    Args:
        shader: the name of a shader in `SHADERS`, or of a file of GLSL.
    """

    def __init__(self, shader: str) -> None:
        self._name = shader
        self._gl: Any = None  # the module moderngl
        self._context: Any = None
        self._programs: dict[str, Any] = {}
        self._shape: object = None
        self._textures: dict[str, Any] = {}  # one or two channels, or four for three
        self._meshes: dict[Mesh, dict[str, Any]] = {}
        self._framebuffers: dict[tuple[int, int], Any] = {}
        self._looked: dict[Any, NDArray[np.float32]] = {}

    def start(self, folder: str) -> str:  # noqa: ARG002
        """Makes it ready, and returns what it is called.

        Raises:
            UsageError: moderngl or OpenGL 3.3 over EGL is missing, or the shader does not compile.
        """
        source = shader_source(self._name)
        with extra("fit", "the renderer gl"):
            import moderngl
        # Only EGL needs no display. moderngl has it for Linux alone; what it takes elsewhere was never tried.
        backend: dict[str, Any] = {"backend": "egl"} if sys.platform == "linux" else {}
        try:
            self._context = moderngl.create_context(standalone=True, require=330, **backend)
        except Exception as error:  # loaders and drivers raise what they like
            raise UsageError(
                f"the renderer gl found no OpenGL 3.3 over EGL ({' '.join(str(error).split())}): install a driver, "
                "which without a GPU is Mesa's (Debian and Ubuntu: apt install libegl1 libgl1 libgl1-mesa-dri)"
            ) from None
        self._gl = moderngl
        self._programs = {"geometry": self._context.program(_VERTICES, _GEOMETRY), "image": self._compiled(source)}
        return f"gl ({self._name})"

    def render(self, maps: SharedMaps, content: dict[str, Any]) -> Frame:
        """The frame of a view, with `lod` and `id`. UsageError: what `_check` finds."""
        view = view_of(content)
        self._check(maps, view)
        self._upload(maps)
        program = self._programs["image"]
        for unit, (name, texture) in enumerate(self._textures.items()):
            if f"{name}_map" in program:
                texture.use(unit)
                program[f"{name}_map"] = unit
        _set(program, "mipbake_eye", view.camera.position)
        _set(program, "light_count", len(view.lighting.direction))
        _set(program, "light_directions", view.lighting.direction)
        _set(program, "light_radiances", view.lighting.radiance)
        image = self._drawn("image", maps, view)[..., :3]
        # All but the image is the same whatever the texels are. Views that are moved for references come once.
        key = str((content, maps.sizes))
        found = self._looked.get(key)
        if found is None:
            found = self._drawn("geometry", maps, view)
            if view.offset == (0.0, 0.0):
                self._looked[key] = found
        return Frame(image, found[..., :2], lod=found[..., 2], id=found[..., 3])

    def _drawn(self, what: str, maps: SharedMaps, view: View) -> NDArray[np.float32]:
        """(H, W, 4) what a program makes of a view, 0 where nothing is, rows from the top."""
        (height, width), program = view.size, self._programs[what]
        if view.size not in self._framebuffers:
            colour = self._context.renderbuffer((width, height), 4, dtype="f4")
            depth = self._context.depth_renderbuffer((width, height))
            self._framebuffers[view.size] = self._context.framebuffer([colour], depth)
        framebuffer, array = self._framebuffers[view.size], self._mesh(view.mesh)[what]
        _set(program, "mipbake_clip", tuple(view.matrix().T.reshape(-1)))
        _set(program, "mipbake_size", maps.sizes[0][::-1])
        _set(program, "mipbake_last", len(maps.sizes) - 1)
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 0.0)
        self._context.enable_only(self._gl.DEPTH_TEST)
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

    def _upload(self, maps: SharedMaps) -> None:
        """Uploads the texels that changed, into one texture for each map.

        Texels that are rounded to 8 bits lie in normalised numbers of 16 bits, q / 255 as 257 q / 65535, which are the
        very same numbers. llvmpipe filters textures of 8 bits in 8 bits: between 10/255 and 20/255 it finds nothing but
        whole 255ths, where GPUs and its other textures do. Colours are exempt, as sRGB is decoded before it is
        filtered.
        """
        sizes = maps.sizes
        colours = {each.name for each in MODELS[maps.model].stored if each.facts.encoding == COLOUR}
        if (maps.model, sizes) != self._shape:
            for texture in self._textures.values():
                texture.release()
            self._shape, self._textures = (maps.model, sizes), {}
            for name, levels in maps.maps.items():
                channels = levels[0].shape[2]
                dtype, internal = ("f1", _SRGB8_ALPHA8) if name in colours else ("nu2", None)
                texture = self._context.texture(
                    sizes[0][::-1], 4 if channels == 3 else channels, alignment=1, dtype=dtype, internal_format=internal
                )
                texture.build_mipmaps(0, len(sizes) - 1)  # makes room, and sets the last level
                texture.filter = (self._gl.LINEAR_MIPMAP_LINEAR, self._gl.LINEAR)
                self._textures[name] = texture
        for name, texture in self._textures.items():
            texture.repeat_x, texture.repeat_y = (each == "wrap" for each in maps.wrap)
            for index, (level, parts) in enumerate(zip(maps.maps[name], maps.changed, strict=True)):
                for row, column, height, width in parts:
                    texels = np.full((height, width, texture.components), 255, np.uint8)
                    write_bytes(texels, level[row : row + height, column : column + width])
                    wider = texels if name in colours else texels.astype(np.uint16) * np.uint16(257)
                    texture.write(wider, (column, row, width, height), index)

    def _check(self, levels: SharedMaps, view: View) -> None:
        """UsageError for another model than glTF's, a map that the model does not have, or too many lights."""
        check_model("gl", levels.model)
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
        code = re.sub(r"//[^\n]*|/\*.*?\*/", " ", shader, flags=re.DOTALL)
        if re.search(r"^[ \t]*#[ \t]*version\b", code, re.MULTILINE):
            raise UsageError(f"{self._name} has a line #version: leave it out, mipbake writes `#version 330` before it")
        try:
            return self._context.program(_VERTICES, _BEFORE + shader + _AFTER)
        except self._gl.Error as error:
            if not re.search(r"\bvec3\s+shade\s*\(\s*((const|in)\s+)*Surface\b[^)]*\)\s*\{", code):
                raise UsageError(f"{self._name} has no function `shade`: expected `vec3 shade(Surface s)`") from None
            complaint = re.split(r"\n=+\n", str(error))[-1].strip()
            raise UsageError(
                f"{self._name} does not compile, so correct what the compiler of OpenGL complains of. 0:7 or 0(7) is "
                f"line 7 of the file, and lines from 90000 on are what stands around it:\n{complaint}"
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


def main() -> None:
    """The program: its argument is the shader, the first of SHADERS without one."""
    renderer = GlRenderer(sys.argv[1] if sys.argv[1:] else SHADERS[0])
    serve(renderer.render, renderer.start)
