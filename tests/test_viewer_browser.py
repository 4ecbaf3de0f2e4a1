"""The interactive view in headless Chromium: its pixels against the library's lookups and shading, and its controls."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from mipbake import sampling, shading
from mipbake.comparing.viewer import LIGHTS, viewer_fragment
from mipbake.material import MODELS
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import filter_named, level_sizes
from mipbake.stack.stack import MipStack

from .chromium import watched
from .viewer_scenes import PROVENANCE, material, stack_of

pytestmark = pytest.mark.independent

FIELD_OF_VIEW = math.radians(40)
VIEW = {
    "shape": "plane",
    "sides": [0],
    "tiling": 1,
    "lights": 0,
    "lightAzimuth": 20,
    "lightHeight": 15,
    "azimuth": 33,
    "pixels": 4,
}


class Shot(NamedTuple):
    """One side as the browser shaded it: (H, W, 3) linear radiance and (H, W) coverage, bottom row first."""

    radiance: np.ndarray
    covered: np.ndarray


@pytest.fixture
def open_page(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """Opens a page with the viewer from disk (chromium.watched); arguments of `viewer_fragment`."""
    path = tmp_path / "page.html"
    with watched(browser, path.as_uri()) as page:

        def opened(stacks: dict[str, MipStack], source: FilteredSource | None = None, **more: Any) -> Any:
            head = '<!DOCTYPE html><meta name="viewport" content="width=device-width"><title>t</title>'
            path.write_text(f"{head}<body>{viewer_fragment(stacks, source, **more)}", encoding="utf-8")
            return page(viewport={"width": 330, "height": 700})

        yield opened


def changed(page: Any, **view: Any) -> None:
    page.evaluate("view => document.querySelector('.mipbake-viewer').viewer.set(view)", view)


def shot(page: Any, **view: Any) -> Shot:
    changed(page, **view)
    (width, height), data = page.evaluate(
        """() => {
            const { renderer } = document.querySelector('.mipbake-viewer').viewer;
            const bytes = new Uint8Array(renderer.read(0).buffer);
            let text = '';
            for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
            return [renderer.size, btoa(text)];
        }"""
    )
    values = np.frombuffer(base64.b64decode(data), np.float32).reshape(height, width, 4)
    return Shot(values[..., :3].astype(np.float64), values[..., 3] > 0.5)


class Plane(NamedTuple):
    """The floor as pixels see it: texture coordinates, their derivatives, and directions to the eye in the frame."""

    uv: np.ndarray
    uv_da: np.ndarray
    view: np.ndarray
    hit: np.ndarray


def plane_seen(size: tuple[int, int], view: dict[str, Any], aspect: float, offset: Any = (0.0, 0.0)) -> Plane:
    """Rays through the pixels (centres plus offset) of an orbiting camera, met with the floor, in float64."""
    height, width = size
    azimuth, elevation = math.radians(view["azimuth"]), math.radians(view["elevation"])
    back = np.array(
        [math.cos(elevation) * math.sin(azimuth), math.sin(elevation), math.cos(elevation) * math.cos(azimuth)]
    )
    right = np.array([math.cos(azimuth), 0, -math.sin(azimuth)])
    up, eye = np.cross(back, right), view["distance"] * back
    slope = math.tan(FIELD_OF_VIEW / 2)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, y = x + offset[0], y + offset[1]
    step_x, step_y = 2 / width * slope * width / height * right, 2 / height * slope * up
    ray = (x - width / 2)[..., None] * step_x + (y - height / 2)[..., None] * step_y - back
    with np.errstate(divide="ignore", over="ignore"):
        along = -eye[1] / ray[..., 1:2]
    place = eye + along * ray
    inside = (along[..., 0] > 0) & (np.abs(place[..., 0]) < 16) & (np.abs(place[..., 2]) < 16)
    repeats = 16 * view.get("tiling", 1) / 32 * np.array([1.0, aspect])  # of the texture, per unit of length
    derivatives = [along * (s - ray * s[1] / ray[..., 1:2]) for s in (step_x, step_y)]
    du, dv = ([d[..., axis] * repeats[i] for d in derivatives] for i, axis in ((0, 0), (1, 2)))
    to_eye = -ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    frame = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # tangent, bitangent (against v), normal
    return Plane((place[..., [0, 2]] + 16) * repeats, np.stack([*du, *dv], -1), to_eye @ frame.T, inside)


def lights_seen(view: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Directions (K, 3) in the floor's frame, and radiance (K, 3), of the light set as the view turns it."""
    lights = LIGHTS[view["lights"]]
    a, h = math.radians(view["lightAzimuth"]), math.radians(view["lightHeight"])
    lift = np.array([[1, 0, 0], [0, math.cos(h), math.sin(h)], [0, -math.sin(h), math.cos(h)]])
    turn = np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])
    world = lights.direction @ (turn @ lift).T
    return world @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T, lights.radiance


