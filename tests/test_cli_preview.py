"""`mipbake preview`: a page with the view alone, where it is written, and whether a browser is opened."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mipbake.cli import preview
from mipbake.cli.main import main

from .command_line import fails, write_set
from .report_cases import NAMES, Page, made_up
from .viewer_scenes import scene_of


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """What browsers were asked to open, on a machine with a screen."""
    asked: list[str] = []
    monkeypatch.setattr(preview.webbrowser, "open", asked.append)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(preview.tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    return asked


def test_a_preview_is_the_view_alone_and_is_opened(tmp_path, opened, capsys):
    assert main(["preview", str(write_set(tmp_path / "metal"))]) == 0
    (written,) = (tmp_path / "temporary").glob("*/metal/index.html")
    assert opened == [written.as_uri()] and capsys.readouterr().out.startswith(f"wrote {written}\nfor a verdict, ")
    text = written.read_text(encoding="utf-8")
    assert [each["name"] for each in scene_of(text)["images"]] == ["truth", "plain MIP maps", "mipbake"]
    assert [section["id"] for section in Page(text).all("section")] == ["view", "made"]


def test_a_place_and_a_method_of_ones_own(tmp_path, opened, capsys):
    folder, out = write_set(tmp_path / "metal"), tmp_path / "out"
    given = ["preview", str(folder), "-o", str(out), "--no-open", "--method", "lean", "--json"]
    assert main(given) == 0 and not opened
    (found,) = json.loads(capsys.readouterr().out)["results"]
    assert found["page"] == str(out / "index.html")
    names = [each["name"] for each in scene_of((out / "index.html").read_text(encoding="utf-8"))["images"]]
    assert names == ["truth", "plain MIP maps", "lean (gaussian)"]
    assert main(given) == 0  # previews replace each other
    capsys.readouterr()
    (out / "mine.txt").write_text("keep me")
    assert "mipbake's" in fails(capsys, 4, *given[:-1])
    assert "unknown method 'best'" in fails(capsys, 2, "preview", folder, "--method", "best")


def test_what_was_measured_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made_up(NAMES, 16).save(tmp_path / "report")
    before = {file: file.read_bytes() for file in (tmp_path / "report").iterdir()}
    said = fails(capsys, 4, "preview", write_set(tmp_path / "metal"), "-o", tmp_path / "report")
    assert "whose figures were measured" in said and said.count("\n") <= 1
    assert before == {file: file.read_bytes() for file in (tmp_path / "report").iterdir()}
