"""Pages that quote the code stay in step with it, and what makes their pictures works."""

from __future__ import annotations

import ast
import importlib
import json
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import mipbake
from mipbake.comparing.meshes import mesh_render
from mipbake.material.aim import DEFAULT_AIM
from mipbake.quality import environment
from mipbake.quality.judging.terms import TERMS, weights_for
from mipbake.source.layout import PROJECT

from .source_tree import NATIVE, modules

ROOT = Path(__file__).resolve().parent.parent


def test_pages_install_what_was_tested() -> None:
    """Every command that installs this folder takes the versions of constraints.txt."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").glob("*/*.md")]
    commands = [c for page in pages for c in re.findall(r"pip install .*", page.read_text(encoding="utf-8"))]
    ours = [command for command in commands if re.search(r"[ '\"]\.(\[|\s)", command)]
    assert len(ours) >= 4
    assert all(command.startswith("pip install -c constraints.txt ") for command in ours)


FOLDERS = (
    *("mipbake", "models", "training", "cli", "csrc", "benchmarks", "docs", "examples", "integrations", "tests"),
    *("web", ".ci"),
)

PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in ("", *FOLDERS)
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
    for folder in FOLDERS
    for path in (ROOT / folder).rglob("*.*")
    if path.suffix in {".py", ".h", ".cpp", ".cu"} and "node_modules" not in path.parts
)
FILE_NAME = re.compile(r"(?<![\w/.*<>-])([\w./-]*\w\.py)\b(?!-)")
MODULE_NAME = re.compile(r"(?<![\w./-])(mipbake(?:\.[a-z_]\w*)+)(?![\w/])")
MADE_UP = ("tests/", "docs/engines/", "integrations/", "CHANGELOG.md")
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


def rows(page: str, head: str) -> list[list[str]]:
    """The cells of the tables of a page that have this first line."""
    found = []
    for part in (ROOT / page).read_text(encoding="utf-8").split(head + "\n")[1:]:
        lines = part.partition("\n\n")[0].splitlines()[1:]
        found += [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return found


def test_the_weights_of_the_method_are_those_of_the_code() -> None:
    said = {
        name: tuple(float(cell.strip("`")) for cell in row[2:])
        for row in rows("docs/method.md", "| term | error | counts | behind |")
        for name in re.findall(r"`([^`]+)`", row[0])
    }
    weights = weights_for(DEFAULT_AIM)
    assert said == {name: pytest.approx((weights.terms[name].counts, weights.terms[name].behind)) for name in TERMS}
    page = " ".join((ROOT / "docs/method.md").read_text(encoding="utf-8").split())
    assert f"+ {weights.group_behind:g} sum over pair sets" in page
    pairs, pictures = dict.fromkeys(each.tie for each in weights.terms.values())
    assert f"allowed = {pairs:g} + half the standard error" in page
    assert f"{pictures:g} in place of {pairs:g} for visible errors" in page


@cache
def functions(path: Path) -> frozenset[str]:
    tree = ast.parse(path.read_text(encoding="utf-8")) if path.is_file() else ast.Module([], [])
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef))


def test_what_shows_a_claim_of_a_source_is_there() -> None:
    found = rows("docs/sources.md", "| section | claim | state | shown by |")
    assert len(found) > 50
    for _, claim, state, shown in found:
        assert state in ("reproduced", "differs", "not here"), claim
        tests = re.findall(r"`(tests/[^`:]*)::([^`]*)`", shown)
        records = re.findall(r"records? `([^`]*)`", shown)
        assert [name for file, name in tests if name not in functions(ROOT / file)] == [], claim
        assert all((ROOT / "benchmarks" / "records" / f"{name}.json").is_file() for name in records), claim
        assert tests or records or state != "reproduced", claim


Script = Callable[..., Any]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Script:
    """Runs docs/<name>.py with arguments for small pictures of stacks that take no search; the figures that it kept."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    pictures = importlib.import_module("pictures")
    texture_set = mipbake.load(pictures.SET)
    stacks = {
        name: mipbake.bake(texture_set, "linear", pixel_filter=kernel)
        for name, kernel in ((pictures.PLAIN, "box"), (pictures.BAKED, "gaussian"))
    }
    monkeypatch.setattr(pictures, "load", lambda: (texture_set, stacks))

    def run(name: str, *arguments: object) -> Any:
        kept = tmp_path / "figures.json"
        monkeypatch.setattr(sys, "argv", [name, *map(str, (tmp_path, *arguments, "--results", kept))])
        importlib.import_module(name).main()
        return json.loads(kept.read_text(encoding="utf-8"))

    return run


