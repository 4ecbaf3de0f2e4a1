"""What a batch knows of the last time, and what it does where that is lost, damaged or not to be trusted."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.baking.results import Planned
from mipbake.cli.main import main
from mipbake.library import bake_library
from mipbake.library import listing as batch_library
from mipbake.library import task as batch_task
from mipbake.library.state import Record, States

from .batch_inline import LINEAR, Inline, aged, bake, counts, inline_workers, only, small_library
from .command_line import tree, write_png, write_set
from .gltf_files import png
from .test_batch_parts import write_maps

__all__ = ["inline_workers", "small_library"]
"""Fixtures."""


@pytest.mark.long
def test_what_is_wrong_with_files_is_told_again_without_another_try(library: Path, inline: Inline) -> None:
    (library / "broken").mkdir()
    write_png(library / "broken/normal.png", np.tile(np.uint8([128, 128, 255]), (16, 16, 1)))
    (library / "lost.gltf").write_text(
        json.dumps(
            {
                "asset": {"version": "2.0"},
                "images": [{"uri": "images%20here/n.png"}],
                "textures": [{"source": 0}],
                "materials": [{"name": "m", "normalTexture": {"index": 0}}],
            }
        )
    )
    first = bake(aged(library))
    assert counts(first) == (2, 0, 2) and first.exit_code == 3
    inline.labels.clear()
    again = bake(library)
    assert inline.labels == [] and counts(again) == (0, 2, 2) and again.exit_code == 3
    assert [str(each.error) for each in again.failures] == [str(each.error) for each in first.failures]
    assert counts(bake(library, force=True)) == (2, 0, 2)
    (library / "images here").mkdir()
    (library / "images here/n.png").write_bytes(png("normal n", 32))
    inline.labels.clear()
    assert counts(bake(library)) == (1, 2, 1)
    assert inline.labels == ["lost.gltf"]


def test_a_full_disk_is_tried_again(library: Path, inline: Inline, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise mipbake.OutputError("cannot write: the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(batch_task, "bake_jobs", full)
        assert bake(library).exit_code == 4
    assert counts(bake(library)) == (2, 0, 0)


@pytest.mark.long
def test_a_map_that_is_added_to_tiles_of_a_materialx_document(tmp_path: Path, inline: Inline) -> None:
    """No list of files says that: a document may stand for files that are new, and include others."""
    root = tmp_path / "lib"
    for tile in (1001, 1003):
        write_set(tmp_path / f"t{tile}")
        for name in ("normal", "roughness"):
            (root / "tex").mkdir(parents=True, exist_ok=True)
            shutil.copy(tmp_path / f"t{tile}/{name}.png", root / "tex" / f"{name}.{tile}.png")
    file = '<input name="file" type="filename" value="tex/{name}.&lt;UDIM&gt;.png"/>'
    image = '<{kind} name="{name}" type="{type}">' + file + "</{kind}>"
    (root / "a.mtlx").write_text(
        '<?xml version="1.0"?><materialx version="1.38">'
        + image.format(kind="image", name="roughness", type="float")
        + image.format(kind="image", name="normal", type="vector3")
        + '<normalmap name="bumps" type="vector3"><input name="in" type="vector3" nodename="normal"/></normalmap>'
        '<standard_surface name="s" type="surfaceshader">'
        '<input name="specular_roughness" type="float" nodename="roughness"/>'
        '<input name="normal" type="vector3" nodename="bumps"/></standard_surface>'
        '<surfacematerial name="m" type="material"><input name="surfaceshader" type="surfaceshader" nodename="s"/>'
        "</surfacematerial></materialx>"
    )
    assert bake_library(root / "a.mtlx", tmp_path / "out", LINEAR).baked == 2
    aged(root)
    assert bake_library(root / "a.mtlx", tmp_path / "out", LINEAR).baked == 0
    for name in ("normal", "roughness"):
        shutil.copy(root / "tex" / f"{name}.1001.png", root / "tex" / f"{name}.1005.png")
    aged(root)
    assert bake_library(root / "a.mtlx", tmp_path / "out", LINEAR).baked == 3


@pytest.mark.long
@pytest.mark.parametrize("damage", ["gone", "a line", "another shape", "file in place of the folder"])
def test_a_list_that_cannot_be_used_is_no_list(library: Path, inline: Inline, damage: str) -> None:
    bake(library)
    folder = library.parent / "out/.mipbake"
    place = folder / "batch.jsonl"
    data = place.read_bytes()
    if damage == "gone":
        place.unlink()
    elif damage == "a line":
        place.write_bytes(data[:100] + b"\xff" * 50 + data[150:])
    elif damage == "another shape":
        place.write_bytes(data.replace(b'"count"', b'"counts"'))
    else:
        place.unlink()
        folder.rmdir()
        folder.touch()
    assert counts(bake(library, dry_run=True)) == (0, 2, 0)
    assert counts(bake(library)) == (0, 2, 0)
    write_png(library / "wood/roughness.png", np.full((16, 16), 91, np.uint8))
    assert counts(bake(library)) == (1, 1, 0)


def test_a_list_is_made_shorter_and_others_may_add_to_it(library: Path) -> None:
    state = Record("wood", "/lib/wood", "", (), (), 1)
    one, other = States(library), States(library)
    for count in range(9):
        one.remember(replace(state, count=count))
        other.remember(replace(state, entry="iron", count=count))
    place = library / ".mipbake/batch.jsonl"
    assert place.read_bytes().count(b"\n") == 18
    assert {name: record.count for name, record in States(library, write=False).records.items()} == {
        "wood": 8,
        "iron": 8,
    }
    assert place.read_bytes().count(b"\n") == 18
    assert States(library).records == States(library, write=False).records
    assert place.read_bytes().count(b"\n") == 2


@pytest.mark.long
def test_a_result_whose_manifest_a_build_system_removed(library: Path, inline: Inline) -> None:
    """Ninja removes it after Ctrl-C, and `clean` of CMake does: what it leaves is in nobody's way."""
    bake(library)
    place = library.parent / "out/wood/wood"
    whole = tree(place)
    (place / "stack.json").unlink()
    assert counts(bake(library, dry_run=True)) == (0, 1, 0) and "normal_mip00.png" in tree(place)
    assert counts(bake(library)) == (1, 1, 0)
    assert tree(place) == whole
    (place / "stack.json").unlink()
    (place / "own.txt").write_text("a file of somebody's")
    failed = bake(library)
    assert counts(failed) == (0, 1, 1) and "not mipbake's" in str(failed.failures[0].error)
    assert set(tree(place)) == set(whole) - {"stack.json"} | {"own.txt"}
    (place / "own.txt").unlink()
    (place / "normal_mip00.png").write_bytes(b"a file that somebody changed")
    assert counts(bake(library)) == (0, 1, 1)
    assert (place / "normal_mip00.png").read_bytes() == b"a file that somebody changed"


