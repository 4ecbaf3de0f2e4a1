"""Programs that render for fits, written as scripts, and what tests of them share."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import RendererError
from mipbake.base.leftovers import unfinished
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.camera import Camera
from mipbake.fitting import program
from mipbake.fitting.process import ProcessRenderer
from mipbake.fitting.protocol import JsonView
from mipbake.fitting.renderer import Levels
from mipbake.fitting.views import View
from mipbake.quality import environment

from .fitting_levels import stamps_of

ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="looks at processes and files as Linux shows them")

PROGRAM = Path(program.__file__)

SERVING = f"""
import importlib.util, sys
spec = importlib.util.spec_from_file_location("program", {str(PROGRAM)!r})
program = sys.modules["program"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(program)
"""
"""What gives a script `program`, copied out as far as Python is concerned: mipbake is not imported."""

RENDER = '''
import numpy as np

def render(levels, view):
    """A picture that depends on every texel, and on the view."""
    height, width = view["size"]
    right, up = view.get("offset", (0, 0))
    y, x = np.mgrid[:height, :width].astype(np.float32)
    u, v = (x + 0.5 + right) / width, (y + 0.5 - up) / height
    image = np.zeros((height, width, 3), np.float32)
    for name, maps in sorted(levels.maps.items()):
        for texels in maps:
            rows, columns = ((x * n).astype(int) % n for x, n in ((v, texels.shape[0]), (u, texels.shape[1])))
            image += texels[rows, columns].sum(-1, keepdims=True) * [1, 2, 3]
    return image, np.stack([u, v], -1), np.full((height, width), 1.25), (x + y).astype(int) * 1000
'''

GOOD = f"""{SERVING}{RENDER}
def rendered(levels, view):
    image, uv, lod, number = render(levels, view)
    print("changed", [bool(each) for each in levels.changed], file=open(sys.argv[1], "a")) if sys.argv[1:] else None
    return program.Frame(image, uv, lod, None, number)

program.serve(rendered, "good")
"""

TALK = """
import json, os, signal, subprocess, sys, time

def hello():
    request = json.loads(sys.stdin.readline())
    answer({"answer": "hello", "renderer": "by hand"})
    return request

def asked():
    return json.loads(sys.stdin.readline())

def answer(content, version=2):
    print(json.dumps({"mipbake": version, **content}), flush=True)

def give(request, size=(2, 3), cut=0):
    with open(request["frame"], "wb") as file:
        file.write(bytes(4 * size[0] * size[1] * 6 - cut))
    answer({"answer": "frame", "arrays": {"image": [*size, 3], "uv": [*size, 2], "lod": size}})
"""
"""A program that speaks the protocol without any code of mipbake."""


def levels_of(seed: int = 0, stamps: tuple[int, ...] = (1, 2, 3), size: int = 4) -> Levels:
    rng = np.random.default_rng(seed)
    widths = {"base_color": 3, "roughness": 1, "normal": 3}
    sizes = [(size >> i, 2 * size >> i) for i in range(3)]
    maps = {n: [rng.random((*each, w), np.float32) for each in sizes] for n, w in widths.items()}
    return Levels("gltf", maps, ("wrap", "clamp"), stamps_of(sizes, stamps))


def view_of(size: tuple[int, int] = (5, 7), name: str = "a view") -> View:
    return View(name, "near", shapes.plane(), Camera((0, 2, 2)), environment.lamps(), size)


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def is_gone(pid: int) -> bool:
    """Whether there is no such process, and no zombie of it. A grandchild may wait for the system to take it away."""
    end = time.monotonic() + 30
    while time.monotonic() < end:
        try:
            state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state[0] == "Z" and int(state[1]) != os.getpid():  # of whoever adopts orphans here
            return True
        time.sleep(0.01)
    return False


Write = Callable[..., list[str]]

ANY = JsonView({})
"""A view of which a program needs to know nothing."""


def script(tmp_path: Path) -> Write:
    """Writes a program in Python, and gives its command."""

    def write(text: str, *arguments: object, name: str = "engine.py") -> list[str]:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return [sys.executable, str(path), *map(str, arguments)]

    return write


def before() -> Iterator[None]:
    """Checks that a test leaves neither descriptors nor files."""
    count = descriptors()
    yield
    assert unfinished() == []
    assert descriptors() == count


def fails(command: list[str], expected: str, **options: Any) -> str:
    """Renders, expects an error, and gives its message."""
    with ProcessRenderer(command, **options) as renderer, pytest.raises(RendererError, match=expected) as caught:
        renderer.render(levels_of(), JsonView({"name": "the corner"}))
    sentence = str(caught.value).splitlines()[0]
    assert "Traceback" not in sentence and sentence.startswith("the ")
    return str(caught.value)


def by_hand(levels: Levels, view: dict[str, Any]) -> tuple[np.ndarray, ...]:
    space: dict[str, Any] = {}
    exec(RENDER, space)
    return space["render"](levels, view)


def starts_another(pids: Path, then: str) -> str:
    return f"""{TALK}
other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
with open({str(pids)!r}, "w") as file:
    print(os.getpid(), other.pid, file=file)
hello()
asked()
{then}
"""
