"""Pages that quote the code stay in step with it, and what makes their pictures and tables works."""

from __future__ import annotations

import importlib
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mipbake.baking.bake import DEFAULT_METHOD
from mipbake.baking.methods import METHODS
from mipbake.comparing.meshes import mesh_render
from mipbake.quality import environment
from mipbake.source.layout import PROJECT

from .quick_methods import quick_methods
from .source_tree import NATIVE, modules

ROOT = Path(__file__).resolve().parent.parent


def test_pages_install_what_was_tested() -> None:
    """Every command that installs this folder takes the versions of constraints.txt."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").glob("*/*.md")]
    commands = [c for page in pages for c in re.findall(r"pip install .*", page.read_text(encoding="utf-8"))]
    ours = [command for command in commands if re.search(r"[ '\"]\.(\[|\s)", command)]
    assert len(ours) >= 4
    assert all(command.startswith("pip install -c constraints.txt ") for command in ours)


PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in ("", "docs", "examples", "benchmarks", "models", "training", "cli", "mipbake", "csrc", "tests")
    for path in (ROOT.glob("*.md") if not folder else (ROOT / folder).rglob("*.md"))
    if "node_modules" not in path.parts
)


def prose(text: str) -> list[tuple[int, str]]:
    """Numbered lines outside of tables and of code in fences."""
    lines, fenced = [], False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif not fenced and not line.lstrip().startswith("|"):
            lines.append((number, line))
    return lines


CODE = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in ("mipbake", "models", "training", "cli", "csrc", "benchmarks", "docs", "examples", "tests", ".ci")
    for path in (ROOT / folder).rglob("*.*")
    if path.suffix in {".py", ".h", ".cpp", ".cu"} and "node_modules" not in path.parts
)
FILE_NAME = re.compile(r"(?<![\w/.*<>-])([\w./-]*\w\.py)\b(?!-)")
MODULE_NAME = re.compile(r"(?<![\w./-])(mipbake(?:\.[a-z_]\w*)+)(?![\w/])")
MADE_UP = ("tests/", "docs/engines/", "CHANGELOG.md")
"""Pages and files that name what is made up, other people's, or gone."""


def test_python_files_and_modules_that_are_named_are_there() -> None:
    """In pages, in comments and in code."""

    def is_there(name: str) -> bool:
        """Whether a module is, or the first name that follows its own."""
        if name.startswith(NATIVE) or name == PROJECT:
            return True
        module = next(m for m in (name.rsplit(".", up)[0] for up in range(name.count(".") + 1)) if m in modules())
        rest = name.removeprefix(module).strip(".").partition(".")[0]
        return re.search(rf"\b{rest}\b", modules()[module].read_text(encoding="utf-8")) is not None

    gone = []
    for text in (text for text in (*PAGES, *CODE) if not text.startswith(MADE_UP)):
        content = (ROOT / text).read_text(encoding="utf-8")
        files = {
            name for name in FILE_NAME.findall(content) if not any(f"/{each}".endswith(f"/{name}") for each in CODE)
        }
        names = {name for name in MODULE_NAME.findall(content) if not is_there(name)}
        gone += [f"{text}: {name}" for name in sorted(files | names)]
    assert not gone, gone


LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(#[^)\s]*)?\)")


def anchors(text: str) -> set[str]:
    """What links may name after a #: headings, as GitHub writes them."""
    heads = [line.lstrip("#").strip().lower() for _, line in prose(text) if line.startswith("#")]
    return {"#" + re.sub(r"[^\w\- ]", "", head).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("folder", sorted({page.partition("/")[0] for page in PAGES}))
def test_links_lead_somewhere(folder: str) -> None:
    for page in (each for each in PAGES if each.partition("/")[0] == folder):
        check_links(page)


def check_links(page: str) -> None:
    path = ROOT / page
    lines = [line for _, line in prose(path.read_text(encoding="utf-8")) if not line.startswith("    ")]  # or code
    for file, anchor in LINK.findall(re.sub(r"`[^`]*`", "", "\n".join(lines))):
        if "://" in file or file.startswith("mailto:"):
            continue
        goal = (path.parent / file).resolve() if file else path
        assert goal.exists(), f"{page} links {file}, which is not there"
        if anchor and goal.suffix == ".md":
            there = anchors(goal.read_text(encoding="utf-8"))
            assert anchor in there, f"{page}: {file or page} has no heading {anchor}"


def test_the_soup_of_the_page_of_fits_becomes_its_picture() -> None:
    text = (ROOT / "docs" / "fit.md").read_text(encoding="utf-8")
    [code] = [block for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "stochastic.perturb" in block]
    before, loop = code.split("\nfor step in ")
    names: dict[str, Any] = {}
    exec(before, names)
    error = [float(np.square(names["render"](names["soup"])[0] - names["wanted"]).mean())]
    exec(f"for step in {loop}", names)
    error.append(float(np.square(names["render"](names["soup"])[0] - names["wanted"]).mean()))
    assert error[1] < 0.1 * error[0]


Script = Callable[..., str]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Script:
    """Runs docs/<name>.py with arguments, in this process because importing torch takes seconds; what it prints.

    The default method searches with little effort.
    """
    monkeypatch.syspath_prepend(ROOT / "docs")
    monkeypatch.setitem(METHODS, DEFAULT_METHOD, quick_methods()[DEFAULT_METHOD])

    def run(name: str, *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        importlib.import_module(name).main()
        return capsys.readouterr().out

    return run


@pytest.mark.long
def test_the_picture_of_the_readme(script: Script, tmp_path: Path) -> None:
    figures = ("--figures", tmp_path / "figures.json")
    said = script("make_picture", tmp_path / "scales.png", "--side", 24, "--passes", 16, *figures)
    assert len(re.findall(r"linear -?\d+\.\d dB, mipbake -?\d+\.\d dB", said)) == 4
    picture = np.asarray(Image.open(tmp_path / "scales.png"))
    assert picture.shape[1] == 4 * 24 + 5 * 10 and picture.std() > 10
    data = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    told = re.findall(r"linear (-?\d+\.\d) dB", said)
    assert [f"{each['snr']['linear']:.1f}" for each in data["scales"].values()] == told
    caption = importlib.import_module("records.views").scales_caption({"picture": data})
    mean = sum(each["snr"]["linear"] for each in data["scales"].values()) / 4
    assert f"{mean:.1f} dB with plain MIP maps" in caption.replace("\n", " ")


@pytest.mark.long
def test_the_animation_of_the_readme(script: Script, tmp_path: Path) -> None:
    figures = ("--figures", tmp_path / "figures.json")
    said = script("make_animation", tmp_path / "shimmer.webp", "--side", 24, "--passes", 4, "--frames", 3, *figures)
    assert re.search(r"linear: flicker \S+, SNR .* dB\nmipbake: flicker", said)
    animation = Image.open(tmp_path / "shimmer.webp")
    assert animation.n_frames == 3 and animation.info["loop"] == 0
    data = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    flicker = re.findall(r"flicker (\S+),", said)
    assert flicker == [f"{each['flicker']:.2f}" for each in data["methods"].values()]
    assert f"change {flicker[1]} times" in importlib.import_module("records.views").shimmer_caption({"animation": data})


def test_the_animation_has_no_seam(script: Script) -> None:
    """The sphere looks the same after a whole turn of one repeat, and different before."""
    pictures = importlib.import_module("pictures")
    _, stacks = pictures.load(pictures.SET)
    stack = stacks[pictures.BAKED]
    at_rest = pictures.spheres(pictures.SET, environment.key(), 32)["near"]

    def image(turns: float) -> np.ndarray:
        view = pictures.turned(at_rest, 4, turns)
        shot = mesh_render.Shot(view.mesh, view.camera, view.lighting, (32, 32))
        return mesh_render.candidate(shot, stack.levels, stack.model, ("wrap", "wrap")).image

    start = image(0.0)
    assert np.abs(image(1.0) - start).max() < 1e-3 * start.max() < np.abs(image(0.5) - start).max()


def test_the_table_of_the_set_that_no_method_can_show(script: Script, tmp_path: Path) -> None:
    out, plate = tmp_path / "failure.json", tmp_path / "plate"
    plate.mkdir()
    for name, value in (("normal", (128, 128, 255)), ("base_color", (120,) * 3), ("roughness", (90,) * 3)):
        Image.fromarray(np.full((16, 16, 3), value, np.uint8)).save(plate / f"{name}.png")
    script("make_failure_table", out, "--set", plate, "--points", 16, "--samples", 2)
    data = json.loads(out.read_text(encoding="utf-8"))
    views = importlib.import_module("records.views")
    table = views.failure_table({"failure": data})
    assert len(re.findall(r"^\| (neural|linear \(box\)) (\| -?\d+\.\d ){8}\|$", table, re.MULTILINE)) == 2
    neural = data["methods"]["neural"]["near-mirror"]
    assert f"| neural | {neural['near']:.1f} | {neural['1:1']:.1f} |" in table
    best = max(row["hemisphere"]["far"] for row in data["methods"].values())
    assert f"or {best:.1f} dB over the" in views.failure_words({"failure": data}).replace("\n", " ")
