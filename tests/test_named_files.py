"""Files that a user names for output are written over what mipbake wrote, and over nothing else. A link stays."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from mipbake.cli.main import main
from mipbake.library import task

from .command_line import fails, tree, write_set
from .gltf_files import png
from .gltf_results import two_textures

pytestmark = pytest.mark.usefixtures("unmeasured")

LINEAR = ["--method", "linear", "--format", "png", "--max-level", "0"]
GLB = ["--method", "linear", "--format", "glb", "--max-level", "0"]


def named(place: Path, text: str) -> Path:
    place.write_text(text)
    return place


def link(place: Path, goal: Path) -> Path:
    place.symlink_to(goal)
    return place


OTHERS: dict[str, Callable[[Path], Path]] = {
    "a map": lambda folder: folder / "lib/wood/normal.png",
    "a link to a map": lambda folder: link(folder / "link", folder / "lib/wood/normal.png"),
    "a project file": lambda folder: named(folder / "mipbake.toml", '[options]\nmethod = "linear"\n'),
    "a makefile": lambda folder: named(folder / "Makefile", "all: a\n\n\ncc a.c\n"),
    "the other's": lambda folder: named(folder / "other", "s: \\\n  a\n\na:\n"),
}


@pytest.mark.parametrize("option", ["--depfile", "--json-log"])
@pytest.mark.parametrize("other", OTHERS)
def test_files_of_others_are_not_written_over(option, other, tmp_path, capsys, monkeypatch):
    write_set(tmp_path / "lib/wood")
    file = OTHERS[other](tmp_path)
    if (option, other) == ("--depfile", "the other's"):
        file.write_text(json.dumps({"entry": "wood", "source": "wood", "ok": True, "exit_code": 0}) + "\n")
    before = {name: (tmp_path / name).read_bytes() for name in tree(tmp_path) if (tmp_path / name).is_file()}
    monkeypatch.setattr(task, "bake_jobs", lambda *_: pytest.fail("found only after something was read"))
    said = fails(capsys, 4, "bake", tmp_path / "lib", "-r", "-o", tmp_path / "out", option, file, *LINEAR)
    assert f"cannot write {file}: it is there, and is no" in said
    assert {name: (tmp_path / name).read_bytes() for name in before} == before and not (tmp_path / "out").exists()


@pytest.mark.long
def test_files_of_an_earlier_batch_are_written_again(tmp_path: Path) -> None:
    """And empty ones, and through links, which stay."""
    write_set(tmp_path / "lib/50 % wood")
    log, rule, far = (tmp_path / name for name in ("log", "rule", "far"))
    log.touch()
    rule.symlink_to(far)
    command = ["bake", str(tmp_path / "lib"), "-r", "-o", str(tmp_path / "out"), *LINEAR]
    for _ in range(3):
        assert main([*command, "--json-log", str(log), "--depfile", str(rule), "-q"]) == 0
        assert json.loads(log.read_text())["entry"] == "50 % wood" and far.read_text().count("\n\n") == 1
    assert rule.is_symlink()


def test_files_that_cannot_be_there(tmp_path: Path, capsys) -> None:
    base = ["bake", write_set(tmp_path / "wood"), "-o", tmp_path / "out", *LINEAR]
    both = ["--json-log", tmp_path / "a", "--depfile", tmp_path / "a"]
    assert "expected two files" in fails(capsys, 2, *base, *both)
    assert "is a folder" in fails(capsys, 2, *base, "--json-log", tmp_path)
    assert "lies in the result" in fails(capsys, 2, *base, "--json-log", tmp_path / "out/wood/log")
    assert tree(tmp_path / "out") == []


def scene(folder: Path) -> Path:
    folder.mkdir()
    return two_textures(png("normal a"), png("mr")).write(folder / "bolt", "glb")


@pytest.mark.long
def test_a_glb_is_written_through_a_link(tmp_path: Path) -> None:
    """The link stays, and what it leads to is the new file."""
    source, out, far = scene(tmp_path / "in"), tmp_path / "out", tmp_path / "far.glb"
    assert main(["bake", str(source), "-o", str(out), *GLB, "-q"]) == 0
    (out / "bolt.glb").rename(far)
    (out / "bolt.glb").symlink_to(far)
    first = far.read_bytes()
    assert main(["bake", str(source), "-o", str(out), *GLB, "--strength", "0.5", "-q"]) == 0
    assert (out / "bolt.glb").readlink() == far and far.read_bytes() != first
    assert tree(out) == ["bolt.glb"]


@pytest.mark.long
@pytest.mark.parametrize("leads_to", ["the source", "another source", "a file of somebody"])
def test_a_glb_is_not_written_through_a_link_to(leads_to: str, tmp_path: Path, capsys) -> None:
    source, out = scene(tmp_path / "in"), tmp_path / "out"
    assert main(["bake", str(source), "-o", str(out), *GLB, "-q"]) == 0
    (tmp_path / "made").mkdir()
    other = (out / "bolt.glb").rename(tmp_path / "made/nut.glb")  # mipbake made it, and it is a source now
    theirs = two_textures(png("normal c"), png("mr")).write(tmp_path / "theirs", "glb")
    far = {"the source": source, "another source": other, "a file of somebody": theirs}[leads_to]
    (out / "bolt.glb").symlink_to(far)
    before = far.read_bytes()
    said = fails(capsys, 4, "bake", source, other, "-o", out, *GLB)
    assert ("it is the source" in said) == (leads_to != "a file of somebody")
    assert far.read_bytes() == before and tree(out) == ["bolt.glb"]


def test_a_fit_refuses_a_checkpoint_of_others_before_it_bakes(tmp_path: Path, capsys, monkeypatch) -> None:
    folder, out = write_set(tmp_path / "metal"), tmp_path / "out"
    out.mkdir()
    (out / "metal.fit").write_text("notes on how it fits")
    monkeypatch.setattr("mipbake.cli.fit.mipbake.bake", lambda *_, **__: pytest.fail("found only after a bake"))
    command = ["fit", folder, "-o", out, "--renderer", "torch", "--start", "linear", "-q"]
    assert "is no checkpoint of a fit that mipbake wrote" in fails(capsys, 4, *command)
    (out / "metal.fit").unlink()
    (out / "metal").mkdir()
    (out / "metal" / "notes").touch()
    assert "not mipbake's" in fails(capsys, 4, *command)
