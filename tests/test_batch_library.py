"""What is found below a folder, and where the results lie. Nothing is read, so files may be empty."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import pytest

from mipbake.base.errors import InputError
from mipbake.library import Entry, entries_below, found_library
from mipbake.source.options import LoadOptions

MAPS = ("wood_normal.png", "wood_roughness.png")


def make(root: Path, *names: str) -> Path:
    """Empty files below a folder."""
    for name in names:
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    return root


def results(*sources: Path, recursive: bool = True) -> dict[str, str]:
    """Label to the folder of its results."""
    found = found_library(sources, sources[0].parent / "out", lambda _: LoadOptions(), recursive)
    return {each.label: each.result.as_posix() for each in found.entries}


def labels(entries: Iterable[Entry]) -> set[str]:
    return {each.label for each in entries}


def test_results_keep_the_tree_of_the_library(tmp_path: Path) -> None:
    root = make(
        tmp_path / "lib",
        *(f"metals/steel/{name}" for name in MAPS),
        *(f"my wood/{name}" for name in MAPS),
        "wood.zip",
        "chairs/red.glb",
        "a/b/c.mtlx",
    )
    assert results(root) == {
        "wood.zip": "wood.zip",
        "a/b/c.mtlx": "a/b/c.mtlx",
        "chairs/red.glb": "chairs/red.glb/red",
        "metals/steel": "metals/steel/steel",
        "my wood": "my wood/my_wood",
    }


def test_a_source_that_is_named_is_a_library_of_its_own(tmp_path: Path) -> None:
    root = make(tmp_path / "wood", *MAPS)
    archive, scene = (make(tmp_path, name) / name for name in ("x.zip", "s.gltf"))
    assert results(root) == {".": "wood"}
    named = {str(root): "wood", str(archive): ".", str(scene): "s"}
    assert results(root, archive, scene) == results(root, archive, scene, recursive=False) == named


def test_no_result_is_or_holds_the_result_of_another_source(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", *(f"{folder}{name}" for folder in ("w/", "w/4k/", "w/w/") for name in MAPS))
    found = found_library([root], tmp_path / "out", lambda _: LoadOptions()).entries
    assert {each.label: each.rival for each in found} == {"w": None, "w/4k": None, "w/w": root / "w"}
    one, two = (make(tmp_path / name / "wood", *MAPS) for name in ("one", "two"))
    found = found_library([one, two], tmp_path / "out", lambda _: LoadOptions(), recursive=False).entries
    assert [each.rival for each in found] == [None, one]


def test_what_is_passed_over(tmp_path: Path) -> None:
    root = make(
        tmp_path / "lib",
        *(f"{folder}/{name}" for folder in ("set", ".hidden", "out/set", "baked/set") for name in MAPS),
        "notes/readme.txt",
        "previews/sphere.jpg",
    )
    (root / "baked/set/stack.json").write_text('{"schema": "mipbake-stack"}')
    (root / "set/round").symlink_to(root)
    library = entries_below([root], root / "out")
    assert [entry.label for entry in library.entries] == ["set"]
    (note,) = library.notes
    assert "previews" in note and "tell no map" in note


def test_what_lies_in_the_library_comes_before_links_to_it(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", *(f"steel/{name}" for name in MAPS))
    make(tmp_path / "store", *(f"oak/{name}" for name in MAPS))
    (root / "a").mkdir()
    (root / "a" / "again").symlink_to(root / "steel")
    (root / "a" / "oak").symlink_to(tmp_path / "store" / "oak")
    library = entries_below([root], tmp_path / "out")
    assert sorted(entry.label for entry in library.entries) == ["a/oak", "steel"]
    (note,) = library.notes
    assert note.startswith(f"{root / 'a' / 'again'} is left out: it is a link to ")


def document(*images: str) -> str:
    """glTF that shows images."""
    return json.dumps({"asset": {"version": "2.0"}, "images": [{"uri": each} for each in images]})


def test_images_that_a_document_beside_their_folder_shows_are_not_left_out(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "chair/one.png", "chair/two.png")
    (root / "chair.gltf").write_text(document("chair/one.png", "chair/two.png"))
    assert entries_below([root], tmp_path / "out").notes == ()
    (root / "chair.gltf").write_text(document("chair/one.png"))
    (note,) = entries_below([root], tmp_path / "out").notes
    assert "chair is left out" in note


def test_maps_beside_a_document_are_its_own_or_a_set(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", *(f"s/{name}" for name in MAPS), *(f"t/textures/{name}" for name in MAPS))
    (root / "s/s.gltf").write_text(document(*MAPS))
    assert labels(entries_below([root], tmp_path / "out").entries) == {"s/s.gltf", "t"}
    (root / "s/s.gltf").write_text("broken")
    assert labels(entries_below([root], tmp_path / "out").entries) == {"s/s.gltf", "s", "t"}


def test_names_say_more_than_the_materialx_document_beside_them(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "s/s.mtlx", *(f"s/{name}" for name in MAPS))
    library = entries_below([root], tmp_path / "out")
    assert [entry.label for entry in library.entries] == ["s"]
    assert "s.mtlx is left out" in library.notes[0]


def test_nothing_to_bake(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "previews/sphere.jpg")
    with pytest.raises(InputError, match=r"nothing below .* can be baked.*previews is left out"):
        entries_below([root], tmp_path / "out")
    with pytest.raises(InputError, match="does not exist"):
        entries_below([tmp_path / "no"], tmp_path / "out")
