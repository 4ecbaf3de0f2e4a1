"""The renderer `gl`: its frames are the library's, and its textures hold what files of 8 bits would hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import UsageError
from mipbake.base.srgb import linear_to_srgb, srgb_to_linear
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.camera import Camera
from mipbake.fitting.gl import MAX_LIGHTS, SHADERS
from mipbake.fitting.named import RendererChoice
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.renderer import Levels, new_stamp, new_stamps
from mipbake.fitting.views import View
from mipbake.material import COLOUR, MODELS, SIGNED
from mipbake.quality.environment import directional

from . import independent_scenes as scenes
from .fitting_levels import check_tiles, stamps_of
from .mesh_renders import candidate
from .viewer_scenes import material, stack_of

pytestmark = pytest.mark.independent

PLANE = View("plane", "near", scenes.PLANE, scenes.CAMERA, scenes.LIGHTING, (48, 64))
BALL = View(
    "ball", "far", shapes.sphere(32, (6, 3)), Camera((1.2, 0.0, 3.6), field_of_view=36), scenes.LIGHTING, (60, 50)
)
# Straight above a plane that fills the view: pixel (row i, column j) sees u = (j + 1/2) / 16, v = (i + 1/2) / 16.
ABOVE = Camera((0.0, 1.0, 0.0), up=(0.0, 0.0, -1.0), field_of_view=90.0)
FLAT = View("flat", "1:1", shapes.plane(2.0, 2.0), ABOVE, scenes.LIGHTING, (16, 16))

SHOW = "vec3 shade(Surface s) {{ return {}; }}"
SHOW_COLOUR = SHOW.format("look_up(base_color_map).rgb")

Made = Callable[[str], Any]


@pytest.fixture(scope="module")
def driver() -> None:
    moderngl = pytest.importorskip("moderngl", reason="moderngl is not installed (the extra `fit`)")
    try:
        moderngl.create_context(standalone=True, backend="egl", require=330).release()
    except Exception as error:  # whatever a loader or a driver complains of
        pytest.skip(f"no OpenGL 3.3 over EGL ({error}; Debian's libegl1, libgl1 and libgl1-mesa-dri have it)")


@pytest.fixture(scope="module")
def made(driver: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Made]:
    """Makes renderers of a shader's name, or of GLSL; one for each."""
    renderers: dict[str, Any] = {}
    file = tmp_path_factory.mktemp("shaders") / "mine.glsl"

    def make(shader: str) -> Any:
        if shader not in renderers:
            file.write_text(shader, encoding="utf-8")
            renderers[shader] = RendererChoice("gl", shader if shader in SHADERS else str(file)).made()
        return renderers[shader]

    yield make
    for renderer in renderers.values():
        renderer.close()


def levels_of(stack: Sequence[np.ndarray], model: str, wrap: tuple[str, str] = ("wrap", "wrap")) -> Levels:
    """Stored channels, as a renderer gets them."""
    encode = {COLOUR: lambda x: linear_to_srgb(x.astype(np.float64)), SIGNED: lambda x: (x + 1) / 2}
    maps = {
        each.name: [
            encode.get(each.facts.encoding, np.asarray)(level[..., MODELS[model].maps[each.name]]).astype(np.float32)
            for level in stack
        ]
        for each in MODELS[model].stored
    }
    sizes = [(level.shape[0], level.shape[1]) for level in stack]
    return Levels(model, maps, wrap, new_stamps(sizes))


def flat(texel: Sequence[float], size: int = 16, stamp: int | None = None) -> Levels:
    """One level of `gltf`, the same everywhere, from encoded values."""
    values = np.broadcast_to(np.asarray(texel, np.float32), (size, size, 8))
    maps = {name: [values[..., part]] for name, part in MODELS["gltf"].maps.items()}
    return Levels("gltf", maps, ("wrap", "wrap"), stamps_of([(size, size)], [new_stamp() if stamp is None else stamp]))


@pytest.fixture(scope="module")
def stack() -> list[np.ndarray]:
    """Levels whose values files of 8 bits can hold."""
    stored = list(stack_of(material("gltf"), "gltf").levels)
    parameters = Parameters.of("gltf", *stored[0].shape[:2], len(stored))
    values = np.round(parameters.values(stored) * 255) / 255
    return parameters.stored(values.astype(np.float32))


