"""Results whose place changes because a source was added or is gone."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from mipbake.baking.results import Planned
from mipbake.cli.main import main
from mipbake.library import BatchOptions, bake_library

from .batch_inline import LINEAR, Inline, aged, bake, counts, inline_workers, only
from .command_line import write_png, write_set
from .test_batch_parts import write_maps

__all__ = ["inline_workers"]
"""A fixture."""


def stacks(root: Path) -> set[str]:
    """Folders of stacks below the folder of all results."""
    out = root.parent / "out"
    return {file.parent.relative_to(out).as_posix() for file in out.rglob("stack*.json")}


def files(root: Path, folder: str) -> set[str]:
    return {path.name for path in (root.parent / "out" / folder).iterdir()}


@pytest.fixture(name="two")
def two_sets(tmp_path: Path) -> Path:
    root = tmp_path / "lib"
    write_maps(root / "bricks", "Old")
    write_maps(root / "bricks", "New", 120)
    write_set(root / "wood")
    return aged(root)


def without(root: Path, name: str) -> None:
    for file in (root / "bricks").glob(f"{name}_*"):
        file.unlink()
    aged(root, 5.0)


@pytest.mark.long
def test_one_of_two_sets_is_gone(two: Path, inline: Inline) -> None:
    bake(two)
    assert stacks(two) == {"bricks/Old", "bricks/New", "wood"}
    without(two, "New")
    (two.parent / "out/bricks/.DS_Store").touch()
    assert counts(bake(two)) == (1, 1, 0)
    assert stacks(two) == {"bricks", "wood"}
    assert "New" not in files(two, "bricks") and "Old" not in files(two, "bricks")
    assert counts(bake(two)) == (0, 2, 0)


@pytest.mark.long
def test_a_second_set_is_added(two: Path, inline: Inline) -> None:
    without(two, "New")
    bake(two)
    out = two.parent / "out/bricks"
    assert stacks(two) == {"bricks", "wood"}
    (out / "base.png.meta").write_text("of a file that is not there")
    (out / "stack.json.meta").write_text("what an engine knows of it")
    write_maps(two / "bricks", "New", 120)
    aged(two, 5.0)
    assert counts(bake(two, dry_run=True))[2] == 0 and stacks(two) == {"bricks", "wood"}
    assert counts(bake(two)) == (2, 1, 0)
    assert stacks(two) == {"bricks/Old", "bricks/New", "wood"}
    assert files(two, "bricks") == {"Old", "New", "base.png.meta"}
    without(two, "New")
    (out / "base.png.meta").unlink()
    assert counts(bake(two)) == (1, 1, 0) and stacks(two) == {"bricks", "wood"}


def test_a_stack_stays_until_what_takes_its_place_is_baked(two: Path, inline: Inline) -> None:
    without(two, "New")
    bake(two)
    for name in ("Old", "New"):
        write_maps(two / "bricks", name)
        (two / "bricks" / f"{name}_Normal.png").write_bytes(b"no image")
    aged(two, 5.0)
    assert counts(bake(two)) == (0, 1, 2) and stacks(two) == {"bricks", "wood"}


@pytest.mark.long
def test_what_takes_a_place_leaves_what_is_not_known(two: Path, inline: Inline) -> None:
    bake(two)
    without(two, "New")
    foreign = two.parent / "other"
    write_set(foreign / "other" / "wood")
    bake_library(foreign, two.parent / "out/bricks/", LINEAR, batch=BatchOptions())
    (two.parent / "out/bricks/.mipbake").rename(two.parent / "gone")
    failed = bake(two)
    assert counts(failed) == (0, 1, 1) and "it holds other results" in str(failed.failures[0].error)
    assert stacks(two) == {"bricks/Old", "bricks/New", "bricks/other/wood", "wood"}


@pytest.mark.long
def test_a_stack_of_another_source_is_no_place_for_others(two: Path, inline: Inline) -> None:
    main(["bake", str(two / "wood"), "-o", str(two.parent / "out/bricks/.."), "--method", "linear", "--format", "png"])
    (two.parent / "out/wood").rename(two.parent / "out/bricks")
    failed = bake(two)
    assert counts(failed) == (1, 0, 2) and stacks(two) == {"bricks", "wood"}
    assert all("holds a stack of another source, remove it" in str(each.error) for each in failed.failures)


@pytest.mark.long
def test_a_folder_gets_folders_of_sets(tmp_path: Path, inline: Inline) -> None:
    root = tmp_path / "lib"
    write_set(root / "steel")
    bake(aged(root))
    assert stacks(root) == {"steel"}
    write_set(root / "steel" / "rusty")
    aged(root, 5.0)
    assert counts(bake(root)) == (2, 0, 0) and stacks(root) == {"steel/steel", "steel/rusty"}


def told(root: Path, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["bake", str(root), "-r", "-o", str(root.parent / "out"), "--method", "linear", "--format", "png"]) == 0
    return capsys.readouterr().out


@pytest.mark.long
def test_a_tile_that_is_gone_leaves_the_result(tmp_path: Path, inline: Inline) -> None:
    root = tmp_path / "lib"
    for tile in (1001, 1002, 1021):
        write_maps(root / "body", "Body", tile=f".{tile}")
    bake(aged(root))
    assert "stack.1021.json" in files(root, "body")
    for file in (root / "body").glob("*.1021.png"):
        file.unlink()
    aged(root, 5.0)
    planned = only(bake(root, dry_run=True), Planned)
    assert planned.why == "the source of its tile 1021 is gone"
    assert counts(bake(root)) == (2, 0, 0)
    assert {"stack.1001.json", "stack.1002.json"} <= files(root, "body")
    assert not any("1021" in name for name in files(root, "body"))
    assert counts(bake(root))[0] == 0


@pytest.mark.long
def test_batches_tell_what_belongs_to_no_set(two: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_png(two / "bricks" / "Other_Height.png", np.zeros((16, 16), np.uint8))
    assert "1 warning" in told(aged(two), capsys)
    out = ["-o", str(two.parent / "alone"), "--method", "linear", "--format", "png"]
    assert main(["bake", str(two / "bricks"), *out]) == 0
    assert capsys.readouterr().out.count("belongs to none of the sets, and is left out") == 1


@pytest.mark.long
def test_results_whose_sources_are_gone_are_told_of(
    two: Path, inline: Inline, capsys: pytest.CaptureFixture[str]
) -> None:
    write_set(two / "steel")
    out = two.parent / "out"
    told(aged(two), capsys)
    for name in ("wood", "steel"):
        shutil.rmtree(two / name)
    said = f"note: 2 results, such as {out / 'steel'}, have no source any more, and nothing is baked there"
    assert said in told(two, capsys)
    part = ["bake", str(two / "bricks"), "-o", str(out), "--method", "linear", "--format", "png"]
    assert main(part) == 0  # a set beside them
    shutil.rmtree(out / "steel")
    assert f"note: the result {out / 'wood'} has no source any more" in told(two, capsys)
    write_set(two / "other" / "wood")  # which takes another place
    write_set(two / "wood")
    aged(two, 5.0)
    assert "no source any more" not in told(two, capsys)


def test_a_place_that_another_source_has_taken_is_no_result_without_one(
    tmp_path: Path, inline: Inline, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "lib"
    write_set(root / "steel")
    told(aged(root), capsys)
    shutil.make_archive(str(root / "steel"), "zip", root / "steel")
    shutil.rmtree(root / "steel")
    aged(root, 5.0)
    assert "no source any more" not in told(root, capsys)


@pytest.mark.long
def test_one_of_two_sets_without_files_is_told_of_and_patterns_are_not(
    two: Path, inline: Inline, capsys: pytest.CaptureFixture[str]
) -> None:
    root = two.parent / "tiles"
    write_maps(root / "body", "Body", tile=".1001")
    pattern = str(aged(root) / "body" / "Body_Normal.<UDIM>.png")
    out = ["-o", str(two.parent / "out"), "--method", "linear", "--format", "png", "--force"]
    assert main(["bake", pattern, *out, "--map", "roughness=1"]) == 0
    write_maps(two / "bricks", "Third", 100)
    told(aged(two), capsys)
    assert (two.parent / "out/bricks/Third").exists()
    without(two, "Third")
    assert f"note: the result {two.parent / 'out/bricks/Third'} has no source any more" in told(two, capsys)
