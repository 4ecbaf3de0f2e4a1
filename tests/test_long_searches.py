"""Searches that are stopped, killed and resumed: what is kept of them, and what is said."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.baking import Listener, bake_sources
from mipbake.baking.methods import PrefilterResult
from mipbake.baking.search import checkpoint
from mipbake.baking.search.checkpoint import Checkpoint, discard
from mipbake.baking.search.long_run import LongRun, Stop, never
from mipbake.baking.search.methods import Auto
from mipbake.base import checkpoints
from mipbake.base.errors import UsageError
from mipbake.cli.bake_output import Stopping

from .command_line import bumps, write_set
from .long_searches import ManyRegions, with_many_regions, without_pauses

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and locks as POSIX has them")

WRAP = ("wrap", "wrap")


def set_in_memory(width: int = 32) -> mipbake.TextureSet:
    maps = {name: image / np.float32(255) for name, image in bumps(16, width).items()}
    maps["normal"] = 2 * maps["normal"] - 1
    return mipbake.TextureSet.from_arrays("bumps", metallic=0.0, **maps)


STORED = set_in_memory().material("gltf")


class After:
    """A stop that says True after it was asked so many times."""

    def __init__(self, times: int) -> None:
        self.left = times

    def __call__(self) -> bool:
        self.left -= 1
        return self.left < 0


def done_in(path: Path) -> list[str]:
    """The files of the regions that a checkpoint holds."""
    return sorted(file.name for file in path.glob("region-*.npz"))


def searched(
    path: Path | None,
    stop: Stop = never,
    notes: Callable[[str], None] = lambda _: None,
    stored: Any = STORED,
    **options: Any,
) -> PrefilterResult:
    method = ManyRegions(**{"budget": "best", "long_run": LongRun(path, lambda: nullcontext(stop), notes), **options})
    return method(stored, "gltf", "gltf", "gaussian", WRAP, lambda _: None)


def same(first: PrefilterResult, second: PrefilterResult) -> bool:
    levels = zip(first.levels, second.levels, strict=True)
    return all(np.array_equal(one, other) for one, other in levels) and first.measured == second.measured


@pytest.fixture(scope="module")
def whole() -> PrefilterResult:
    """The search, uninterrupted."""
    return searched(None)


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    without_pauses(monkeypatch.setattr)


def stopped(path: Path, regions: int = 1, **options: Any) -> PrefilterResult:
    """A search that is stopped when so many regions are kept."""
    found = searched(path, lambda: len(done_in(path)) == regions, **options)
    assert found.stopped and (path / "start.npz").is_file() and len(done_in(path)) == regions
    return found


@pytest.mark.long
def test_a_search_that_is_stopped_often_is_the_same_to_the_last_bit(tmp_path: Path, whole: PrefilterResult) -> None:
    """Stopped at once, in the middle of every region, whose gain is in the result, and between regions."""
    path = tmp_path / "kept"
    for regions in range(4):
        start = searched(path, lambda: True)
        found = searched(path, After(40 if regions else 100))
        assert found.stopped and len(done_in(path)) == regions
        assert (regions or not same(found, start)) and same(searched(path, lambda: True), start)
        if regions < 3:
            stopped(path, regions + 1)
    assert same(searched(path), whole)


def test_a_search_that_is_stopped_at_once_has_its_start(tmp_path: Path) -> None:
    found, notes = searched(tmp_path / "kept", lambda: True), list[str]()
    assert found.stopped and found.measured is not None
    assert {each.refined for each in found.measured.levels} == {0.0}
    assert same(searched(tmp_path / "kept", lambda: True, notes.append), found)
    assert notes[0].startswith("going on from the checkpoint")


def damages(path: Path) -> Iterator[tuple[Path, bytes]]:
    """Files of a checkpoint, and what damage makes of them."""
    for file in sorted(path.iterdir()):
        if file.name != "lock":
            data = file.read_bytes()
            middle = len(data) // 2
            yield file, data[:middle] if file.name == "start.npz" else b""
            yield file, data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


@pytest.mark.long
def test_a_damaged_checkpoint_costs_time_alone(tmp_path: Path, whole: PrefilterResult) -> None:
    path = tmp_path / "kept"
    stopped(path, 2)
    of = about(path / "start.npz")["of"]
    good = {file: file.read_bytes() for file in path.iterdir()}
    assert {file.name for file in good} == {"lock", "start.npz", "region-0.npz", "region-1.npz"}

    begun: Any = id

    def loaded(notes: list[str]) -> object:
        """What is kept: whole searches would take long."""
        with closing(Checkpoint(path, of, False, notes.append)) as kept:
            return kept.load(begun)

    for number, (file, data) in enumerate(damages(path)):
        file.write_bytes(data)
        notes: list[str] = []
        if number:
            assert loaded(notes) is None, file
        else:
            assert same(searched(path, notes=notes.append), whole)
        assert f"the checkpoint {path} is not used, because it cannot be read (" in notes[0], (file, notes)
        assert notes[0].endswith(": the search begins anew")
        for each, before in good.items():
            each.write_bytes(before)
    notes = []
    assert loaded(notes) is not None and not notes


def about(path: Path) -> dict[str, Any]:
    """What a file of a checkpoint says of itself."""
    with np.load(path) as file:
        found: dict[str, Any] = json.loads(file["about"].tobytes())
    return found


def rewrite(path: Path, **changes: Any) -> None:
    """Changes that."""
    with np.load(path) as file:
        arrays = dict(file)
    arrays["about"] = np.frombuffer(json.dumps({**about(path), **changes}).encode(), np.uint8)
    checkpoints.write_arrays(path, arrays)


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"stored": STORED * np.float32(0.9)}, "the set changed"),
        ({"aim": 0.25}, "the options changed"),
        ({"weights": "other"}, "the weights changed"),
        ({"version": "0"}, "it was made by mipbake"),
    ],
)
def test_a_checkpoint_of_another_search_is_not_used(tmp_path: Path, change: dict[str, Any], why: str) -> None:
    path, notes = tmp_path / "kept", list[str]()
    stopped(path)
    start = path / "start.npz"
    if "version" in change:
        rewrite(start, **change)
    if "weights" in change:
        rewrite(start, of={**about(start)["of"], **change})
    change = {} if {"version", "weights"} & change.keys() else change
    assert searched(path, lambda: True, notes.append, **change).stopped
    assert notes[0].startswith(f"the checkpoint {path} is not used, because {why}") and not done_in(path)
    notes.clear()
    searched(path, lambda: True, notes.append, **change)  # it has taken the place of the other
    assert notes[0].startswith(f"going on from the checkpoint {path}, after ")


def test_a_checkpoint_that_lacks_something_is_not_used(tmp_path: Path) -> None:
    """As those of another checkout of the same version may."""
    path, notes = tmp_path / "kept", list[str]()
    first = searched(path, lambda: True)
    with np.load(path / "start.npz") as file:
        checkpoints.write_arrays(path / "start.npz", {name: file[name] for name in file if name != "seen 0"})
    assert same(searched(path, lambda: True, notes.append), first)
    assert notes[0] == (
        f"the checkpoint {path} is not used, because it cannot be read ('seen 0' is missing): the search begins anew"
    )
    notes.clear()
    searched(path, lambda: True, notes.append)  # a new one has taken its place
    assert notes[0].startswith("going on from the checkpoint")


@pytest.mark.long
def test_a_reproducible_search_does_not_go_on_from_one_with_a_limit_of_time(tmp_path: Path) -> None:
    path, notes = tmp_path / "kept", list[str]()
    stopped(path, budget="1h")
    searched(path, lambda: True, notes.append, budget="2h")
    assert notes.pop().startswith("going on from the checkpoint") and not notes
    searched(path, lambda: True, notes.append)
    assert "because it was made within a limit of time, and without one a search is reproducible" in notes[0]
    discard(path)
    stopped(path)
    notes.clear()
    stopped(path, 2, notes=notes.append, budget="1h")  # the other way round nothing is lost
    assert notes[0].startswith("going on from the checkpoint")
    notes.clear()
    searched(path, lambda: True, notes.append)
    assert "limit of time" in notes[0]


@pytest.mark.long
def test_time_that_was_spent_counts(tmp_path: Path) -> None:
    path, notes = tmp_path / "kept", list[str]()
    found = stopped(path, budget="1h")
    rewrite(path / "region-0.npz", seconds=3601.0)
    rest = searched(path, notes=notes.append, budget="1h")
    # No round is worked any more, and the search is done.
    assert notes == [f"going on from the checkpoint {path}, after 1 h of 1 h"]
    assert not rest.stopped and same(rest, found)


@pytest.mark.long
def test_a_full_disk_ends_no_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: PrefilterResult) -> None:
    def full(path: Path, _about: Any, _arrays: Any) -> int:
        path.write_bytes(b"some")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "write_kept", full)
    notes: list[str] = []
    path = tmp_path / "kept"
    assert same(searched(path, notes=notes.append), whole)
    assert sum("is not kept in the checkpoint" in each and "the disk is full" in each for each in notes) == 1
    assert not path.exists()


@pytest.mark.long
def test_two_processes_do_not_share_a_checkpoint(tmp_path: Path, whole: PrefilterResult) -> None:
    path, notes = tmp_path / "kept", list[str]()
    stopped(path)
    lock = checkpoints.lock_of(path / "lock")
    before = {file: file.read_bytes() for file in path.iterdir()}
    try:
        assert same(searched(path, notes=notes.append), whole)
        discard(path)
    finally:
        os.close(lock)
    assert f"another process has the checkpoint {path}: this search is not kept" in notes
    assert {file: file.read_bytes() for file in path.iterdir()} == before


def test_arrays_are_read_as_they_were_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoints, "AT_ONCE", 100)
    rng = np.random.default_rng(0)
    arrays = {
        "a": rng.random((33, 5, 3)).astype(np.float32),
        "b": rng.random((40, 30, 2))[3:20, 4:9],
        "c": np.array(3.5),
        "d": np.zeros((0, 4), np.float32),
    }
    size = checkpoints.write_arrays(tmp_path / "arrays", arrays)
    assert size == (tmp_path / "arrays").stat().st_size
    into = np.zeros((40, 30, 2))
    given = {"b": lambda _shape, _dtype: into[3:20, 4:9]}
    found = checkpoints.read_arrays(tmp_path / "arrays", given.get)
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
    np.testing.assert_array_equal(into[3:20, 4:9], arrays["b"])
    with np.load(tmp_path / "arrays") as file:
        np.testing.assert_array_equal(file["a"], arrays["a"])


def test_the_first_interrupt_is_heard_where_there_is_something_to_keep() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        stopping = Stopping()
        with stopping.descending() as stop:
            assert not stop()
            os.kill(os.getpid(), signal.SIGINT)
            assert stop() and stopping.asked
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1)
        with stopping.descending() as stop:
            assert stop()  # what is begun after it is ended at once
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        with stopping.descending():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("sets") / "metal", **bumps(16, 32))


class Stops(Listener):
    """Stops the first search."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.asked = False

    @contextmanager
    def descending(self) -> Iterator[Stop]:
        self.asked = True
        yield lambda: True

    def ends(self) -> bool:
        return self.asked

    def note(self, sentence: str) -> None:
        self.notes.append(sentence)


