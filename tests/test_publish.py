"""No result is lost, wherever a process is stopped while it puts another in its place."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from mipbake.base.errors import OutputError
from mipbake.base.leftovers import remove, unfinished
from mipbake.base.publish import check_file, check_place, published, replaced_file
from mipbake.cli.main import main

from .command_line import fails, write_set

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and locks as POSIX has them")

STEPS = Path(__file__).parent / "publish_steps.py"


def program(code: str, *arguments: object) -> subprocess.Popen[str]:
    path = os.pathsep.join(p for p in sys.path if p)
    command = [sys.executable, *(("-c", code) if code else ()), *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(
        command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env={**os.environ, "PYTHONPATH": path}
    )


def ours(_folder: Path) -> bool:
    return True


def publish_text(place: Path, text: str) -> None:
    with published(place, ours) as folder:
        (folder / "text").write_text(text)


def without_exchange(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes the C library one that cannot exchange two names."""

    def refuses(_name: None) -> None:
        raise OSError("no C library")

    monkeypatch.setattr(ctypes, "CDLL", refuses)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.long
@pytest.mark.parametrize(
    "arguments",
    ["exchange KILL folder", "renames KILL folder", "exchange INT folder", "renames TERM folder", "exchange KILL file"],
)
def test_a_result_survives_a_stop_at_every_step(tmp_path: Path, arguments: str) -> None:
    running = program("", STEPS, tmp_path, *arguments.split())
    out, err = running.communicate(timeout=600)
    assert running.returncode == 0, err
    first, *wrong = out.strip().splitlines()
    assert int(first.split()[0]) > 80, first
    assert not wrong, "\n".join(wrong[:10])


def test_a_folder_that_got_other_files_meanwhile_stays(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match="holds files that are not mipbake's"),
        published(tmp_path / "set", lambda _folder: False) as folder,
    ):
        (folder / "text").write_text("ours")
        (tmp_path / "set").mkdir()
        (tmp_path / "set" / "notes").write_text("somebody's")
    assert names(tmp_path) == ["set"] and names(tmp_path / "set") == ["notes"]


def test_leftovers_of_the_dead_go_and_those_of_the_living_stay(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from mipbake.base.publish import published\n"
        "with published(Path(sys.argv[1]) / 'set', lambda folder: True) as folder:\n"
        "    (folder / 'text').write_text('living'); print('ready', flush=True); sys.stdin.read()\n"
    )
    living, dying = program(code, tmp_path), program(code, tmp_path)
    for each in (living, dying):
        assert each.stdout is not None and each.stdout.readline() == "ready\n"
    dying.kill()
    dying.communicate()
    foreign = tmp_path / ".set.notes.partial"
    foreign.write_text("somebody's")
    (tmp_path / ".set.0badcafe.partial").mkdir()
    (tmp_path / ".other.0badcafe.partial").mkdir()
    assert len(names(tmp_path)) == 5
    publish_text(tmp_path / "set", "new")
    left = [name for name in names(tmp_path) if name not in (foreign.name, "set", ".other.0badcafe.partial")]
    assert len(left) == 1 and (tmp_path / left[0] / "text").read_text() == "living"
    assert (tmp_path / "set" / "text").read_text() == "new"
    assert living.communicate("")[1] == "" and living.returncode == 0
    assert (tmp_path / "set" / "text").read_text() == "living"
    assert names(tmp_path) == [".other.0badcafe.partial", foreign.name, "set"]


def test_a_result_that_was_moved_aside_comes_back(tmp_path: Path) -> None:
    aside = tmp_path / ".set.0badcafe.old"
    aside.mkdir()
    (aside / "text").write_text("old")
    with pytest.raises(OutputError, match="not mipbake's"):
        check_place(tmp_path / "set", lambda _folder: False)  # what it holds now counts, as ever
    assert names(tmp_path) == ["set"] and (tmp_path / "set" / "text").read_text() == "old"
    aside.mkdir()  # the process died before it could remove it: the new one is there
    check_place(tmp_path / "set", ours)
    assert names(tmp_path) == ["set"] and (tmp_path / "set" / "text").read_text() == "old"


