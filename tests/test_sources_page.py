"""docs/sources.md, what the sources claim and what holds here: whatever a row names is there and shows it today."""

from __future__ import annotations

import ast
import importlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest

import mipbake.nvdiffrast

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "sources.md"
RECORDS = ROOT / "benchmarks" / "records"
HEAD = ("section", "claim", "where", "state", "shown by")
STATES = ("reproduced", "differs", "not yet", "not here")
FILTER, PRIMITIVES, DOCUMENTATION, STOCHASTIC = SOURCES = (
    "Pixel-filter-aware MIP maps",
    "The nvdiffrast paper",
    "The documentation of nvdiffrast",
    "Stochastic gradients",
)
NUMBERED: Mapping[str, Mapping[str, int]] = {
    FILTER: {"equation": 6, "figure": 11},
    PRIMITIVES: {"equation": 4, "figure": 12, "table": 2},
    STOCHASTIC: {"equation": 9, "figure": 8, "table": 3, "algorithm": 2},
}
"""How many of each a source has."""

PARTS: Mapping[str, tuple[str, ...]] = {
    FILTER: ("1", "2.1", "2.2", "3.1", "3.2", "3.3", "3.4", "3.5", "4", "4.1", "5"),
    PRIMITIVES: (
        *("1", "2", "3", "3.1", "3.2", "3.3", "3.4", "3.5", "3.6", "3.7", "4.1", "4.2", "4.3", "4.4", "4.5"),
        *("5", "5.1", "5.2", "5.3", "5.4"),
    ),
    STOCHASTIC: ("1", "2.3", "3", "4.1", "4.2", "4.3", "4.4", "5", "6.1", "6.2", "6.3", "6.4", "7"),
}
"""Sections that have a row."""

NAMED_TEST = re.compile(r"`(tests/[^`]*)`")
NAMED_RECORD = re.compile(r"(waits for )?record `([^`]*)`")
LINK = re.compile(r"\[([^\]]*)\]\(([^)#\s]*)(#[^)\s]*)?\)")


@dataclass(frozen=True)
class Row:
    """A row of a table of the page, and the heading that it stands under."""

    source: str
    section: str
    claim: str
    where: str
    state: str
    shown: str


def rows(text: str) -> Iterator[Row]:
    """The rows of all tables below second headings.

    Raises:
        ValueError: a table has other columns.
    """
    source = ""
    for line in text.splitlines():
        if line.startswith("## "):
            source = line.removeprefix("## ")
        if source and line.startswith("|"):
            cells = tuple(cell.strip() for cell in line.strip().strip("|").split("|"))
            if len(cells) != len(HEAD):
                raise ValueError(f"{len(cells)} columns, expected {len(HEAD)}: {line}")
            if cells != HEAD and set(cells) != {"---"}:
                yield Row(source, *cells)


@cache
def functions(path: Path) -> frozenset[str]:
    """Names of the functions of a file that begin a line."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


@cache
def anchors(path: Path) -> frozenset[str]:
    """What links may name after a #: headings, as GitHub writes them."""
    heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return frozenset(re.sub(r"[^\w\- ]", "", head.strip().lower()).replace(" ", "-") for head in heads)


@cache
def unrecorded() -> frozenset[str]:
    return frozenset(json.loads((RECORDS / "unrecorded.json").read_text(encoding="utf-8"))["records"])


def faults_of_tests(row: Row) -> Iterator[str]:
    for name in NAMED_TEST.findall(row.shown):
        file, _, function = name.partition("::")
        if not (ROOT / file).is_file():
            yield f"there is no file {file}"
        elif not function.startswith("test_") or function not in functions(ROOT / file):
            yield f"there is no test {name}"


def faults_of_records(row: Row) -> Iterator[str]:
    for waits, name in NAMED_RECORD.findall(row.shown):
        if waits:
            if name not in unrecorded():
                yield f"record {name} is not one that nobody has measured: say what it shows, or correct its name"
            if row.state != "not yet":
                yield f"it waits for record {name}, so its state is not {row.state!r}"
        elif name in unrecorded():
            yield f"nobody has measured record {name} with this version"
        elif not (RECORDS / f"{name}.json").is_file() or name == "unrecorded":
            yield f"there is no record {name}"


