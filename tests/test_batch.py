"""Batches: what has changed is baked, and nothing else."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.baking import BakeOptions, NotBaked
from mipbake.baking.results import BakedSet, Planned, Result
from mipbake.base.errors import UsageError
from mipbake.library import BatchOptions, Shard, bake_library
from mipbake.library import state as batch_state
from mipbake.library import task as batch_task

from .batch_inline import LINEAR, Inline, aged, bake, counts, inline_workers, only, small_library
from .command_line import tree, write_png, write_set
from .gltf_files import png
from .gltf_results import two_textures

__all__ = ["inline_workers", "small_library"]
"""Fixtures."""


@pytest.mark.long
def test_what_killed_processes_left_beside_unchanged_results_goes(library: Path, inline: Inline) -> None:
    two_textures(png("normal a"), png("mr")).write(library / "bolt", "glb")
    aged(library, 100.0)
    options = BakeOptions(method="linear", max_level=0)
    bake(library, options)
    out = library.parent / "out"
    assert (out / "bolt.glb/bolt.glb").is_file()
    before = [name for name in tree(out) if ".mipbake" not in name]
    for name in ("wood/wood", "metals/steel/steel", "bolt.glb/bolt.glb", "wood/mipbake-trial"):
        for suffix in ("partial",) if "trial" in name else ("partial", "old"):
            (out / name).with_name(f".{Path(name).name}.0badcafe.{suffix}").mkdir()
    (out / ".notes.0badcafe.partial").mkdir()  # beside nothing of ours
    dry = tree(out)
    assert bake(library, options, dry_run=True).planned == 0 and tree(out) == dry
    summary = bake(library, options)
    assert (summary.baked, summary.documents, summary.failures) == (0, 0, [])
    assert [name for name in tree(out) if ".mipbake/" not in name and name != ".mipbake"] == sorted(
        [*before, ".notes.0badcafe.partial"]
    )


def test_a_result_that_was_moved_aside_comes_back_unchanged(library: Path, inline: Inline) -> None:
    bake(library)
    place = library.parent / "out/wood/wood"
    place.rename(place.with_name(".wood.0badcafe.old"))
    assert counts(bake(library)) == (0, 2, 0)
    assert (place / "stack.json").is_file()


def test_a_file_of_another_time_and_the_same_content(library: Path, inline: Inline) -> None:
    bake(library)
    out = library.parent / "out"
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.png")}
    (library / "wood/normal.png").touch()
    assert counts(bake(library)) == (0, 2, 0)
    assert inline.labels == ["wood"]
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.png")} == before


def test_a_file_that_was_just_written_is_looked_into(library, inline, monkeypatch):
    """Its time would be the same if it changed once more within the same tick of the file system's clock."""
    monkeypatch.setattr(batch_state, "FRESH", 3_600_000_000_000)  # however slow the machine of this test is
    bake(library)
    bake(library)
    assert inline.labels == ["metals/steel", "wood"]


def test_another_set_of_that_name_is_not_written_over(library: Path, inline: Inline, tmp_path: Path) -> None:
    bake(library)
    other = tmp_path / "other"
    write_set(other / "wood", **{name: np.full((16, 16, 3), 9, np.uint8) for name in ("base_color", "roughness")})
    write_png(other / "wood/normal.png", np.tile(np.uint8([128, 128, 255]), (16, 16, 1)))
    summary = bake_library(other, tmp_path / "out", LINEAR)
    assert "of other source files" in str(only(summary, NotBaked).error) and summary.exit_code == 4


@pytest.mark.long
def test_a_map_more_and_a_file_more(library: Path, inline: Inline) -> None:
    bake(library)
    (library / "wood/readme.txt").write_text("oak")
    aged(library, 5.0)
    assert counts(bake(library)) == (0, 2, 0)
    write_png(library / "wood/ao.png", np.full((16, 16), 200, np.uint8))
    assert counts(bake(library)) == (1, 1, 0)
    (library / "wood/ao.png").unlink()
    assert counts(bake(library)) == (1, 1, 0)


def changed_manifest(file: Path, **provenance: Any) -> None:
    content = json.loads(file.read_text())
    content["provenance"].update(provenance)
    file.write_text(json.dumps(content))


def test_a_dry_run_says_what_cannot_be_written(library: Path, inline: Inline) -> None:
    out = library.parent / "out"
    out.touch()
    for dry_run in (True, False):
        said = {str(failure.error) for failure in bake(library, dry_run=dry_run).failures}
        assert said == {
            f"cannot write to {out / name}: {out} is a file, choose another folder"
            for name in ("metals/steel/steel", "wood/wood")
        }
    out.unlink()
    notes = out / "wood/wood/notes.txt"  # no result of ours
    notes.parent.mkdir(parents=True)
    notes.touch()
    for dry_run in (True, False):
        [failure] = bake(library, dry_run=dry_run).failures
        assert f"cannot write to {notes.parent}: " in str(failure.error)
    assert notes.exists()


