"""integrations/unreal with a stand-in for the module `unreal`; and what manifests tell all importers."""

from __future__ import annotations

import json
import runpy
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from . import packed_sets
from .command_line import run
from .input_files import write_image
from .packed_sets import COLOUR, OPACITY, baked, every_map
from .unreal_stand_in import stand_in

INTEGRATIONS = Path(__file__).parents[1] / "integrations"
SCRIPT = INTEGRATIONS / "unreal" / "mipbake_import.py"


def imported(monkeypatch: pytest.MonkeyPatch, unreal: Any, *arguments: object) -> list[str]:
    """What the log of the engine has after a `py` command."""
    unreal.said.clear()
    monkeypatch.setitem(sys.modules, "unreal", unreal)
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *map(str, arguments)])
    runpy.run_path(str(SCRIPT), run_name="__main__")
    return list(unreal.said)


def test_unreal_gets_textures_and_a_material(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unreal = stand_in()
    said = imported(monkeypatch, unreal, baked(every_map(tmp_path / "wood"), tmp_path / "out", "unreal"), "/Game/Made/")
    assert said == ["mipbake: made /Game/Made/M_wood"]
    textures = {path.rsplit("_", 1)[1]: unreal.assets[path] for path in unreal.assets if "/T_" in path}
    assert set(textures) == {"BC", "N", "ORM", "E", "H"}
    for name, texture in textures.items():
        found = {key: getattr(value, "name", value) for key, value in texture.properties.items()}
        assert found == {
            "mip_gen_settings": "TMGS_LEAVE_EXISTING_MIPS",
            "composite_texture": None,
            "composite_texture_mode": "CTM_DISABLED",
            "flip_green_channel": False,
            "lod_bias": 0,
            "compression_settings": "TC_NORMALMAP" if name == "N" else "TC_BC7",
            "srgb": name in ("BC", "E"),
            "address_x": "TA_WRAP",
            "address_y": "TA_WRAP",
        }
        assert texture.saved
    material = unreal.assets["/Game/Made/M_wood"]
    feeds = {}
    for target, (node, channel) in material.feeds.items():
        texture = next(name for name, each in textures.items() if each is node.properties["texture"])
        sampler = node.properties["sampler_type"].name.removeprefix("SAMPLERTYPE_")
        feeds[target] = (node.properties["parameter_name"], texture, channel, sampler)
    assert feeds == {
        "MP_BASE_COLOR": ("BaseColor", "BC", "RGB", "COLOR"),
        "MP_OPACITY": ("BaseColor", "BC", "A", "COLOR"),
        "MP_NORMAL": ("Normal", "N", "RGB", "NORMAL"),
        "MP_AMBIENT_OCCLUSION": ("ORM", "ORM", "R", "LINEAR_COLOR"),
        "MP_ROUGHNESS": ("ORM", "ORM", "G", "LINEAR_COLOR"),
        "MP_METALLIC": ("ORM", "ORM", "B", "LINEAR_COLOR"),
        "MP_EMISSIVE_COLOR": ("Emissive", "E", "RGB", "COLOR"),
    }
    assert material.properties == {"blend_mode": unreal.BlendMode.BLEND_TRANSLUCENT}
    assert material.saved and material.compiled


def test_unreal_keeps_a_material_that_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unreal = stand_in()
    stack = baked(every_map(tmp_path / "wood"), tmp_path / "out", "unreal")
    imported(monkeypatch, unreal, stack)
    material = unreal.assets["/Game/mipbake/M_wood"]
    before = dict(unreal.assets)
    material.feeds.clear()
    unreal.assets["/Game/mipbake/T_wood_ORM"].properties["srgb"] = True
    said = imported(monkeypatch, unreal, stack)
    assert said == ["mipbake: updated the textures of /Game/mipbake/M_wood, the material itself is as it was"]
    assert unreal.assets == before and not material.feeds
    assert unreal.assets["/Game/mipbake/T_wood_ORM"].properties["srgb"] is False


def test_unreal_gets_tested_opacity_half_floats_and_tiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unreal = stand_in()
    leaf = packed_sets.orm(tmp_path / "leaf", wood_base_color=np.dstack([COLOUR, OPACITY]))
    options = ["--method", "linear", "--alpha-cutoff", "0.25", "--wrap-u", "clamp"]
    imported(monkeypatch, unreal, baked(leaf, tmp_path / "out", "unreal", *options))
    material = unreal.assets["/Game/mipbake/M_leaf"]
    assert material.properties == {"blend_mode": unreal.BlendMode.BLEND_MASKED, "opacity_mask_clip_value": 0.25}
    assert material.feeds["MP_OPACITY_MASK"][1] == "A" and "MP_OPACITY" not in material.feeds
    base = unreal.assets["/Game/mipbake/T_leaf_BC"].properties
    assert (base["address_x"].name, base["address_y"].name) == ("TA_CLAMP", "TA_WRAP")

    bright = packed_sets.orm(tmp_path / "bright")
    write_image(bright / "wood_emissive.exr", np.full((16, 16, 3), 4, np.float32))
    imported(monkeypatch, unreal, baked(bright, tmp_path / "out", "unreal"))
    node, _ = unreal.assets["/Game/mipbake/M_bright"].feeds["MP_EMISSIVE_COLOR"]
    texture = node.properties["texture"].properties
    assert (texture["compression_settings"].name, texture["srgb"]) == ("TC_HDR", False)
    assert node.properties["sampler_type"].name == "SAMPLERTYPE_LINEAR_COLOR"

    tiled = packed_sets.tiles(tmp_path / "wall")
    said = imported(monkeypatch, unreal, baked(tiled, tmp_path / "out", "unreal"))
    assert said == ["mipbake: made /Game/mipbake/M_wall_1001", "mipbake: made /Game/mipbake/M_wall_1002"]


def test_unreal_says_what_it_cannot_import_and_makes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, out = every_map(tmp_path / "wood"), tmp_path / "out"
    torn = shutil.copytree(baked(source, out, "unreal"), tmp_path / "torn")
    (torn / "T_wood_N.dds").unlink()
    unreadable = tmp_path / "unreadable"
    unreadable.mkdir()
    (unreadable / "stack.json").write_text('{"outputs": 3}')
    again = "bake the set again with mipbake bake SET --preset unreal"
    blocks = baked(source, tmp_path / "blocks", "unreal", "--method", "linear", "--format", "dds")
    cases = {
        (baked(source, tmp_path / "unity", "unity"),): f"stack.json is not of files for Unreal Engine: {again}.",
        (blocks,): f"stack.json is not of files for Unreal Engine: {again}.",
        (torn,): "T_wood_N.dds is missing: copy the whole folder that mipbake wrote.",
        (unreadable,): f"stack.json cannot be read as the description of a stack: {again}.",
        (tmp_path,): "holds no stack.json: name the folder that mipbake wrote, such as OUT/SET.",
        (out / "wood", "Made"): "Made is no content folder: expected one such as /Game/Materials.",
        (): 'type py "mipbake_import.py" "OUT/SET" and, if you like, a folder such as /Game/Materials.',
    }
    unreal = stand_in()
    for arguments, sentence in cases.items():
        (said,) = imported(monkeypatch, unreal, *arguments)
        assert said.startswith("error: mipbake: ") and said.endswith(sentence)
    assert not unreal.assets


def test_manifests_tell_where_each_map_is(tmp_path: Path) -> None:
    """Importers go by `map_files`, so every name in it is a file."""
    for preset in ("godot", "unity", "unreal"):
        stack = baked(every_map(tmp_path / preset / "wood"), tmp_path / preset / "out", preset)
        (output,) = json.loads((stack / "stack.json").read_text())["outputs"]
        maps = {"base_color", "normal", "roughness", "metallic", "occlusion", "emissive", "height", "opacity"}
        assert set(output["map_files"]) == maps
        assert {path.name for path in stack.iterdir()} == {"stack.json", *output["map_files"].values()}


def test_materials_beside_a_stack_are_in_nobodys_way(tmp_path: Path) -> None:
    """What importers make of a stack lies beside its folder, and stays when the set is baked again."""
    for preset, made in {"godot": ["wood.tres"], "unity": ["wood.mat", "wood.mat.meta", "wood.meta"]}.items():
        out = tmp_path / preset / "out"
        source = every_map(tmp_path / preset / "wood")
        baked(source, out, preset)
        for name in made:
            (out / name).write_text("a material")
        other = packed_sets.orm(tmp_path / preset / "plank")
        assert run("bake", source, other, "-o", out, "--preset", preset, "--method", "linear")[0] == 0
        assert {path.name for path in out.iterdir()} == {"wood", "plank", *made}
