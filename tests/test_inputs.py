"""What arguments stand for, and what kind of input a path is."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mipbake.base.errors import InputError
from mipbake.source.images.read import IMAGE_SUFFIXES
from mipbake.source.inputs import expand, kind

from .input_files import plain_set


def touch(folder: Path, *names: str) -> list[Path]:
    paths = [folder / name for name in names]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return paths


def test_a_glob_is_what_it_finds_sorted(tmp_path: Path) -> None:
    b, a, deep = touch(tmp_path, "b.png", "a.png", "inner/c.png")
    assert expand([f"{tmp_path}/*.png"]) == [a, b]
    assert expand([f"{tmp_path}/?.png", f"{tmp_path}/**/*.png"]) == [a, b, deep]


def test_names_that_look_like_patterns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What exists is itself, and what does not stays as it is; lines of a list are patterns, its folder is not."""
    bracketed, _, inside, _, _ = touch(tmp_path, "wood[1].png", "wood1.png", "[ab]/1.png", "a/1.png", "@wood")
    (tmp_path / "[ab]" / "list").write_text("*.png\n")
    assert expand([str(bracketed), f"@{tmp_path / '[ab]' / 'list'}"]) == [bracketed, inside]
    assert expand([f"{tmp_path}/none", "a.<UDIM>.png"]) == [tmp_path / "none", Path("a.<UDIM>.png")]
    monkeypatch.chdir(tmp_path)
    assert expand(["@wood"]) == [Path("@wood")]
    for source, told in ((f"{tmp_path}/*.exr", r"\*\.exr matches nothing"), ("", "a source has no name")):
        with pytest.raises(InputError, match=told):
            expand([source])


def test_a_glob_passes_over_what_is_no_input(tmp_path: Path) -> None:
    """It does not pass over folders that are empty or hold folders: a forgotten set would be missed."""
    touch(tmp_path, "README.md", "make.py", "code/a.py", "code/more/b.png", "docs/.b.png", "docs/a.md")
    image, document, *_ = touch(tmp_path, "n.png", "a.GLB", "set/a.png", "set/a.txt", "deep/set/a.png", "b/Textures/x")
    (tmp_path / "empty").mkdir()
    wanted = [tmp_path / name for name in ("b", "deep", "empty", "set")]
    assert expand([f"{tmp_path}/*"]) == sorted([image, document, *wanted])
    with pytest.raises(InputError, match=r"matches .*README\.md and nothing that can be baked"):
        expand([f"{tmp_path}/*.md"])


def test_every_input_comes_once_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = touch(tmp_path, "a.png", "b.png")
    monkeypatch.chdir(tmp_path)
    assert expand([str(b), f"{tmp_path}/*.png", "b.png", "./a.png"]) == [b, a]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_list_names_paths_relative_to_itself(tmp_path: Path, encoding: str) -> None:
    first, second, third = touch(tmp_path, "sets/grün.png", "sets/x/1.png", "sets/x/2.png")
    listing = tmp_path / "sets" / "list.txt"
    listing.write_text(f"# sets\n\ngrün.png  \nx/*.png\n{first}\n", encoding=encoding)
    assert expand([f"@{listing}"]) == [first, second, third]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        *((None, "cannot be read"), (b"\n# nothing\n", "holds no path"), (b"\xff\xfe\x00", "is not UTF-8 text")),
        (b"wood*\0.png\n", "zero byte"),
    ],
)
def test_broken_lists_are_refused(tmp_path: Path, content: bytes | None, message: str) -> None:
    listing = tmp_path / "list.txt"
    if content is not None:
        listing.write_bytes(content)
    with pytest.raises(InputError, match=message):
        expand([f"@{listing}"])


def test_kinds_by_suffix(tmp_path: Path) -> None:
    kinds = {".gltf": "gltf", ".GLB": "gltf", ".mtlx": "materialx"} | dict.fromkeys(IMAGE_SUFFIXES, "file")
    for suffix, expected in kinds.items():
        (path,) = touch(tmp_path, f"thing{suffix}")
        assert kind(path) == expected
    (other,) = touch(tmp_path, "thing.txt")
    with pytest.raises(InputError, match=r"thing\.txt is not a source.*@FILE"):
        kind(other)
    with pytest.raises(InputError, match="does not exist"):
        kind(tmp_path / "none")
    with pytest.raises(InputError, match="is neither a file nor a folder"):
        kind(os.devnull)


def test_kinds_of_folders(tmp_path: Path) -> None:
    assert kind(plain_set(tmp_path / "plain")) == "folder"
    touch(tmp_path, "wide/a_color_1024.png", "wide/a_normal_1024.png", "years/trip_1998.jpg", "years/trip_1999.jpg")
    assert kind(tmp_path / "wide") == kind(tmp_path / "years") == "folder"
    touch(tmp_path, "tiles/a_color.1001.png", "tiles/a_color.1002.png", "tiles/read.me")
    touch(tmp_path, "outer/textures/a_color_u1_v1.png", "outer/textures/a_color_u2_v1.png", "outer/license.txt")
    assert kind(tmp_path / "tiles") == kind(tmp_path / "outer") == "udim"
    assert kind("a.<UDIM>.png") == "udim"
    (tmp_path / "empty").mkdir()
    assert kind(tmp_path / "empty") == "folder"
