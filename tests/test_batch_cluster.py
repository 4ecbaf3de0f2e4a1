"""Batches on a Ray cluster of two machines, which are processes here and see the same disk."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path, PurePath
from typing import Any

import pytest

from mipbake.baking import BakeOptions, NotBaked
from mipbake.base.errors import InputError, UsageError
from mipbake.base.leftovers import OLD, PARTIAL
from mipbake.base.version import __version__
from mipbake.library import BatchListener, BatchOptions, Entry, Summary, bake_library
from mipbake.library.cluster import Order, check_files, followed
from mipbake.library.task import Task
from mipbake.source.options import LoadOptions

from .batch_inline import counts
from .command_line import fails, tree, write_set
from .test_batch_workers import LINEAR, content, write_library

ray = pytest.importorskip("ray", reason="the extra `cluster` has no build for this system")
from ray.cluster_utils import Cluster  # noqa: E402

_NODE = {"num_cpus": 1, "object_store_memory": 100 << 20}


@pytest.fixture(name="machines", scope="module")
def two_machines() -> Iterator[Cluster]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_worker_niceness", "0")  # else others on the machine keep its processes waiting
        made = Cluster(initialize_head=True, head_node_args={**_NODE, "include_dashboard": False})
        made.add_node(**_NODE)
        made.wait_for_nodes()
        yield made
        made.shutdown()


class Heard(BatchListener):
    """Remembers how many processes there are, and may do something before they begin."""

    def __init__(self, begins: Callable[[], object] = bool) -> None:
        self.processes = 0
        self.begins = begins

    def found(self, entries: Sequence[Entry], notes: Sequence[str], jobs: int) -> None:
        del entries, notes
        self.processes = jobs
        self.begins()


def bake(
    library: Path | str, out: Path | str, machines: Cluster, listener: BatchListener | None = None, **how: Any
) -> Summary:
    options = BatchOptions(cluster=machines.address, **how)
    return bake_library(library, out, LINEAR, None, options, listener or BatchListener())


@pytest.mark.long
def test_results_are_those_of_one_machine(tmp_path: Path, machines: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths may be relative: machines of a cluster have working directories of their own."""
    write_library(tmp_path / "lib", 4)
    monkeypatch.chdir(tmp_path)
    listener = Heard()
    found = bake("lib", "out", machines, listener)
    assert counts(found) == (4, 0, 1) and listener.processes == 2
    here = bake_library("lib", "calm", LINEAR)
    assert content(Path("out")) == content(Path("calm"))
    assert str(found.failures[0].error) == str(here.failures[0].error)
    assert [each.results[0].source for each in found.entries] == [each.results[0].source for each in here.entries]
    baked = [(a.results[0], b.results[0]) for a, b in zip(found.entries, here.entries, strict=True)]
    for a, b in baked:
        assert isinstance(a, NotBaked) or Path("calm") / a.out.relative_to("out") == b.out
    assert counts(bake("lib", "out", machines)) == (0, 4, 1)
    assert tree(Path("out/.mipbake")) == ["batch.jsonl"]


@pytest.mark.long
def test_a_machine_that_does_not_see_the_results_says_so(tmp_path: Path, machines: Cluster) -> None:
    out = tmp_path / "out"
    write_set(tmp_path / "lib" / "steel")

    def lose_the_mark() -> None:
        for mark in (out / ".mipbake").glob(f".shared.*{PARTIAL}"):
            mark.unlink()

    found = bake(tmp_path / "lib", out, machines, Heard(lose_the_mark))
    assert counts(found) == (0, 0, 1) and found.exit_code == 3
    assert f"does not see {out} as the machine does that has begun the batch" in str(found.failures[0].error)


def test_a_machine_that_sees_other_sources_says_so(tmp_path: Path) -> None:
    source = write_set(tmp_path / "lib" / "steel")
    entry = Entry(source, "steel", PurePath("steel"))
    task = Task(entry, tmp_path / "out", BakeOptions(), LoadOptions(), "", "changed", True)
    mark = tmp_path / "out/.mipbake/mark"
    mark.parent.mkdir(parents=True)
    mark.touch()
    order = Order(__version__, 1, None, task, Path.cwd(), mark, (("steel/normal.png", 1),))
    with pytest.raises(InputError, match=f"does not see {source} as the machine"):
        check_files(order)


def at_work() -> list[int]:
    """Processes of the cluster that do a task now."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if path.read_bytes().startswith(b"ray::followed"):
                found.append(int(path.parent.name))
        except OSError:
            continue
    return found


@pytest.mark.long
def test_what_a_process_leaves_when_it_is_killed_is_done_by_others(tmp_path: Path, machines: Cluster) -> None:
    library = write_library(tmp_path / "lib", 3)
    killed = threading.Event()

    def kill() -> None:
        end = time.monotonic() + 120
        while time.monotonic() < end:
            for process in at_work():
                os.kill(process, signal.SIGKILL)
                killed.set()
                return
            time.sleep(0.005)

    thread = threading.Thread(target=kill)
    thread.start()
    out = tmp_path / "out"
    found = bake(library, out, machines)
    thread.join()
    assert killed.is_set() and counts(found) in ((3, 0, 1), (2, 1, 1))  # it may have written its result before
    bake_library(library, tmp_path / "calm", LINEAR)
    assert content(out) == content(tmp_path / "calm")
    assert not [name for name in tree(out) if name.endswith((PARTIAL, OLD))]


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nonsense"])
def test_no_cluster(tmp_path: Path, capsys: pytest.CaptureFixture[str], address: str) -> None:
    library = write_library(tmp_path / "lib", 1)
    (tmp_path / "given").mkdir()
    out = tmp_path / "given" / "new" / "out"
    said = fails(capsys, 2, "bake", library, "-r", "-o", out, "--cluster", address, "--quiet")
    assert f"no Ray cluster can be used at {address}" in said and "ray start --head" in said
    assert list((tmp_path / "given").iterdir()) == []


def test_another_version_is_refused(tmp_path: Path) -> None:
    library = write_library(tmp_path / "lib", 1)
    entry = bake_library(library, tmp_path / "out", LINEAR, None, BatchOptions(dry_run=True)).entries[0].entry
    task = Task(entry, tmp_path / "out", BakeOptions(), LoadOptions(), "", "none", True)
    order = Order("0.0.1", 1, None, task, tmp_path, tmp_path / "mark")
    with pytest.raises(UsageError, match=r"begun by 0\.0\.1: install the same version"):
        followed(order)


def test_a_dry_run_needs_no_cluster(tmp_path: Path) -> None:
    library = write_library(tmp_path / "lib", 1)
    options = BatchOptions(cluster="127.0.0.1:1", dry_run=True)
    assert bake_library(library, tmp_path / "out", LINEAR, None, options).planned == 1


@pytest.mark.long
def test_more_memory_than_there_is(tmp_path: Path, machines: Cluster) -> None:
    library = write_library(tmp_path / "lib", 1)
    with pytest.raises(UsageError, match="the largest machine of the cluster gives"):
        bake(library, tmp_path / "out", machines, memory=1 << 46)
    assert not list((tmp_path / "out" / ".mipbake").glob("*shared*"))
