"""benchmarks/engines: levels in renderers that share no code with mipbake; and that what is broken is noticed."""

from __future__ import annotations

import importlib
import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from .test_metrics_films import needs_cvvdp

ENGINES = Path(__file__).parents[1] / "benchmarks" / "engines"

pytestmark = [pytest.mark.independent, pytest.mark.long]


@pytest.fixture
def engines(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The folder's scripts can be imported."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(ENGINES)
    yield
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(ENGINES)):
            del sys.modules[name]


@pytest.fixture
def web(engines: None) -> None:
    """Chromium, the npm packages and the encoder of UASTC are there."""
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed (the extra `checks`)")
    pytest.importorskip("alktx2", reason="alktx2, which encodes UASTC, is not installed")
    if not (ENGINES / "node_modules").is_dir():
        pytest.skip("the npm packages are not installed (npm ci --prefix benchmarks/engines)")
    if not any(shutil.which(name) for name in ("chromium", "chromium-browser", "google-chrome")):
        pytest.skip("Chromium is not installed")


def test_openimageio_reads_the_levels(engines: None) -> None:
    assert importlib.import_module("oiio_proof").main() == 0


def test_openimageio_is_seen_to_read_another_level(engines: None) -> None:
    proof = importlib.import_module("oiio_proof")
    write = proof.WRITERS["exr"]

    def repeated(levels: list[np.ndarray], folder: Path) -> Path:
        finer = [
            np.ascontiguousarray(levels[max(0, i - 1)][:: 1 + (i > 0), :: 1 + (i > 0)]) for i in range(len(levels))
        ]
        return Path(write(finer, folder))

    assert proof.main({"exr": repeated}) == 1


def test_three_and_filament_sample_the_levels_of_a_glb(web: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["gltf_proof.py"])
    assert importlib.import_module("gltf_proof").main() == 0


def test_a_level_that_is_missing_in_a_glb_is_seen(web, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["gltf_proof.py"])
    squares: ModuleType = importlib.import_module("glb_squares")
    coloured = squares.level_coloured

    def broken(side: int, colour: bool) -> object:
        made = coloured(side, colour)
        made.levels[3][:] = made.levels[2][0, 0]
        return made

    monkeypatch.setattr(squares, "level_coloured", broken)
    assert importlib.import_module("gltf_proof").main() == 1
    said = capsys.readouterr().err
    assert all(f"{engine}: level 3 shows" in said for engine in ("three", "filament"))
    assert "level 5 shows" not in said


def test_three_samples_custom_levels_of_every_container(web: None, tmp_path: Path) -> None:
    page, levels = importlib.import_module("three_page"), importlib.import_module("three_levels")
    with page.opened_three(tmp_path) as three:
        seen = levels.check_levels(three)
    kinds = importlib.import_module("engine_textures").KINDS
    assert len(seen) == len(kinds) + 1  # all but level 0 in floats, and two checks of levels that WebGL makes


@needs_cvvdp
def test_a_set_of_the_gallery_is_filmed_once(web: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    gallery = importlib.import_module("three_gallery")
    results = tmp_path / "results.json"
    small = ("--size", "128", "--height", "32", "--frames", "3", "--samples", "8")
    monkeypatch.setattr(sys, "argv", ["", str(tmp_path), *small, "--only", "black_tiles", "--results", str(results)])
    gallery.main()
    found = json.loads(results.read_text())["sets"]["black_tiles"]
    assert set(found) == {"plain MIP maps", "mipbake"} and all(0 < each["jod"] < 10 for each in found.values())
    picture = Image.open(tmp_path / "gallery-black_tiles.webp")
    # WebP keeps one of frames that are alike, as small ones may be.
    assert picture.n_frames <= 4 and picture.width > 3 * 48 and np.asarray(picture.convert("RGB")).std() > 10
    monkeypatch.setattr(gallery, "filmed", None)
    gallery.main()  # takes what is there
