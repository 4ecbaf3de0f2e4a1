"""Searches that are stopped, killed and gone on with: what is kept of them, and what is said."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.baking import Listener, bake_sources
from mipbake.baking.methods import PrefilterResult
from mipbake.baking.search import checkpoint
from mipbake.baking.search.checkpoint import Checkpoint, discard
from mipbake.baking.search.sitting import Sitting, Stop, never
from mipbake.base import checkpoints
from mipbake.base.errors import UsageError
from mipbake.cli.bake_stopping import Stopping

from .command_line import bumps, write_set
from .long_searches import SOME_ROUNDS, ManyRegions, with_many_regions, without_pauses

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and locks as POSIX has them")

WRAP = ("wrap", "wrap")


def set_in_memory(width: int = 32) -> mipbake.TextureSet:
    maps = {name: image / np.float32(255) for name, image in bumps(16, width).items()}
    maps["normal"] = 2 * maps["normal"] - 1
    return mipbake.TextureSet.from_arrays("bumps", metallic=0.0, **maps)


STORED = set_in_memory().material("gltf")


class After:
    """A stop that says True after it was asked so many times; the next descent is asked anew."""

    def __init__(self, times: int) -> None:
        self.times, self.left = times, times

    def __call__(self) -> bool:
        self.left -= 1
        return self.left < 0


def searched(
    path: Path | None,
    stop: Stop = never,
    told: Callable[[str], None] = lambda _: None,
    stored: Any = STORED,
    **options: Any,
) -> PrefilterResult:
    method = ManyRegions(**{"budget": "best", "sitting": Sitting(path, lambda: nullcontext(stop), told), **options})
    return method(stored, "gltf", "gltf", "gaussian", WRAP, lambda _: None)


def same(first: PrefilterResult, second: PrefilterResult) -> bool:
    levels = zip(first.levels, second.levels, strict=True)
    return all(np.array_equal(one, other) for one, other in levels) and first.promise == second.promise


@pytest.fixture(scope="module")
def whole() -> PrefilterResult:
    """The search, in one sitting."""
    return searched(None)


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    without_pauses(monkeypatch.setattr)


def stopped(path: Path, times: int = 110) -> PrefilterResult:
    found = searched(path, After(times))
    assert found.stopped and (path / "about.json").is_file()
    return found


@pytest.mark.long
def test_a_search_in_many_sittings_is_the_same_to_the_last_bit(tmp_path: Path, whole: PrefilterResult) -> None:
    path, sittings = tmp_path / "kept", 1
    found = searched(path, After(70))
    assert found.stopped and not same(found, whole)
    while found.stopped:
        sittings += 1
        assert sittings < 100
        found = searched(path, After(70))
    assert sittings > 2 and same(found, whole)


@pytest.mark.long
def test_more_than_ten_regions_are_gone_on_with(tmp_path: Path) -> None:
    """The order of 2 and 10 is another one as numbers than as text, which is what JSON has."""
    path, told, stored = tmp_path / "kept", list[str](), set_in_memory(256).material("gltf")
    found = searched(path, After(1200), told.append, stored)
    kept = checkpoint.read_about(path / "about.json")["regions"]
    assert found.stopped and len(kept) > 10
    again = searched(path, lambda: True, told.append, stored)
    assert same(again, found) and not any("not used" in sentence for sentence in told)
    assert checkpoint.read_about(path / "about.json")["regions"] == kept


def test_a_search_that_is_stopped_at_once_has_its_start(tmp_path: Path, whole: PrefilterResult) -> None:
    found = searched(tmp_path / "kept", lambda: True)
    assert found.stopped and found.promise is not None
    assert {each.refined for each in found.promise.levels} == {0.0}
    assert same(searched(tmp_path / "kept"), whole)


@pytest.mark.long
def test_what_was_gained_before_a_stop_is_kept(tmp_path: Path) -> None:
    """Also where the next sitting is stopped before its first round."""
    found = stopped(tmp_path / "kept", 200)
    start = searched(None, lambda: True)
    assert any(not np.array_equal(one, other) for one, other in zip(found.levels, start.levels, strict=True))
    again = searched(tmp_path / "kept", lambda: True)
    assert again.stopped and same(again, found)


def damages(path: Path) -> Iterator[tuple[Path, bytes]]:
    """Files of a checkpoint, and what damage makes of them."""
    for file in sorted(path.iterdir()):
        if file.name != "lock":
            data = file.read_bytes()
            middle = len(data) // 2
            yield file, data[:middle]
            yield file, data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
            yield file, b""


@pytest.mark.long
def test_a_damaged_checkpoint_costs_time_alone(tmp_path: Path, whole: PrefilterResult) -> None:
    path = tmp_path / "kept"
    stopped(path, 300)
    of = checkpoint.read_about(path / "about.json")["of"]
    good = {file: file.read_bytes() for file in path.iterdir()}
    kinds = {file.name.partition("-")[0] for file in good}
    assert kinds == {"about.json", "lock", "start.npz", "region", "state"}
    shapes, windows = [level.shape for level in whole.levels], _windows()
    for number, (file, data) in enumerate(damages(path)):
        file.write_bytes(data)
        told: list[str] = []
        if number:  # whole searches would take long
            kept = _checkpoint(path, of, told)
            assert kept.load(shapes, windows) is None, file
            kept.close()
        else:
            assert same(searched(path, told=told.append), whole)
            path.mkdir(exist_ok=True)
        assert f"the checkpoint {path} is not used, because it cannot be read (" in told[0], (file, told)
        assert told[0].endswith(": the search begins anew")
        for each, before in good.items():
            each.write_bytes(before)
    told = []
    kept = _checkpoint(path, of, told)
    assert kept.load(shapes, windows) is not None and not told
    kept.close()


def _windows() -> Any:
    from functools import partial

    from mipbake.baking.search.keeping import windows_in
    from mipbake.baking.search.regions import timed_regions
    from mipbake.quality.reference.problem import Problem

    problem = Problem(STORED, "gltf", "gltf", "gaussian", WRAP)
    return partial(windows_in, problem, list(timed_regions(problem, SOME_ROUNDS.window, True, 8)))


def _checkpoint(path: Path, of: Mapping[str, str], told: list[str]) -> Checkpoint:
    return Checkpoint(path, of, False, told.append)


def rewrite(path: Path, about: dict[str, Any]) -> None:
    """Changes what a checkpoint says of itself."""
    text = json.dumps({"sum": checkpoint.checksum(about), "about": about})
    (path / "about.json").write_text(text, encoding="utf-8")


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
    path, told = tmp_path / "kept", list[str]()
    stopped(path)
    weights, version = change.get("weights"), change.get("version")
    if weights is not None or version is not None:
        about = checkpoint.read_about(path / "about.json")
        about["version"] = version or about["version"]
        about["of"]["weights"] = weights or about["of"]["weights"]
        rewrite(path, about)
        change = {}
    found = searched(path, lambda: True, told.append, **change)
    assert found.stopped
    assert told[0].startswith(f"the checkpoint {path} is not used, because {why}")
    told.clear()
    searched(path, lambda: True, told.append, **change)  # it has taken the place of the other
    assert told[0].startswith(f"going on from the checkpoint {path}, after ")


@pytest.mark.long
def test_a_reproducible_search_does_not_go_on_from_one_with_a_limit_of_time(tmp_path: Path) -> None:
    path, told = tmp_path / "kept", list[str]()
    searched(path, After(110), budget="1h")
    searched(path, lambda: True, told.append, budget="2h")
    assert told.pop().startswith("going on from the checkpoint") and not told
    searched(path, lambda: True, told.append)
    assert "because it was made within a limit of time, and without one a search is reproducible" in told[0]
    discard(path)
    stopped(path)
    told.clear()
    searched(path, lambda: True, told.append, budget="1h")  # the other way round nothing is lost
    assert told[0].startswith("going on from the checkpoint")
    told.clear()
    searched(path, lambda: True, told.append)
    assert "limit of time" in told[0]


@pytest.mark.long
def test_time_that_was_spent_counts(tmp_path: Path) -> None:
    path, told = tmp_path / "kept", list[str]()
    found = searched(path, After(200), budget="1h")
    about = checkpoint.read_about(path / "about.json")
    rewrite(path, {**about, "seconds": 3601.0})
    rest = searched(path, told=told.append, budget="1h")
    # No round is worked any more: what was best is kept, and the search is done.
    assert told == [f"going on from the checkpoint {path}, after 1 h of 1 h"]
    assert not rest.stopped and same(rest, found)


@pytest.mark.long
def test_a_full_disk_ends_no_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: PrefilterResult) -> None:
    def full(path: Path, _arrays: Any) -> int:
        path.write_bytes(b"some")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "write_arrays", full)
    told: list[str] = []
    path = tmp_path / "kept"
    assert same(searched(path, told=told.append), whole)
    assert sum("is not kept in the checkpoint" in each and "the disk is full" in each for each in told) == 1
    assert not path.exists()


@pytest.mark.long
def test_two_processes_do_not_share_a_checkpoint(tmp_path: Path, whole: PrefilterResult) -> None:
    path, told = tmp_path / "kept", list[str]()
    stopped(path)
    lock = checkpoints.lock_of(path / "lock")
    assert lock is not None
    before = {file: file.read_bytes() for file in path.iterdir()}
    try:
        assert same(searched(path, told=told.append), whole)
        discard(path)
    finally:
        os.close(lock)
    assert f"another process has the checkpoint {path}: this search is not kept" in told
    assert {file: file.read_bytes() for file in path.iterdir()} == before


@pytest.mark.long
def test_checkpoints_are_no_more_often_than_they_may_cost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "COST", 0.02)
    written: list[float] = []
    write = checkpoint.write_arrays

    def slow(path: Path, arrays: Any) -> int:
        begin = time.monotonic()
        size = write(path, arrays)
        time.sleep(0.05)
        written.append(time.monotonic() - begin)
        return size

    monkeypatch.setattr(checkpoint, "write_arrays", slow)
    begin = time.monotonic()
    searched(tmp_path / "kept")
    assert written, "the first writing seems cheap"
    assert sum(written[:-1]) < 0.04 * (time.monotonic() - begin) + 0.1


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
def test_sets_after_a_search_that_was_stopped_are_not_begun(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_auto_without_a_budget_is_neither_kept_nor_stopped(tmp_path: Path) -> None:
    from mipbake.baking.search.methods import Auto

    assert not Auto().long and Auto(budget="1h").long
    assert not isinstance(Auto().steps, ManyRegions)
