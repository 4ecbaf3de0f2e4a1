"""Pages that quote the code stay in step with it, and what makes their pictures and tables works."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mipbake.render import environment, mesh_render

ROOT = Path(__file__).resolve().parent.parent


def test_the_primitives_page_quotes_the_docstrings() -> None:
    run = subprocess.run(
        [sys.executable, ROOT / "docs" / "make_primitives_page.py", "--check"],
        check=False,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr


def test_pages_install_what_was_tested() -> None:
    """Every command that installs this folder takes the versions of constraints.txt."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").glob("*/*.md")]
    commands = [c for page in pages for c in re.findall(r"pip install .*", page.read_text(encoding="utf-8"))]
    ours = [command for command in commands if re.search(r"[ '\"]\.(\[|\s)", command)]
    assert len(ours) >= 4
    assert all(command.startswith("pip install -c constraints.txt ") for command in ours)


Script = Callable[..., str]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Script:
    """Runs docs/<name>.py with arguments, in this process because importing torch takes seconds; what it prints."""
    monkeypatch.syspath_prepend(ROOT / "docs")

    def run(name: str, *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        importlib.import_module(name).main()
        return capsys.readouterr().out

    return run


def test_the_picture_of_the_readme(script: Script, tmp_path: Path) -> None:
    said = script("make_picture", tmp_path / "scales.png", "--side", 24, "--passes", 16)
    assert len(re.findall(r"linear -?\d+\.\d dB, mipbake -?\d+\.\d dB", said)) == 4
    picture = np.asarray(Image.open(tmp_path / "scales.png"))
    assert picture.shape[1] == 4 * 24 + 5 * 10 and picture.std() > 10


def test_the_animation_of_the_readme(script: Script, tmp_path: Path) -> None:
    said = script("make_animation", tmp_path / "shimmer.webp", "--side", 24, "--passes", 4, "--frames", 3)
    assert re.search(r"linear: flicker \S+, SNR .* dB\nmipbake: flicker", said)
    animation = Image.open(tmp_path / "shimmer.webp")
    assert animation.n_frames == 3 and animation.info["loop"] == 0


def test_the_animation_has_no_seam(script: Script) -> None:
    """The sphere looks the same after a whole turn of one repeat, and different before."""
    pictures = importlib.import_module("pictures")
    _, stacks = pictures.load(pictures.SET)
    stack = stacks[pictures.BAKED]
    at_rest = pictures.spheres(pictures.SET, environment.key(), 32)["near"]

    def image(turns: float) -> np.ndarray:
        view = pictures.turned(at_rest, 4, turns)
        scene = (view.mesh, view.camera, view.lighting)
        return mesh_render.candidate(*scene, stack.levels, stack.model, ("wrap", "wrap"), (32, 32)).image

    start = image(0.0)
    assert np.abs(image(1.0) - start).max() < 1e-3 * start.max() < np.abs(image(0.5) - start).max()


def test_the_table_of_the_set_that_no_method_can_show(script: Script, tmp_path: Path) -> None:
    page, plate = tmp_path / "page.md", tmp_path / "plate"
    plate.mkdir()
    for name, value in (("normal", (128, 128, 255)), ("base_color", (120,) * 3), ("roughness", (90,) * 3)):
        Image.fromarray(np.full((16, 16, 3), value, np.uint8)).save(plate / f"{name}.png")
    page.write_text("before\n<!-- failure -->\nold\n<!-- end failure -->\nafter\n", encoding="utf-8")
    script("make_failure_table", page, "--set", plate, "--points", 16, "--samples", 2)
    text = page.read_text(encoding="utf-8")
    assert "old" not in text and text.startswith("before") and text.endswith("after\n")
    assert len(re.findall(r"^\| (neural|linear \(box\)) (\| -?\d+\.\d ){8}\|$", text, re.MULTILINE)) == 2
    page.write_text("nothing", encoding="utf-8")
    with pytest.raises(SystemExit):
        script("make_failure_table", page, "--set", plate, "--points", 16, "--samples", 2)