@pytest.mark.long
def test_a_dry_run_says_why_and_writes_nothing(library: Path, inline: Inline) -> None:
    out = library.parent / "out"
    assert {each.why for e in bake(library, dry_run=True).entries for each in e.results} == {"there is no result yet"}
    assert not out.exists()
    bake(library)
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}

    def why() -> str:
        told: str = only(bake(library, dry_run=True), Planned).why
        return told

    write_png(library / "wood/roughness.png", np.full((16, 16), 91, np.uint8))
    assert why() == "its sources changed"
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()} == before
    bake(library)
    manifest = out / "wood/wood/stack.json"
    recipe = json.loads(manifest.read_text())["provenance"]["recipe"]
    changed_manifest(manifest, recipe={**recipe, "weights": "0"})
    assert why() == "the weights changed"
    changed_manifest(manifest, recipe={**recipe, "options": "0"})
    assert why() == "the options changed"
    changed_manifest(manifest, recipe=recipe, tool_version="0.0.1")
    assert why() == "it was baked by mipbake 0.0.1"
    changed_manifest(manifest, recipe={}, tool_version=mipbake.__version__)
    assert why() == "its result does not say what it was made from"
    changed_manifest(manifest, recipe=recipe)
    normal = out / "wood/wood/normal_mip00.png"
    normal.write_bytes(normal.read_bytes()[:-1])
    assert why() == "its file normal_mip00.png has another size than when it was written"
    normal.unlink()
    assert why() == "its file normal_mip00.png is missing"
    manifest.write_text("{")  # nothing says any more whose files these are
    aged(library)
    for _ in range(2):  # with what the list knows of the sources, and without
        [failure] = bake(library, dry_run=True).failures
        assert f"cannot write to {out / 'wood/wood'}: it holds files that are not mipbake's" in str(failure.error)
        shutil.rmtree(out / ".mipbake", ignore_errors=True)
    shutil.rmtree(out / "wood")
    assert why() == "there is no result yet"
    assert counts(bake(library)) == (1, 1, 0)


@pytest.mark.long
def test_archives_documents_and_tiles(tmp_path: Path, inline: Inline) -> None:
    root = tmp_path / "lib"
    write_set(tmp_path / "packed" / "one")
    write_set(tmp_path / "packed" / "two", roughness=np.full((16, 16), 70, np.uint8))
    root.mkdir()
    shutil.make_archive(str(root / "several"), "zip", tmp_path / "packed")
    two_textures(png("normal n"), png("mr")).write(root / "scene")
    for tile in (1001, 1002):
        for name in ("normal", "roughness"):
            write_set(tmp_path / f"t{tile}{name}")
            (root / "udim").mkdir(exist_ok=True)
            shutil.copy(tmp_path / f"t{tile}{name}" / f"{name}.png", root / "udim" / f"w_{name}.{tile}.png")
    options = BakeOptions(method="linear", max_level=1)
    first = bake(aged(root), options)
    assert first.failures == []
    assert first.documents == 1
    out = tmp_path / "out"
    assert {"several.zip/one/stack.json", "several.zip/two/stack.json", "udim/udim/stack.1001.json"} <= set(tree(out))
    shutil.rmtree(out / ".mipbake")
    second = bake(root, options)
    assert (second.baked, second.documents, second.unchanged) == (0, 0, 4), second
    inline.labels.clear()
    assert bake(root, options).unchanged == 2 + 1 + 1
    assert inline.labels == []
    other = two_textures(png("normal other"), png("mr"))
    other.write(root / "scene")
    third = bake(root, options)
    assert (third.documents, third.unchanged) == (1, 3)


def test_a_defect_is_a_failure_of_its_entry(library: Path, inline: Inline, monkeypatch: pytest.MonkeyPatch) -> None:
    def defect(*_: object) -> None:
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr(batch_task, "bake_jobs", defect)
    summary = bake(library)
    assert summary.exit_code == 1 and counts(summary) == (0, 0, 2)
    assert "this is a defect (ZeroDivisionError: by zero)" in str(summary.failures[0].error)


def test_options_that_cannot_be(library: Path) -> None:
    with pytest.raises(UsageError, match="number of jobs is 0"):
        BatchOptions(jobs=0)
    with pytest.raises(UsageError, match="one of the two"):
        BatchOptions(force=True, dry_run=True)
    with pytest.raises(UsageError, match="unknown method"):
        bake(library, BakeOptions(method="nothing"))
    assert not (library.parent / "out").exists()


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "-1/2"])
def test_a_shard_that_is_none(text: str) -> None:
    with pytest.raises(UsageError, match="expected I/N"):
        Shard.parsed(text)


@pytest.mark.long
def test_all_maps_change(library: Path, inline: Inline) -> None:
    """Somebody exports a set anew. Alone, a bake would take it for another set of the same name."""
    bake(library)
    shutil.rmtree(library / "wood")
    write_set(library / "wood", **{name: np.full((16, 16, 3), 128, np.uint8) for name in ("base_color", "roughness")})
    write_png(library / "wood/normal.png", np.tile(np.uint8([128, 128, 255]), (16, 16, 1)))
    assert counts(bake(library)) == (1, 1, 0)


def test_a_result_with_a_defect_is_told_in_the_same_way_again(library, inline, monkeypatch):
    plain = batch_task.bake_jobs

    def defective(*arguments: Any) -> list[Result]:
        made = plain(*arguments)
        return [replace(each, defects=("one", "two")) if isinstance(each, BakedSet) else each for each in made]

    monkeypatch.setattr(batch_task, "bake_jobs", defective)
    first = bake(library)
    assert (first.baked, first.exit_code) == (2, 1)
    inline.labels.clear()
    again = bake(library)
    assert inline.labels == []
    assert counts(again) == (0, 0, 2) and again.exit_code == 1
    assert [str(each.error) for each in again.failures] == ["one; two"] * 2
