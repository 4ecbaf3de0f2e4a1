"""Renderers that are programs: what they are told, and what comes back."""

from __future__ import annotations

import json
import shlex
import shutil
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mipbake.errors import InputError, UsageError
from mipbake.fitting.process import ProcessRenderer
from mipbake.fitting.protocol import JsonView, read_views
from mipbake.fitting.renderer import Levels
from mipbake.fitting.views import View
from mipbake.render import environment, shapes
from mipbake.render.camera import Camera
from mipbake.render.mesh_gltf import read_gltf

from . import fitting_programs as programs
from .fitting_programs import (
    EXCHANGES,
    GOOD,
    PROGRAM,
    SERVING,
    TALK,
    Write,
    by_hand,
    fails,
    is_gone,
    levels_of,
    view_of,
)

script = pytest.fixture(programs.script)
before = pytest.fixture(programs.before)
pytestmark = programs.ON_LINUX


@pytest.mark.parametrize("exchange", EXCHANGES)
def test_a_frame_is_what_the_function_gives(exchange: str, script: Write, before: None) -> None:
    levels, view = levels_of(), view_of()
    with ProcessRenderer(script(GOOD), exchange=exchange) as renderer:
        for seen in (view, view.moved(0.25, -0.5), JsonView({"size": [3, 4]}), {"size": [2, 2]}):
            frame = renderer.render(levels, seen)
            told = (
                {"size": seen.size, "offset": seen.offset} if isinstance(seen, View) else getattr(seen, "content", seen)
            )
            image, uv, lod, number = by_hand(levels, told)
            np.testing.assert_array_equal(frame.image, image.astype(np.float32))
            np.testing.assert_array_equal(frame.uv, uv.astype(np.float32))
            np.testing.assert_array_equal(frame.lod, lod.astype(np.float32))
            np.testing.assert_array_equal(frame.id, number)
            assert frame.uv_da is None and frame.id.dtype == np.int32 and frame.image.flags.writeable


@pytest.mark.parametrize("exchange", EXCHANGES)
def test_derivatives_come_back_in_their_order(exchange: str, script: Write, before: None) -> None:
    text = f"""{SERVING}
import numpy as np
numbers = np.arange(2 * 3 * 4).reshape(2, 3, 4)
program.serve(lambda levels, view: program.Rendered(numbers[..., :3], numbers[..., :2], uv_da=numbers))
"""
    with ProcessRenderer(script(text), exchange=exchange) as renderer:
        frame = renderer.render(levels_of(), {})
    np.testing.assert_array_equal(frame.uv_da, np.arange(24).reshape(2, 3, 4))
    assert frame.lod is None and frame.id is None


@pytest.mark.parametrize("exchange", EXCHANGES)
def test_what_has_not_changed_is_not_handed_over_again(
    exchange: str, script: Write, tmp_path: Path, before: None
) -> None:
    levels, told = levels_of(), tmp_path / "told"
    with ProcessRenderer(script(GOOD, told), exchange=exchange) as renderer:

        def image(levels: Levels) -> np.ndarray:
            return renderer.render(levels, view_of()).image

        first = image(levels)
        levels.maps["roughness"][1][:] = 0.5  # as a stamp says that it has not changed, nothing comes of it
        np.testing.assert_array_equal(image(levels), first)
        levels = Levels(levels.model, levels.maps, levels.wrap, (1, 9, 3))
        now = image(levels)
        assert (now != first).any()
        np.testing.assert_array_equal(now, by_hand(levels, {"size": (5, 7)})[0].astype(np.float32))
        larger = levels_of(size=8, stamps=(1, 9, 3))  # other sizes, and the same stamps
        np.testing.assert_array_equal(image(larger), by_hand(larger, {"size": (5, 7)})[0].astype(np.float32))
        other = Levels("ggx", {"diffuse": larger.maps["base_color"]}, larger.wrap, larger.stamps)
        np.testing.assert_array_equal(image(other), by_hand(other, {"size": (5, 7)})[0].astype(np.float32))
    every = "(True, True, True)"
    changed = [every, "(False, False, False)", "(False, True, False)", every, every]
    assert told.read_text(encoding="utf-8").splitlines() == [f"changed {each}" for each in changed]


