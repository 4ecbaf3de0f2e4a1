"""What is found below a folder, and where the results lie. Nothing is read, so files may be empty."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

from mipbake.base.errors import InputError
from mipbake.library import Entry, entries_below, entries_of

MAPS = ("wood_normal.png", "wood_roughness.png")


def make(root: Path, *names: str) -> Path:
    """Empty files below a folder."""
    for name in names:
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    return root


def none(_document: Path) -> Iterable[Path]:
    return ()


def below(root: Path, out: Path | None = None, files_of=none) -> tuple[Entry, ...]:
    return entries_below([root], out or root.parent / "out", files_of).entries


def places(entries: Iterable[Entry]) -> dict[str, str]:
    """Label to the place of a result that is called as the source is."""
    return {each.label: str(each.home.place([each.home.name]) / each.home.name) for each in entries}


def test_the_tree_is_kept(tmp_path: Path) -> None:
    root = make(
        tmp_path / "lib", *(f"metals/steel/{name}" for name in MAPS), "wood.zip", "chairs/red.glb", "a/b/c.mtlx"
    )
    assert places(below(root)) == {
        "wood.zip": "wood",
        "a/b/c.mtlx": "a/b/c",
        "chairs/red.glb": "chairs/red",
        "metals/steel": "metals/steel",
    }


def test_sources_with_several_results_get_a_folder(tmp_path: Path) -> None:
    (entry,) = below(make(tmp_path / "lib", "metals/all.zip"))
    assert entry.home.place(["all"]).as_posix() == "metals"
    assert entry.home.place(["iron", "gold"]).as_posix() == "metals/all"
    assert entry.home.place(["iron"]).as_posix() == "metals/all"


def test_names_that_several_sources_would_have(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "wood.zip", "wood.glb", "WOOD.mtlx", *(f"wood/{name}" for name in MAPS))
    found = below(root)
    named = places(found)
    assert named["wood"] == "wood"  # folders come first
    assert len({place.casefold() for place in named.values()}) == len(named) == 4
    for entry in found:
        if entry.label != "wood":  # whatever they hold, it lies in a folder that is theirs
            assert entry.home.place([entry.home.name]) == entry.home.place(["x", "y"])
            assert entry.home.place(["x"]).name == entry.label


def test_a_result_holds_no_other(tmp_path: Path) -> None:
    """The files of a stack lie alone in their folder."""
    root = make(tmp_path / "lib", *(f"{folder}{name}" for folder in ("w/", "w/4k/", "w/w/") for name in MAPS))
    named = places(below(root))
    assert named["w"] == "w/w_2" or named["w"] == "w/w"
    folders = [Path(place) for place in named.values()]
    assert len(set(folders)) == 3
    assert not any(a != b and a in b.parents for a in folders for b in folders)


def test_adding_a_source_moves_no_other(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "wood.zip", *(f"wood/{name}" for name in MAPS), "x/a.zip")
    before = places(below(root))
    make(root, "wood.gltf", "ash.zip", "x/b.zip")
    after = places(below(root))
    assert before.items() <= after.items()


def test_what_is_passed_over(tmp_path: Path) -> None:
    root = make(
        tmp_path / "lib",
        *(f"{folder}/{name}" for folder in ("set", ".hidden", "out/set", "baked/set") for name in MAPS),
        "notes/readme.txt",
        "previews/sphere.jpg",
    )
    (root / "baked/set/stack.json").write_text('{"schema": "mipbake-stack"}')
    (root / "set/round").symlink_to(root)
    library = entries_below([root], root / "out", none)
    assert [entry.label for entry in library.entries] == ["set"]
    (note,) = library.notes
    assert "previews" in note and "tell no map" in note


def test_what_lies_in_the_library_comes_before_links_to_it(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", *(f"steel/{name}" for name in MAPS))
    make(tmp_path / "store", *(f"oak/{name}" for name in MAPS))
    (root / "a").mkdir()
    (root / "a" / "again").symlink_to(root / "steel")
    (root / "a" / "oak").symlink_to(tmp_path / "store" / "oak")
    library = entries_below([root], tmp_path / "out", none)
    assert sorted(entry.label for entry in library.entries) == ["a/oak", "steel"]
    (note,) = library.notes
    assert note.startswith(f"{root / 'a' / 'again'} is left out: it is a link to ")


def test_images_that_a_document_beside_their_folder_shows_are_not_left_out(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "chair.gltf", "chair/one.png", "chair/two.png")
    images = [root / "chair/one.png", root / "chair/two.png"]
    assert entries_below([root], tmp_path / "out", lambda _: images).notes == ()
    (note,) = entries_below([root], tmp_path / "out", lambda _: images[:1]).notes
    assert "chair is left out" in note


def test_textures_belong_to_the_folder_around_them(tmp_path: Path) -> None:
    root = make(
        tmp_path / "lib", *(f"set/textures/{name}" for name in MAPS), "scene/scene.gltf", "scene/textures/a.png"
    )
    assert set(places(below(root))) == {"set", "scene/scene.gltf"}


def test_maps_beside_a_document_are_its_own_or_a_set(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "s/s.gltf", *(f"s/{name}" for name in MAPS))
    assert set(places(below(root, files_of=lambda _: [root / "s" / name for name in MAPS]))) == {"s/s.gltf"}
    assert set(places(below(root))) == {"s/s.gltf", "s"}


def test_a_broken_document_is_a_source(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "s/s.gltf", "s/x_normal.png")

    def broken(_document: Path) -> Iterable[Path]:
        raise InputError("broken")

    assert set(places(below(root, files_of=broken))) == {"s/s.gltf"}


def test_names_say_more_than_the_materialx_document_beside_them(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "s/s.mtlx", *(f"s/{name}" for name in MAPS))
    library = entries_below([root], tmp_path / "out", none)
    assert [entry.label for entry in library.entries] == ["s"]
    assert "s.mtlx is left out" in library.notes[0]


def test_a_library_that_is_a_set(tmp_path: Path) -> None:
    assert places(below(make(tmp_path / "wood", *MAPS))) == {".": "wood"}


def test_files_among_the_roots_and_several_roots(tmp_path: Path) -> None:
    one, two = (make(tmp_path / name, *(f"w/{each}" for each in MAPS)) for name in ("one", "two"))
    archive = make(tmp_path, "x.zip") / "x.zip"
    found = entries_below([one, two, archive], tmp_path / "out", none).entries
    assert [each.label for each in found] == [str(one / "w"), str(two / "w"), str(archive)]
    assert len(set(places(found).values())) == 3


def test_nothing_to_bake(tmp_path: Path) -> None:
    root = make(tmp_path / "lib", "previews/sphere.jpg")
    with pytest.raises(InputError, match=r"nothing below .* can be baked.*previews is left out"):
        below(root)
    with pytest.raises(InputError, match="does not exist"):
        below(tmp_path / "no")


def test_sources_that_are_named_lie_side_by_side(tmp_path: Path) -> None:
    paths = [tmp_path / "a" / "wood", tmp_path / "b" / "wood", tmp_path / "b" / "iron.zip"]
    named = places(entries_of(paths).entries)
    assert named[str(paths[2])] == "iron" and len(set(named.values())) == 3
