"""Renderers that are programs: what they are told, and what comes back."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import UsageError
from mipbake.comparing.meshes.mesh_gltf import read_gltf
from mipbake.fitting.process import ProcessRenderer
from mipbake.fitting.protocol import JsonView
from mipbake.fitting.views import View

from . import fitting_programs as programs
from .fitting_levels import by_tiles, noisy
from .fitting_programs import (
    ANY,
    GOOD,
    RENDER,
    SERVING,
    TALK,
    Write,
    by_hand,
    levels_of,
    view_of,
)

script = pytest.fixture(programs.script)
before = pytest.fixture(programs.before)
pytestmark = programs.ON_LINUX


def test_a_frame_is_what_the_function_gives(script: Write, before: None) -> None:
    levels, view = levels_of(), view_of()
    with ProcessRenderer(script(GOOD)) as renderer:
        for seen in (view, view.moved(0.25, -0.5), JsonView({"size": [3, 4]})):
            frame = renderer.render(levels, seen)
            told = {"size": seen.size, "offset": seen.offset} if isinstance(seen, View) else seen.content
            image, uv, lod, number = by_hand(levels, told)
            np.testing.assert_array_equal(frame.image, image.astype(np.float32))
            np.testing.assert_array_equal(frame.uv, uv.astype(np.float32))
            np.testing.assert_array_equal(frame.lod, lod.astype(np.float32))
            np.testing.assert_array_equal(frame.id, number)
            assert frame.uv_da is None and frame.image.flags.writeable


FOLLOWING = f"""{SERVING}{RENDER}
copies = {{}}

def rendered(levels, view):
    for level, parts in enumerate(levels.changed):
        for row, column, height, width in parts:
            rows, columns = slice(row, row + height), slice(column, column + width)
            for name, maps in levels.maps.items():
                kept = copies.setdefault((name, level), np.zeros_like(maps[level]))
                kept[rows, columns] = maps[level][rows, columns]
    for (name, level), kept in copies.items():
        levels.maps[name][level] = kept
    image, uv, lod, number = render(levels, view)
    return program.Frame(image, uv, lod, None, number)

program.serve(rendered)
"""
"""A program that keeps textures, and takes over only the texels that it is told of."""


def test_a_program_that_takes_only_the_tiles_that_changed(script: Write, before: None) -> None:
    first = noisy((100, 75), 1, 1)
    view = JsonView({"size": [60, 50]})
    with ProcessRenderer(script(FOLLOWING)) as renderer:
        old = renderer.render(first, view).image
        told, whole = by_tiles(first, noisy((100, 75), 2, 1), 3)
        seen = renderer.render(told, view).image
        again = renderer.render(told, view).image
    wanted = by_hand(whole, view.content)[0].astype(np.float32)
    np.testing.assert_array_equal(seen, wanted)
    np.testing.assert_array_equal(again, wanted)
    assert not np.array_equal(seen, old)


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
    assert end == {"mipbake": 2, "request": "end"}
    assert hello["request"] == "hello" and Path(hello["folder"]).is_absolute()
    assert {each["mipbake"] for each in (hello, *renders)} == {2}
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
    assert [each["changed"] for each in stack] == [[[0, 0, *each]] for each in levels.sizes]
    assert renders[0]["levels"]["wrap"] == ["wrap", "clamp"]
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
os.write(1, b"\\xff\\xfe not text\\r\\n" + b"x" * 2_000_000 + b"\\n")
os.write(2, b"y" * 1_000_000)
for line in sys.stdin:
    request = json.loads(line)
    if request["request"] == "end":
        break
    print("\\x1b[31mrendering\\x1b[0m")
    give(request)
"""
    with ProcessRenderer(script(text), timeout=100) as renderer:
        for _ in range(2):
            assert renderer.render(levels_of(), ANY).image.shape == (2, 3, 3)


def test_a_view_longer_than_a_pipe(script: Write, before: None) -> None:
    with ProcessRenderer(script(GOOD)) as renderer:
        assert renderer.render(levels_of(), JsonView({"size": [2, 2], "text": "z" * 3_000_000})).image.shape == (
            2,
            2,
            3,
        )


@pytest.mark.parametrize(
    "view", [3, {}, JsonView({"x": float("nan")}), JsonView({"x": SimpleNamespace()}), JsonView({"offset": 1}, (1, 0))]
)
def test_views_that_cannot_be_told(view: Any, script: Write, before: None) -> None:
    with ProcessRenderer(script(GOOD)) as renderer, pytest.raises(UsageError, match="expected"):
        renderer.render(levels_of(), view)


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("", {}),
        ([], {}),
        ("'half", {}),
        ("x", {"timeout": 0}),
        ("x", {"timeout": float("nan")}),
    ],
)
def test_what_makes_no_renderer(command: Any, options: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="expected"):
        ProcessRenderer(command, **options)


def test_without_room_in_memory_files_lie_among_temporary_ones(
    script: Write, tmp_path: Path, before: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    text = f"{TALK}\nprint(hello()['folder'], file=open({str(tmp_path / 'told')!r}, 'w'))\ngive(asked())\nasked()"
    with ProcessRenderer(script(text)) as renderer:
        renderer.render(levels_of(), ANY)
    folder = Path((tmp_path / "told").read_text(encoding="utf-8").strip())
    assert folder.parent == tmp_path and not folder.exists()
