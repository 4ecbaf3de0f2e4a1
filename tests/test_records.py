"""Records: pages are what their records say, and what records are made of."""

from __future__ import annotations

import importlib
import json
import math
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from .result_records import file

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(autouse=True)
def module(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module


def test_pages_are_what_their_records_say(module: Callable[[str], ModuleType]) -> None:
    stale = [path.relative_to(ROOT).as_posix() for path in module("records.making").renewed()]
    assert not stale, "python docs/remake.py makes these pages again"


def test_blocks_have_views_and_say_their_release(module: Callable[[str], ModuleType]) -> None:
    making, views = module("records.making"), module("records.views")
    blocks = {page: set(making.blocks((ROOT / page).read_text(encoding="utf-8"))) for page in making.pages()}
    assert set().union(*blocks.values()) == {*views.VIEWS, making.RELEASE}
    assert [page for page, names in blocks.items() if names and making.RELEASE not in names] == []


def test_files_of_records_are_known(module: Callable[[str], ModuleType]) -> None:
    record, known = module("records.record"), module("records.known").KNOWN
    assert {path.stem for path in record.FOLDER.glob("*.json")} <= set(known)


def test_a_page_says_which_release_it_is_of_and_whether_goldens_differ(module, tmp_path):
    record, making = module("records.record"), module("records.making")
    golden = {"stacks": "a", "trainings": "b", "films": "c"}
    for name, on, goldens in (("one", "2026-01-01", golden), ("two", "2026-02-01", golden), ("time", "2026-01-03", {})):
        measured = record.Measured(on, "machine", 1.0, "0.1.0", goldens)
        record.Record(name, measured, {}, tmp_path).save()

    def words(*names: str, **changes: str) -> str:
        return " ".join(making.release(names, record.Records(tmp_path), golden | changes).split())

    assert words("one", "two", "gone").endswith("measured 2026-01-01 to 2026-02-01 (records `one`, `two`).")
    assert "What the code makes has changed since" in words("one", "two", stacks="x", films="y")
    assert words("time", stacks="x") == "The figures are of release 0.1.0, measured 2026-01-03 (record `time`)."
    assert words("gone").startswith("Nobody has measured")


def test_every_kind_of_golden_output_has_a_digest(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    record, path = module("records.record"), tmp_path / "golden.json"
    names = ("stacks, a", "trainings, a", "films, a")
    path.write_text(json.dumps({"results": {name: {"bits": "1"} for name in names}}))
    before = record.goldens(path)
    for kind in record.KINDS:
        changed = {name: {"bits": "2" if name.startswith(kind) else "1"} for name in names}
        path.write_text(json.dumps({"results": changed}))
        assert [each for each in before if before[each] != record.goldens(path)[each]] == [kind]


def test_docstrings_say_what_was_measured(module: Callable[[str], ModuleType]) -> None:
    records = module("records.record").Records()
    for path, words in module("records.views").DOCSTRINGS.items():
        package, name = path.rsplit(".", 1)
        said = " ".join((getattr(module(package), name).__doc__ or "").split())
        assert words(records) in said, f"the docstring of {path} shall say: {words(records)}"


def test_records_survive_their_file(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    record = module("records.record")
    assert record.load("one", tmp_path) is None
    data = {"sets": {"a": {"x": [1.0, None], "y": "ü"}}, "list": [[1, 2], [3, 4]], "none": [], "text": "word"}
    made = record.Record("one", record.Measured("today", "machine", 12.0, "0.1.0", {"films": "0"}), data, tmp_path)
    made.save()
    assert record.load("one", tmp_path) == made
    assert record.rounded({"a": [1.23456, float("nan"), 123456, "t", True]}) == {"a": [1.235, None, 123456, "t", True]}


def test_measuring_keeps_what_a_command_writes(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    """Figures from its file or from what it prints; pictures are moved when all are complete."""
    known, measuring = module("records.known"), module("records.measuring")
    code = (
        "import sys, pathlib as p; p.Path(sys.argv[1]).write_bytes(b'x'); p.Path(sys.argv[2]).write_text('[1.2345678]')"
    )
    writes = known.Known("", ("-c", code, known.WORK + "/a.png", known.OUT), pictures="kept")
    (tmp_path / "kept").mkdir()
    made = measuring.measure("one", writes, None, tmp_path)
    assert (
        made.data == [1.23457]
        and made.measured.machine
        and set(made.measured.goldens) == {"stacks", "trainings", "films"}
    )
    assert (tmp_path / "kept" / "a.png").read_bytes() == b"x"
    printed = known.Known("", ("-c", "print('a\\n\\nb')"), golden=False)
    assert measuring.measure("two", printed, None, tmp_path).data == {"printed": ["a", "", "b"]}
    both = known.Known("", ("-c", "print('a')", f"{known.WORK}/kept.json"), golden=False)
    assert measuring.measure("timing-three", both, None, tmp_path).data == {"printed": ["a"]}
    fails = known.Known("", ("-c", code + "; 1 / 0", known.WORK + "/b.png", known.OUT), pictures="kept")
    with pytest.raises(subprocess.CalledProcessError):
        measuring.measure("three", fails, None, tmp_path)
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["a.png"]


def test_an_older_native_core_is_not_measured(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    measuring = module("records.measuring")
    measuring.check_built(tmp_path)  # no sources, nothing newer
    (tmp_path / "csrc").mkdir()
    source = tmp_path / "csrc" / "a.cpp"
    source.touch()
    os.utime(source, (4e9, 4e9))
    with pytest.raises(SystemExit, match=r"a\.cpp is newer than the native core .*: build it"):
        measuring.check_built(tmp_path)


def test_results_are_packed_without_loss(module: Callable[[str], ModuleType]) -> None:
    results = module("records.results")
    files = [file(name, {"linear": snr, "refine 30s": math.nan}, {"crop": 64}) for name, snr in (("a", 20), ("b", 30))]
    back = results.unpack(json.loads(json.dumps(results.pack(files))))
    assert [each["name"] for each in back] == ["a", "b"] and back[0]["crop"] == 64
    for old, new in zip(files, back, strict=True):
        key = lambda f: (f["method"], f.get("measure", ""), f["view"], str(f.get("scale", f.get("lod"))))  # noqa: E731
        for part in ("curve", "figures"):
            was, now = ({key(f): f["value"] for f in each[part]} for each in (old, new))
            assert now == {n: None if math.isnan(v) else pytest.approx(v, rel=1e-3) for n, v in was.items()}
        assert [m["processor_seconds"] for m in new["methods"]] == [m["processor_seconds"] for m in old["methods"]]


def test_blocks_are_filled(module: Callable[[str], ModuleType]) -> None:
    pages = module("records.making")
    text = """As a `<!-- record:NAME/VIEW -->` is.
<!-- record:one/words -->
old 7.7 dB
<!-- end -->
and <!-- record:two/more -->7 ms<!-- end -->.
"""
    assert pages.blocks(text) == ["one/words", "two/more"]
    made = pages.filled(text, lambda name: "new 8.8 dB" if name == "one/words" else None)
    assert made == text.replace("old 7.7 dB", "new 8.8 dB")
