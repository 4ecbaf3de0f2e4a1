"""What the file system refuses, and what is not a file, gets one sentence and the exit code of unusable input."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import pytest

from mipbake.base import disk
from mipbake.base.json_text import parsed
from mipbake.cli.main import main

from .command_line import fails, tree, write_set
from .permissions import bound_by_permissions

__all__ = ["bound_by_permissions"]

Capture = pytest.CaptureFixture[str]
COMMANDS = {
    "bake": lambda source, out: ["bake", source, "-o", out, "--method", "linear"],
    "inspect": lambda source, _out: ["inspect", source],
    "info": lambda source, _out: ["info", source],
    "validate": lambda source, _out: ["validate", source, source],
    "convert": lambda source, out: ["convert", source, "--to", "ggx", "-o", out],
    "compare": lambda source, out: ["compare", source, "-o", out],
}

pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="permissions, pipes and links of POSIX systems"),
    pytest.mark.usefixtures("unmeasured"),
]


@pytest.fixture
def patience() -> Iterator[None]:
    """Ends a test that waits for a pipe."""

    def late(_signal: int, _frame: FrameType | None) -> None:
        raise AssertionError("it waits")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def locked(tmp_path: Path, bound_by_permissions: None) -> Iterator[Callable[[Path, int], Path]]:
    """Takes permissions from a path, and gives them back."""
    changed = []

    def lock(path: Path, mode: int) -> Path:
        changed.append((path, path.stat().st_mode))
        path.chmod(mode)
        return path

    yield lock
    for path, mode in reversed(changed):
        path.chmod(mode)


@pytest.mark.parametrize(
    ("command", "what"), [*((each, "parent") for each in COMMANDS), ("bake", "folder"), ("bake", "entered")]
)
def test_what_permissions_hide_is_unusable_input(folder, tmp_path, capsys, locked, command, what):
    parent = tmp_path / "parent"
    parent.mkdir()
    source = Path(shutil.copytree(folder, parent / "metal"))
    if what == "parent":
        locked(parent, 0)
    else:
        locked(source, 0 if what == "folder" else 0o444)
    code = 3
    message = fails(capsys, code, *COMMANDS[command](source, tmp_path / "out"))
    assert str(source) in message
    assert ("Permission denied" in message) == (command != "info" or what == "parent")
    assert not (tmp_path / "out").exists()


def test_a_map_below_a_locked_folder_is_unusable_input(folder, tmp_path, capsys, locked):
    (tmp_path / "p").mkdir()
    locked(tmp_path / "p", 0)
    for source in ("x.glb", "x.mtlx", "x.png", "x_<UDIM>.png"):
        assert "Permission denied" in fails(capsys, 3, *COMMANDS["bake"](tmp_path / "p" / source, tmp_path / "out"))
    assert "Permission denied" in fails(capsys, 3, "inspect", folder, "--map", f"normal={tmp_path / 'p' / 'n.png'}")
    assert "Permission denied" in fails(capsys, 3, "bake", f"@{tmp_path / 'p' / 'list'}", "-o", tmp_path / "out")
    mesh = ["compare", folder, "-o", tmp_path / "out", "--mesh", tmp_path / "p" / "m.obj"]
    assert "Permission denied" in fails(capsys, 3, *mesh)
    light = ["compare", folder, "-o", tmp_path / "out", "--light", tmp_path / "p" / "l.exr"]
    assert "Permission denied" in fails(capsys, 3, *light)


def test_a_glob_says_what_it_may_not_see(folder, tmp_path, capsys, locked):
    locked(folder, 0o444)
    assert "Permission denied" in fails(capsys, 3, *COMMANDS["bake"](tmp_path / "met*", tmp_path / "out"))
    locked(folder, 0)
    assert "cannot be listed" in fails(capsys, 3, *COMMANDS["bake"](folder / "*.png", tmp_path / "out"))


@pytest.mark.long
@pytest.mark.parametrize("mode", [0, 0o444])
@pytest.mark.parametrize("pattern", ["**/*.png", "*/roughness.png", "lock*/**"])
def test_a_glob_names_the_inner_folder_that_it_may_not_see(tmp_path, capsys, monkeypatch, locked, pattern, mode):
    """Whatever else it finds is read."""
    inner = write_set(tmp_path / "lib" / "locked")
    locked(inner, mode)
    monkeypatch.chdir(tmp_path / "lib")
    for given in (pattern, tmp_path / "lib" / pattern):
        said = fails(capsys, 3, *COMMANDS["bake"](given, tmp_path / "out"))
        assert said.startswith(f"mipbake: {'locked' if given == pattern else inner}") and "Permission denied" in said
    write_set(tmp_path / "lib" / "open")
    assert main(["bake", "**", "-o", str(tmp_path / "out"), "--method", "linear", "--format", "png", "-q"]) == 3
    assert "mipbake: locked" in capsys.readouterr().err
    assert (tmp_path / "out" / "open" / "stack.json").is_file()


@pytest.mark.parametrize("command", COMMANDS)
def test_a_loop_of_links_is_unusable_input(tmp_path: Path, capsys: Capture, command: str) -> None:
    (tmp_path / "loop").symlink_to("loop")
    message = fails(capsys, 3, *COMMANDS[command](tmp_path / "loop", tmp_path / "out"))
    assert "leads back to itself" in message


@pytest.mark.parametrize("command", ["bake", "convert", "compare"])
def test_loops_and_pipes_are_no_place_for_results(folder: Path, tmp_path: Path, capsys: Capture, command: str) -> None:
    (tmp_path / "loop").symlink_to("loop")
    os.mkfifo(tmp_path / "pipe")
    before = tree(tmp_path)
    for out in (tmp_path / "loop", tmp_path / "loop" / "below"):
        assert "leads back to itself" in fails(capsys, 4, *COMMANDS[command](folder, out))
    fails(capsys, 4, *COMMANDS[command](folder, tmp_path / "pipe"))
    assert tree(tmp_path) == before


def test_links_to_nothing_in_a_set_are_passed_over(folder: Path, capsys: Capture) -> None:
    (folder / "self").symlink_to("self")
    (folder / "metal_ao.png").symlink_to("nowhere.png")
    (folder / "stack.json").symlink_to("stack.json")
    assert main(["inspect", str(folder), "--quiet"]) == 0


@pytest.mark.parametrize("name", ["a.png", "a.glb", "a.mtlx", "a.ktx2", "a"])
def test_a_pipe_is_no_source(tmp_path: Path, capsys: Capture, patience: None, name: str) -> None:
    os.mkfifo(tmp_path / name)
    for command in ("bake", "inspect", "info", "convert"):
        fails(capsys, 3, *COMMANDS[command](tmp_path / name, tmp_path / "out"))


def test_pipes_in_a_set_are_passed_over(folder: Path, tmp_path: Path, capsys: Capture, patience: None) -> None:
    for name in ("metal_ao.png", "stack.json", "material.json", "notes.txt"):
        os.mkfifo(folder / name)
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "linear", "-q"]) == 0
    assert "is a pipe" in fails(capsys, 3, "info", folder)
    (folder / "normal.png").unlink()
    os.mkfifo(folder / "normal.png")
    assert "no normal" in fails(capsys, 3, "inspect", folder)


def test_a_list_may_be_a_pipe_that_somebody_writes_to(folder: Path, tmp_path: Path, patience: None) -> None:
    os.mkfifo(tmp_path / "silent")
    assert disk.read_text_or_pipe(tmp_path / "silent") == ""
    reading, writing = os.pipe()
    os.write(writing, f"{folder}\n".encode())
    os.close(writing)
    assert disk.read_text_or_pipe(Path(f"/dev/fd/{reading}")) == f"{folder}\n"
    os.close(reading)


@pytest.mark.parametrize("text", ['{"a": Infinity}', '{"a": -Infinity}', "[NaN]", "1e999", "[" * 100_000])
def test_json_is_what_the_standard_says(text: str) -> None:
    with pytest.raises(ValueError, match=r"not a number|beyond|deeply"):
        parsed(text)
