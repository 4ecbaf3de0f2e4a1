"""The npm package in headless Chromium: it bakes what it bakes in Node, and decodes images without changing them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .input_files import bytes_of, encoded, height_field, write_image
from .test_web import WEB, in_javascript, needs_the_core

pytestmark = needs_the_core


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A page of a browser that finds the package at http://package.test; nothing else is there."""

    def answered(route: Any) -> None:
        path = route.request.url.removeprefix("http://package.test/")
        kinds = {".js": "text/javascript", ".wasm": "application/wasm", ".json": "application/json"}
        if not path:
            route.fulfill(body="<!doctype html><title>.</title>", content_type="text/html")
        else:
            kind = kinds.get(Path(path).suffix, "application/octet-stream")
            route.fulfill(body=(WEB / path).read_bytes(), content_type=kind)

    opened = browser.new_page()
    opened.set_default_timeout(60_000)
    opened.route("**/*", answered)
    opened.goto("http://package.test/")
    yield opened
    opened.close()


def test_browsers_bake_the_same(page: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    maps = {"normal": encoded(height_field(16, 24)), "roughness": bytes_of(rng.random((16, 24, 1)))}
    wanted = in_javascript(tmp_path, maps).stored
    given = {name: [*pixels.shape, pixels.ravel().tolist()] for name, pixels in maps.items()}
    found = page.evaluate(
        """async (given) => {
            const { bake } = await import('/src/index.js');
            const maps = {};
            for (const [name, [height, width, channels, values]] of Object.entries(given))
                maps[name] = { data: Uint8Array.from(values), width, height, channels };
            const found = [];
            for (const threads of [1, 3]) found.push(await bake(maps, { threads }));
            return found.map(({ stored }) => stored.map(({ data }) => [...data]));
        }""",
        given,
    )
    for each in found:
        for level, values in zip(wanted, each, strict=True):
            assert np.array_equal(level.ravel(), np.array(values, np.float32))
    assert len(page.workers) == 0


def test_browsers_decode_images_without_changing_them(page: Any, tmp_path: Path) -> None:
    pixels = np.random.default_rng(4).integers(0, 256, (5, 7, 4)).astype(np.uint8)
    pixels[0, :, 3] = 0  # colours that are not seen stay
    data = write_image(tmp_path / "a.png", pixels).read_bytes()
    found = page.evaluate(
        """async (bytes) => {
            const { decodedImage } = await import('/src/decode.js');
            const { data, width, height } = await decodedImage(Uint8Array.from(bytes), 'image/png', 'a');
            return [width, height, [...data]];
        }""",
        list(data),
    )
    assert found[:2] == [7, 5] and np.array_equal(np.array(found[2], np.uint8).reshape(5, 7, 4), pixels)