def shaded(model: str, texels: np.ndarray, seen: np.ndarray, view: dict[str, Any]) -> np.ndarray:
    """(P, S, 3): S texels (P, S, C) of each of P pixels, under every light, towards (P, 3)."""
    directions, radiance = lights_seen(view)
    towards = np.repeat(seen[:, None], len(directions), 1)
    f = shading.shade(model, texels.astype(np.float64), directions[None], towards)  # (P, K, S, 3)
    return np.einsum("pksc,kc->psc", f, radiance)


def candidate(stack: MipStack, size: tuple[int, int], view: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """What the library says that the floor looks like, one trilinear lookup for each pixel; and where the floor is."""
    plane = plane_seen(size, view, stack.size[1] / stack.size[0])
    finest, *coarser = (level[None].astype(np.float64) for level in stack.levels)
    texels = sampling.texture(
        finest,
        plane.uv[None],
        plane.uv_da[None],
        mip=coarser,
        filter_mode="linear-mipmap-linear",
        boundary_mode=stack.wrap,
    )[0]
    image = shaded(stack.model, texels.reshape(-1, 1, texels.shape[-1]), plane.view.reshape(-1, 3), view)
    return image.reshape(*size, 3), plane.hit


def decibels(image: np.ndarray, expected: np.ndarray) -> float:
    return float(10 * np.log10(np.square(expected).sum() / np.square(image - expected).sum()))


@pytest.mark.parametrize(("size", "half"), [((32, 32), False), ((24, 40), True)])
def test_level_colours_are_exact_at_every_level_of_detail(open_page: Any, size: tuple[int, int], half: bool) -> None:
    rng = np.random.default_rng(1)
    levels = []
    for height, width in level_sizes(*size):
        # Linear values that 8-bit sRGB, and half floats, hold to rounding.
        srgb = rng.integers(20, 255, 3) / 255
        level = np.zeros((height, width, 8), np.float32)
        level[..., 0:3] = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
        level[..., 4], level[..., 7] = 0.5, 1
        levels.append(level)
    page = open_page({"a": MipStack("a", "gltf", levels, {}, ("wrap", "wrap"), PROVENANCE)}, half=half)
    down = {"shape": "plane", "sides": [0], "show": 1, "azimuth": 0, "elevation": 90, "distance": 4, "pixels": 4}
    rows = len(shot(page, **down).radiance)
    for index, level in enumerate(levels):
        # Seen straight down, a pixel is this large, so that this many repeats give the level of detail `index`.
        pixel = 2 * math.tan(FIELD_OF_VIEW / 2) * 4 / rows
        tiling = 2**index / (pixel * size[1]) / (16 / 32)
        image = shot(page, tiling=tiling)
        assert image.covered.all()
        np.testing.assert_allclose(image.radiance, np.broadcast_to(level[0, 0, :3], image.radiance.shape), atol=1.5e-3)
        shown = page.evaluate(
            """() => {
                const canvas = document.querySelector('.mipbake-viewer canvas'), pixel = new Uint8Array(4);
                canvas.getContext('webgl2').readPixels(40, 30, 1, 1, 6408, 5121, pixel);
                return [...pixel];
            }"""
        )
        linear = level[0, 0, :3].astype(np.float64)
        wanted = np.rint(255 * (1.055 * linear ** (1 / 2.4) - 0.055))
        assert np.abs(np.array(shown[:3]) - wanted).max() <= 1  # log2 of a software GL is right to 4e-4


@pytest.mark.parametrize(("model", "lights"), [*((model, 0) for model in MODELS), ("gltf", 1), ("ggx", 2)])
def test_the_floor_agrees_with_the_library(open_page: Any, model: str, lights: int) -> None:
    stack = stack_of(material(model), model)
    page = open_page({"a": stack}, half=True)
    # Not grazing: where n.v changes its sign, f jumps, and rounding decides whole pixels.
    for pose in ({"elevation": 35, "distance": 2.0}, {"elevation": 35, "distance": 12.0, "tiling": 4}):
        view = {**VIEW, "lights": lights, **pose}
        image = shot(page, **view)
        expected, hit = candidate(stack, image.covered.shape, view)
        assert (hit != image.covered).mean() < 0.001
        both = hit & image.covered
        found = decibels(image.radiance[both], expected[both])
        assert found > 35


def test_the_reference_is_the_pixel_filtered_source(open_page: Any) -> None:
    """Against rays through importance-sampled places in each pixel, in float64, which bend the footprint as they do."""
    source, rng = material("gltf"), np.random.default_rng(2)
    stack = stack_of(source, "gltf")
    page = open_page({"a": stack}, source=FilteredSource(source, "gltf", ("wrap", "wrap"), "mitchell"), half=True)
    view = {**VIEW, "sides": [1], "lights": 1, "elevation": 50, "distance": 8.0, "tiling": 1.5, "pixels": 8}
    image = shot(page, **view)
    size = image.covered.shape
    centre = plane_seen(size, view, 4 / 3)
    expected, kernel, samples = np.zeros((*size, 3)), filter_named("mitchell"), 600
    total, shift = np.zeros((*size, 1)), rng.random((2, *size))
    for index in range(samples):
        # The sequence of Roberts 2018 under a shift of each pixel's own.
        step = index * np.array([0.7548776662466927, 0.5698402909980532])
        offset, weight = kernel.offsets((shift + step[:, None, None]) % 1)
        plane = plane_seen(size, view, 4 / 3, offset)
        texels = sampling.texture(source[None].astype(np.float64), plane.uv[None], filter_mode="linear")[0]
        towards = centre.view.reshape(-1, 3)  # directions belong to the pixel (docs/conventions.md)
        f = shaded("gltf", texels.reshape(-1, 1, 8), towards, view).reshape(*size, 3)
        expected += weight.prod(0)[..., None] * f
        total += weight.prod(0)[..., None]
    both = image.covered & centre.hit
    assert both.mean() > 0.9
    expected = (expected / total)[both]
    once, _ = candidate(stack, size, view)
    assert decibels(image.radiance[both], expected) > 30  # both are estimates
    assert decibels(once[both], expected) < 25
    assert "the source as it should look, the mean of 512 samples" in page.inner_text(".mv-status")


@pytest.mark.parametrize("shape", ["plane", "sphere", "ball"])
def test_equal_stacks_do_not_differ_and_frames_are_right_handed(open_page: Any, shape: str) -> None:
    """A texture whose normals lean up in the picture is brighter under light from above, whatever carries it."""
    leaning = []
    for tilt in (0.5, -0.5):
        level = np.zeros((1, 1, 8), np.float32)
        level[..., 0:3], level[..., 4] = 0.5, 0.9
        level[..., 5:8] = [0, tilt, math.sqrt(1 - tilt * tilt)]
        leaning.append(MipStack("a", "gltf", [level], {}, ("wrap", "wrap"), PROVENANCE))
    page = open_page({"up": leaning[0], "up too": leaning[0], "down": leaning[1]})
    # From the front: on the ball's side and the sphere's front face, up in the picture is up in the world.
    pose = {"azimuth": 0, "elevation": 0 if shape != "plane" else 40, "lights": 1, "lightHeight": 70, "lightAzimuth": 0}
    if shape == "plane":  # here up in the picture points away from the viewer
        pose |= {"lightAzimuth": 180, "lightHeight": 40}
    up = shot(page, shape=shape, sides=[0], distance=5, pixels=2, **pose)
    down = shot(page, sides=[2])
    rows, columns = up.covered.shape
    middle = np.s_[rows // 2 - 1 : rows // 2 + 1, columns // 2 - 3 : columns // 2 + 3]
    assert up.covered[middle].all()
    assert (up.radiance[middle] > 1.2 * down.radiance[middle]).all()
    changed(page, sides=[0, 1], differ=True, dividers=[0.9])
    colours = page.evaluate(
        """() => {
            const canvas = document.querySelector('.mipbake-viewer canvas'), { width, height } = canvas;
            const pixels = new Uint8Array(4 * width * height);
            canvas.getContext('webgl2').readPixels(0, 0, width, height, 6408, 5121, pixels);
            const middle = 4 * (width * (height >> 1) + (width >> 1));
            return [...pixels.subarray(middle, middle + 3)];
        }"""
    )
    assert max(colours) < 60  # the dark end of the heat map


def state(page: Any) -> Any:
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return page.evaluate("() => document.querySelector('.mipbake-viewer').viewer.view")


def test_mouse_keys_and_buttons_move_the_view(open_page: Any) -> None:
    stack = stack_of(material("gltf", 16, 16), "gltf")
    page = open_page(
        {"one": stack, "two": stack}, source=FilteredSource(stack.levels[0], "gltf", ("wrap", "wrap"), "gaussian")
    )
    canvas, before = page.locator("canvas"), state(page)
    assert (before["sides"], before["away"]) == ([0, 1, 2], "middle")
    assert page.locator(".mv-name").all_inner_texts() == ["one", "two", "truth"]
    page.locator(".mv-more summary").click()
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 6, box["y"] + box["height"] / 3
    page.mouse.move(x, y)
    page.mouse.wheel(0, 200)  # not clicked yet: the page scrolls
    assert state(page)["distance"] == before["distance"]
    page.wait_for_function("() => scrollY > 0")
    page.evaluate("() => scrollTo(0, 0)")
    page.mouse.down()
    page.mouse.move(x + 50, y + 20)
    page.mouse.up()
    after = state(page)
    assert after["azimuth"] == pytest.approx(before["azimuth"] - 20) and after["elevation"] > before["elevation"]
    page.mouse.wheel(0, 200)
    assert state(page)["distance"] > after["distance"] and state(page)["away"] == ""
    canvas.press("b")  # one picture, divided
    handle = page.locator(".mv-divider").first.bounding_box()
    page.mouse.move(handle["x"] + 22, y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], y)
    page.mouse.up()
    assert state(page)["dividers"] == pytest.approx([0.75, 0.75], abs=0.01)  # it takes the other one along
    page.locator(".mv-divider").first.press("ArrowLeft")
    assert state(page)["dividers"] == pytest.approx([0.73, 0.75], abs=0.01)
    for key, field, value in (
        ("3", "shape", "ball"),
        ("d", "differ", True),
        ("f", "away", "far"),
        (" ", "cameraMoves", True),
    ):
        canvas.press(key)
        assert state(page)[field] == value
    canvas.press(" ")
    page.get_by_role("button", name="Sphere").click()
    page.get_by_label("Exposure").fill("1.5")
    assert state(page)["shape"] == "sphere" and state(page)["exposure"] == 1.5
    page.get_by_role("button", name="two").click()
    assert (
        state(page)["sides"] == [0, 2]
        and page.get_by_role("button", name="two").get_attribute("aria-pressed") == "false"
    )
    page.get_by_text("Reset the view").click()
    assert state(page)["away"] == "middle" and state(page)["distance"] > 3.4  # the sphere fits into a side


@pytest.mark.parametrize("wrap", ["wrap", "clamp"])
def test_near_middle_and_far_are_levels_of_detail(open_page: Any, wrap: str) -> None:
    page = open_page({"a": stack_of(material("gltf", 64, 64), "gltf", (wrap, wrap))})
    found = {}
    for away in ("near", "middle", "far"):
        image = shot(page, away=away, show=5, sides=[0])
        middle = tuple(length // 2 for length in image.covered.shape)
        found[away] = 6 * image.radiance[middle][0]  # of six levels
    assert found["middle"] == pytest.approx(1.8, abs=0.1) and found["far"] == pytest.approx(4, abs=0.1)
    assert found["near"] < 0.1


def test_what_moves_goes_on_and_gathers_nothing(open_page: Any) -> None:
    stack = stack_of(material("gltf", 16, 16), "gltf")
    page = open_page({"one": stack}, source=FilteredSource(stack.levels[0], "gltf", ("wrap", "wrap"), "gaussian"))
    viewer = "document.querySelector('.mipbake-viewer').viewer"
    page.evaluate(f"() => {{ {viewer}.change({{ cameraMoves: true, lampMoves: true, pixels: 8 }}); }}")
    page.wait_for_function(f"() => {viewer}.view.azimuth > 0.5 && {viewer}.view.lightAzimuth > 0.5", timeout=20000)
    assert "its grain is noise, not shimmer" in page.inner_text(".mv-status")


def test_a_phone_in_the_dark_and_paper_show_it_without_scrolling_sideways(open_page: Any) -> None:
    page = open_page({"a": stack_of(material("gltf", 8, 8), "gltf")})
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        changed(page)
        ink, stage = page.evaluate(
            "() => [getComputedStyle(document.querySelector('.mipbake-viewer')).color, "
            "getComputedStyle(document.querySelector('.mv-stage')).backgroundColor]"
            ".map((c) => c.match(/[0-9]+/g).slice(0, 3).reduce((sum, x) => sum + Number(x), 0))"
        )
        assert (ink > stage + 300) if scheme == "dark" else (stage > ink + 300)
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    page.emulate_media(media="print")
    assert page.locator("canvas").is_visible()
    assert not page.locator(".mv-panel").is_visible() and not page.locator(".mv-bar").is_visible()
    assert page.evaluate("() => document.querySelector('canvas').toDataURL().length") > 5000
