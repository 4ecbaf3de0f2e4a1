"""The command line: what it prints, what it writes, how it fails."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

import mipbake
from mipbake.cli.main import main
from mipbake.io.containers import DEFAULT_FORMAT, FORMATS
from mipbake.io.options import LoadOptions
from mipbake.prefilter import METHODS
from mipbake.prefilter.pixel_filter import FILTERS
from mipbake.stack import MipStack

PIPELINE = sys.modules["mipbake.bake"]  # the module: mipbake.bake is the function


def write_png(path, pixels):
    pixels = np.ascontiguousarray(pixels if pixels.ndim == 3 else pixels[..., None])
    buffer = OpenImageIO.ImageBuf(pixels)
    assert buffer.write(str(path)), buffer.geterror()


def bumps(height=16, width=16):
    """A periodic bumpy metal: 8-bit maps by file stem, normals in the OpenGL convention."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    dx, dy = 0.5 * np.cos(4 * np.pi * u + 1), 0.4 * np.cos(2 * np.pi * v)
    normal = np.stack([-dx, dy, np.ones_like(u)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    colour = np.stack([0.5 + 0.4 * np.sin(2 * np.pi * u), 0.5 + 0 * u, 0.5 + 0.3 * np.sin(2 * np.pi * v)], -1)
    maps = {"base_color": colour, "normal": (normal + 1) / 2, "roughness": 0.3 + 0.1 * np.sin(2 * np.pi * v)}
    return {name: np.rint(image * 255).astype(np.uint8) for name, image in maps.items()}


def write_set(folder, **changes):
    """A set in a new folder; None leaves a map out."""
    folder.mkdir(parents=True)
    for name, pixels in (bumps() | changes).items():
        if pixels is not None:
            write_png(folder / f"{name}.png", pixels)
    return folder


@pytest.fixture
def folder(tmp_path):
    return write_set(tmp_path / "metal")


def tree(path):
    return sorted(str(p.relative_to(path)) for p in path.rglob("*"))


def fails(capsys, code, *arguments):
    """Runs, expects the exit code and exactly one sentence on stderr; returns the sentence."""
    assert main([str(a) for a in arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("mipbake: ") and err.count("\n") == 1 and err.endswith("\n"), err
    assert "Traceback" not in err
    return err


# ---- what works


@pytest.mark.parametrize("fmt", FORMATS)
def test_bake_writes_what_it_says(folder, tmp_path, capsys, fmt):
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "lean", "--format", fmt]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    for role in ("base_color", "normal", "roughness", "metallic"):
        assert role in out
    assert "constant 0" in out  # metallic is missing, and said to be assumed
    assert "read 0." in out and "write 0." in out and str(tmp_path / "out" / "metal") in out
    stack = mipbake.open_stack(tmp_path / "out" / "metal")
    assert (stack.provenance.method, stack.provenance.pixel_filter, stack.model) == ("lean", "gaussian", "gltf")
    assert set(stack.provenance.sources) == {"base_color.png", "normal.png", "roughness.png"}


def test_bake_equals_the_library(folder, tmp_path, capsys):
    arguments = ["--method", "linear", "--target", "ggx", "--filter", "mitchell", "--map", "metallic=1"]
    arguments += ["--normal-convention", "directx", "--wrap-u", "clamp", "--gloss", "--colour-space", "linear Rec.709"]
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), *arguments, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    options = LoadOptions(
        maps={"metallic": 1.0},
        normal_convention="directx",
        wrap=("clamp", "wrap"),
        roughness_is_gloss=True,
        colour_space="linear Rec.709",
    )
    expected = mipbake.bake(mipbake.load(folder, options), "linear", "ggx", "mitchell")
    expected.save(tmp_path / "library")
    for name in tree(tmp_path / "library"):
        assert (tmp_path / "library" / name).read_bytes() == (tmp_path / "out" / "metal" / name).read_bytes(), name


def test_bake_json(folder, tmp_path, capsys):
    missing = tmp_path / "missing"
    code = main(["bake", str(folder), str(missing), "-o", str(tmp_path / "out"), "--method", "linear", "--json"])
    out, err = capsys.readouterr()
    report = json.loads(out)
    assert code == report["exit_code"] == 3
    good, bad = report["results"]
    assert good["ok"] and good["out"] == str(tmp_path / "out" / "metal")
    assert good["bytes"] == sum(Path(f["path"]).stat().st_size for f in good["files"])
    assert good["stack"]["model"] == "gltf" and good["set"]["maps"]["normal"]["depth"] == "uint8"
    assert set(good["seconds"]) >= {"read", "prefilter", "write"}
    assert not bad["ok"] and bad["exit_code"] == 3 and str(missing) in bad["error"]
    assert err.count("\n") == 1 and str(missing) in err


def test_one_bad_set_does_not_stop_the_others(tmp_path, capsys):
    names = [write_set(tmp_path / "a"), write_set(tmp_path / "b", roughness=None), write_set(tmp_path / "c")]
    assert main(["bake", *map(str, names), "-o", str(tmp_path / "out"), "--method", "linear"]) == 3
    out, err = capsys.readouterr()
    assert "2 of 3 sets baked" in out and err.count("\n") == 1
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["a", "c"]


def test_exit_code_is_the_worst(tmp_path, capsys):
    bad, blocked = write_set(tmp_path / "bad", normal=None), write_set(tmp_path / "blocked")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "blocked").write_text("in the way")
    assert main(["bake", str(blocked), str(bad), "-o", str(tmp_path / "out"), "--method", "linear"]) == 4
    assert capsys.readouterr().err.count("\n") == 2


def test_inspect_writes_nothing(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    assert main(["inspect", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert "normal.png" in out and "16 x 16" in out and "opengl" in out.lower() and err == ""
    assert tree(tmp_path) == before
    assert main(["inspect", str(folder), "--json", "--map", "metallic=0.5"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["maps"]["metallic"]["constant"] == [0.5]
    assert report["maps"]["normal"]["path"] == str(folder / "normal.png")
    assert report["normal_convention"]["name"] == "opengl"


def test_map_option(folder, capsys):
    shutil.copy(folder / "roughness.png", folder / "wear.png")
    assert main(["inspect", str(folder), "--json", "--map", "roughness=wear.png", "--map", "base_color=none"]) == 0
    maps = json.loads(capsys.readouterr().out)["maps"]
    assert maps["roughness"]["path"] == str(folder / "wear.png")
    assert maps["base_color"]["path"] is None
    assert "expected ROLE=SOURCE" in fails(capsys, 2, "inspect", folder, "--map", "roughness")
    assert "expected one of base_color" in fails(capsys, 2, "inspect", folder, "--map", "shininess=wear.png")


def test_validate(folder, tmp_path, capsys):
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "lean", "--quiet"]) == 0
    quick = ["--points", "64", "--samples", "16", "--lods", "0,2"]
    assert main(["validate", str(folder), str(tmp_path / "out" / "metal"), *quick]) == 0
    out = capsys.readouterr().out
    assert "near-mirror" in out and "hemisphere" in out and "baked" in out and "linear (box)" in out
    assert main(["validate", str(folder), str(tmp_path / "out" / "metal"), *quick, "--json", "--seed", "3"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["seed"] == 3 and report["points"] == 64 and report["method"] == "lean"
    assert {row["lod"] for row in report["rows"]} == {0.0, 2.0}
    assert all(isinstance(row["snr"], float) for row in report["rows"])


def test_help_lists_what_the_library_has(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "110")
    assert main(["bake", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for names in (METHODS, FILTERS, FORMATS):
        assert "|".join(names) in text
    for default in (PIPELINE.DEFAULT_METHOD, PIPELINE.DEFAULT_FILTER, PIPELINE.AUTO_TARGET, DEFAULT_FORMAT):
        assert f"[default: {default}]" in text
    assert "Exit codes" in text
    for command in ("validate", "inspect"):
        assert main([command, "--help"]) == 0
        text = capsys.readouterr().out
        assert all(option in text for option in ("--map", "--normal-convention", "--wrap-u", "--json"))
    assert main([]) == 0
    assert "Exit codes" in capsys.readouterr().out


def test_version(capsys):
    assert main(["--version"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"mipbake {mipbake.__version__}"
    assert re.fullmatch(r"instruction set: (baseline|avx2|avx512|\w+)", lines[1])
    assert re.fullmatch("CUDA: (yes|no|compiled, but no device found)", lines[2])
    assert lines[3].startswith("weights: ")


# ---- what does not


def png(width, height):
    """A PNG file of that size, with no texels in it."""

    def chunk(kind, data):
        body = kind + data
        return len(data).to_bytes(4, "big") + body + zlib.crc32(body).to_bytes(4, "big")

    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 2, 0, 0, 0])
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def spoil_missing(folder):
    shutil.rmtree(folder)


def spoil_no_normal(folder):
    (folder / "normal.png").unlink()


def spoil_no_roughness(folder):
    (folder / "roughness.png").unlink()


def spoil_two_candidates(folder):
    shutil.copy(folder / "roughness.png", folder / "metal_roughness.png")


def spoil_truncated(folder):
    data = (folder / "normal.png").read_bytes()
    (folder / "normal.png").write_bytes(data[: len(data) // 2])


def spoil_text(folder):
    (folder / "roughness.png").write_text("no image at all")


def spoil_not_finite(folder):
    (folder / "roughness.png").unlink()
    pixels = np.full((16, 16, 1), 0.5, np.float32)
    pixels[3, 5], pixels[7, 1] = np.nan, np.inf
    OpenImageIO.ImageBuf(pixels).write(str(folder / "roughness.exr"))


def spoil_zero_sized(folder):
    (folder / "base_color.png").write_bytes(png(0, 4))


def spoil_constant_normal(folder):
    write_png(folder / "normal.png", np.full((16, 16, 3), 90, np.uint8))


def spoil_colour_as_normal(folder):
    shutil.copy(folder / "base_color.png", folder / "normal.png")


def spoil_grey_normal(folder):
    shutil.copy(folder / "roughness.png", folder / "normal.png")


BAD_SETS = {
    spoil_missing: ["does not exist"],
    spoil_no_normal: ["normal", "roughness.png"],
    spoil_no_roughness: ["roughness", "normal.png"],
    spoil_two_candidates: ["roughness.png", "metal_roughness.png"],
    spoil_truncated: ["normal.png"],
    spoil_text: ["roughness.png"],
    spoil_not_finite: ["roughness.exr", "2 "],
    spoil_zero_sized: ["base_color.png", "0 x 4"],
    spoil_constant_normal: ["normal.png"],
    spoil_colour_as_normal: ["normal.png"],
    spoil_grey_normal: ["normal.png"],
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
        (["polish"], "expected one of bake, validate, inspect"),
        (["bake"], "FOLDER"),
        (["bake", "x"], "--out"),
        (["bake", "x", "-o", "y", "--nonsense"], "--nonsense"),
        (["validate", "x"], "STACK"),
        (["validate", "x", "y", "--seed", "one"], "--seed"),
        (["validate", "x", "y", "--seed", "-1"], "--seed"),
        (["validate", "x", "y", "--lods", "0;1"], "separated by commas"),
        (["inspect", "x", "--wrap-u", "mirror"], "wrap, clamp"),
        (["inspect", "x", "--normal-convention", "vulkan"], "opengl, directx"),
        (["inspect", "x", "--normal-length", "shorten"], "ignore, roughness"),
        (["bake", "x", "-o", "y", "--target", "ggx", "--format", "png"], "log_roughness"),
    ],
)
def test_usage_errors_exit_2(tmp_path, monkeypatch, capsys, arguments, part):
    monkeypatch.chdir(tmp_path)
    assert part in fails(capsys, 2, *arguments)
    assert tree(tmp_path) == []


def test_two_sets_of_one_name_exit_2(tmp_path, capsys):
    first, second = write_set(tmp_path / "a" / "metal"), write_set(tmp_path / "b" / "metal")
    message = fails(capsys, 2, "bake", first, second, "-o", tmp_path / "out", "--method", "linear")
    assert str(first) in message and str(second) in message and not (tmp_path / "out").exists()


def test_the_stack_of_another_set_is_never_replaced(tmp_path, capsys, monkeypatch):
    first, same, other = (write_set(tmp_path / name / "metal") for name in "abc")
    for name, pixels in bumps(8, 24).items():
        write_png(other / f"{name}.png", pixels)
    bake = ["bake", "-o", str(tmp_path / "out"), "--method", "linear", "--quiet"]
    assert main([*bake, str(first)]) == 0
    assert main([*bake, str(same), "--filter", "mitchell"]) == 0  # the same files: baked again
    monkeypatch.setattr(mipbake, "bake", lambda *_: pytest.fail("found only after the bake"))
    capsys.readouterr()
    message = fails(capsys, 4, *bake, other)
    assert str(tmp_path / "out" / "metal") in message and "roughness.png" in message and "remove" in message
    assert mipbake.open_stack(tmp_path / "out" / "metal").provenance.pixel_filter == "mitchell"


@pytest.mark.parametrize("fmt", FORMATS)
def test_a_baked_stack_is_no_texture_set(folder, tmp_path, capsys, fmt):
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "linear", "--format", fmt, "-q"]) == 0
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
    for out in ("file", "file/below", "full"):
        fails(capsys, 4, "bake", folder, "-o", tmp_path / out, "--method", "linear")
    assert tree(tmp_path) == before
    if hasattr(os, "geteuid") and os.geteuid() != 0:
        (tmp_path / "locked").mkdir(mode=0o500)
        assert "permission" in fails(capsys, 4, "bake", folder, "-o", tmp_path / "locked", "--method", "linear")


def test_baking_over_the_sources_exits_4(folder, tmp_path, capsys):
    before = {name: (folder / name).read_bytes() for name in tree(folder)}
    assert "not mipbake's" in fails(capsys, 4, "bake", folder, "-o", tmp_path, "--method", "linear")
    assert {name: (folder / name).read_bytes() for name in tree(folder)} == before


def test_validate_of_what_is_no_stack_exits_3(folder, tmp_path, capsys):
    assert "stack.json" in fails(capsys, 3, "validate", folder, folder)
    assert "no such folder" in fails(capsys, 3, "validate", folder, tmp_path / "none")


def test_defects_exit_1_without_a_traceback(folder, tmp_path, capsys, monkeypatch):
    def breaks(*_arguments, **_options):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(mipbake, "load", breaks)
    command = ["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "linear"]
    assert "ZeroDivisionError" in fails(capsys, 1, *command)
    assert main(["--debug", *command]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_an_interrupted_bake_leaves_nothing(folder, tmp_path, capsys, monkeypatch):
    save = MipStack.save

    def interrupted(self, path, format, progress):
        def stop(share):
            if share >= 0.5:
                assert list(tmp_path.glob("out/.metal*/*.exr"))
                raise KeyboardInterrupt

        return save(self, path, format, stop)

    monkeypatch.setattr(MipStack, "save", interrupted)
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "linear", "-q"]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# ---- as a process


def process(*arguments, **options):
    path = os.pathsep.join(p for p in sys.path if p)
    environment = {**os.environ, "PYTHONPATH": path, **options}
    command = [sys.executable, "-m", "mipbake.cli.main", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def test_piped_output_has_no_colours(folder):
    out, err = process("inspect", folder).communicate(timeout=60)
    assert "normal.png" in out and "\x1b" not in out + err


def test_names_that_the_terminal_cannot_show_are_escaped(tmp_path):
    folder = write_set(tmp_path / "石")
    (folder / "メモ.txt").write_text("notes")
    for arguments, code in ((["inspect", folder], 0), (["inspect", folder / "木"], 3)):
        running = process(*arguments, PYTHONIOENCODING="ascii")
        out, err = running.communicate(timeout=60)
        assert running.returncode == code and "\\u77f3" in out + err, err
        assert "defect" not in err


def test_help_and_inspect_import_nothing_heavy(folder):
    for arguments, forbidden in (
        (["--help"], {"torch", "OpenImageIO", "colour", "rich", "scipy"}),
        (["inspect", str(folder)], {"torch", "colour", "scipy"}),
    ):
        code = (
            "import sys; from mipbake.cli.main import main; code = main(sys.argv[1:]); "
            f"sys.stderr.write(repr(sorted(set(sys.modules) & {forbidden!r}))); sys.exit(code)"
        )
        path = os.pathsep.join(p for p in sys.path if p)
        done = subprocess.run(
            [sys.executable, "-c", code, *arguments],
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": path},
            check=True,
        )
        assert done.stderr == "[]"


@pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_leave_nothing_behind(tmp_path, number, code):
    folder = write_set(tmp_path / "large", **bumps(768, 1024))
    running = process("bake", folder, "-o", tmp_path / "out", "--method", "lean", "--filter", "mitchell")
    deadline = time.monotonic() + 60
    # A file in the temporary folder shows that it is in the middle of writing.
    while running.poll() is None and not list(tmp_path.glob("out/.large*/*")) and time.monotonic() < deadline:
        time.sleep(0.002)
    running.send_signal(number)
    _, err = running.communicate(timeout=60)
    if running.returncode == 0:  # it was quicker than the signal: then it is whole
        assert mipbake.open_stack(tmp_path / "out" / "large").size == (768, 1024)
        return
    assert running.returncode == code and err.count("\n") == 1 and "Traceback" not in err, err
    assert not (tmp_path / "out").exists()
