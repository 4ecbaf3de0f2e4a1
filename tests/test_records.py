"""Records: what makes them stale, how a sample confirms them, and that all that is printed comes from them."""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "docs"))  # for the names of the list below
try:
    LISTED = importlib.import_module("records.pages").unrecorded().records
finally:
    sys.path.remove(str(ROOT / "docs"))


@pytest.fixture(autouse=True)
def module(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module


# What is printed today


def test_everything_printed_is_recorded_and_every_record_is_current(module: Callable[[str], ModuleType]) -> None:
    """What it says is what to do: measure a record again, confirm it by a sample, make a page again."""
    assert module("remake").faults() == []


@pytest.mark.parametrize("name", LISTED)
def test_a_record_that_nobody_has_measured(name: str) -> None:
    pytest.skip(f"{name} is unrecorded: what pages print of it is as it was typed")


def test_blocks_have_views_and_views_have_blocks(module: Callable[[str], ModuleType]) -> None:
    pages, views = module("records.pages"), module("records.views")
    every = (*pages.pages(), *pages.cards())
    used = {name for page in every for name in pages.blocks((ROOT / page).read_text(encoding="utf-8"))}
    assert used == set(views.VIEWS)


def test_every_record_is_printed(module: Callable[[str], ModuleType]) -> None:
    """A record is printed as a block, a whole page, a part of docs/results.md, or in a docstring."""
    pages, views, known = (module(f"records.{name}") for name in ("pages", "views", "known"))
    asked: set[str] = set()

    class Asked:
        folder = Path("nowhere")

        def __getitem__(self, name: str) -> Any:
            asked.add(name)
            return json.loads((ROOT / "benchmarks/records" / f"{name}.json").read_text(encoding="utf-8"))["data"]

        def record(self, name: str) -> Any:
            asked.add(name)
            raise module("records.missing").Missing(name)

    for view in (*views.VIEWS.values(), *views.DOCSTRINGS.values()):
        try:
            view(Asked())
        except (FileNotFoundError, module("records.missing").Missing) as missing:
            asked.add(str(missing.args[0]) if len(missing.args) == 1 else Path(str(missing.filename)).stem)
    fitting = {name for name in known.KNOWN if name.startswith("fitting-")}  # several in one block
    results = {name for name in known.KNOWN if name.startswith("results-")}
    sections = {"aims", "constant-materials", "paper-pictures"}  # of pages that are made from several records
    assert asked | set(pages.WHOLE.values()) | fitting | results | sections == set(known.KNOWN)


def test_figures_of_quality_depend_on_code(module: Callable[[str], ModuleType]) -> None:
    """Times belong to a machine, trainings to a revision; everything else gets old when its code changes."""
    known = module("records.known").KNOWN
    assert {name for name in known if known[name].entry is None} == {
        *("commands", "library", "soak", "throughput", "throughput-large"),
        *(name for name in known if name.startswith(("timing-", "training-"))),
    }


def test_docstrings_say_what_was_measured(module: Callable[[str], ModuleType]) -> None:
    records = module("records.making").Records()
    for path, words in module("records.views").DOCSTRINGS.items():
        package, name = path.rsplit(".", 1)
        said = " ".join((getattr(module(package), name).__doc__ or "").split())
        assert words(records) in said, f"the docstring of {path} shall say: {words(records)}"


# What makes a record stale


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A small project of the same rooms."""
    files = {
        "mipbake/__init__.py": "from mipbake.a import f\n",
        "mipbake/a.py": '"""Words."""\nimport numpy\n\ndef f(x):\n    """More."""\n    from mipbake.b import g\n'
        "    return g(x)\n",
        "mipbake/b.py": "from mipbake.models.net import layers\nfrom mipbake.shading import shade\n"
        "def g(x):\n    return x\n",
        "mipbake/unused.py": "y = 1\n",
        "mipbake/stack.py": "z = 1\n",
        "mipbake/shading/__init__.py": "def shade(): ...\n",
        "models/__init__.py": "",
        "models/net.py": "layers = 3\n",
        "docs/measure.py": "import mipbake\nimport helper\nmipbake.f(mipbake.stack.z)\n",
        "docs/helper.py": "k = 1\n",
        "csrc/bind/shading.cpp": '#include "shading/lobe.h"\nint a = 1; // one\n',
        "csrc/shading/lobe.h": 'const char *s = "// kept"; /* gone */\n',
        "csrc/cpu/raster.cpp": "int r;\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    weights = tmp_path / "models" / "weights"
    weights.mkdir()
    (weights / "net.safetensors").write_bytes(b"numbers")
    about = {"network": {"layers": 3}, "pixel_filters": ["box"], "default": True, "commit": "1"}
    (weights / "net.json").write_text(json.dumps(about))
    return tmp_path


def hashes(module: Callable[[str], ModuleType], root: Path) -> dict[str, str]:
    code = module("records.code")
    code.forget()
    found: dict[str, str] = code.hashes(code.Entry(("docs/measure.py",), ("net",)), root)
    return found


def test_what_a_record_depends_on(module: Callable[[str], ModuleType], project: Path) -> None:
    """Scripts, imports of imports, imports inside functions, rooms elsewhere, the native core with its headers,
    weights; neither what writes files nor what is not imported."""
    assert set(hashes(module, project)) == {
        "docs/measure.py", "docs/helper.py", "mipbake/a.py", "mipbake/b.py", "mipbake/shading/__init__.py",
        "models/__init__.py", "models/net.py", "csrc/bind/shading.cpp", "csrc/shading/lobe.h", "weights net",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("mipbake/a.py", '"""Words."""', '"""Other words, on\ntwo lines."""'),
        ("mipbake/a.py", '    """More."""\n', ""),
        ("mipbake/b.py", "    return x", "    # why\n\n    return  x  # what"),
        ("csrc/bind/shading.cpp", "int a = 1; // one", "int a\n = 1;/* two\n lines */"),
        ("mipbake/unused.py", "1", "2"),
        ("models/weights/net.json", '"commit": "1"', '"commit": "2"'),
    ],
)
def test_words_change_nothing(
    module: Callable[[str], ModuleType], project: Path, file: str, old: str, new: str
) -> None:
    before, path = hashes(module, project), project / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    assert hashes(module, project) == before


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("mipbake/b.py", "return x", "return -x"),
        ("models/net.py", "3", "4"),
        ("docs/helper.py", "1", "1.0"),
        ("csrc/shading/lobe.h", "// kept", "// kept?"),
        ("csrc/bind/shading.cpp", "1", "2"),
        ("models/weights/net.json", "3", "4"),
        ("models/weights/net.safetensors", "numbers", "other numbers"),
    ],
)
def test_code_and_weights_make_stale(
    module: Callable[[str], ModuleType], project: Path, file: str, old: str, new: str
) -> None:
    record = module("records.record")
    before = hashes(module, project)
    made = record.Record("one", record.Measured("today", "machine", 1.0, "x"), before, {"a": 1.0}, folder=project)
    assert record.state(made, before) == ("current", [])
    (project / file).write_text((project / file).read_text().replace(old, new, 1))
    name = file if not file.startswith("models/weights") else "weights net"
    assert record.state(made, hashes(module, project)) == ("stale", [name])


def test_an_entry_point_that_is_gone_is_an_error(module: Callable[[str], ModuleType], project: Path) -> None:
    code = module("records.code")
    for wrong in (code.Entry(("docs/gone.py",)), code.Entry(("mipbake.gone",)), code.Entry((), ("gone",))):
        with pytest.raises((FileNotFoundError, ModuleNotFoundError)):
            code.hashes(wrong, project)


def test_records_survive_their_file(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    record = module("records.record")
    assert record.load("one", tmp_path) is None and record.state(None, {}) == ("missing", [])
    stamp = record.Confirmed("tomorrow", "a, all figures", 3, 0.5, "y")
    data = {"sets": {"a": {"x": [1.0, None], "y": "ü"}}, "list": [[1, 2], [3, 4]], "none": [], "text": "word"}
    made = record.Record("one", record.Measured("today", "machine", 12.0, "x"), {"f": "0"}, data, stamp, tmp_path)
    made.save()
    assert record.load("one", tmp_path) == made
    assert record.state(made, {"f": "0"})[0] == "confirmed"
    assert record.rounded({"a": [1.23456, float("nan"), 123456, "t", True]}) == {"a": [1.235, None, 123456, "t", True]}


def test_whole_pages_are_made_from_their_data(module: Callable[[str], ModuleType]) -> None:
    script = module("records.scripts").script
    commands = script("benchmarks", "commands")
    losses = {"exr": {"near": 0.01, "over": -0.02}}
    run = commands.Run("tiles", "bake, all formats", 0, "", 3.0, 1.5, 2.0, costs=losses, warnings=())
    data = {"machine": "a machine", "python": "3.11", "fast": "linear", "runs": [dataclasses.asdict(run)]}
    page = commands.page_of(json.loads(json.dumps(data)))
    assert "on a machine, Python 3.11: 1 sets" in page and "| tiles | +0.01 / -0.02 |" in page
    three = script("benchmarks/engines", "three_table")
    cells = [
        {"set": "tiles", "view": "wall-far", "shape": "wall", "scale": "far", "lod": 7.0, "candidate": name,
         "container": three.PLAIN, "snr": snr, "flip": flip, "samples": 64, "reference_snr": 50.0}
        for name, snr, flip in (("linear", 10.0, 0.05001), ("neural", 12.5, 0.05), ("auto", 9.0, 0.04))
    ]  # fmt: skip
    notes = {"engine": {"three": "187", "renderer": "R"}, "levels": ["ok"], "machine": "M", "sizes": [96, 512, 1024]}
    page = three.page_of({"cells": cells, "notes": notes})
    assert "three.js r187 in headless Chromium on M; renderer: R. Pictures of\n96 x 96 pixels" in page
    assert "| neural | all | 1 of 1 | +2.50 dB | +2.5 dB | +2.5 dB | 0 of 1 | +0.0000 |" in page  # as it is shown
    said = " ".join(module("records.views").VIEWS["engines-three/summary"]({"engines-three": {"cells": cells}}).split())
    assert "FLIP is lower in 0 views with the network and in 1 with `auto`." in said and "in 1 views, by 2.5 dB" in said
    blocks = script("benchmarks", "uastc")
    lost = blocks.Row(
        "tiles",
        {"plain": {"near-mirror": 2.0, "hemisphere": 0.4}, "glb": {"near-mirror": 0.3, "hemisphere": 0.5}},
        {"in rgba8": "none"},
    )
    data = {"machine": "M", **{table: [dataclasses.asdict(lost)] for table in blocks.TABLES}}
    page = blocks.page_of(json.loads(json.dumps(data)))
    assert "| tiles | 2.00 / 0.40 | 0.30 / 0.50 | none |" in page
    assert "| plain | 1 | 0 | 0 | 2.00 | 2.00 |" in page and "| glb | 1 | 1 | 1 | 0.50 | 0.50 |" in page
    cycles = script("benchmarks/engines", "cycles_proof")
    data = {"machine": "M", "version": "4.5", "sigma": 0.502, "pixels": 96, "texels": 256, "suns": 3, "samples": 256,
            "columns": ["neural", "reference"], "rows": {"tiles": [10.04, 50.0]}}  # fmt: skip
    assert "| tiles | 10.0 | 50.0 |" in cycles.page_of(data)


def test_measuring_keeps_what_a_command_writes(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    """Figures from its file or from what it prints; pictures are moved when all are complete."""
    known, measuring = module("records.known"), module("records.measuring")
    code = (
        "import sys, pathlib as p; p.Path(sys.argv[1]).write_bytes(b'x'); p.Path(sys.argv[2]).write_text('[1.2345678]')"
    )
    writes = known.Known("", ("-c", code, known.WORK + "/a.png", known.OUT), None, pictures="kept")
    (tmp_path / "kept").mkdir()
    made = measuring.measure("one", writes, None, "today", tmp_path)
    assert made.data == [1.23457] and made.measured.on == "today" and made.measured.machine and made.code == {}
    assert (tmp_path / "kept" / "a.png").read_bytes() == b"x"
    printed = known.Known("", ("-c", "print('a\\n\\nb')"), None)
    assert measuring.measure("two", printed, None, "today", tmp_path).data == {"printed": ["a", "", "b"]}
    both = known.Known("", ("-c", "print('a')", f"{known.WORK}/kept.json"), None)
    assert measuring.measure("timing-three", both, None, "today", tmp_path).data == {"printed": ["a"]}
    fails = known.Known("", ("-c", code + "; 1 / 0", known.WORK + "/b.png", known.OUT), None, pictures="kept")
    with pytest.raises(subprocess.CalledProcessError):
        measuring.measure("three", fails, None, "today", tmp_path)
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


# Confirming by a sample


def results_file(name: str, snr: float) -> dict[str, Any]:
    methods = [
        {"name": n, "method": n, "kernel": "box", "model": "gltf", "weights": None, "budget": budget, "seconds": 1.0,
         "processor_seconds": snr, "peak_mib": 3.0}
        for n, budget in (("linear", None), ("refine 30s", "30s"))
    ]  # fmt: skip
    figures = [
        {"method": m["name"], "measure": measure, "view": "sphere", "scale": scale, "value": value}
        for m in methods
        for scale in ("near", "far")
        for measure, value in (("snr", snr), ("flip", 0.1 if scale == "near" else float("nan")))
    ]
    curve = [
        {"method": m["name"], "view": "hemisphere", "lod": lod, "value": snr + lod}
        for m in methods
        for lod in (0.0, 0.5)
    ]
    return {
        "name": name, "methods": methods, "curve": curve, "figures": figures,
        "scenes": [{"name": "near", "converged": True}],
        "key": {"effort": {"points": 5}}, "threads": 1, "crop": 64, "processor_seconds": 10.0,
    }  # fmt: skip


def test_results_are_packed_without_loss(module: Callable[[str], ModuleType]) -> None:
    results = module("records.results")
    files = [results_file("a", 20.0), results_file("b", 30.0)]
    back = results.unpack(json.loads(json.dumps(results.pack(files))))
    assert [each["name"] for each in back] == ["a", "b"] and back[0]["crop"] == 64
    for old, new in zip(files, back, strict=True):
        key = lambda f: (f["method"], f.get("measure", ""), f["view"], str(f.get("scale", f.get("lod"))))  # noqa: E731
        for part in ("curve", "figures"):
            was, now = ({key(f): f["value"] for f in each[part]} for each in (old, new))
            assert now == {name: None if math.isnan(value) else value for name, value in was.items()}
        assert [m["processor_seconds"] for m in new["methods"]] == [m["processor_seconds"] for m in old["methods"]]


@pytest.mark.parametrize(("off", "agrees"), [(0.0, True), (0.09, True), (0.11, False), (-3.0, False)])
def test_a_sample_keeps_a_record_or_does_not(
    module: Callable[[str], ModuleType], tmp_path: Path, off: float, agrees: bool
) -> None:
    """Decibels agree within a tenth; methods that a budget of time ends, and costs, are not compared."""
    record, results, measuring, known = (module(f"records.{n}") for n in ("record", "results", "measuring", "known"))
    data = results.pack([results_file(name, 20.0) for name in "abcdefgh"])
    old = record.Record("results-whole", record.Measured("then", "machine", 9.0, "x"), {"gone.py": "1"}, data)
    asked: list[str] = []

    def run(name: str, known: object, materials: object, work: object, more: tuple[str, ...], root: Path) -> object:
        asked.extend(more)
        sample = results_file(more[1], 20.0 + off)
        for part in ("curve", "figures"):
            for figure in sample[part]:
                figure["value"] += 50 if figure["method"].startswith("refine") else 0
        return results.pack([sample])

    stamped, lines = measuring.confirm(old, known.KNOWN["results-whole"], Path(), "now", tmp_path, run)
    assert asked[0] == "--plans" and asked[1] in data["sets"] and len(asked) == 2
    assert (stamped is not None) == agrees
    if stamped is not None:
        assert stamped.confirmed.sample == f"{asked[1]}, all figures" and stamped.measured == old.measured
        assert stamped.confirmed.largest == pytest.approx(abs(off) * 10, abs=0.01) and stamped.confirmed.figures == 5
        now = module("records.code").hashes(known.KNOWN["results-whole"].entry)
        assert record.state(stamped, now) == ("confirmed", [])
    else:
        assert "times what is tolerated" in "".join(lines) and "stale until it is measured again" in lines[-1]


def test_nobody_chooses_the_sample(module: Callable[[str], ModuleType]) -> None:
    drawn = module("records.record").drawn
    names = [f"set{i}" for i in range(40)]
    assert drawn(names, 2, {"f": "1"}) == drawn(names[::-1], 2, {"f": "1"})
    assert len({tuple(drawn(names, 2, {"f": str(i)})) for i in range(20)}) > 15


# Pages


def test_what_a_benchmark_printed(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    views, record = module("records.views").VIEWS, module("records.record")
    for lines, shown in (
        (["words " * 30, "", "| " + "cell " * 40 + "|"], ["| cell cell"]),
        (["a   1 ms", "b  10 ms"], ["```\na   1 ms\nb  10 ms\n```"]),
    ):
        made = record.Record(
            "timing-bake", record.Measured("today", "M", 1.0, ""), {}, {"printed": lines}, folder=tmp_path
        )
        made.save()
        said = views["timing-bake/printed"](module("records.making").Records(tmp_path))
        assert all(part in said for part in shown) and said.endswith("\n\nMeasured today on M.")
        assert all(len(line) <= 120 or line.startswith("|") for line in said.splitlines())


def test_blocks_are_filled_and_typed_figures_are_seen(module: Callable[[str], ModuleType]) -> None:
    pages = module("records.pages")
    text = """It is 3.1 dB better in 95 % of 40 sets with version 4.2.
<!-- record:one/words -->
old 7.7 dB
<!-- end -->
and <!-- record:two/more -->7 ms<!-- end -->, <!-- history -->once 9 ms<!-- end -->, `8 ms`.

| a | 4.25 |
```
it took 5 s
```
"""
    assert pages.blocks(text) == ["one/words", "two/more"]
    assert pages.typed(text) == ["3.1 dB", "95 %", "4.25"]
    made = pages.filled(text, lambda name: "new 8.8 dB" if name == "one/words" else None)
    assert made == text.replace("old 7.7 dB", "new 8.8 dB")


def test_the_list_of_what_is_unrecorded_shrinks_alone(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    pages = module("records.pages")
    (tmp_path / "README.md").write_text("takes 7 s, or 9 s at 1 GB")
    listed = pages.Unrecorded(["one", "two"], {"README.md": ["7 s", "8 s"]}, {"README.md": ["1 GB"]})
    assert list(pages.unlisted(listed, tmp_path)) == [("README.md", ["9 s"])]
    shrunk = pages.shrunk(listed, ["two"], tmp_path)
    assert shrunk == pages.Unrecorded(["two"], {"README.md": ["7 s"]}, {"README.md": ["1 GB"]})
    pages.save(shrunk, tmp_path / "list.json")
    assert pages.unrecorded(tmp_path / "list.json") == shrunk
    assert pages.grown(shrunk, ["README.md"], tmp_path).given == {"README.md": ["1 GB", "9 s"]}
    assert dataclasses.asdict(shrunk).keys() == json.loads((tmp_path / "list.json").read_text()).keys()


def test_a_sample_of_fits_is_compared_set_by_set(module: Callable[[str], ModuleType]) -> None:
    fits = module("records.fits")
    sums = {method: [100.0, 1.0, 0.5] for method in ("linear", "lean", "auto", "start", "steps", "fitted")}
    off = {**sums, "fitted": [100.0, 1.05, 0.5]}

    def data(*sets: tuple[str, dict[str, list[float]]]) -> dict[str, Any]:
        view = {name: [{"view": "v", "sums": {m: each for m in ("snr", "snr-displayed")}}] for name, each in sets}
        return {"renderers": {"gl clearcoat": {name: {"scales": {"far": views}} for name, views in view.items()}}}

    record, sample = data(("a", sums), ("b", sums)), data(("b", off))
    assert fits.sets(record) == ["a", "b"]
    found = fits.differences(record, sample)
    assert len(found) == 12 and all(each.name.startswith("gl clearcoat, b, snr") for each in found)
    wrong = {each.name: each.share for each in found if each.share > 1}
    assert set(wrong) == {f"gl clearcoat, b, {m}, far, fitted" for m in ("snr", "snr-displayed")}
    assert fits.differences(record, data(("c", off))) == []
