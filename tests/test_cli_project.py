"""`mipbake init`, and `bake` and `inspect` with a project file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mipbake.cli.main import main

from .command_line import fails, write_set

pytestmark = pytest.mark.usefixtures("unmeasured")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a library and a project file, in which commands run."""
    write_set(tmp_path / "textures" / "metals" / "iron")
    write_set(tmp_path / "textures" / "wood", roughness=np.full((16, 16), 99, np.uint8))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mipbake.toml").write_text(
        'library = "textures"\nout = "baked"\n[options]\nmethod = "linear"\nformat = "png"\n'
        '[[sets]]\nmatch = "metals/*"\nstrength = 0.5\n'
    )
    return tmp_path


def provenance(stack: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads((stack / "stack.json").read_text())["provenance"]
    return found


@pytest.mark.long
def test_a_project_is_baked(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bake", "textures/wood", "--config", "mipbake.toml"]) == 0
    assert "1 set baked, 0 unchanged, 0 failed" in capsys.readouterr().out
    assert main(["bake"]) == 0
    assert "1 set baked, 1 unchanged, 0 failed" in capsys.readouterr().out
    iron, wood = (provenance(project / "baked" / name) for name in ("metals/iron/iron", "wood/wood"))
    assert iron["method"] == wood["method"] == "linear"
    assert iron["adjustments"] and not wood["adjustments"]
    assert main(["bake", "--strength", "1", "--json", "--dry-run"]) == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert {each["entry"]: each.get("planned") for each in results} == {
        "metals/iron": "the options changed",
        "wood": None,
    }
    assert main(["bake", "textures/wood", "-o", "elsewhere", "--method", "lean", "--format", "png"]) == 0
    assert "note: the mipbake.toml of this folder is not used, because sources are named" in capsys.readouterr().out
    assert provenance(project / "elsewhere" / "wood")["method"] == "lean"
    assert main(["bake", "-o", "other", "--map", "metallic=1", "--wrap-u", "clamp", "--gloss", "--filter", "box"]) == 0
    assert provenance(project / "other/wood/wood")["pixel_filter"] == "box"
    assert json.loads((project / "other/wood/wood/stack.json").read_text())["wrap"] == {"u": "clamp", "v": "wrap"}


def test_what_applies_is_shown_with_its_place(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect"]) == 0
    out = capsys.readouterr().out
    assert "metals/iron:" in out and "wood:" in out
    (line,) = (line for line in out.splitlines() if line.startswith("strength"))
    assert line.split("0.5")[1].strip() == "mipbake.toml, line 8"
    assert main(["inspect", "--config", "mipbake.toml", "textures/wood", "--json"]) == 0
    (wood,) = json.loads(capsys.readouterr().out)["results"]
    assert wood["settings"]["method"] == {"value": "linear", "origin": "mipbake.toml, line 4"}
    assert "strength" not in wood["settings"]
    assert not (project / "baked").exists()


def test_without_sources_and_without_a_project(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for command in ("bake", "inspect"):
        assert "missing argument 'SOURCE': expected one or more, or a mipbake.toml" in fails(capsys, 2, command)
    assert "missing option '--out'" in fails(capsys, 2, "bake", write_set(tmp_path / "s"))


def test_init(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    write_set(tmp_path / 'a "b"' / "wood")
    assert main(["init", str(tmp_path), "--library", 'a "b"', "-o", "made"]) == 0
    assert f"wrote {tmp_path / 'mipbake.toml'}" in capsys.readouterr().out
    monkeypatch.chdir(tmp_path)
    assert main(["bake", "--method", "linear"]) == 0
    assert (tmp_path / "made/wood/wood/stack.json").is_file()
    capsys.readouterr()
    assert "mipbake.toml exists" in fails(capsys, 4, "init", tmp_path)
    assert "cannot write" in fails(capsys, 4, "init", tmp_path / "mipbake.toml")