def test_a_program_is_started_once_and_asked_to_end(script: Write, tmp_path: Path, before: None) -> None:
    text = f"""{TALK}
with open({str(tmp_path / "said")!r}, "a") as said:
    print("start", os.getpid(), file=said, flush=True)
    hello()
    for line in sys.stdin:
        request = json.loads(line)
        print(request["request"], file=said, flush=True)
        if request["request"] == "render":
            give(request)
    print("done", file=said)
"""
    renderer = ProcessRenderer(shlex.join(script(text)))
    for _ in range(3):
        renderer.render(levels_of(), {})
    renderer.close()
    renderer.close()
    start, *rest = (tmp_path / "said").read_text(encoding="utf-8").splitlines()
    assert rest == ["render"] * 3 + ["end", "done"]
    assert is_gone(int(start.split()[1]))


def test_what_a_program_is_told(script: Write, tmp_path: Path, before: None) -> None:
    text = f"""{TALK}
request = [hello()]
for line in sys.stdin:
    request.append(json.loads(line))
    if request[-1]["request"] == "end":
        break
    if "mesh" in request[-1]["view"]:
        open({str(tmp_path / "mesh.glb")!r}, "wb").write(open(request[-1]["view"]["mesh"], "rb").read())
    give(request[-1])
json.dump(request, open({str(tmp_path / "requests")!r}, "w"))
"""
    view, levels = view_of().moved(0.25, 0.5), levels_of()
    own = JsonView({"where": ["ä", None, 1.5], "offset": [1, 2]})
    with ProcessRenderer(script(text)) as renderer:
        for each in (view, view.moved(1, 1), own, own.moved(0.5, -1)):
            renderer.render(levels, each)
    hello, *renders, end = json.loads((tmp_path / "requests").read_text(encoding="utf-8"))
    assert not Path(hello["folder"]).exists()
    assert end == {"mipbake": 1, "request": "end"}
    assert hello["request"] == "hello" and hello["exchange"] == "memory" and Path(hello["folder"]).is_absolute()
    assert {each["mipbake"] for each in (hello, *renders)} == {1}
    assert [each["id"] for each in renders] == [1, 2, 3, 4]
    told = renders[0]["view"]
    assert told["name"] == "a view" and told["scale"] == "near"
    assert told["size"] == [5, 7] and told["offset"] == [0.25, 0.5]
    assert told["camera"]["position"] == [0, 2, 2] and told["camera"]["field_of_view"] == 40
    np.testing.assert_array_equal(told["camera"]["matrix"], view.matrix())
    np.testing.assert_array_equal([light["direction"] for light in told["lights"]], view.lighting.direction)
    np.testing.assert_array_equal([light["radiance"] for light in told["lights"]], view.lighting.radiance)
    assert renders[1]["view"]["mesh"] == told["mesh"]  # written once
    assert renders[2]["view"] == own.content
    assert renders[3]["view"] == {**own.content, "offset": [1.5, 1.0]}
    stack = renders[0]["levels"]["stack"]
    assert [each["size"] for each in stack] == [[4, 8], [2, 4], [1, 2]] == [list(size) for size in levels.sizes]
    assert renders[0]["levels"]["wrap"] == ["wrap", "clamp"] and [each["stamp"] for each in stack] == [1, 2, 3]
    mesh, back = view.mesh, read_gltf(tmp_path / "mesh.glb")
    np.testing.assert_array_equal(back.triangles, mesh.triangles)
    for name in ("positions", "normals", "uv", "tangents"):
        np.testing.assert_allclose(getattr(back, name), getattr(mesh, name), atol=1e-6)


