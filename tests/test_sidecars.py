"""Sidecars: lists of a stack's files in the words of other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import mipbake
from mipbake.cli.main import main
from mipbake.stack.manifest import is_stack_folder
from mipbake.stack.output import Output
from mipbake.stack.sidecars import sidecar_named

from .command_line import fails, write_png, write_set


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = write_set(tmp_path / "wood")
    for name in ("metallic", "ao", "height"):
        write_png(folder / f"{name}.png", np.full((16, 16), 120, np.uint8))
    write_png(folder / "emissive.png", np.full((16, 16, 3), 7, np.uint8))
    return folder


def entries(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((folder / "ntc.json").read_text())["textures"]
    return found


def test_ntc_lists_every_level_of_every_map(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["bake", str(source), "-o", str(out), "--method", "linear", "--format", "tx", "--sidecar", "ntc"]) == 0
    listed = entries(out / "wood")
    files = [each["fileName"] for each in listed]
    assert sorted(files) == sorted(path.name for path in (out / "wood").glob("*.png"))
    assert {each["mipLevel"] for each in listed} == set(range(5))
    for each in listed:
        with Image.open(out / "wood" / each["fileName"]) as image:
            assert image.size == (16 >> each["mipLevel"],) * 2
            assert len(image.getbands()) == sum(map(len, each["semantics"].values()))
    labels = {each["name"]: each["semantics"] for each in listed}
    assert labels == {
        "base_color": {"Albedo": "RGB"},
        "normal": {"Normal": "RGB"},
        "roughness": {"Roughness": "R"},
        "metallic": {"Metalness": "R"},
        "occlusion": {"Occlusion": "R"},
        "height": {"Displacement": "R"},
        "emissive": {"Emissive": "RGB"},
    }
    assert {each["name"] for each in listed if each["isSRGB"]} == {"base_color", "emissive"}
    assert is_stack_folder(out / "wood")  # a later bake may replace it
    assert mipbake.open_stack(out / "wood").size == (16, 16)


def test_packed_files_tell_what_lies_where(source: Path, tmp_path: Path) -> None:
    stack = mipbake.bake(mipbake.load(source), "linear")
    for packing, name, wanted in (
        ("orm", "orm", {"Occlusion": "R", "Roughness": "G", "Metalness": "B"}),
        ("mask-map", "mask_map", {"Metalness": "R", "Occlusion": "G", "Glossiness": "A"}),
    ):
        stack.save(tmp_path / name, [Output("png:16", packing)], levels=2, sidecar="ntc")
        assert {each["name"]: each["semantics"] for each in entries(tmp_path / name)}[name] == wanted


def test_what_is_too_much_is_left_out_and_said(source: Path) -> None:
    write_png(source / "anisotropy.png", np.tile(np.uint8([255, 128, 128]), (16, 16, 1)))
    write_png(source / "opacity.png", np.full((16, 16), 200, np.uint8))
    files = mipbake.bake(mipbake.load(source), "linear").files(Output("png", "separate"))
    made = sidecar_named("ntc", files)
    listed = json.loads(made.content)["textures"]
    assert sum(sum(map(len, each["semantics"].values())) or 3 for each in listed if each["mipLevel"] == 0) <= 16
    assert all("has at most 16 channels" in sentence for sentence in made.left_out) and made.left_out
    assert {"base_color", "normal", "roughness", "metallic", "anisotropy"} <= {each["name"] for each in listed}


def test_what_cannot_be(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = fails(capsys, 2, "bake", source, "-o", tmp_path / "out", "--sidecar", "nothing")
    assert "unknown sidecar 'nothing': expected one of ntc" in said
    stack = mipbake.bake(mipbake.load(source), "linear")
    with pytest.raises(mipbake.UsageError, match="files of the format png, which is not asked for"):
        stack.save(tmp_path / "stack", "exr", sidecar="ntc")
    with pytest.raises(mipbake.UsageError, match="unknown sidecar"):
        stack.save(tmp_path / "stack", "png", sidecar="other")
    assert not (tmp_path / "stack").exists()
    stack.save(tmp_path / "stack", "png", sidecar="ntc")
    assert entries(tmp_path / "stack")