# ---- beside the library's renders


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.3, -0.45)])
@pytest.mark.parametrize("view", [PLANE, BALL], ids=["plane", "ball"])
def test_frames_are_the_librarys(made: Made, stack: list[np.ndarray], view: View, offset: tuple[float, float]) -> None:
    frame = made("gltf").render(levels_of(stack, "gltf"), view.moved(*offset))
    other = candidate(view.mesh, view.camera, view.lighting, stack, "gltf", ("wrap", "wrap"), view.size, offset=offset)
    seen = np.asarray(frame.id) > 0
    assert (seen != other.coverage).mean() < 0.001 and seen.mean() > 0.4
    assert not frame.image[~seen].any()
    both = seen & other.coverage
    lods, images = np.abs(frame.lod - other.lod)[both], np.abs(frame.image - other.image)[both].max(-1)
    # Where two triangles meet, either may have a pixel, with another footprint: a few of two thousand.
    assert np.quantile(np.abs(frame.uv - other.uv)[both].max(-1), 0.995) < 1e-5
    assert np.quantile(lods, 0.995) < 1e-3 and np.quantile(images, 0.995) < 5e-3
    assert scenes.decibels(frame.image[both].astype(np.float64), other.image[both].astype(np.float64)) > 50
    assert np.median(other.lod[both]) > 0.3  # past level 0


def test_a_plane_that_passes_behind_the_camera_has_the_librarys_footprints(made: Made, stack: list[np.ndarray]) -> None:
    wide = View(
        "wide", "far", shapes.plane(60, 60, (9, 9)), Camera((0, 0.5, 0), (0, 0.2, -2)), scenes.LIGHTING, (40, 60)
    )
    frame = made(SHOW_COLOUR).render(levels_of(stack, "gltf"), wide)
    other = candidate(wide.mesh, wide.camera, wide.lighting, stack, "gltf", ("wrap", "wrap"), wide.size)
    both = (frame.id > 0) & other.coverage
    assert both.mean() > 0.3 and np.abs(frame.lod - other.lod)[both].max() < 0.01


def test_all_maps_of_anisotropy_arrive(made: Made) -> None:
    levels = levels_of(stack_of(material("gltf-anisotropic", 16, 16), "gltf-anisotropic").levels, "gltf-anisotropic")
    shown = "vec3(look_up(anisotropy_direction_map).rg, look_up(anisotropy_strength_map).r)"
    image = made(SHOW.format(shown)).render(levels, FLAT).image
    expected = [levels.maps[name][0] for name in ("anisotropy_direction", "anisotropy_strength")]
    assert np.abs(image - np.concatenate(expected, -1)).max() < 0.51 / 255


# ---- textures


def test_rgba8_rounds_to_the_nearest_step(made: Made) -> None:
    texel = np.array([0.5, 0.2, 0.9, 100.49 / 255, 100.51 / 255, 0.25, 0.75, 1.0])
    rounded = np.round(texel * 255) / 255
    linear = "vec3(look_up(metallic_map).r, look_up(roughness_map).r, look_up(normal_map).y)"
    assert np.abs(made(SHOW.format(linear)).render(flat(texel), FLAT).image - rounded[[3, 4, 6]]).max() < 1e-6
    # llvmpipe decodes sRGB of 8 bits by a polynomial, a quarter of a step away at most.
    colour = made(SHOW_COLOUR).render(flat(texel), FLAT).image
    assert np.abs(colour - srgb_to_linear(rounded[:3])).max() < 2e-3


@pytest.mark.parametrize("size", [(100, 75), (130, 300)])
def test_tiles_are_uploaded_one_by_one(made: Made, size: tuple[int, int]) -> None:
    renderer = made("clearcoat")
    views = [replace(FLAT, size=(32, 32), mesh=shapes.plane(2.0, 2.0, (n, n))) for n in (0.25, 1.0, 4.0, 16.0)]
    check_tiles(renderer, views, size)


def test_a_source_of_one_level_and_its_stack_do_not_mix(made: Made) -> None:
    renderer = made(SHOW.format("vec3(look_up(roughness_map).r)"))
    stack = [np.full((size, size, 8), value, np.float32) for size, value in ((4, 0.4), (2, 0.6), (1, 0.8))]
    many, one = levels_of(stack, "gltf"), flat([0.2] * 8, 4)
    far = replace(FLAT, mesh=shapes.plane(2.0, 2.0, (64.0, 64.0)))
    for _ in range(2):
        assert np.allclose(renderer.render(many, far).image, 0.8) and np.allclose(renderer.render(one, far).image, 0.2)
    assert renderer.render(one, far).lod.max() == 0 and renderer.render(many, far).lod.min() == 2