def test_what_else_a_program_prints_disturbs_nothing(script: Write, before: None) -> None:
    text = f"""{TALK}
print("[log] a banner")
print('{{"json": "of its own"}}')
print("no line feed before an answer would be wrong", file=sys.stderr)
hello()
os.write(1, b"\\xff\\xfe not text\\r\\n" + b"x" * 3_000_000 + b"\\n")
os.write(2, b"y" * 10_000_000)
for line in sys.stdin:
    request = json.loads(line)
    if request["request"] == "end":
        break
    print("\\x1b[31mrendering\\x1b[0m")
    give(request)
"""
    with ProcessRenderer(script(text), timeout=100) as renderer:
        for _ in range(2):
            assert renderer.render(levels_of(), {}).image.shape == (2, 3, 3)


def test_serving_answers_on_lines_of_their_own(script: Write, before: None) -> None:
    text = GOOD.replace("def rendered(levels, view):", "def rendered(levels, view):\n    print('half a line', end='')")
    with ProcessRenderer(script(text)) as renderer:
        assert renderer.render(levels_of(), view_of()).image.shape == (5, 7, 3)


def test_a_view_longer_than_a_pipe(script: Write, before: None) -> None:
    with ProcessRenderer(script(GOOD)) as renderer:
        assert renderer.render(levels_of(), {"size": [2, 2], "text": "z" * 3_000_000}).image.shape == (2, 2, 3)


def test_without_room_in_memory_files_lie_among_temporary_ones(
    script: Write, tmp_path: Path, before: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    text = f"{TALK}\nprint(hello()['folder'], file=open({str(tmp_path / 'told')!r}, 'w'))\ngive(asked())\nasked()"
    with ProcessRenderer(script(text)) as renderer:
        renderer.render(levels_of(), {})
    folder = Path((tmp_path / "told").read_text(encoding="utf-8").strip())
    assert folder.parent == tmp_path and not folder.exists()


EXR = f"""{TALK}
import shutil
hello()
request = asked()
if len(sys.argv) > 1:
    shutil.copy(sys.argv[1], request["frame"])
    if len(sys.argv) > 2:
        os.truncate(request["frame"], int(sys.argv[2]))
answer({{"answer": "frame", "id": request["id"]}})
asked()
"""


def frame_exr(path: Path, kinds: dict[str, str]) -> Path:
    """An EXR file of the size 2 x 3, whose channels hold 1, 2, 3 ... in the order of their names here."""
    import OpenEXR

    types = {"half": np.float16, "float": np.float32, "uint": np.uint32}
    planes = {name: np.full((2, 3), index + 1, types[kind]) for index, (name, kind) in enumerate(kinds.items())}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, planes) as file:
        file.write(str(path))
    return path


def test_another_writers_exr_files(script: Write, tmp_path: Path, before: None) -> None:
    """Colours in 16 bits, ids as integers, and channels that a frame has no use for."""
    kinds = {**dict.fromkeys("RGBA", "half"), **dict.fromkeys(("u", "v", "lod", "Z"), "float"), "id": "uint"}
    path = frame_exr(tmp_path / "frame.exr", kinds)
    with ProcessRenderer(script(EXR, path), exchange="exr") as renderer:
        frame = renderer.render(levels_of(), {})
    expected = {name: index + 1 for index, name in enumerate(kinds)}
    for array, names in ((frame.image, "RGB"), (frame.uv, "uv")):
        np.testing.assert_array_equal(array, np.broadcast_to([expected[name] for name in names], (2, 3, len(names))))
    np.testing.assert_array_equal(frame.lod, np.full((2, 3), expected["lod"]))
    np.testing.assert_array_equal(frame.id, np.full((2, 3), expected["id"]))


