"""three.js as a renderer of fits: where it looks levels up, what it uploads, and what becomes of its failures."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mipbake.base.errors import RendererError, UsageError
from mipbake.comparing.meshes.camera import orbit
from mipbake.comparing.meshes.shapes import plane, sphere
from mipbake.fitting.named import RendererChoice
from mipbake.fitting.renderer import Levels
from mipbake.fitting.three import MATERIALS, three_folder
from mipbake.fitting.views import View
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.environment import directional

from .fitting_levels import check_tiles, stamps_of
from .mesh_renders import candidate

pytestmark = pytest.mark.independent

MODULES = Path(__file__).parents[1] / "benchmarks/engines/node_modules"
LIGHT = directional("above", [[0.3, 1.0, 0.4]], [[3.0, 2.0, 1.0]])
SLANTED = View("slanted", "middle", plane(4, 4, (2, 2)), orbit(4, 0, 35), LIGHT, (40, 56))
BALL = View("ball", "middle", sphere(), orbit(4, 20, 30), LIGHT, (48, 48))
LOOKED_UP = 0.03  # tolerance for levels of detail, whose precision WebGL leaves to its maker


@pytest.fixture(scope="module")
def build() -> Iterator[None]:
    """three.js and Chromium are there."""
    if not (MODULES / "three").is_dir():
        pytest.skip("three.js is not installed (npm ci --prefix benchmarks/engines)")
    if not any(shutil.which(name) for name in ("chromium", "chromium-browser", "google-chrome")):
        pytest.skip("Chromium is not installed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NODE_PATH", str(MODULES))
        yield


def made(material: str = "standard") -> Any:
    return RendererChoice("three", material).made()


@pytest.fixture(scope="module")
def standard(build: None) -> Iterator[Any]:
    with made() as renderer:
        yield renderer


def constant(
    colours: Sequence[Sequence[float]], size: tuple[int, int] = (64, 64), stamp: int = 0, roughness: float = 1.0
) -> Levels:
    """Levels of one colour (sRGB-encoded) each, flat and not metallic. The stamps count from `stamp` on."""
    sizes = level_sizes(*size)[: len(colours)]

    def maps(*values: float) -> list[NDArray[np.float32]]:
        return [np.full((*each, len(values)), values, np.float32) for each in sizes]

    base = [np.full((*each, 3), colour, np.float32) for each, colour in zip(sizes, colours, strict=True)]
    all_maps = {"base_color": base, "metallic": maps(0), "roughness": maps(roughness), "normal": maps(0.5, 0.5, 1)}
    return Levels("gltf", all_maps, ("wrap", "wrap"), stamps_of(sizes, range(stamp, stamp + len(sizes))))


def stored(levels: Levels) -> list[NDArray[np.float32]]:
    """(H, W, 8) stored channels, for colours that are 0 or 1."""
    maps = levels.maps
    return [
        np.concatenate([base, metallic, roughness, normal * 2 - 1], -1)
        for base, metallic, roughness, normal in zip(
            maps["base_color"], maps["metallic"], maps["roughness"], maps["normal"], strict=True
        )
    ]


def longer_step(uv: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) the longer step to a neighbour, of pixels that GPUs shade in squares of 2 x 2."""
    height, width = uv.shape[:2]
    squares = uv.reshape(height // 2, 2, width // 2, 2, 2)
    right = np.linalg.norm(np.diff(squares, axis=3), axis=-1).repeat(2, 3)
    up = np.linalg.norm(np.diff(squares, axis=1), axis=-1).repeat(2, 1)
    return np.maximum(right, up).reshape(height, width)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.4, -0.3)])
def test_where_it_looks_up_agrees_with_the_library(standard: Any, offset: tuple[float, float]) -> None:
    levels = constant([(1, 1, 1)] * 9, (256, 256), 100)
    frame = standard.render(levels, SLANTED.moved(*offset))
    view = SLANTED
    ours = candidate(view.mesh, view.camera, LIGHT, stored(levels), "gltf", levels.wrap, view.size, offset=offset)
    covered = ours.coverage
    # SwiftShader snaps corners of triangles to 1/16 of a pixel, which is more than GPUs do.
    assert ((frame.id > 0) != covered).sum() <= 4 and 100 < covered.sum() < covered.size
    covered = covered & (frame.id > 0)
    pixel = 2.0 ** ours.lod[covered].max() / 256
    np.testing.assert_allclose(frame.uv[covered], ours.uv[covered], atol=pixel / 16)
    inside = covered.reshape(20, 2, 28, 2).all((1, 3)).repeat(2, 0).repeat(2, 1)
    wanted = np.log2(np.maximum(longer_step(ours.uv) * 256, 1))
    assert np.ptp(wanted[inside]) > 1
    assert np.median(np.abs(frame.lod - wanted)[inside]) < LOOKED_UP
    assert np.abs(frame.lod - wanted)[inside].max() < 0.1
    # The library's level follows from the longer axis of a footprint.
    assert (frame.lod - ours.lod)[inside].max() < 0.1
    assert np.median(np.abs(frame.lod - ours.lod)[inside]) < 0.1
    for empty in (frame.image, frame.uv, frame.lod):
        assert not empty[frame.id == 0].any()


