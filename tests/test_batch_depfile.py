"""What results were made from, as Make and Ninja read it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from mipbake.cli.main import main
from mipbake.models.registry import WEIGHTS_FOLDER

from .command_line import fails, write_png, write_set

ARGUMENTS = ["--method", "linear", "--format", "png", "--max-level", "1"]


def older(folder: Path, seconds: float = 100.0) -> None:
    then = time.time() - seconds
    for path in (folder, *folder.rglob("*")):
        os.utime(path, (then, then))


def test_the_rule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_set(tmp_path / "my textures" / "wood #1")
    assert main(["bake", "my textures", "-r", "-o", "out", "--depfile", "deep/wood.d", *ARGUMENTS]) == 0
    rule, *empty = Path("deep/wood.d").read_text().split("\n\n")
    results, sources = rule.replace(" \\\n  ", " ").split(": ")
    assert results == r"out/wood\ \#1/wood_1/stack.json"
    inside = [rf"my\ textures/wood\ \#1/{name}.png" for name in ("base_color", "normal", "roughness")]
    assert sources == " ".join([*inside, r"my\ textures/wood\ \#1", r"my\ textures"])
    assert [line.strip() for line in empty] == [
        f"{each}:" for each in (*inside, r"my\ textures/wood\ \#1", r"my\ textures")
    ]


@pytest.mark.long
@pytest.mark.parametrize("tool", ["make", "ninja"])
def test_names_that_tools_write_otherwise(tmp_path: Path, tool: str) -> None:
    if shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed")
    write_set(tmp_path / "lib" / "100% a: $b #c" / "Q%r s")
    command = " ".join(["mipbake bake lib/*/* -o out --depfile s.d --quiet", *ARGUMENTS])
    target = "out/Q_r_s/stack.json"
    rule = f"rule bake\n  command = {command}\n  depfile = s.d\n  deps = gcc\nbuild {target}: bake\n"
    (tmp_path / "build.ninja").write_text(rule)
    (tmp_path / "Makefile").write_text(f"{target}:\n\t{command}\n-include s.d\n")
    older(tmp_path)

    def said() -> str:
        done = subprocess.run([tool], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    said()
    assert "no work to do" in said() or "up to date" in said()


def test_a_rule_is_written_into_a_pipe_and_not_over_it(tmp_path: Path) -> None:
    write_set(tmp_path / "lib" / "wood")
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with subprocess.Popen(["cat", pipe], stdout=subprocess.PIPE, text=True) as reader:
        command = ["bake", str(tmp_path / "lib"), "-r", "-o", str(tmp_path / "out"), *ARGUMENTS, "--quiet"]
        assert main([*command, "--depfile", str(pipe)]) == 0
        assert reader.communicate(timeout=60)[0].startswith(f"{tmp_path}/out/wood/wood/stack.json: ")
    assert pipe.is_fifo()


def test_a_folder_is_no_place_for_a_rule(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for place in ("", ".", str(tmp_path)):
        assert "is a folder" in fails(capsys, 2, "bake", str(tmp_path), "-r", "-o", "out", "--depfile", place)


def test_no_rule_where_something_failed(tmp_path: Path) -> None:
    (tmp_path / "lib/broken").mkdir(parents=True)
    write_png(tmp_path / "lib/broken/normal.png", np.tile(np.uint8([128, 128, 255]), (16, 16, 1)))
    assert (
        main(["bake", str(tmp_path / "lib"), "-r", "-o", str(tmp_path / "out"), "--depfile", str(tmp_path / "d")]) == 3
    )
    assert not (tmp_path / "d").exists()


def builds(folder: Path) -> bool:
    """Whether ninja had something to do."""
    run = subprocess.run(["ninja", "-v"], cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return "no work to do" not in run.stdout


@pytest.mark.long
@pytest.mark.skipif(shutil.which("ninja") is None, reason="ninja is not installed")
def test_ninja_bakes_what_has_changed(tmp_path: Path) -> None:
    write_set(tmp_path / "lib" / "wood")
    project = tmp_path / "mipbake.toml"
    text = 'library = "lib"\nout = "out"\n[options]\nmethod = "linear"\nformat = "png"\nmax-level = 1\n'
    project.write_text(text)
    (tmp_path / "build.ninja").write_text(
        "rule bake\n  command = mipbake bake --config mipbake.toml --depfile wood.d --quiet\n  depfile = wood.d\n"
        "  deps = gcc\nbuild out/wood/wood/stack.json: bake\n"
    )
    older(tmp_path)

    assert builds(tmp_path) and not builds(tmp_path)
    (tmp_path / "lib/wood/normal.png").touch()
    assert builds(tmp_path) and not builds(tmp_path)  # nothing is baked, and the result gets a new time
    project.write_text(text + "strength = 0.5\n")
    assert builds(tmp_path) and not builds(tmp_path)
    assert json.loads((tmp_path / "out/wood/wood/stack.json").read_text())["provenance"]["adjustments"]


def test_a_rule_within_a_result_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wood = write_set(tmp_path / "lib" / "wood")
    depfile = tmp_path / "out/wood/stack.json.d"
    err = fails(capsys, 2, "bake", wood, "-o", tmp_path / "out", "--depfile", depfile, *ARGUMENTS)
    assert f"the depfile {depfile} lies in the result {tmp_path / 'out/wood'}, which is replaced" in err
    assert not (tmp_path / "out/wood").exists()


def test_a_dry_run_writes_no_rule(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["bake", write_set(tmp_path / "s"), "-o", tmp_path / "out", "--depfile", tmp_path / "d", "--check"]
    assert "a dry run bakes nothing that --depfile could tell of" in fails(capsys, 2, *base)


@pytest.mark.long
def test_weights_are_part_of_the_rule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        write_set(tmp_path / "lib" / name)
    rules = (
        '[[sets]]\nmatch = "a"\nmethod = "neural"\nweights = "mipbake-3"\n[[sets]]\nmatch = "b"\nmethod = "linear"\n'
    )
    (tmp_path / "mipbake.toml").write_text(f'library = "lib"\nout = "out"\n{rules}')

    def named(*arguments: str) -> list[str]:
        assert main(["bake", *arguments, "--depfile", "d"]) == 0
        found = Path("d").read_text().split("\n\n")[0].split(" \\\n  ")
        return [each for each in found if each.endswith(".safetensors")]

    assert named("--config", "mipbake.toml") == [str(WEIGHTS_FOLDER / "mipbake-3.safetensors")]
    assert named("lib/b", "-o", "other", "--method", "linear") == []