def faults_of_links(row: Row) -> Iterator[str]:
    for text in (row.claim, row.shown):
        for _, file, anchor in LINK.findall(text):
            goal = (PAGE.parent / file).resolve() if file else PAGE
            if not goal.exists():
                yield f"there is no {file}"
            elif anchor and (goal.suffix != ".md" or anchor.removeprefix("#") not in anchors(goal)):
                yield f"{file} has no heading {anchor}"


def faults_of_modules(row: Row, modules: Mapping[str, Path]) -> Iterator[str]:
    """Modules by their dotted names, and other files and folders by their paths."""
    for name in () if row.where == "none" else row.where.split(", "):
        plain = name.strip("`")
        if name != f"`{plain}`" or not plain:
            yield f"{name} is not written as code"
        elif plain not in modules and (plain.startswith("mipbake.") or not (ROOT / plain).exists()):
            yield f"there is no module, file or folder {plain}"


def faults(row: Row, modules: Mapping[str, Path]) -> list[str]:
    """Sentences on what is wrong with a row; none where all is as the page says."""
    found = [*faults_of_tests(row), *faults_of_records(row), *faults_of_links(row), *faults_of_modules(row, modules)]
    reason = re.sub(r"[\W_]+", " ", NAMED_RECORD.sub("", NAMED_TEST.sub("", row.shown))).strip()
    shows = bool(NAMED_TEST.search(row.shown)) or any(not waits for waits, _ in NAMED_RECORD.findall(row.shown))
    if row.source not in SOURCES:
        found.append(f"there is no source {row.source!r}")
    if not row.section or not row.claim.endswith("."):
        found.append("a row has a section, and its claim is a sentence")
    if row.state not in STATES:
        found.append(f"there is no state {row.state!r}")
    elif row.state == "reproduced" and not shows:
        found.append("it is reproduced, and names neither a test nor a record")
    elif row.state == "reproduced" and row.where == "none":
        found.append("it is reproduced, and names no module")
    elif row.state != "reproduced" and len(reason.split()) < 4:
        found.append(f"its state is {row.state!r}, and it does not say why")
    return found