@pytest.mark.parametrize("exchange", [True, False])
def test_many_at_once_leave_one_whole_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exchange: bool) -> None:
    if not exchange:
        without_exchange(monkeypatch)
    failed: list[BaseException] = []

    def work(text: str) -> None:
        try:
            for _ in range(10):
                publish_text(tmp_path / "new" / "set", text)
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=work, args=(str(index),)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not failed, failed
    assert names(tmp_path / "new") == ["set"] and (tmp_path / "new" / "set" / "text").read_text() in "0123"


def test_another_process_takes_the_name_in_the_middle_of_a_swap(tmp_path, monkeypatch):
    without_exchange(monkeypatch)
    publish_text(tmp_path / "set", "old")
    rename = Path.rename
    others: list[str] = []

    def interrupted(source: Path, goal: Path) -> Path:
        if source.suffix == ".partial" and goal.exists() and not others:
            others.append(goal.name)
            try:
                return rename(source, goal)
            finally:
                remove(goal)  # moved aside
        return rename(source, goal)

    monkeypatch.setattr(Path, "rename", interrupted)
    publish_text(tmp_path / "set", "new")
    assert len(others) == 1
    assert names(tmp_path) == ["set"] and (tmp_path / "set" / "text").read_text() == "new"


def test_an_earlier_result_that_cannot_be_moved_back_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next bake of it gives it its name back."""
    without_exchange(monkeypatch)
    publish_text(tmp_path / "set", "old")
    rename = Path.rename

    def refused(source: Path, goal: Path) -> Path:
        if source.suffix == ".old" or (source.suffix == ".partial" and not (tmp_path / "set").exists()):
            raise OSError(5, "Input/output error")
        return rename(source, goal)

    monkeypatch.setattr(Path, "rename", refused)
    with pytest.raises(OutputError, match=r"the earlier result is .*\.old, and the next bake") as caught:
        publish_text(tmp_path / "set", "new")
    (aside,) = names(tmp_path)
    assert aside in str(caught.value) and (tmp_path / aside / "text").read_text() == "old"
    monkeypatch.undo()
    check_place(tmp_path / "set", ours)
    assert names(tmp_path) == ["set"] and (tmp_path / "set" / "text").read_text() == "old"


def test_what_cannot_be_removed_is_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mipbake.base.leftovers.remove", lambda _path: None)
    with pytest.raises(OutputError), published(tmp_path / "set", ours):
        raise OSError(5, "Input/output error")
    assert len(unfinished()) == 2  # the trial, too
    monkeypatch.undo()
    check_place(tmp_path / "set", ours)
    assert not unfinished() and names(tmp_path) == []


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    replaced_file(tmp_path / "new" / "scene.glb", b"one")
    (tmp_path / "new" / ".scene.glb.0badcafe.partial").write_bytes(b"half")
    replaced_file(tmp_path / "new" / "scene.glb", b"two")
    assert (tmp_path / "new" / "scene.glb").read_bytes() == b"two" and names(tmp_path / "new") == ["scene.glb"]
    with pytest.raises(OutputError, match="Not a directory"):
        replaced_file(tmp_path / "new" / "scene.glb" / "other.glb", b"")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "link").symlink_to(tmp_path / "far" / "file")
    replaced_file(tmp_path / "link", b"three")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "far" / "file").read_bytes() == b"three"
    with pytest.raises(OutputError):
        check_file(tmp_path / "loop", ours, "file")


def test_what_engines_put_beside_files_moves_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = write_set(tmp_path / "wood"), tmp_path / "out"
    bake = ["bake", source, "-o", out, "--method", "linear", "--format", "png", "--quiet"]
    assert main([*map(str, bake), "--max-level", "2"]) == 0
    result = out / "wood"
    (kept, coarse) = (result / f"{name}.meta" for name in ("base_color_mip00.png", "base_color_mip02.png"))
    kept.write_text("guid: 1")
    coarse.write_text("guid: 2")
    (result / ".DS_Store").write_bytes(b"\0")
    assert main([*map(str, bake), "--max-level", "1"]) == 0
    assert kept.read_text() == "guid: 1"
    assert not coarse.exists() and not (result / ".DS_Store").exists()
    (result / "nothing.png.meta").write_text("guid: 3")
    assert "files that are not mipbake's" in fails(capsys, 4, *bake)
    assert (result / "nothing.png.meta").exists() and kept.read_text() == "guid: 1"
