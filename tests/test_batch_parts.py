"""Several sets in one folder: each is baked by itself, with options of its own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.baking import BakeOptions
from mipbake.library import Chosen, Shard, bake_library
from mipbake.library.listing import found_library
from mipbake.source.options import LoadOptions

from .batch_inline import LINEAR, Inline, aged, bake, counts, inline_workers
from .command_line import write_png
from .test_batch_workers import content

__all__ = ["inline_workers"]
"""A fixture."""

READ = LoadOptions()


def write_maps(folder: Path, name: str, roughness: int = 90, tile: str = "", **maps: np.ndarray) -> None:
    """A normal and a roughness map whose names begin with the name of their set."""
    folder.mkdir(parents=True, exist_ok=True)
    normal = np.full((16, 16, 3), (128, 128, 255), np.uint8)
    every = {"Normal": normal, "Roughness": np.full((16, 16), roughness, np.uint8), **maps}
    for role, texels in every.items():
        write_png(folder / f"{name}_{role}{tile}.png", texels)


@pytest.fixture(name="flat")
def flat_folder(tmp_path: Path) -> Path:
    root = tmp_path / "lib"
    for index, name in enumerate(("Body", "Head", "Left_Arm")):
        write_maps(root / "props", name, 60 + 20 * index)
    write_maps(root / "wood", "wood")
    return aged(root)


def labels(root: Path) -> list[str]:
    return [each.label for each in found_library([root], root.parent / "out", lambda _: READ).entries]


def test_each_set_is_an_entry(flat: Path) -> None:
    assert labels(flat) == ["props/Body", "props/Head", "props/Left_Arm", "wood"]
    assert labels(flat / "props") == ["Body", "Head", "Left_Arm"]


def test_results_are_those_of_a_bake_of_the_folder(flat: Path, inline: Inline) -> None:
    assert counts(bake(flat)) == (4, 0, 0)
    assert inline.labels == ["props/Body", "props/Head", "props/Left_Arm", "wood"]
    mipbake.bake_all(flat / "props", flat.parent / "alone", LINEAR)
    one, other = flat.parent / "alone", flat.parent / "out/props"
    assert content(one) == content(other) != {}


@pytest.mark.long
def test_one_set_changes_or_is_added(flat: Path, inline: Inline) -> None:
    bake(flat)
    inline.labels.clear()
    assert counts(bake(flat)) == (0, 4, 0) and inline.labels == []
    write_maps(flat / "props", "Head", 200)
    write_maps(flat / "props", "Tail")
    assert counts(bake(aged(flat, 5.0))) == (2, 3, 0)
    told = json.loads((flat.parent / "out/props/Head/stack.json").read_text())
    assert told["name"] == "Head"


@pytest.mark.long
def test_a_choice_that_does_not_fit_one_of_the_sets(flat: Path, inline: Inline) -> None:
    def choose(label: str) -> Chosen:
        maps = {"normal": "Left_Arm_*.png"} if label == "props/Left_Arm" else {}
        write = BakeOptions(method="linear", format="png", max_level=1)
        return Chosen(write, LoadOptions(maps=maps))

    write_png(flat / "props/Left_Arm_Metallic.png", np.full((16, 16), 9, np.uint8))
    summary = bake_library(flat, flat.parent / "out", choose=choose)
    assert counts(summary) == (3, 0, 1)
    (error,) = [each.error for each in summary.failures]
    assert "matches" in str(error) and "Left_Arm" in str(error)


def test_shards_divide_the_sets_of_a_folder(flat: Path) -> None:
    def part(number: int) -> list[str]:
        library = found_library([flat], flat.parent / "out", lambda _: READ, shard=Shard(number, 2))
        return [each.label for each in library.entries]

    assert part(1) == ["props/Body", "props/Left_Arm"] and part(2) == ["props/Head", "wood"]


@pytest.mark.long
def test_a_set_in_a_folder_and_a_folder_of_its_name(flat: Path, inline: Inline) -> None:
    write_maps(flat / "props/Body", "b")
    aged(flat)
    found = labels(flat)
    assert len(set(found)) == len(found) == 5 and {"props/Body", "props/Body_2"} <= set(found)
    summary = bake(flat)
    assert counts(summary) == (4, 0, 1)
    assert f"the result of {flat / 'props'} lies there as well" in str(summary.failures[0].error)
