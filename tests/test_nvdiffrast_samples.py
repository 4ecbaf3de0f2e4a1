"""The samples of nvdiffrast's documentation run, and are programs for nvdiffrast as they stand but for one line."""

from __future__ import annotations

import importlib
import json
import runpy
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
import torch

from . import nvdiffrast_as_documented

FITTING = Path(__file__).parents[1] / "examples" / "fitting"
OURS, THEIRS = "import mipbake.nvdiffrast as dr", "import nvdiffrast.torch as dr"
SMALL = {
    "triangle": ["--cuda"],
    "cube": ["--resolutions", "8", "--runs", "2", "--iterations", "4"],
    "earth": ["--texture-size", "8", "--resolution", "16", "--supersampling", "2", "--iterations", "4"],
    "envphong": ["--texture-size", "8", "--resolution", "24", "--iterations", "4"],
    "pose": ["--trials", "2", "--resolution", "16", "--iterations", "4"],
    "minimal": [],
}
"""The samples, and arguments with which they take no time."""

USED = {
    "triangle": {"rasterize", "interpolate"},
    "cube": {"rasterize", "interpolate", "antialias", "antialias_construct_topology_hash"},
    "earth": {"rasterize", "interpolate", "texture"},
    "envphong": {"rasterize", "interpolate", "texture"},
    "pose": {"rasterize", "interpolate", "antialias", "antialias_construct_topology_hash"},
    "minimal": {"rasterize", "interpolate", "texture"},
}
HELPERS = sorted(path.stem for path in FITTING.glob("*.py") if path.stem not in SMALL)


def source(name: str) -> str:
    return (FITTING / f"{name}.py").read_text(encoding="utf-8")


@pytest.fixture
def scripts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, which the samples write into and their modules are found in; they are forgotten later."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as the scripts do
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in (*HELPERS, *SMALL):
        monkeypatch.delitem(sys.modules, name, raising=False)
    for name in HELPERS:
        shutil.copy(FITTING / f"{name}.py", tmp_path)
    yield tmp_path
    torch.set_num_threads(threads)
    for name in (*HELPERS, *SMALL):
        sys.modules.pop(name, None)


def run(name: str, *arguments: str) -> None:
    if name == "minimal":
        runpy.run_path("minimal.py", run_name="__main__")
    else:
        importlib.import_module(name).main([*SMALL[name], *arguments])


def test_every_sample_of_the_documentation_is_there() -> None:
    assert {"triangle", "cube", "earth", "envphong", "pose"} <= set(SMALL)
    assert set(HELPERS) == {"camera", "meshes", "report", "textures"}


@pytest.mark.parametrize("name", [*SMALL, *HELPERS])
def test_one_line_alone_is_mipbakes(name: str) -> None:
    lines = [line for line in source(name).splitlines() if "mipbake" in line]
    assert lines == ([OURS] if name in SMALL else [])


@pytest.mark.parametrize("name", SMALL)
def test_samples_run_where_that_line_is_nvdiffrasts(name: str, scripts: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a stand-in that has what nvdiffrast documents, and refuses what its documentation does not allow."""
    text = source(name)
    assert text.count(OURS) == 1
    few = text.replace(OURS, THEIRS).replace("range(200)", "range(4)")  # the iterations of minimal.py
    (scripts / f"{name}.py").write_text(few, encoding="utf-8")
    package, stand_in = ModuleType("nvdiffrast"), nvdiffrast_as_documented.as_documented()
    package.torch = stand_in  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "nvdiffrast", package)
    monkeypatch.setitem(sys.modules, "nvdiffrast.torch", stand_in)
    run(name)
    assert set(nvdiffrast_as_documented.called) == USED[name]


@pytest.mark.parametrize("name", [name for name in SMALL if name not in ("minimal", "triangle")])
def test_both_contexts_lead_to_the_same_figures(name: str, scripts: Path) -> None:
    shutil.copy(FITTING / f"{name}.py", scripts)
    figures = []
    for option in ([], ["--opengl"]):
        run(name, *option)
        content = json.loads((scripts / "fitting" / f"{name}.json").read_text())
        assert content["settings"]["opengl"] == bool(option)
        figures.append(content["figures"])
    assert figures[0] == figures[1]
