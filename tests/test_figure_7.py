"""docs/make_figure_7.py: the page of one material in every model."""

from __future__ import annotations

import importlib
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
MODELS = ("ggx", "beckmann", "gltf", "gltf-anisotropic")


def test_the_page_of_figure_7(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs")
    figure = importlib.import_module("make_figure_7")
    monkeypatch.setattr(figure, "networks", lambda source, output: [])
    monkeypatch.setattr(figure, "MODELS", MODELS[:2])
    monkeypatch.setattr(figure, "SCALES", ("near",))
    plate = tmp_path / "plate"
    plate.mkdir()
    values = {"normal": (128, 128, 255), "base_color": (180,) * 3, "roughness": (170,) * 3, "metallic": (255,) * 3}
    for name, value in values.items():
        Image.fromarray(np.full((16, 16, 3), value, np.uint8)).save(plate / f"{name}.png")
    page = tmp_path / "figure.md"
    arguments = [page, "--figures", tmp_path / "f.json", "--set", plate, "--side", 16, "--passes", 32]
    arguments += ["--methods", "linear", "lean"]
    monkeypatch.setattr(sys, "argv", ["make_figure_7", *map(str, arguments)])
    figure.main()
    text = figure.page_of(json.loads((tmp_path / "f.json").read_text(encoding="utf-8")), "figure")
    assert re.findall(r"\((figure-[\w-]+\.webp)\)", text) == [f"figure-{model}.webp" for model in MODELS[:2]]
    rows = re.findall(r"^\| `([\w-]+)` \| (-?[\d.]+) \| (-?[\d.]+) \|$", text, re.MULTILINE)
    assert [source for source, _, _ in rows] == [*MODELS[:2]] and "The table has the SNR of `lean` in dB, near." in text
    # On a constant metal a stack in the model of its input lacks the pixel filter alone, another one has another lobe.
    (_, *ggx), (_, *beckmann) = [[float(cell) if index else cell for index, cell in enumerate(row)] for row in rows]
    assert ggx[0] > ggx[1] + 3 and beckmann[1] > beckmann[0] + 3
    picture = np.asarray(Image.open(tmp_path / "figure-ggx.webp"))
    assert picture.shape[1] == figure.LEFT + 3 * (16 + figure.GAP) and picture.std() > 10