@pytest.mark.parametrize(
    ("kinds", "rest", "expected"),
    [
        (None, (), "cannot be read .No such file or directory.: expected the file"),
        (dict.fromkeys("RGBuv", "half"), (), "channel [uv] of the renderer's frame has 16 bits, which are too coarse"),
        (dict.fromkeys("RGuv", "float"), (), "shows nothing: expected the channels R, G and B"),
        (dict.fromkeys("RGBuv", "float"), (400,), "expected a whole EXR file"),
        (dict.fromkeys("RGBuv", "float"), (10,), "expected a whole EXR file"),
        (dict.fromkeys("RGBuv", "float"), (0,), "expected a whole EXR file"),
    ],
)
def test_exr_files_that_are_no_frames(
    kinds: dict[str, str] | None, rest: tuple[int, ...], expected: str, script: Write, tmp_path: Path, before: None
) -> None:
    arguments = () if kinds is None else (frame_exr(tmp_path / "frame.exr", kinds), *rest)
    fails(script(EXR, *arguments), expected, exchange="exr")


@pytest.mark.parametrize("exchange", EXCHANGES)
def test_ids_are_whole_numbers(exchange: str, script: Write, before: None) -> None:
    text = f"""{SERVING}
import numpy as np
program.serve(lambda levels, view: program.Rendered(np.ones((2, 2, 3)), np.ones((2, 2, 2)), id=np.full((2, 2), 0.5)))
"""
    fails(script(text), "has an id that is no integer", exchange=exchange)


SHELL = """
while IFS= read -r line; do
    case "$line" in
    *'"request": "hello"'*) echo '{"mipbake": 1, "answer": "hello", "renderer": "shell"}' ;;
    *'"request": "render"'*)
        id=$(printf '%s' "$line" | sed 's/.*"request": "render", "id": \\([0-9]*\\),.*/\\1/')
        maps=$(printf '%s' "$line" | sed 's/.*"file": "\\([^"]*\\)".*/\\1/')
        frame=$(printf '%s' "$line" | sed 's/.*"frame": "\\([^"]*\\)".*/\\1/')
        head -c 12 "$maps" > "$frame"
        head -c 12 /dev/zero >> "$frame"
        printf '{"mipbake": 1, "answer": "frame", "id": %s, "arrays": ' "$id"
        printf '{"image": {"offset": 0, "shape": [1, 1, 3]}, '
        echo '"uv": {"offset": 12, "shape": [1, 1, 2]}, "lod": {"offset": 20, "shape": [1, 1]}}}' ;;
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


@pytest.mark.parametrize("view", [3, {"x": float("nan")}, {"x": SimpleNamespace()}, JsonView({"offset": 1}, (1, 0))])
def test_views_that_cannot_be_told(view: Any, script: Write, before: None) -> None:
    with ProcessRenderer(script(GOOD)) as renderer, pytest.raises(UsageError, match="expected"):
        renderer.render(levels_of(), view)


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("", {}),
        ([], {}),
        ("'half", {}),
        ("x", {"exchange": "carrier pigeon"}),
        ("x", {"timeout": 0}),
        ("x", {"start_timeout": float("nan")}),
    ],
)
def test_what_makes_no_renderer(command: Any, options: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="expected"):
        ProcessRenderer(command, **options)


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
    maps = {"base_color": [np.zeros((n, n, 3), np.float32) for n in (2, 1)]}
    maps["roughness"] = [np.zeros((n, n, 1), np.float32) for n in (2, 1)]
    camera = Camera((0, 0, 2), field_of_view=90, near=1, far=3)
    light = environment.directional("one", [[0, 0.6, 0.8]], [[3, 3, 3]])
    view = View("front", "near", shapes.plane(), camera, light, (2, 4))
    with ProcessRenderer(script(text)) as renderer:
        for stamp, seen in ((2, view), (3, view.moved(0.25, -0.25))):
            frame = renderer.render(Levels("gltf", maps, ("wrap", "clamp"), (1, stamp)), seen)
            assert frame.image.shape == (2, 4, 3) and frame.id.shape == (2, 4)
    lines = (tmp_path / "told").read_text(encoding="utf-8").splitlines()
    folder = json.loads(lines[0])["folder"]
    told = [json.loads(line.replace(folder, "/x")) for line in lines]
    expected = [json.loads(line) for who, line in said if who == ">"]
    assert len(told) == len(expected) == 4
    for one, other in zip(told, expected, strict=True):
        assert near(one, other), (one, other)