@pytest.mark.long
def test_sets_after_a_search_that_was_stopped_are_not_begun(folder, tmp_path, monkeypatch):
    with_many_regions(monkeypatch.setattr)
    other = write_set(tmp_path / "other", **bumps(16, 32))
    options = mipbake.BakeOptions(method="refine", budget="best")
    with pytest.raises(KeyboardInterrupt):
        bake_sources([folder, other], tmp_path / "out", options, listener=Stops())
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [".metal.search", "metal"]


@pytest.mark.long
def test_a_program_stops_a_search_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_many_regions(monkeypatch.setattr)

    def bake(**options: Any) -> mipbake.MipStack:
        return mipbake.bake(set_in_memory(), "refine", budget="best", **options)

    path = tmp_path / "kept"
    first = bake(checkpoint=path, stop=After(110))
    assert first.provenance.warnings == ("the search was stopped before it was done",) and path.is_dir()
    second, alone = bake(checkpoint=str(path)), bake()
    assert not path.exists() and second.provenance == alone.provenance
    assert all(np.array_equal(one, other) for one, other in zip(second.levels, alone.levels, strict=True))
    for given in ({"checkpoint": path}, {"stop": never}):
        with pytest.raises(UsageError, match=rf"method linear takes no {next(iter(given))}: leave it out, or choose"):
            mipbake.bake(set_in_memory(), "linear", **given)


def test_auto_without_a_budget_is_neither_kept_nor_stopped() -> None:
    assert not Auto().long and Auto(budget="1h").long