def test_the_picture_of_the_readme(script: Script, tmp_path: Path) -> None:
    found = script("make_picture", "--side", 24, "--passes", 16)
    assert len(found["scales"]) == 4 and all(
        -20 < each["snr"]["plain MIP maps"] < 40 for each in found["scales"].values()
    )
    picture = np.asarray(Image.open(tmp_path / "scales.png"))
    assert picture.shape[1] > 4 * 24 and picture.std() > 10
    caption = importlib.import_module("records.views").scales_caption({"picture": found})
    near = found["scales"]["near"]["snr"]
    more = 10 ** ((near["mipbake"] - near["plain MIP maps"]) / 10)
    assert f"is {more:.1f} times that of mipbake near" in caption.replace("\n", " ")


def test_the_animation_of_the_readme(script: Script, tmp_path: Path) -> None:
    found = script("make_animation", "--side", 24, "--passes", 4, "--frames", 3)
    animation = Image.open(tmp_path / "shimmer.webp")
    assert animation.n_frames == 3 and animation.info["loop"] == 0
    flicker = found["methods"]["mipbake"]["flicker"]
    assert f"mipbake changes {flicker:.2f} times" in importlib.import_module("records.views").shimmer_caption(
        {"animation": found}
    ).replace("\n", " ")


def test_the_animation_has_no_seam(script: Script) -> None:
    """The sphere looks the same after a whole turn of one repeat, and different before."""
    pictures = importlib.import_module("pictures")
    stack = pictures.load()[1][pictures.BAKED]
    at_rest = pictures.spheres(environment.key(), 32)["near"]

    def image(turns: float) -> np.ndarray:
        view = pictures.turned(at_rest, 4, turns)
        shot = mesh_render.Shot(view.mesh, view.camera, view.lighting, (32, 32))
        return mesh_render.candidate(shot, stack.levels, stack.model, ("wrap", "wrap")).image

    start = image(0.0)
    assert np.abs(image(1.0) - start).max() < 1e-3 * start.max() < np.abs(image(0.5) - start).max()


def test_the_pictures_of_figure_7(script: Script, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    figure, models = importlib.import_module("make_figure_7"), ("ggx", "beckmann")
    assert {"neural", "paper-cross"} <= set(figure.networks("gltf", "gltf"))
    monkeypatch.setattr(figure, "networks", lambda source, output: [])
    monkeypatch.setattr(figure, "MODELS", models)
    monkeypatch.setattr(figure, "SCALES", ("near",))
    plate = tmp_path / "plate"
    plate.mkdir()
    values = {"normal": (128, 128, 255), "base_color": (180,) * 3, "roughness": (170,) * 3, "metallic": (255,) * 3}
    for name, value in values.items():
        Image.fromarray(np.full((16, 16, 3), value, np.uint8)).save(plate / f"{name}.png")
    found = script("make_figure_7", "--set", plate, "--side", 24, "--passes", 32, "--methods", "linear", "lean")
    # On a constant metal a stack in the model of its input lacks the pixel filter alone, another one has another lobe.
    snr = {source: {m: found["inputs"][source][m]["lean"][0][0] for m in models} for source in models}
    assert snr["ggx"]["ggx"] > snr["ggx"]["beckmann"] + 3 and snr["beckmann"]["beckmann"] > snr["beckmann"]["ggx"] + 3
    picture = np.asarray(Image.open(tmp_path / "figure-7-ggx.webp"))
    assert picture.shape[1] > 3 * 24 and picture.std() > 10