@pytest.mark.long
def test_results_whose_sources_are_gone_are_named(tmp_path, inline, capsys):
    root, out = tmp_path / "lib", tmp_path / "out"
    for name in ("iron", "steel", "wood"):
        write_set(root / name)
    command = ["bake", str(aged(root)), "-r", "-o", str(out), "--method", "linear", "--format", "png"]
    assert main(command) == 0
    for name in ("wood", "steel"):
        shutil.rmtree(root / name)
    capsys.readouterr()
    assert main(command) == 0
    said = f"note: 2 results, such as {out / 'steel/steel'}, have no source any more, and nothing is baked there"
    assert said in capsys.readouterr().out
    shutil.rmtree(out / "steel/steel")
    assert main(command) == 0
    assert f"note: the result {out / 'wood/wood'} has no source any more" in capsys.readouterr().out


@pytest.mark.long
def test_a_tile_that_is_gone_leaves_the_result(tmp_path: Path, inline: Inline) -> None:
    root, out = tmp_path / "lib", tmp_path / "out/body/body"
    for tile in (1001, 1002, 1021):
        write_maps(root / "body", "Body", tile=f".{tile}")
    bake(aged(root))
    assert (out / "stack.1021.json").exists()
    for file in (root / "body").glob("*.1021.png"):
        file.unlink()
    aged(root, 5.0)
    assert only(bake(root, dry_run=True), Planned).why == "the source of its tile 1021 is gone"
    assert counts(bake(root)) == (2, 0, 0)
    assert {"stack.1001.json", "stack.1002.json"} <= set(tree(out))
    assert not any("1021" in name for name in tree(out))
    assert counts(bake(root))[0] == 0


def test_results_of_a_library_and_of_a_set_alone_do_not_lie_in_each_other(library: Path, inline: Inline) -> None:
    out = library.parent / "out"
    bake_library(library / "wood", out, LINEAR)
    failed = bake(library)
    assert counts(failed) == (1, 0, 1) and failed.exit_code == 4
    assert f"{out / 'wood'} holds a stack itself, remove it" in str(failed.failures[0].error)
    shutil.rmtree(out / "wood")
    assert counts(bake(library)) == (1, 1, 0)
    (failure,) = bake_library(library / "wood", out, LINEAR).failures
    assert "it holds other results" in str(failure.error)


def test_an_archive_that_changes_while_it_is_read(tmp_path, inline, monkeypatch):
    write_set(tmp_path / "one" / "s")
    write_set(tmp_path / "two" / "s", roughness=np.full((16, 16), 200, np.uint8))
    (tmp_path / "lib").mkdir()
    shutil.make_archive(str(tmp_path / "lib" / "s"), "zip", tmp_path / "one")
    aged(tmp_path)
    real = batch_library.jobs

    def slow(*arguments: Any) -> Any:
        found = real(*arguments)
        if (tmp_path / "two").exists():
            shutil.make_archive(str(tmp_path / "lib" / "s"), "zip", tmp_path / "two")
            shutil.rmtree(tmp_path / "two")
            aged(tmp_path / "lib", 5.0)
        return found

    monkeypatch.setattr(batch_library, "jobs", slow)
    assert bake(tmp_path / "lib").baked == 1
    assert bake(tmp_path / "lib").baked == 1
    assert bake(tmp_path / "lib").baked == 0
