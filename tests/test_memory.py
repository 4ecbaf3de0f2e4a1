"""A limit of memory: results stay bit for bit, the limit is held, and what cannot be is a sentence."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mipbake import _native
from mipbake.base import memory
from mipbake.base.errors import OutputError, UsageError
from mipbake.cli.main import main

from .command_line import fails, tree, write_set
from .input_files import encoded, height_field

if not _native.pages_supported():
    pytest.skip("limits of memory are for Linux", allow_module_level=True)

MIB = 1 << 20


@pytest.fixture
def everything_in_files(monkeypatch) -> None:
    """Arrays of a few texels lie in files, too."""
    monkeypatch.setattr(memory, "LEAST_SIZE", 1)
    monkeypatch.setattr(memory, "SHARE", 0.0)


def mapped_files() -> int:
    return sum(" rw-s " in line for line in Path("/proc/self/maps").read_text().splitlines())


@pytest.mark.parametrize(
    ("text", "size"),
    [("4G", 4 << 30), ("1.5g", 3 << 29), ("800M", 800 * MIB), ("12 KiB", 12 << 10), ("7", 7), ("2TB", 2 << 40)],
)
def test_sizes_are_read(text, size) -> None:
    assert memory.parsed(text) == size


@pytest.mark.parametrize("text", ["", "0", "4X", "1e9", "0.0000001K"])
def test_what_is_no_size_is_a_sentence(text) -> None:
    with pytest.raises(UsageError, match="expected a size such as 4G"):
        memory.parsed(text)


def test_arrays_lie_in_memory_without_a_limit_and_in_files_beyond_one() -> None:
    before = mapped_files()
    assert memory.empty((4, 5)).shape == (4, 5)
    with memory.limited(128 * MIB):
        small, first, second = (memory.empty((size, MIB), np.uint8) for size in (1, 24, 24))
        assert mapped_files() == before + 1  # the second does not fit into a quarter of the limit
        second[...] = np.arange(24, dtype=np.uint8)[:, None]
        view = second[3:, ::2]
        assert view.base is second and second.flags.c_contiguous and second.flags.writeable
    del first, second, small
    gc.collect()
    assert mapped_files() == before + 1  # a view holds it, after the block too
    np.testing.assert_array_equal(view[:, 0], np.arange(3, 24))
    del view
    gc.collect()
    assert mapped_files() == before


def test_pages_are_let_go_of_while_they_are_written() -> None:
    """Four times the limit is written, in pieces. A thread lets go of pages, as late as other programs make it."""
    before = _native.resident_bytes()
    deadline = time.monotonic() + 300
    with memory.limited(before + 96 * MIB):
        made = memory.empty((400, MIB), np.uint8)
        for index, row in enumerate(made):
            row[...] = index % 251
            while _native.resident_bytes() > before + 200 * MIB and time.monotonic() < deadline:
                time.sleep(0.002)
            assert time.monotonic() < deadline, "the thread lets go of no pages"
        assert all((row == index % 251).all() for index, row in enumerate(made))


@pytest.mark.long
@pytest.mark.parametrize(("method", "kind"), [("linear", "anisotropic"), ("lean", "broken")])
def test_bakes_are_the_same_bit_for_bit(tmp_path, capsys, everything_in_files, method, kind) -> None:
    rng = np.random.default_rng(3)
    maps = {
        "normal": encoded(height_field(40, 72, steepness=1.5 if kind == "broken" else 0.4)),
        "base_color": rng.integers(0, 256, (40, 72, 3), np.uint8),
        "roughness": rng.integers(20, 256, (20, 36), np.uint8),
        "metallic": rng.integers(0, 256, (40, 72), np.uint8),
        "ao": rng.integers(0, 256, (40, 72), np.uint8),
    }
    if kind == "broken":
        maps["normal"][4:9, 5:11] = 0
    if kind == "anisotropic":
        maps["anisotropy"] = rng.integers(0, 256, (40, 72, 3), np.uint8)
    folder = write_set(tmp_path / "set", **maps)
    command = ["bake", str(folder), "--method", method, "--format", "exr,png,tx,ktx2:bc,dds:rgba8"]
    for name, size in (("free", "1T"), ("held", "1G")):
        monkey = pytest.MonkeyPatch()
        if name == "free":
            monkey.setattr(memory, "SHARE", 1.0)
        assert main([*command, "--memory", size, "-o", str(tmp_path / name)]) == 0
        monkey.undo()
    capsys.readouterr()
    names = [name for name in tree(tmp_path / "free") if (tmp_path / "free" / name).is_file()]
    assert len(names) > 20 and tree(tmp_path / "held") == tree(tmp_path / "free")
    for name in names:
        assert (tmp_path / "free" / name).read_bytes() == (tmp_path / "held" / name).read_bytes(), name


BAKE = """
import sys
from pathlib import Path
from mipbake import bake, load
from mipbake.base.memory import limited
with limited(sys.argv[2]):
    bake(load(sys.argv[1]), "linear")
print(next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line))
"""


def most_held(folder: Path, limit: str) -> int:
    """Bytes that a process held at most which baked a set within a limit."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", BAKE, str(folder), limit]
    return 1024 * int(subprocess.run(command, capture_output=True, env=environment, check=True, timeout=600).stdout)


@pytest.mark.long
def test_a_limit_is_held(tmp_path) -> None:
    side = 3072
    folder = write_set(
        tmp_path / "set",
        base_color=np.random.default_rng(0).integers(0, 256, (side, side, 3), np.uint8),
        normal=np.tile(encoded(height_field(64, 64)), (side // 64, side // 64, 1)),
        roughness=np.full((side, side), 90, np.uint8),
    )
    # A busy machine may be late to let go of pages, but not always.
    assert min(most_held(folder, "256M") for _ in range(2)) < 450 * MIB < 800 * MIB < most_held(folder, "1T")


@pytest.mark.parametrize("method", ["linear", "neural", "auto"])
def test_too_little_memory_is_a_sentence_before_the_work(tmp_path, capsys, method) -> None:
    folder = write_set(tmp_path / "metal")
    told = fails(capsys, 2, "bake", folder, "--method", method, "--memory", "100M", "-o", tmp_path / "out")
    assert f"a bake of 16 x 16 texels by {method} takes" in told and "the limit is 100 MiB" in told
    assert "--memory" in told and not (tmp_path / "out").exists()


def test_no_room_for_temporary_files_is_a_sentence(monkeypatch) -> None:
    monkeypatch.setattr(memory, "SHARE", 0.0)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with memory.limited(1 << 30), pytest.raises(OutputError, match=r"No space left.*TMPDIR.*--memory"):
        memory.empty((64, MIB), np.uint8)
