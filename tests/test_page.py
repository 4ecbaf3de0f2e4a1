"""The page in the browser: what is dropped is baked in it as the command line bakes it, and nothing leaves it."""

from __future__ import annotations

import base64
import importlib.util
import io
import json
import threading
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import mipbake
from mipbake.cli.gui_bakes import Bench
from mipbake.source.names import classify
from mipbake.stack.output import Output
from mipbake.stack.packing import SEPARATE
from mipbake.stack.verdict import DISTANCES, in_words

from .command_line import run
from .gltf_files import GltfFile
from .gltf_files import png as png_of
from .gui_pages import serving
from .input_files import encoded, height_field, plain_set, write_image, write_set

pytestmark = pytest.mark.independent

WEB = Path(__file__).resolve().parent.parent / "web"
PHONE = {"width": 390, "height": 700}


class _Silent(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        pass

    def handle(self) -> None:
        with suppress(ConnectionError):  # pages that close do not wait for the end of what they fetch
            super().handle()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of the site, put together anew."""
    if not all((WEB / name).exists() for name in ("dist/bakes.wasm", "src/index.js")):
        pytest.skip("the core is not compiled to WebAssembly: python web/build.py does it")
    spec = importlib.util.spec_from_file_location("page_build", WEB / "page_build.py")
    assert spec and spec.loader
    builder = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(builder)
    folder = tmp_path_factory.mktemp("site")
    builder.assemble(folder)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Silent, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()


@pytest.fixture
def opened(browser: Any, site: str) -> Iterator[Callable[..., Any]]:
    """Opens the page; in the end, fails on what the browser complained about or asked other places for."""
    complaints: list[str] = []
    contexts = []

    def made(url: str = site, **options: Any) -> Any:
        contexts.append(browser.new_context(viewport=PHONE, **options))
        page = contexts[-1].new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
        page.on("request", lambda r: None if r.url.startswith((url, "data:", "blob:")) else complaints.append(r.url))
        page.goto(url)
        page.wait_for_selector("#privacy:not(:empty)", state="attached")
        return page

    yield made
    for context in contexts:
        context.close()
    # A second WebGL context takes the place of one that the page gives back.
    quiet = ("GL Driver Message", "software WebGL", "CONTEXT_LOST_WEBGL")
    assert [c for c in complaints if not any(words in c for words in quiet)] == []


def drop(page: Any, *files: Path) -> None:
    page.set_input_files("#file-input", [str(file) for file in files])


def baked(page: Any) -> str:
    """The verdict, once all is done."""
    page.wait_for_function(
        "() => !document.getElementById('download').hidden || !document.getElementById('problem').hidden", timeout=90000
    )
    assert not page.is_visible("#problem"), page.inner_text("#problem")
    return str(page.inner_text("#verdict"))


def problem(page: Any) -> str:
    page.wait_for_selector("#problem:not([hidden])")
    return str(page.inner_text("#problem"))


def downloaded(page: Any, link: str = "#download") -> dict[str, bytes]:
    with page.expect_download() as waiting:
        page.click(link)
    with zipfile.ZipFile(waiting.value.path()) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def pixels(content: bytes) -> np.ndarray:
    found = np.asarray(Image.open(io.BytesIO(content)))
    return found if found.ndim == 3 else found[..., None]


def test_a_dropped_set_is_baked_as_the_command_line_bakes_it(opened: Callable[..., Any], tmp_path: Path) -> None:
    folder = plain_set(tmp_path / "wood", metallic="metallic", ao="occlusion")
    page = opened()
    page.set_input_files("#folder-input", str(folder))
    assert baked(page).split(".")[1:] and page.locator(".mv-name").all_inner_texts() == ["plain", "mipbake", "truth"]
    files = downloaded(page)
    mipbake.bake(folder, "neural").save(tmp_path / "native", [Output("png", SEPARATE)])
    native = sorted((tmp_path / "native").glob("*_mip*.png"))
    assert len(native) == 5 * 6
    for file in native:
        role, level = file.stem.rsplit("_mip", 1)
        ours = pixels(files[f"wood/png/wood_{role}_mip{level}.png"]).astype(int)
        assert np.abs(ours - pixels(file.read_bytes()).astype(int)).max() <= 1, file.name
    assert {Path(name).name.split("_")[-1] for name in files if name.endswith(".ktx2")} == {
        "baseColor.ktx2",
        "normal.ktx2",
        "occlusionRoughnessMetallic.ktx2",
    }
    place = tmp_path / "normal.ktx2"
    place.write_bytes(next(content for name, content in files.items() if name.endswith("_normal.ktx2")))
    code, said = run("info", place, "--json")
    assert code == 0 and "UASTC" in said.upper(), json.loads(said)


def test_packed_maps_alpha_and_green_down_are_as_on_the_command_line(opened, tmp_path):
    rng = np.random.default_rng(3)
    colour = rng.integers(20, 235, (32, 32, 4)).astype(np.uint8)
    colour[..., 3] = np.where(rng.random((32, 32)) < 0.3, 0, 255)
    down = encoded(height_field(32, 32), directx=True)  # which no name says
    files = {"fern_diff.png": colour, "fern_nor.png": down, "fern_arm.png": "packed"}
    folder = write_set(tmp_path / "fern", files)
    page = opened()
    page.set_input_files("#folder-input", str(folder))
    baked(page)
    files = downloaded(page)
    mipbake.bake(folder, "neural").save(tmp_path / "native", [Output("png", SEPARATE)])
    for file in sorted((tmp_path / "native").glob("*_mip*.png")):
        role, level = file.stem.rsplit("_mip", 1)
        ours = pixels(files[f"fern/png/fern_{role.replace('opacity', 'base_color')}_mip{level}.png"]).astype(int)
        found = ours[..., 3:] if role == "opacity" else ours[..., :3]
        assert np.abs(found - pixels(file.read_bytes()).astype(int)).max() <= 1, file.name
    assert page.evaluate("() => document.getElementById('viewer').viewer.scene.images[0].model") == "gltf"


def test_archives_and_documents_with_several_materials(opened: Callable[..., Any], tmp_path: Path) -> None:
    archive = tmp_path / "all.zip"
    with zipfile.ZipFile(archive, "w") as written:
        for index, (name, method) in enumerate((("stone", zipfile.ZIP_DEFLATED), ("metal", zipfile.ZIP_STORED))):
            for file in plain_set(tmp_path / name).iterdir():
                written.write(file, f"{name}/textures/{file.name}" if index else f"{name}/{file.name}", method)
    page = opened()
    drop(page, archive)
    baked(page)
    page.click("#maps summary")
    chooser = page.locator("#choices select").first
    assert chooser.locator("option").all_inner_texts() == ["stone", "metal"]
    chooser.select_option("metal")
    baked(page)
    assert any(name.startswith("metal/png/metal_normal_mip00") for name in downloaded(page))
    document = GltfFile()
    for kind in ("normal", "rough"):
        document.texture(document.image(png_of(kind), kind))
    slots = {
        "normalTexture": {"index": 0, "scale": 0.5},
        "pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 1}},
    }
    document.material("plate", **slots)
    document.material("bare")
    place = document.write(tmp_path / "scene.glb")
    page.click("#again")
    drop(page, place)
    baked(page)
    names = downloaded(page)
    assert {name.split("/")[0] for name in names} == {"plate"} and not page.is_visible("#problem")


def test_plain_mip_maps_are_offered_where_a_bake_is_not_better(opened: Callable[..., Any], tmp_path: Path) -> None:
    smooth = np.full((16, 16, 3), (128, 128, 255), np.uint8)
    paper = {"base_color": np.full((16, 16, 3), 120, np.uint8), "roughness": np.full((16, 16), 200, np.uint8)}
    folder = plain_set(tmp_path / "card", normal_gl=smooth, **paper)
    page = opened()
    page.set_input_files("#folder-input", str(folder))
    assert baked(page).startswith("No visible gain at any distance. Plain MIP maps look the same")
    page.wait_for_selector("#plain:not([hidden])")
    found = downloaded(page, "#plain")
    source = pixels((folder / "base_color.png").read_bytes()).astype(int)
    assert np.abs(pixels(found["card/png/card_base_color_mip00.png"]).astype(int) - source).max() <= 1


def test_what_cannot_be_baked_is_said_in_a_sentence(opened: Callable[..., Any], tmp_path: Path) -> None:
    page = opened()
    folder = plain_set(tmp_path / "wood")
    odd = folder / "wear.png"
    (folder / "roughness.png").rename(odd)
    drop(page, *sorted(folder.iterdir()))
    assert "is the roughness map" in problem(page)
    page.get_by_label("Roughness").select_option(label="wear.png")
    page.click("#bake")
    baked(page)
    write_image(folder / "rough.png", np.zeros((8, 8), np.uint8))
    write_image(folder / "roughness.png", np.zeros((8, 8), np.uint8))
    drop(page, *sorted(folder.iterdir()))
    assert problem(page) == "rough.png and roughness.png all look like the roughness map: choose one."
    broken = tmp_path / "bad"
    broken.mkdir()
    for name, expected in (
        ("scene.glb", "is no .glb file"),
        ("all.zip", "cannot be opened"),
        ("wood_normal.exr", "browsers do not read"),
        ("notes.txt", "No image is in there"),
    ):
        (broken / name).write_bytes(b"nothing of use")
        drop(page, broken / name)
        page.wait_for_function(f"() => document.getElementById('problem').textContent.includes({json.dumps(expected)})")
        assert page.is_visible("#start")
    for name in ("wood_normal.png", "wood_roughness.png"):
        (broken / name).write_bytes(b"nothing of use")
    drop(page, broken / "wood_normal.png", broken / "wood_roughness.png")
    page.wait_for_function(
        "() => document.getElementById('problem').textContent.includes('cannot be read as an image')"
    )


def test_what_is_transparent_keeps_its_colours(opened: Callable[..., Any], tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (7, 5, 4)).astype(np.uint8)
    image[..., 3] = rng.choice([0, 3, 128, 255], (7, 5))
    content = base64.b64encode(write_image(tmp_path / "a.png", image).read_bytes()).decode()
    read, again = opened().evaluate(
        """async (content) => {
            const { decoded, png } = await import('./images.js');
            const image = await decoded(await (await fetch(`data:image/png;base64,${content}`)).blob(), 'a.png');
            return [[...image.data], [...await png(image)]];
        }""",
        content,
    )
    assert np.array_equal(np.array(read).reshape(image.shape), image)
    assert np.array_equal(pixels(bytes(again)), image)


def test_it_works_without_a_network_and_by_the_keyboard(opened: Callable[..., Any]) -> None:
    page = opened(color_scheme="dark")
    page.evaluate("() => navigator.serviceWorker.ready")
    page.context.set_offline(True)
    page.reload()
    words = page.inner_text("body").split()
    assert len(words) < 150 and "uploaded:" in words
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    for _ in range(6):
        page.keyboard.press("Tab")
        if page.evaluate("() => document.activeElement.id") == "example":
            break
    page.keyboard.press("Enter")
    assert "truer to the source" in baked(page)
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    reached = []
    for _ in range(4):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("() => document.activeElement.id || document.activeElement.tagName"))
    assert reached[0] == "download" and "CANVAS" in reached
    while page.evaluate("() => document.activeElement.tagName") != "CANVAS":
        page.keyboard.press("Shift+Tab")
    page.keyboard.press("f")
    assert page.evaluate("() => document.getElementById('viewer').viewer.view.away") == "far"


def test_the_page_of_mipbake_gui_bakes_with_the_program(opened: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "work").mkdir()
    with serving(Bench(tmp_path / "work", plain_set(tmp_path / "wood"))) as server:
        page = opened(server.url)
        baked(page)  # what the command line named
        assert page.locator("#invitation").is_hidden() and "wood" in page.title()
        page.click("#again")
        page.locator("#engine select").select_option("unreal")
        page.set_input_files("#folder-input", str(plain_set(tmp_path / "stone")))
        assert baked(page).endswith((".", ")"))
        assert "In Unreal Engine: keep Mip Gen Settings" in page.inner_text("#notes")
        assert {"stone/T_stone_BC.dds", "stone/T_stone_N.dds"} < set(downloaded(page))


def test_verdicts_have_the_words_of_the_command_line(opened: Callable[..., Any]) -> None:
    page = opened()
    effects = [dict(zip(DISTANCES, each, strict=True)) for each in product((1, 0, -1), repeat=3)]
    found = page.evaluate(
        "async (all) => { const { inWords } = await import('./verdict.js'); return all.map(inWords); }", effects
    )
    for each, ours in zip(effects, found, strict=True):
        theirs = in_words(each)
        assert ours["sentence"] == theirs.sentence
        assert ours["better"] == (theirs.outcome in ("gains", "mixed"))
        assert ("keep them" in ours["advice"]) == (theirs.outcome == "loses")


NAMES = (
    "rusty_metal_02_diff_1k rusty_metal_02_nor_gl_1k rusty_metal_02_arm_1k rusty_metal_02_disp_1k",
    "Metal007_1K-JPG_Color Metal007_1K-JPG_NormalGL Metal007_1K-JPG_NormalDX Metal007_1K-JPG_Roughness Metal007",
    "T_Brick_BC T_Brick_N T_Brick_ORM T_Brick_H",
    "wood_basecolor wood_gloss wood_normal_ogl wood_ao wood_specular wood_opacity",
    "Concrete044D roughness normals heightmap metalness gunmetal woodcolor",
    "leather_COLOR_VAR1_2K leather_COLOR_VAR2_2K leather_NRM_2K leather_GLOSS_2K leather_REFL_2K",
    "tile_MetallicSmoothness tile_AlbedoTransparency tile_Normal tile_MaskMap tile_detail_mask",
    "Poliigon_Wood_Color_2K_METALNESS Poliigon_Wood_Metalness_2K_METALNESS brushed_metal_rough brushed_metal_nor",
    "color(1) stone_rough_copy stone_nor.dx rock-albedo rockRoughness rock_aniso rock_cavity",
)


def test_names_mean_what_they_mean_to_the_command_line(opened: Callable[..., Any]) -> None:
    page = opened()
    for names in NAMES:
        stems = names.split(" ")
        found = page.evaluate("async (stems) => (await import('./names.js')).classify(stems)", stems)
        expected = classify(stems)
        assert len(found) == len(expected)
        for stem, ours, theirs in zip(stems, found, expected, strict=True):
            if theirs is None:
                assert ours is None, stem
                continue
            assert [
                (m["role"], m["inverted"], m["rank"], m["convention"] or None, m["variant"]) for m in ours["meanings"]
            ] == [(m.role, m.inverted, m.rank, m.convention, m.variant) for m in theirs.meanings], stem
            assert (ours["word"], ours["asset"]) == (theirs.word, theirs.asset)
