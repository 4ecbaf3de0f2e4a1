"""The command line, given what it cannot use: one sentence, an exit code, nothing written."""

import os
import shutil
from importlib import import_module

import numpy as np
import OpenImageIO
import pytest

from mipbake.baking.methods import METHODS
from mipbake.cli.main import main
from mipbake.material.pixel_filter import FILTERS
from mipbake.source.jobs import Job
from mipbake.stack.containers import FORMATS
from mipbake.stack.stack import MipStack

from .command_line import fails, tree

pytestmark = pytest.mark.usefixtures("unmeasured")

PIPELINE = import_module("mipbake.baking.pipeline")


def spoil_missing(folder):
    shutil.rmtree(folder)


def spoil_no_normal(folder):
    (folder / "normal.png").unlink()


def spoil_truncated(folder):
    data = (folder / "normal.png").read_bytes()
    (folder / "normal.png").write_bytes(data[: len(data) // 2])


def spoil_not_finite(folder):
    (folder / "roughness.png").unlink()
    pixels = np.full((16, 16, 1), 0.5, np.float32)
    pixels[3, 5], pixels[7, 1] = np.nan, np.inf
    OpenImageIO.ImageBuf(pixels).write(str(folder / "roughness.exr"))


BAD_SETS = {
    spoil_missing: ["does not exist"],
    spoil_no_normal: ["normal", "roughness.png"],
    spoil_truncated: ["normal.png"],
    spoil_not_finite: ["roughness.exr", "2 "],
}


@pytest.mark.parametrize("spoil", BAD_SETS, ids=lambda f: f.__name__)
def test_bad_sets_exit_3_and_write_nothing(folder, tmp_path, capsys, spoil):
    spoil(folder)
    message = fails(capsys, 3, "bake", folder, "-o", tmp_path / "out", "--method", "linear")
    for part in BAD_SETS[spoil]:
        assert part in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "valid"),
    [("--method", METHODS), ("--target", PIPELINE.TARGETS), ("--filter", FILTERS), ("--format", FORMATS)],
)
def test_unknown_names_exit_2_and_list_the_valid_ones(folder, tmp_path, capsys, option, valid):
    message = fails(capsys, 2, "bake", folder, "-o", tmp_path / "out", option, "nonsense")
    assert "'nonsense'" in message and ", ".join(valid) in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["polish"], "expected one of bake, preview, gui, compare, fit, validate, convert, inspect"),
        (["bake"], "SOURCE"),
        (["bake", "x"], "--out"),
        (["bake", "x", "-o", "y", "--nonsense"], "--nonsense"),
        (["validate", "x"], "SOURCE"),
        (["validate", "x", "y", "--seed", "one"], "--seed"),
        (["validate", "x", "y", "--seed", "-1"], "--seed"),
        (["validate", "x", "y", "--wrap-u", "mirror"], "wrap, clamp"),
        (["inspect", "x", "--normal-convention", "vulkan"], "opengl, directx"),
        (["bake", "x", "-o", "y", "--target", "ggx", "--format", "png"], "log_roughness"),
    ],
)
def test_usage_errors_exit_2(tmp_path, monkeypatch, capsys, arguments, part):
    monkeypatch.chdir(tmp_path)
    assert part in fails(capsys, 2, *arguments)
    assert tree(tmp_path) == []


@pytest.mark.long
def test_a_baked_stack_is_no_texture_set(folder, tmp_path, capsys):
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "linear", "-q"]) == 0
    stack = tmp_path / "out" / "metal"
    before = {name: (stack / name).read_bytes() for name in tree(stack)}
    assert "is a baked stack" in fails(capsys, 3, "bake", stack, "-o", tmp_path / "out", "--method", "linear")
    assert "give its source" in fails(capsys, 3, "inspect", stack)
    assert {name: (stack / name).read_bytes() for name in tree(stack)} == before
    (folder / "stack.json").write_text('{"schema": "of something else"}')
    assert main(["inspect", str(folder), "--quiet"]) == 0


def test_unwritable_outputs_exit_4(folder, tmp_path, capsys):
    (tmp_path / "file").write_text("x")
    (tmp_path / "full" / "metal").mkdir(parents=True)
    (tmp_path / "full" / "metal" / "mine.txt").write_text("keep")
    before = tree(tmp_path)
    for out in ("file", "file/below", "full", "."):
        fails(capsys, 4, "bake", folder, "-o", tmp_path / out, "--method", "linear")
    assert tree(tmp_path) == before
    assert "stack.json" in fails(capsys, 3, "validate", folder, folder)
    if hasattr(os, "geteuid") and os.geteuid() != 0:
        (tmp_path / "locked").mkdir(mode=0o500)
        assert "permission" in fails(capsys, 4, "bake", folder, "-o", tmp_path / "locked", "--method", "linear")


def test_defects_exit_1_without_a_traceback(folder, tmp_path, capsys, monkeypatch):
    def breaks(*_arguments, **_options):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(Job, "read", breaks)
    command = ["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "linear"]
    assert "ZeroDivisionError" in fails(capsys, 1, *command)
    assert main(["--debug", *command]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_too_little_memory_is_no_defect(folder, tmp_path, capsys, monkeypatch):
    def breaks(*_arguments, **_options):
        raise MemoryError("Unable to allocate 745. GiB")

    monkeypatch.setattr(Job, "read", breaks)
    said = fails(capsys, 1, "bake", folder, "-o", tmp_path / "out", "--method", "linear")
    assert "745. GiB" in said and "ask for less" in said and "defect" not in said


def test_an_interrupted_bake_leaves_nothing(folder, tmp_path, capsys, monkeypatch):
    save = MipStack.save

    def interrupted(self, path, format, progress, *others, **more):
        def stop(share):
            if share >= 0.5:
                assert list(tmp_path.glob("out/.metal*/*.exr"))
                raise KeyboardInterrupt

        return save(self, path, format, stop, *others, **more)

    monkeypatch.setattr(MipStack, "save", interrupted)
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "linear", "-q"]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


LONG = "a" * 300


@pytest.mark.parametrize(
    "arguments",
    [["bake", LONG, "-o", "o"], ["bake", f"{LONG}/<UDIM>.png", "-o", "o"], ["info", LONG], ["inspect", LONG]],
)
def test_names_that_are_too_long(tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    assert LONG[:80] in fails(capsys, 3, *arguments)
    assert tree(tmp_path) == []
