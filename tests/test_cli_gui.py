"""`mipbake gui` without a browser: what its server answers, to whom, and what it leaves behind."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mipbake.base.errors import InputError
from mipbake.cli import gui_bakes
from mipbake.cli.gui_bakes import Bench
from mipbake.cli.gui_server import Server

from .command_line import fails, tree, write_set
from .gltf_files import many_materials
from .gui_pages import serving

NOTHING_CHOSEN = {"index": 0, "maps": {}, "convention": "", "preset": ""}


class Page:
    """What a page asks its server for."""

    def __init__(self, server: Server) -> None:
        self.server = server

    def ask(self, what: str, body: bytes | dict[str, Any] = b"", **headers: str) -> tuple[int, bytes]:
        """Status and answer; a body or headers are posted."""
        url = self.server.url
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        request = urllib.request.Request(f"{url}{what}", data or None, {"Origin": url.rstrip("/")} | headers)
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return answer.status, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()

    def done(self, what: str, body: bytes | dict[str, Any] = b"{}") -> Any:
        """The last line of an answer."""
        status, answer = self.ask(f"api/{what}", body)
        assert status == 200
        return json.loads(answer.splitlines()[-1])

    def drop(self, folder: Path) -> None:
        """Sends the files of a folder, as a drop does."""
        self.done("clear")
        for file in sorted(folder.iterdir()):
            assert self.done(f"file?name={folder.name}/{file.name}", file.read_bytes()) == {"done": {}}


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    (tmp_path / "work").mkdir()
    return Bench(tmp_path / "work")


@pytest.fixture
def page(bench: Bench) -> Iterator[Page]:
    with serving(bench) as server:
        yield Page(server)


def test_a_dropped_set_is_baked_and_downloaded(page: Page, tmp_path: Path) -> None:
    page.drop(write_set(tmp_path / "metal"))
    files = ["base_color.png", "normal.png", "roughness.png"]
    assert page.done("sets") == {"done": {"sets": [{"name": "metal", "files": files}]}}
    status, answer = page.ask("api/bake", NOTHING_CHOSEN)
    *progress, last = (json.loads(line) for line in answer.splitlines())
    assert status == 200 and {"read", "prefilter", "write", "check"} <= {each["phase"] for each in progress}
    made = last["done"]
    assert [image["name"] for image in made["scene"]["images"]] == ["truth", "plain", "mipbake"]
    assert made["verdict"]["outcome"] in ("gains", "same", "mixed", "loses") and made["verdict"]["sentence"].endswith(
        "."
    )
    status, archive = page.ask("api/result/baked")
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        names = opened.namelist()
        sizes = sum(each.file_size for each in opened.infolist())
    assert "metal/stack.json" in names and any(name.endswith("_mip4.png") or "mip" in name for name in names)
    assert made["file"] == "metal.zip" and made["about"] == f"{len(names)} files, {sizes / 1e6:.1f} MB"


def test_the_files_of_an_engine_and_maps_that_the_user_chose(page: Page, tmp_path: Path) -> None:
    folder = write_set(tmp_path / "metal")
    (folder / "roughness.png").rename(folder / "wear.png")
    page.drop(folder)
    page.done("sets")
    refused = page.done("bake", NOTHING_CHOSEN)["error"]
    assert "has no roughness map" in refused and "\n" not in refused
    chosen = NOTHING_CHOSEN | {"maps": {"roughness": "wear.png"}, "preset": "unreal", "convention": "directx"}
    made = page.done("bake", chosen)["done"]
    with zipfile.ZipFile(io.BytesIO(page.ask("api/result/baked")[1])) as opened:
        assert {"metal/T_metal_BC.dds", "metal/T_metal_N.dds", "metal/T_metal_ORM.dds"} < set(opened.namelist())
    assert made["scene"]["images"][0]["model"] == "gltf"
    assert any(note.startswith("In Unreal Engine: keep Mip Gen") for note in made["notes"])
    assert not any("--" in note for note in made["notes"])
    plain = page.done("plain", chosen)["done"]
    with zipfile.ZipFile(io.BytesIO(page.ask("api/result/plain")[1])) as opened:
        assert plain["file"] == "metal_plain.zip" and '"linear"' in opened.read("metal_plain/stack.json").decode()
    assert "error" not in page.done("bake", chosen | {"maps": {"roughness": None}})  # a constant


def test_a_document_becomes_a_document(page: Page, tmp_path: Path) -> None:
    document = many_materials(("leather", "Fence")).write(tmp_path / "scene.glb")
    page.done("clear")
    assert "done" in page.done("file?name=scene.glb", document.read_bytes())
    sets = page.done("sets")["done"]["sets"]
    assert len(sets) == 2 and all(each["files"] == [] for each in sets)
    for preset, suffix in (("", ".glb"), ("three", ".glb"), ("unreal", ".zip")):
        made = page.done("bake", NOTHING_CHOSEN | {"index": 1, "preset": preset})["done"]
        assert made["file"].endswith(suffix), preset
        assert page.ask("api/result/baked")[1][:4] == (b"glTF" if suffix == ".glb" else b"PK\x03\x04")


def test_bad_files_give_one_sentence(page: Page, bench: Bench, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert page.done("sets")["error"] == "there are no files: drop the maps of a material"
    page.done("clear")
    for name in ("../outside.png", "/outside.png", "a/../../outside.png", "C:/outside.png", ""):
        assert "expected a name" in page.done(f"file?name={name}", b"x")["error"]
    assert page.done("file?name=wood/wood_normal.png", b"no image")["done"] == {}
    page.done("sets")
    said = page.done("bake", NOTHING_CHOSEN)["error"]
    assert "wood_normal.png" in said and "Traceback" not in said and "\n" not in said
    assert "load the page again" in page.done("bake", b"{}")["error"]
    assert "not there any more" in page.done("bake", NOTHING_CHOSEN | {"index": 7})["error"]
    monkeypatch.setattr(gui_bakes, "MOST_BYTES", 4)
    assert "on the command line" in page.done("file?name=big.png", b"12345")["error"]
    assert not any("outside" in name for name in tree(tmp_path))
    with pytest.raises(InputError, match="did not arrive whole"):
        Bench(bench.folder).add("cut.png", io.BytesIO(b"12"), 4)


def test_other_pages_and_other_names_are_refused(page: Page) -> None:
    assert page.ask("")[0] == 200 and page.ask("viewer.js")[0] == 200
    for headers in ({"Host": "example.org"}, {"Origin": "http://example.org"}, {"Origin": "null"}):
        for what, body in (("", b""), ("api/start", b""), ("api/clear", b"{}")):
            assert page.ask(what, body, **headers)[0] == 403
    request = urllib.request.Request(f"{page.server.url}api/clear", b"{}")  # no page at all
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(request, timeout=10)
    for what in (
        "../gui_server.py",
        "%2e%2e/gui_server.py",
        "sw.js",
        "api/nothing",
        "api/result/baked",
        "server_baker.js/",
    ):
        assert page.ask(what)[0] == 404
    assert page.server.server_address[0] == "127.0.0.1"


def test_ctrl_c_ends_it_and_leaves_nothing(tmp_path: Path) -> None:
    work = tmp_path / "temporary"
    work.mkdir()
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "  # a shell may ignore it
    start = f"{heeding}from mipbake_start import run; run()"
    program = [sys.executable, "-c", start, "gui", str(write_set(tmp_path / "metal"))]
    started = subprocess.Popen(
        [*program, "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(work), "PYTHONUNBUFFERED": "1"},
    )
    url = started.stdout.readline().split()[3]
    with urllib.request.urlopen(f"{url}api/start", timeout=30) as answer:
        assert json.load(answer)["source"] == "metal"
    assert list(work.iterdir())
    time.sleep(0.1)
    started.send_signal(signal.SIGINT)
    _, said = started.communicate(timeout=30)
    assert (started.returncode, said) == (130, "mipbake: interrupted, nothing unfinished was left behind\n")
    assert list(work.iterdir()) == []


def test_what_cannot_be_opened_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str], page: Page) -> None:
    assert "is not there" in fails(capsys, 3, "gui", tmp_path / "nothing", "--no-browser")
    assert "--port is 70000" in fails(capsys, 2, "gui", "--port", 70000)
    assert "choose another --port" in fails(capsys, 4, "gui", "--no-browser", "--port", page.server.server_port)