@pytest.fixture
def modules(monkeypatch: pytest.MonkeyPatch) -> Mapping[str, Path]:
    """Every module of the package by its dotted name."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    found: Mapping[str, Path] = importlib.import_module("rooms.imports").modules()
    return found


@pytest.fixture
def page() -> list[Row]:
    return list(rows(PAGE.read_text(encoding="utf-8")))


def test_whatever_a_row_names_is_there(page: list[Row], modules: Mapping[str, Path]) -> None:
    found = [f"{row.source}: {row.section}: {row.claim} {fault}" for row in page for fault in faults(row, modules)]
    assert not found, "\n".join(found)


def test_no_claim_stands_twice(page: list[Row]) -> None:
    claims = [(row.source, row.section, row.claim) for row in page]
    assert len(claims) == len(set(claims)) > 100


def test_each_source_has_its_section(page: list[Row]) -> None:
    assert tuple(dict.fromkeys(row.source for row in page)) == SOURCES


@pytest.mark.parametrize(
    ("source", "kind", "number"),
    [
        (source, kind, number)
        for source, kinds in NUMBERED.items()
        for kind, count in kinds.items()
        for number in range(1, count + 1)
    ],
)
def test_equations_figures_and_tables_have_rows(page: list[Row], source: str, kind: str, number: int) -> None:
    assert any(re.search(rf"\b{kind} {number}\b", row.section) for row in page if row.source == source)


@pytest.mark.parametrize(("source", "part"), [(source, part) for source, parts in PARTS.items() for part in parts])
def test_sections_have_rows(page: list[Row], source: str, part: str) -> None:
    assert any(part in row.section.replace("`", "").split(", ") for row in page if row.source == source)


@pytest.mark.parametrize("name", [*mipbake.nvdiffrast.__all__, "DepthPeeler.rasterize_next_layer"])
def test_functions_of_the_documentation_have_rows(page: list[Row], name: str) -> None:
    assert any(name in row.section.split(", ") for row in page if row.source == DOCUMENTATION)


SOUND = Row(
    FILTER,
    "`3.2`, equation 5",
    "The loss is a quotient.",
    "`mipbake.training.loss`, `csrc/shading`, `benchmarks/raster.py`",
    "reproduced",
    "`tests/test_sources_page.py::test_a_sound_row_has_no_faults`, record `picture`. See [limits](method.md#limits).",
)


def test_a_sound_row_has_no_faults(modules: Mapping[str, Path]) -> None:
    assert faults(SOUND, modules) == []
    for state in ("differs", "not here"):
        assert faults(replace(SOUND, state=state, where="none", shown="It is made in another way."), modules) == []


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"source": "Pixel filters"}, "there is no source"),
        ({"state": "reproducd"}, "there is no state"),
        ({"claim": ""}, "its claim is a sentence"),
        ({"section": ""}, "a row has a section"),
        ({"shown": "`tests/test_source_page.py::test_a_sound_row_has_no_faults`"}, "there is no file"),
        ({"shown": "`tests/test_sources_page.py::test_a_sound_row_has_no_fault`"}, "there is no test"),
        ({"shown": "`tests/test_sources_page.py::rows`"}, "there is no test"),
        ({"shown": "`tests/test_sources_page.py`"}, "there is no test"),
        ({"shown": "record `results-hole`"}, "there is no record"),
        ({"shown": "record `unrecorded`"}, "there is no record"),
        ({"shown": "Nobody knows why it holds here."}, "names neither a test nor a record"),
        ({"state": "not yet", "shown": "record `results-whole`"}, "does not say why"),
        ({"state": "not yet", "shown": "It still waits for record `results-whole`."}, "say what it shows"),
        ({"state": "not here", "shown": ""}, "does not say why"),
        ({"where": "none"}, "names no module"),
        ({"where": "`mipbake.training.los`"}, "there is no module"),
        ({"where": "`csrc/shadin`"}, "there is no module"),
        ({"where": "`mipbake.training.loss`, `benchmarks/rasters.py`"}, "there is no module"),
        ({"where": "mipbake.training.loss"}, "is not written as code"),
        ({"where": ""}, "is not written as code"),
        ({"shown": SOUND.shown.replace("#limits", "#limit")}, "has no heading #limit"),
        ({"shown": SOUND.shown.replace("method.md", "methods.md")}, "there is no methods.md"),
    ],
)
def test_faults_of_broken_rows_are_found(change: dict[str, str], fault: str, modules: Mapping[str, Path]) -> None:
    assert any(fault in found for found in faults(replace(SOUND, **change), modules))


def test_records_that_nobody_has_measured_show_nothing(
    modules: Mapping[str, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A list of its own, because the project's list is empty one day."""
    (tmp_path / "unrecorded.json").write_text('{"records": ["later"]}')
    monkeypatch.setattr(f"{__name__}.RECORDS", tmp_path)
    unrecorded.cache_clear()
    try:
        named = replace(SOUND, shown="record `later`")
        assert faults(named, modules) == ["nobody has measured record later with this version"]
        waiting = replace(
            SOUND, shown="It was not measured with this version and waits for record `later`.", state="not yet"
        )
        assert faults(waiting, modules) == []
        assert any("its state is not" in found for found in faults(replace(waiting, state="differs"), modules))
    finally:
        unrecorded.cache_clear()


def test_tables_of_other_columns_are_refused() -> None:
    with pytest.raises(ValueError, match="4 columns, expected 5"):
        list(rows("## A source\n\n| 1 | A claim. | none | differs |\n"))
