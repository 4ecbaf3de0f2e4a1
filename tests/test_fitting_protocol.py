"""The protocol as its page has it: a program written from the page alone, the example, and views of a user's own."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import InputError
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.camera import Camera
from mipbake.fitting.process import ProcessRenderer
from mipbake.fitting.protocol import read_views
from mipbake.fitting.renderer import Levels
from mipbake.fitting.views import View
from mipbake.quality import environment

from . import fitting_programs as programs
from .fitting_levels import stamps_of
from .fitting_programs import PROGRAM, Write, levels_of, view_of

script = pytest.fixture(programs.script)
before = pytest.fixture(programs.before)
pytestmark = programs.ON_LINUX

SHELL = """
while IFS= read -r line; do
    case "$line" in
    *'"request": "hello"'*) echo '{"mipbake": 2, "answer": "hello", "renderer": "shell"}' ;;
    *'"request": "render"'*)
        maps=$(printf '%s' "$line" | sed 's/.*"file": "\\([^"]*\\)".*/\\1/')
        frame=$(printf '%s' "$line" | sed 's/.*"frame": "\\([^"]*\\)".*/\\1/')
        head -c 12 "$maps" > "$frame"
        head -c 12 /dev/zero >> "$frame"
        echo '{"mipbake": 2, "answer": "frame", "arrays": {"image": [1, 1, 3], "uv": [1, 1, 2], "lod": [1, 1]}}' ;;
    *) exit 0 ;;
    esac
done
"""
"""A renderer of one pixel, the first texel, for the shell: it reads the lines as the example of the page has them."""


def test_a_program_of_the_page_alone(tmp_path: Path, before: None) -> None:
    path, levels = tmp_path / "renderer.sh", levels_of()
    path.write_text(SHELL, encoding="utf-8")
    with ProcessRenderer(f"sh {shlex.quote(str(path))}") as renderer:
        frame = renderer.render(levels, view_of())
        np.testing.assert_array_equal(frame.image[0, 0], levels.maps["base_color"][0][0, 0])
        assert frame.lod.shape == (1, 1)
        renderer.render(levels, view_of())


def test_the_programs_side_needs_numpy_alone() -> None:
    lines = PROGRAM.read_text(encoding="utf-8").splitlines()
    imports = {line.split()[1].partition(".")[0] for line in lines if line.startswith(("import ", "from "))}
    assert imports <= {*sys.stdlib_module_names, "numpy"}


def test_views_of_a_users_own(tmp_path: Path) -> None:
    path = tmp_path / "views.json"
    path.write_text('[{"name": "door", "scale": "far", "camera": 3}, {"offset": [1, 2]}]', encoding="utf-8")
    door, other = read_views(path)
    assert (door.name, door.scale, door.as_json()) == ("door", "far", {"name": "door", "scale": "far", "camera": 3})
    moved = door.moved(0.5, 1).moved(0.25, 0)
    assert (moved.name, moved.offset, moved.as_json()["offset"]) == ("door", (0.75, 1), [0.75, 1.0])
    assert (other.name, other.scale) == ("view", "other")
    assert other.moved(-1, 0.5).as_json() == {"offset": [0.0, 2.5]}


@pytest.mark.parametrize(
    "text", ["{}", "[]", "[1]", "[{]", '[{"a": NaN}]', '[{"offset": 3}]', '[{"offset": [1, "2"]}]']
)
def test_files_that_hold_no_views(text: str, tmp_path: Path) -> None:
    path = tmp_path / "views.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"views\.json"):
        read_views(path)


def conversation() -> list[tuple[str, str]]:
    """The example of the page: who speaks, and the line."""
    page = Path(__file__).parents[1] / "docs" / "fit-protocol.md"
    block = page.read_text(encoding="utf-8").partition("## An example")[2].split("```")[1]
    said: list[tuple[str, str]] = []
    for line in block.splitlines():
        if line.startswith(("> ", "< ")):
            said.append((line[0], line[2:]))
        elif line:
            said[-1] = (said[-1][0], said[-1][1] + line)
    return said


def near(found: Any, expected: Any) -> bool:
    """Whether two JSON values are equal but for the rounding of numbers."""
    if isinstance(expected, dict):
        return list(found) == list(expected) and all(near(found[key], expected[key]) for key in expected)
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(near, found, expected))
    if isinstance(expected, float):
        return bool(np.isclose(found, expected, atol=1e-9))
    return type(found) is type(expected) and found == expected


def test_the_example_of_the_page_is_what_is_said(script: Write, tmp_path: Path, before: None) -> None:
    """A program says what the page's program says, and is told what the page tells it."""
    said = conversation()
    answers = [line for who, line in said if who == "<"]
    text = f"""
import json, sys
answers = {answers!r}
with open({str(tmp_path / "told")!r}, "w") as told:
    for line in sys.stdin:
        told.write(line)
        request = json.loads(line)
        if request["request"] == "render":
            open(request["frame"], "wb").write(bytes(224))
        while request["request"] != "end":
            answer = answers.pop(0)
            print(answer, flush=True)
            if answer.startswith("{{"):
                break
"""
    sizes = [(2, 2), (1, 1)]
    maps = {"base_color": [np.zeros((*size, 3), np.float32) for size in sizes]}
    maps["roughness"] = [np.zeros((*size, 1), np.float32) for size in sizes]
    camera = Camera((0, 0, 2), field_of_view=90, near=1, far=3)
    light = environment.directional("one", [[0, 0.6, 0.8]], [[3, 3, 3]])
    view = View("front", "near", shapes.plane(), camera, light, (2, 4))
    with ProcessRenderer(script(text)) as renderer:
        for stamp, seen in ((2, view), (3, view.moved(0.25, -0.25))):
            frame = renderer.render(Levels("gltf", maps, ("wrap", "clamp"), stamps_of(sizes, (1, stamp))), seen)
            assert frame.image.shape == (2, 4, 3) and frame.id.shape == (2, 4)
    lines = (tmp_path / "told").read_text(encoding="utf-8").splitlines()
    folder = json.loads(lines[0])["folder"]
    told = [json.loads(line.replace(folder, "/x")) for line in lines]
    expected = [json.loads(line) for who, line in said if who == ">"]
    assert len(told) == len(expected) == 4
    for one, other in zip(told, expected, strict=True):
        assert near(one, other), (one, other)