@pytest.mark.parametrize("wrap", [("clamp", "wrap"), ("wrap", "clamp")])
def test_maps_repeat_or_end(made: Made, wrap: tuple[str, str]) -> None:
    level = material("gltf", 16, 16)
    twice = replace(FLAT, mesh=shapes.plane(2.0, 2.0, (2.0, 2.0)))
    image = made(SHOW_COLOUR).render(levels_of([level], "gltf", wrap), twice).image
    other = candidate(twice.mesh, ABOVE, twice.lighting, [level], "gltf", wrap, twice.size)
    assert other.coverage.all()
    at = ((np.arange(16) + 0.5) / 8 * 16 - 0.5)[None].repeat(2, 0)  # of texels' centres, along v and u
    rows, columns = (
        [np.mod(x, 16) if mode == "wrap" else np.clip(x, 0, 15) for x in (np.floor(a), np.floor(a) + 1)]
        for a, mode in zip(at, wrap[::-1], strict=True)
    )
    means = [level[np.ix_(r.astype(int), c.astype(int))][..., :3] for r in rows for c in columns]
    assert np.abs(image - np.mean(means, 0)).max() < 5e-3


# ---- views


def test_rows_run_from_the_top_and_v_down(made: Made) -> None:
    uv = made(SHOW_COLOUR).render(flat([0.5] * 8), FLAT).uv
    centres = (np.arange(16) + 0.5) / 16
    assert np.allclose(uv, np.stack(np.meshgrid(centres, centres), -1), atol=1e-6)


def test_the_surface_is_the_meshs(made: Made) -> None:
    levels = flat([0.5] * 8)
    for shown, expected in (("s.frame[0]", [1, 0, 0]), ("s.frame[1]", [0, 0, -1]), ("s.frame[2]", [0, 1, 0])):
        assert np.allclose(made(SHOW.format(shown)).render(levels, FLAT).image, expected, atol=1e-6)
    corner = made(SHOW.format("s.position")).render(levels, FLAT).image[0, -1]
    assert np.allclose(corner, [15 / 16, 0, -15 / 16], atol=1e-6)
    towards = made(SHOW.format("s.view")).render(levels, FLAT).image[0, -1]
    assert np.allclose(towards, np.array([-15 / 16, 1, 15 / 16]) / np.sqrt(1 + 2 * (15 / 16) ** 2), atol=1e-6)


@pytest.mark.parametrize("name", SHADERS)
def test_shipped_shaders_render(made: Made, stack: list[np.ndarray], name: str) -> None:
    renderer = made(name)
    first, again = (renderer.render(levels_of(stack, "gltf"), BALL) for _ in range(2))
    assert np.isfinite(first.image).all() and first.image.min() >= 0
    assert first.image[first.id > 0].std() > 0.01
    for what in ("image", "uv", "lod", "id"):
        assert np.array_equal(getattr(first, what), getattr(again, what))


# ---- errors


@pytest.mark.parametrize(
    ("shader", "told"),
    [
        ("// one\nvec3 shade(Surface s) {\n  return nothing;\n}\n", r"mine\.glsl does not compile.*\n.*\b3\b.*nothing"),
        ("vec3 other(Surface s) { return vec3(1.0); }", "mine.glsl has no function `shade`"),
        ("// vec3 shade(Surface s) { return vec3(1.0); }", "has no function `shade`"),
        ("#version 330\nvec3 shade(Surface s) { return vec3(1.0); }", "leave it out"),
    ],
)
def test_a_broken_shader_is_told(made: Made, shader: str, told: str) -> None:
    with pytest.raises(UsageError, match=told):
        made(shader)


def test_what_cannot_be_rendered_is_told(made: Made, stack: list[np.ndarray]) -> None:
    renderer, levels = made("gltf"), levels_of(stack, "gltf")
    other = stack_of(material("ggx"), "ggx").levels
    with pytest.raises(UsageError, match="'ggx': expected gltf or gltf-anisotropic"):
        renderer.render(levels_of(other, "ggx"), PLANE)
    with pytest.raises(UsageError, match=r"looks up anisotropy_strength_map, which .* gltf does not have"):
        made(SHOW.format("look_up(anisotropy_strength_map).rrr")).render(levels, PLANE)
    many = directional("many", np.ones((MAX_LIGHTS + 1, 3)), np.ones((MAX_LIGHTS + 1, 3)))
    with pytest.raises(UsageError, match="65 lights: expected at most 64"):
        renderer.render(levels, replace(PLANE, lighting=many))


def test_what_is_missing_is_said(driver: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match=r"the shader toon cannot be read .*: expected gltf, clearcoat, ramp, or a"):
        RendererChoice("gl", "toon").made()
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nowhere")
    with pytest.raises(UsageError, match=r"no OpenGL 3\.3 over EGL .*libegl1"):
        RendererChoice("gl").made()
    (tmp_path / "moderngl.py").write_text("raise ModuleNotFoundError('none', name='moderngl')", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(UsageError, match=r"the renderer gl needs moderngl.*mipbake\[fit\]"):
        RendererChoice("gl").made()
