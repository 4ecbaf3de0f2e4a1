"""Files for build systems: the functions of CMake, the hooks, the action and the image."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mipbake.cli.main import main

from .command_line import write_set

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples" / "pipeline"


def run(*command: str, folder: Path) -> str:
    made = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    return made.stdout


@pytest.mark.long
@pytest.mark.skipif(not all(map(shutil.which, ("cmake", "ninja"))), reason="cmake or ninja is not installed")
def test_cmake_bakes_sets_and_libraries(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--cmake-dir"]) == 0
    place = capsys.readouterr().out.strip()
    write_set(tmp_path / "textures" / "metals" / "iron")
    write_set(tmp_path / "others" / "my oak.v2")
    options = "--method linear --format png --max-level 1"
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.20)\nproject(game NONE)\nfind_package(mipbake REQUIRED)\n"
        f'mipbake_bake(oak "others/my oak.v2" two {options})\n'
        f'mipbake_bake_library(library textures "e very" {options} --jobs 1)\n'
    )
    then = time.time() - 100
    for path in (tmp_path, *tmp_path.rglob("*")):
        os.utime(path, (then, then))
    build = tmp_path / "build"
    run("cmake", "-S", ".", "-B", "build", "-G", "Ninja", f"-Dmipbake_DIR={place}", folder=tmp_path)
    run("cmake", "--build", "build", folder=tmp_path)
    assert (build / "e very/metals/iron/iron/stack.json").is_file()
    assert (build / "two/my_oak.v2/stack.json").is_file()
    assert "no work to do" in run("cmake", "--build", "build", folder=tmp_path)
    (tmp_path / "others/my oak.v2/normal.png").touch()
    assert "Baking oak" in run("cmake", "--build", "build", folder=tmp_path)
    write_set(tmp_path / "textures" / "gold")
    told = run("cmake", "--build", "build", folder=tmp_path)
    assert "Baking the library library" in told and "Baking oak" not in told
    assert (build / "e very/gold/gold/stack.json").is_file()
    assert "no work to do" in run("cmake", "--build", "build", folder=tmp_path)


@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed")
@pytest.mark.parametrize(("source", "said"), [("scene.glb", "is a document"), ("eiche-ä", "name it, with SET")])
def test_cmake_refuses_what_it_cannot_name(source, said, tmp_path, capsys):
    assert main(["--cmake-dir"]) == 0
    (tmp_path / source).mkdir()
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.20)\nproject(game NONE)\nfind_package(mipbake REQUIRED)\n"
        f"mipbake_bake(one {source} out)\n",
        encoding="utf-8",
    )
    place = capsys.readouterr().out.strip()
    made = subprocess.run(
        ["cmake", "-S", ".", "-B", "build", f"-Dmipbake_DIR={place}"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.returncode != 0 and said in " ".join(made.stderr.split())


def commands(text: str) -> list[str]:
    """Calls of `mipbake bake` in a file."""
    return [match.group(0) for match in re.finditer(r"mipbake bake[^\n;|]*", text)]


def test_hooks_and_the_action_call_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bake", "--help-all"]) == 0
    offered = set(re.findall(r"--[a-z0-9-]+", capsys.readouterr().out))
    files = (ROOT / ".pre-commit-hooks.yaml", EXAMPLES / "action.yml", EXAMPLES / "Dockerfile", EXAMPLES / "try.py")
    found = [command for file in files for command in commands(file.read_text(encoding="utf-8"))]
    assert len(found) >= 5
    for command in found:
        assert set(re.findall(r"--[a-z0-9-]+", command)) <= offered, command


def test_the_example_says_what_it_lacks_and_goes_on(tmp_path: Path) -> None:
    made = subprocess.run(
        [sys.executable, str(EXAMPLES / "try.py")],
        env={**os.environ, "PATH": str(tmp_path)}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert made.stdout.count("left out, because mipbake is not installed: get it with python -m pip install") == 4


def test_hooks_have_what_pre_commit_asks_for() -> None:
    text = (ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8")
    hooks = text.split("- id: ")[1:]
    assert [hook.split("\n")[0] for hook in hooks] == ["mipbake-check", "mipbake-bake"]
    for hook in hooks:
        keys = set(re.findall(r"^  (\w+):", hook, re.MULTILINE))
        assert {"name", "entry", "language", "pass_filenames"} <= keys


def test_the_image_compiles_in_a_stage_that_is_left() -> None:
    first, last = re.split(r"^FROM .*$", (EXAMPLES / "Dockerfile").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    assert "g++" in first and "g++" not in last and "COPY --from=build" in last
