"""`mipbake bake` of searches that are stopped by signals and killed, and the same command after that."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import mipbake
from mipbake.baking.recipe import set_changed

from .command_line import bumps, write_set

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and locks as POSIX has them")

HERE = Path(__file__).parent
OPTIONS = ("--method", "refine", "--budget", "best")


def command(flags: str, folder: Path, out: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE.parent), *(p for p in sys.path if p)])}
    return subprocess.Popen(
        [sys.executable, "-m", "tests.long_searches", flags or "none", "bake", str(folder), "-o", str(out), *OPTIONS],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        cwd=HERE.parent,
    )


def ended(running: subprocess.Popen[str]) -> tuple[int, str, str]:
    out, err = running.communicate(timeout=120)
    return running.returncode, out, err


def wait_for(running: subprocess.Popen[str], path: Path) -> None:
    deadline = time.monotonic() + 90
    while not path.exists():
        assert running.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("sets") / "metal", **bumps(16, 32))


@pytest.fixture(scope="module")
def in_one(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of the result of a search that nothing interrupts."""
    out = tmp_path_factory.mktemp("out")
    assert ended(command("", folder, out))[0] == 0
    assert [path.name for path in out.iterdir()] == ["metal"]
    return content(out / "metal")


@pytest.mark.long
def test_a_search_that_is_killed_or_stopped_goes_on(folder: Path, tmp_path: Path, in_one: dict[str, bytes]) -> None:
    """Ctrl-C keeps the best so far, and a warning says so."""
    kept = tmp_path / ".metal.search"
    running = command("slow", folder, tmp_path)
    wait_for(running, kept / "start.npz")
    running.kill()
    assert ended(running)[0] == -signal.SIGKILL and not (tmp_path / "metal").exists()
    running = command("slow", folder, tmp_path)
    wait_for(running, kept / "region-0.npz")
    running.send_signal(signal.SIGINT)
    begin = time.monotonic()
    code, out, err = ended(running)
    assert (code, err) == (0, "") and time.monotonic() - begin < 30
    assert "note: going on from the checkpoint" in out
    assert "warning: the search was stopped before it was done" in out and f"goes on from {kept} (" in out
    stack = mipbake.open_stack(tmp_path / "metal")
    assert stack.provenance.warnings[-1] == "the search was stopped before it was done"
    wanted = {name: each for name, each in stack.provenance.recipe.items() if name != "stopped"}
    assert set_changed(tmp_path / "metal", [0], wanted) == "its search was stopped before it was done"
    code, out, err = ended(command("", folder, tmp_path))
    assert (code, err) == (0, "") and f"note: going on from the checkpoint {kept}, after " in out
    assert content(tmp_path / "metal") == in_one and [path.name for path in tmp_path.iterdir()] == ["metal"]
