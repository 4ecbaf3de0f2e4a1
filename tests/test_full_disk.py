"""Where there is no room: one sentence that says so, exit code 4, nothing left, and no waiting for ever."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from .command_line import write_set

if sys.platform == "win32":
    pytest.skip("limits of files as POSIX has them", allow_module_level=True)

import resource

STEPS = Path(__file__).parent / "full_disk_steps.py"
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}


@pytest.fixture(scope="module")
def disk() -> Iterator[Path]:
    """A disk of three megabytes."""
    if shutil.which("mount") is None or os.geteuid() != 0:
        pytest.skip("only root mounts a small disk")
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", folder], capture_output=True, check=False
        )
        if done.returncode:
            pytest.skip(f"a small disk cannot be mounted: {done.stderr.decode().strip()}")
        try:
            yield Path(folder)
        finally:
            subprocess.run(["umount", folder], check=True)


@pytest.fixture
def noise(tmp_path: Path) -> Path:
    return write_set(tmp_path / "noise", base_color=np.random.default_rng(0).integers(0, 255, (160, 160, 3), np.uint8))


def bake(folder: Path, out: Path, *options: str, limit: int | None = None, **environment: str) -> tuple[int, str]:
    """Exit code and stderr of a bake; with `limit`, of one whose files may have no more than so many bytes."""

    def limited() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    command = [sys.executable, "-m", "mipbake.cli.main", "bake", str(folder), "-o", str(out), "--method", "linear"]
    done = subprocess.run(
        [*command, "-q", *options],
        capture_output=True,
        text=True,
        preexec_fn=limited,
        env={**ENVIRONMENT, **environment},
        timeout=300,
        check=False,
    )
    return done.returncode, done.stderr


def check_writers(folder: Path, how: str) -> None:
    command = [sys.executable, STEPS, folder, how]
    done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, timeout=1200, check=False)
    assert done.returncode == 0 and done.stdout.endswith("writers\n") and done.stdout.count("\n") == 1, done


@pytest.mark.long
def test_every_writer_says_that_a_file_gets_too_long(tmp_path: Path) -> None:
    check_writers(tmp_path, "limit")


@pytest.mark.long
def test_every_writer_says_that_the_disk_is_full(disk: Path) -> None:
    check_writers(disk, "disk")


@pytest.mark.long
@pytest.mark.parametrize("fmt", ["exr", "glb"])
def test_a_bake_beyond_a_limit_of_files_exits_4(noise: Path, tmp_path: Path, fmt: str) -> None:
    code, err = bake(noise, tmp_path / "out", "--format", fmt, limit=4096)
    assert code == 4 and "the file is larger than its file system or a limit of the session allows" in err, err
    assert err.startswith("mipbake: cannot write ") and err.count("\n") == 1, err
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_an_earlier_result_stays_where_the_disk_is_full(noise: Path, disk: Path) -> None:
    assert bake(noise, disk / "out") == (0, "")
    before = {path.name: path.read_bytes() for path in (disk / "out" / "noise").iterdir()}
    (disk / "filler").write_bytes(bytes(os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize - (1 << 15)))
    code, err = bake(noise, disk / "out")
    assert code == 4 and "the disk is full" in err and err.count("\n") == 1, err
    assert {path.name: path.read_bytes() for path in (disk / "out" / "noise").iterdir()} == before
    assert [path.name for path in (disk / "out").iterdir()] == ["noise"]
    for path in (disk / "filler", *(disk / "out" / "noise").iterdir()):
        path.unlink()


def test_no_room_for_temporary_files_exits_4(noise: Path, tmp_path: Path, disk: Path) -> None:
    (disk / "filler").write_bytes(bytes(os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize - (1 << 13)))
    archive = Path(shutil.make_archive(str(tmp_path / "noise"), "zip", noise))
    code, err = bake(archive, tmp_path / "out", TMPDIR=str(disk))
    (disk / "filler").unlink()
    assert code == 4 and "of temporary space" in err and "TMPDIR" in err and err.count("\n") == 1, err
    assert not (tmp_path / "out").exists()
