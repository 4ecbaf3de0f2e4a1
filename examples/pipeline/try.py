"""Shows on a small library what the page docs/pipeline.md says: --watch, a depfile, CMake, and a hook of pre-commit.

    python examples/pipeline/try.py

It works in a temporary folder, on copies of the example sets. A part that needs a program which is not installed is
left out, with a sentence that says how to get it; one that fails says why, and the others go on.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OPTIONS = ["--method", "linear", "--format", "png"]
SOURCES = {"git": "from https://git-scm.com", "mipbake": f"with python -m pip install {ROOT}"}
"""Where programs come from; all others with pip."""


class PartError(Exception):
    """A part did not work."""


def run(*command: str, folder: Path, may_fail: bool = False) -> str:
    """What a command prints."""
    made = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if made.returncode and not may_fail:
        raise PartError(f"{' '.join(command)}\n{made.stdout}{made.stderr}")
    return made.stdout + made.stderr


def edit(folder: Path) -> None:
    """Saves the roughness map of the leather anew, a little rougher each time."""
    from PIL import Image

    file = folder / "textures" / "leather" / "roughness.png"
    with Image.open(file) as image:
        changed = image.point(lambda value: min(value + 1, 255))
    changed.save(file)


def lines(log: Path) -> list[dict[str, object]]:
    """What a log of JSON tells so far."""
    if not log.exists():
        return []
    return [json.loads(line) for line in log.read_text().splitlines(keepends=True) if line.endswith("\n")]


def wait(holds: Callable[[], bool], what: str) -> None:
    """Waits until something holds, at most a minute."""
    end = time.monotonic() + 60
    while not holds():
        if time.monotonic() > end:
            raise PartError(f"{what} did not happen within a minute")
        time.sleep(0.01)


def show_watch(folder: Path) -> None:
    """An edit is baked while the command goes on."""
    log = folder / "watch.jsonl"
    command = ["mipbake", "bake", "textures", "-o", "watched", "--recursive", "--watch", "--json-log"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*command, str(log), *OPTIONS], cwd=folder, **quiet) as process:
        try:
            wait(lambda: len(lines(log)) == 2, "the first bake")
            time.sleep(2)  # the watch begins after it
            edit(folder)
            saved = time.monotonic()
            result = folder / "watched" / "leather" / "leather" / "stack.json"
            before = result.stat().st_mtime_ns
            wait(lambda: result.stat().st_mtime_ns != before, "the bake of an edit")
            print(f"  {time.monotonic() - saved:.2f} s after the edit was saved, its result was there")
        finally:
            process.terminate()


def show_depfile(folder: Path) -> None:
    """Ninja bakes what has changed, and nothing else."""
    (folder / "build.ninja").write_text(
        f"rule bake\n  command = mipbake bake $in -o baked --depfile $set.d --quiet {' '.join(OPTIONS)}\n"
        "  depfile = $set.d\n  deps = gcc\n"
        "build baked/leather/stack.json: bake textures/leather\n  set = leather\n"
        "build baked/tiles/stack.json: bake textures/tiles\n  set = tiles\n"
    )
    for what in ("the first time", "again", "after an edit"):
        if what == "after an edit":
            edit(folder)
        told = run("ninja", folder=folder)
        print(f"  {what}: {told.splitlines()[-1]}")


def show_cmake(folder: Path) -> None:
    """The functions that find_package brings."""
    (folder / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.20)\nproject(game NONE)\nfind_package(mipbake REQUIRED)\n"
        f"mipbake_bake_library(textures textures baked {' '.join(OPTIONS)})\n"
    )
    place = run("mipbake", "--cmake-dir", folder=folder).strip()
    run("cmake", "-S", ".", "-B", "build", "-G", "Ninja", f"-Dmipbake_DIR={place}", folder=folder)
    for what in ("the first time", "again", "after an edit"):
        if what == "after an edit":
            edit(folder)
        print(f"  {what}: {run('cmake', '--build', 'build', folder=folder).splitlines()[-1]}")


def show_hook(folder: Path) -> None:
    """A commit of an edit that was not baked is refused."""
    (folder / "mipbake.toml").write_text(
        'library = "textures"\nout = "results"\n[options]\nmethod = "linear"\nformat = "png"\n'
    )
    # As a repository would name a release of mipbake, but with the command that is installed here.
    (folder / ".pre-commit-config.yaml").write_text(
        "repos:\n- repo: local\n  hooks:\n  - id: mipbake-check\n    name: results of mipbake fit their sources\n"
        "    entry: mipbake bake --config mipbake.toml --check\n    language: system\n    pass_filenames: false\n"
        "    always_run: true\n"
    )
    (folder / ".gitignore").write_text("watched/\nbuild/\n.mipbake/\n.ninja*\n*.d\n*.jsonl\n")
    who = ["-c", "user.name=try", "-c", "user.email=try@example.org"]
    run("git", "init", "--quiet", folder=folder)
    run("mipbake", "bake", folder=folder)
    run("git", "add", ".", folder=folder)
    run("pre-commit", "install", folder=folder)
    for what in ("what is baked", "an edit that is not baked"):
        if what != "what is baked":
            edit(folder)
            run("git", "add", ".", folder=folder)
        told = run("git", *who, "commit", "-m", "try", folder=folder, may_fail=True)
        passed = next((line for line in told.splitlines() if line.startswith("results of mipbake")), told)
        print(f"  {what}: {passed}")


PARTS = (
    ("--watch", show_watch, ("mipbake",)),
    ("--depfile, with Ninja", show_depfile, ("mipbake", "ninja")),
    ("CMake", show_cmake, ("mipbake", "cmake", "ninja")),
    ("the hook mipbake-check", show_hook, ("mipbake", "git", "pre-commit")),
)


def main() -> int:
    """Shows everything; 1 where a part failed."""
    failed = False
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for example, short in (("lacquered_leather", "leather"), ("glazed_tiles", "tiles")):
            shutil.copytree(ROOT / "examples" / example, folder / "textures" / short)
        then = time.time() - 60
        for path in folder.rglob("*"):
            os.utime(path, (then, then))
        for title, show, programs in PARTS:
            print(title)
            for program in (each for each in programs if shutil.which(each) is None):
                source = SOURCES.get(program, f"with python -m pip install {program}")
                print(f"  left out, because {program} is not installed: get it {source}")
                break
            else:
                try:
                    show(folder)
                except (PartError, OSError) as error:
                    print(f"  failed: {error}")
                    failed = True
    print("not shown: the action and the image (action.yml, Dockerfile), which need a server and Docker")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