@pytest.mark.parametrize("view", [SLANTED, BALL], ids=lambda view: view.name)
def test_the_picture_mixes_the_levels_that_lod_says(standard: Any, view: View) -> None:
    mixed = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (0, 1, 1), (1, 0, 1), (1, 1, 1)]
    black, white, shown = (
        standard.render(constant(colours, (64, 64), stamp), view)
        for colours, stamp in (([(0, 0, 0)] * 7, 300), ([(1, 1, 1)] * 7, 310), (mixed, 320))
    )
    covered = shown.id > 0
    lod = shown.lod[covered].astype(np.float64)
    low = np.minimum(lod.astype(int), len(mixed) - 2)
    share = (lod - low)[:, None]
    wanted = (1 - share) * np.asarray(mixed)[low] + share * np.asarray(mixed)[low + 1]
    span = (white.image - black.image)[covered]
    lit = span.min(-1) > 0.01
    found = (shown.image - black.image)[covered] / np.maximum(span, 1e-6)
    assert len(np.unique(low[lit])) > 1
    np.testing.assert_allclose(found[lit], wanted[lit], atol=0.02)


def test_radiance_is_the_irradiance_of_a_surface_that_faces_the_light(standard: Any) -> None:
    view = View("sphere", "near", sphere(), orbit(4, 30, 20), LIGHT, (32, 32))
    levels = constant([(1, 1, 1)], (4, 4), 400)
    frame = standard.render(levels, view)
    ours = candidate(view.mesh, view.camera, LIGHT, stored(levels), "gltf", levels.wrap, view.size)
    lit = (frame.id > 0) & ours.coverage & (ours.image[..., 0] > 0.2)
    assert lit.sum() > 100
    # Rough and not metallic: what the two shaders differ in is a small part of it.
    np.testing.assert_allclose(frame.image[lit], ours.image[lit], rtol=0.1)


def test_tiles_are_uploaded_one_by_one(standard: Any) -> None:
    views = [SLANTED, BALL, View("near", "near", plane(8, 8), orbit(4, 0, 60), LIGHT, (40, 56))]
    check_tiles(standard, views, (130, 300))


def test_materials_differ(build: None) -> None:
    plain = constant([(0.5, 0.5, 0.5)] * 7, roughness=0.4)
    sizes = plain.sizes
    more = {
        "anisotropy_direction": [np.full((*each, 2), (1, 0.5), np.float32) for each in sizes],
        "anisotropy_strength": [np.full((*each, 1), 0.9, np.float32) for each in sizes],
    }
    brushed = Levels("gltf-anisotropic", {**plain.maps, **more}, plain.wrap, plain.stamps)
    seen = []
    for material in MATERIALS:
        with made(material) as renderer:
            seen += [renderer.render(plain, BALL).image, renderer.render(brushed, BALL).image]
    assert all(np.isfinite(image).all() for image in seen)
    assert all(np.abs(a - b).max() > 0.01 for n, a in enumerate(seen) for b in seen[:n])


# ---- failures


@pytest.mark.parametrize(
    ("script", "message"),
    [
        (
            "Geometry.prototype.setIndex = () => { console.log('so far', 1); throw new Error('torn'); };",
            "torn.*so far 1",
        ),
        ("Geometry.prototype.setIndex = () => { setTimeout(() => { later(); }); };", "later is not defined"),
        ("ShaderChunk.common += '\\nnone';", "a shader does not compile.*syntax error"),
    ],
)
def test_a_page_that_fails_is_an_error(
    build: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, message: str
) -> None:
    """three.js with more code at its end, which finds BufferGeometry as `Geometry`."""
    module = tmp_path / "node_modules/three/build/three.module.js"
    shutil.copytree(MODULES / "three/build", module.parent)
    named = "import { BufferGeometry as Geometry } from './three.core.js';\n"
    module.write_text(f"{named}{module.read_text(encoding='utf-8')}\n{script}\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with made() as renderer, pytest.raises(RendererError) as caught:
        for _ in range(200):  # a timer of the page may wait for a second, because browsers slow pages that nobody sees
            renderer.render(constant([(1, 1, 1)]), SLANTED)
    assert re.search(message, str(caught.value), re.DOTALL)


def test_a_program_that_is_no_browser_is_an_error(build: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "chromium").symlink_to(shutil.which("false") or "false")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RendererError, match="Chromium ended with status 1"):
        made()


@pytest.mark.skipif(sys.platform != "linux", reason="looks at processes as Linux shows them")
def test_nothing_of_chromium_is_left(build: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIPBAKE_TEST", str(tmp_path))  # what tells its processes apart

    def running() -> list[Path]:
        return [each for each in Path("/proc").glob("[0-9]*/environ") if str(tmp_path).encode() in content(each)]

    def content(path: Path) -> bytes:
        with suppress(OSError):
            return path.read_bytes()
        return b""

    renderer = made()
    assert len(running()) > 2
    renderer.close()
    assert running() == []


def test_levels_that_it_cannot_draw_are_named(standard: Any) -> None:
    levels = constant([(1, 1, 1)] * 3)
    with pytest.raises(UsageError, match="no model 'ggx'"):
        standard.render(Levels("ggx", levels.maps, levels.wrap, levels.stamps), SLANTED)
    assert standard.render(levels, SLANTED).image.any()


def test_what_is_missing_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NODE_PATH", raising=False)
    with pytest.raises(UsageError, match="npm install three@"):
        three_folder()
    build = tmp_path / "node_modules/three/build"
    build.mkdir(parents=True)
    (build / "three.module.js").touch()
    (tmp_path / "deeper").mkdir()
    monkeypatch.chdir(tmp_path / "deeper")
    assert three_folder() == build.resolve()
    monkeypatch.setenv("PATH", "")
    with pytest.raises(UsageError, match="install Chromium"):
        made()
    with pytest.raises(UsageError, match="no material 'wax'"):
        made("wax")
