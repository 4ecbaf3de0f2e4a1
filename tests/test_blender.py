"""The extension in Blender: `blender_steps.py` does what a user does, in an interpreter that has the package bpy.

That is $BPY_PYTHON, or this one. The extension calls mipbake by its command, as it lies in another environment.
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
import pytest

from mipbake.base.version import __version__

from .command_line import bumps, write_png
from .source_tree import ROOT, tomllib

EXTENSION = ROOT / "integrations" / "blender"
MANIFEST = tomllib.loads((EXTENSION / "blender_manifest.toml").read_text(encoding="utf-8"))
SIDE = 64
PLAIN = 256  # Cycles reads no level smaller than a tile, 64 texels: there are three that it can read
IMAGE, SEPARATE, MATH = "ShaderNodeTexImage", "ShaderNodeSeparateColor", "ShaderNodeMath"


def test_its_version_is_that_of_mipbake() -> None:
    assert MANIFEST["version"] == __version__


class Blender:
    """Runs steps in Blender."""

    def __init__(self, python: str, folder: Path) -> None:
        self._python, self.folder, self.sets = python, folder, folder / "sets"
        self._extension, self._command = folder / "mipbake.zip", folder / "mipbake"
        with zipfile.ZipFile(self._extension, "w") as archive:
            for path in [*EXTENSION.glob("*.py"), EXTENSION / "blender_manifest.toml"]:
                archive.write(path, path.name)
        paths = os.pathsep.join(filter(None, sys.path))
        self._command.write_text(f'#!/bin/sh\nPYTHONPATH="{paths}" exec "{sys.executable}" -m mipbake "$@"\n')
        self._command.chmod(0o755)

    def run(self, step: str) -> tuple[dict[str, Any], Path]:
        """What a step returns, and the folder that it had."""
        folder, result = self.folder / step, self.folder / f"{step}.json"
        folder.mkdir()
        job = {"extension": self._extension, "command": self._command, "sets": self.sets}
        job |= {"folder": folder, "result": result}
        (folder / "job.json").write_text(json.dumps(job, default=str))
        environment = {**os.environ, "BLENDER_USER_RESOURCES": str(self.folder / f"user {step}")}
        environment.pop("PYTHONPATH", None)
        command = [self._python, str(ROOT / "tests" / "blender_steps.py"), step, str(folder / "job.json")]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=600)
        assert result.is_file(), done.stdout[-2000:] + done.stderr[-4000:]
        return json.loads(result.read_text()), folder


@pytest.fixture(scope="module")
def blender(tmp_path_factory: pytest.TempPathFactory) -> Blender:
    python = os.environ.get("BPY_PYTHON") or (sys.executable if find_spec("bpy") else "")
    if not python:
        pytest.skip("no interpreter has the package bpy: set BPY_PYTHON to one")
    made = Blender(python, tmp_path_factory.mktemp("blender"))
    write_sets(made.sets)
    return made


def write_sets(folder: Path) -> None:
    for name in ("plain", "tiles"):
        (folder / name).mkdir(parents=True)
    small = bumps(SIDE // 4, SIDE // 4)
    for name, pixels in {**small, "metallic": small["roughness"] // 2}.items():
        repeats = PLAIN // len(pixels)
        write_png(folder / "plain" / f"{name}.png", np.tile(pixels, (repeats, repeats, 1)[: pixels.ndim]))
    maps = bumps(SIDE, SIDE)
    (folder / "broken.png").write_bytes((folder / "plain" / "normal.png").read_bytes()[:200])
    for tile in (1001, 1002):
        write_png(folder / "tiles" / f"base.{tile}.png", maps["base_color"])
        write_png(folder / "tiles" / f"n.{tile}.png", maps["normal"])
        write_png(folder / "tiles" / f"packed.{tile}.png", packed())
    (folder / "scene.gltf").write_text(json.dumps(document(folder)))


def packed() -> np.ndarray:
    """Roughness in red and green, metallic in blue."""
    rough = bumps(SIDE, SIDE)["roughness"]
    return np.stack([rough, rough, np.full_like(rough, 200)], -1)


def document(folder: Path) -> dict[str, Any]:
    """A triangle whose material has factors, a mask, and textures that are scaled; all in one glTF document."""
    alpha = np.full((SIDE, SIDE, 1), 255, np.uint8)
    alpha[: SIDE // 2] = 40
    maps = bumps(SIDE, SIDE)
    images = []
    for name, pixels in {
        "colour": np.concatenate([maps["base_color"], alpha], -1),
        "orm": packed(),
        "normal": maps["normal"],
    }.items():
        write_png(folder / f"{name}.png", pixels)
        data = base64.b64encode((folder / f"{name}.png").read_bytes()).decode()
        images.append({"uri": f"data:image/png;base64,{data}"})
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    buffer = points.tobytes() + np.ascontiguousarray(points[:, :2]).tobytes()
    scaled = {"extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}
    colour, orm, normal = ({"index": index, **scaled} for index in range(3))
    material = {
        "name": "Gold/1",
        "alphaMode": "MASK",
        "pbrMetallicRoughness": {
            "baseColorTexture": colour,
            "baseColorFactor": [1, 0.5, 0.5, 0.8],
            "metallicRoughnessTexture": orm,
            "roughnessFactor": 0.75,
        },
        "normalTexture": {**normal, "scale": 0.5},
    }
    return {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_texture_transform"],
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "buffers": [
            {"uri": f"data:application/octet-stream;base64,{base64.b64encode(buffer).decode()}", "byteLength": 60}
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 24}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"},
        ],
        "images": images,
        "textures": [{"source": index} for index in range(3)],
        "materials": [material],
    }


def pixels_of(path: Path) -> np.ndarray:
    image = OpenImageIO.ImageBuf(str(path))
    assert not image.has_error, image.geterror()
    return image.get_pixels(OpenImageIO.FLOAT)


@pytest.mark.independent
def test_a_material_is_baked_shown_and_undone(blender: Blender) -> None:
    result, folder = blender.run("separate")
    stem = "//mipbake/Old_Leather_001/Old_Leather_001"
    spaces = {"base_color": "Linear Rec.709", "roughness": "Non-Color", "metallic": "Non-Color", "normal": "Non-Color"}
    baked = {role: [f"{stem}_{role}.exr", space, PLAIN] for role, space in spaces.items()}
    assert "save it first" in result["unsaved"][0]
    assert result["baked"] == result["again"] == baked
    assert result["before"] == result["undone"] == result["original"] != baked
    assert result["original"]["roughness"][1:] == ["Non-Color", PLAIN]
    assert (result["more nodes"], result["levels"]) == (0, 9)
    spaces["base_color"] = "sRGB"
    for found, level in ((result["level 2"], 2), (result["last level"][1], 8)):
        assert found == {
            role: [f"{stem}_{role}_mip{level:02}.png", space, PLAIN >> level] for role, space in spaces.items()
        }
    assert result["last level"][0] == 8
    assert result["cache"] == ([True, False] if result["version"] >= [5, 2] else [None, None])
    assert (folder / "mipbake" / "Old_Leather_001" / "stack.json").is_file()
    shown = {name: pixels_of(Path(file)) for name, file in result["render"].items()}
    assert shown["before"].mean() > 0.05
    off = {name: np.abs(picture - shown["after"]).mean() for name, picture in shown.items()}
    assert 0 < off["before"] < 0.1
    fine, coarse = off["level 0"], off["level 2"]  # the picture has ten texels a pixel, which 5.2 reads level 2 for
    assert 4 * coarse < fine if result["version"] >= [5, 2] else 4 * fine < coarse


@pytest.mark.independent
def test_what_blender_imports_of_gltf_is_baked_with_its_factors(blender: Blender) -> None:
    result, folder = blender.run("gltf")
    baked, stem = result["baked"], folder / "Gold_1" / "Gold_1"
    assert {baked[role][0] for role in ("roughness", "metallic", "normal")} == {
        f"{stem}_{role}.exr" for role in ("roughness", "metallic", "normal")
    }
    assert (baked["base_color"], baked["opacity"]) == ("ShaderNodeMix", MATH)  # factor and mask are behind the images
    assert result["mapped"] == ["ShaderNodeMapping"] * 5
    assert result["strength"] == 1
    source = packed()[..., 1] / 255 * 0.75
    assert pixels_of(Path(f"{stem}_roughness.exr")).min() > 0.99 * source.min()
    assert 0.8 * source.mean() < pixels_of(Path(f"{stem}_roughness.exr")).mean() < 1.6 * source.mean()
    opacity = pixels_of(Path(f"{stem}_opacity.exr"))
    assert np.allclose([opacity.max(), opacity.min()], [1, 40 / 255], atol=0.01)


@pytest.mark.independent
def test_udim_tiles_and_packed_channels(blender: Blender) -> None:
    result, folder = blender.run("tiles")
    stem = f"{folder}/Old_Leather_001/Old_Leather_001"
    roles = ("base_color", "roughness", "metallic", "normal")
    assert [result["baked"][role][0] for role in roles] == [f"{stem}_{role}.<UDIM>.exr" for role in roles]
    assert [result["level 1"][role][0] for role in roles] == [f"{stem}_{role}.<UDIM>_mip01.png" for role in roles]
    assert result["tiles"] == [[1001, 1002]] * 4
    assert result["sizes"] == [[[SIDE // 2, SIDE // 2]] * 2] * 4
    metallic = pixels_of(Path(f"{stem}_metallic.1002.exr"))
    assert np.allclose(metallic, 200 / 255, atol=0.05)


@pytest.mark.independent
def test_what_cannot_be_baked_is_said_in_a_sentence(blender: Blender) -> None:
    result, folder = blender.run("errors")
    result.pop("version")
    expected = {
        "generated": "image 'made here' is generated",
        "painted": "not saved",
        "ramp": "Roughness passes through 'Color",
        "bump": "passes through 'Bump'",
        "two_images": "2 images",
        "mapped": "different texture coordinates",
        "unlinked": "has no image",
        "coloured": "colour space sRGB: expected Non-Color",
        "missing": "nowhere.png is not there",
        "second": "2 Principled BSDF nodes",
        "taken": "'Old Leather 014' shows the images in",
        "nothing": "no image feeds",
        "broken": "normal.png is cut short",
        "program": "'no such program' is not there",
    }
    assert list(result) == list(expected)
    for name, words in expected.items():
        assert words in result[name] and "\n" not in result[name] and "Traceback" not in result[name], result[name]
    assert [path.name for path in folder.iterdir() if path.is_dir()] == ["Old_Leather_014"]  # others have left nothing
