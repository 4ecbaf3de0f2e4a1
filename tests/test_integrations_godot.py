"""integrations/godot in Godot 4.6: what its materials are, and that every level of their textures is the file's."""

from __future__ import annotations

import base64
import io
import json
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

from mipbake.base.srgb import srgb_to_linear

from . import packed_sets
from .godot_project import HERE, played
from .gpu_textures import openimageio_levels
from .packed_sets import AO, COLOUR, METAL, NORMALS, OPACITY, ROUGH, SIZE, baked, encoded, waves

ADDON = Path(__file__).parents[1] / "integrations" / "godot" / "addons" / "mipbake"
LINEAR, ANISOTROPIC = 3, 5  # BaseMaterial3D.TextureFilter
EDITOR = {"extends EditorPlugin": 'extends "res://editor.gd"', "EditorInterface": "self", '"res://"': '"user://stacks"'}
"""What plugin.gd takes from the editor and from the project's folder, and what stands in for it here."""
ALPHA, SCISSOR = 1, 2  # BaseMaterial3D.Transparency

pytestmark = [pytest.mark.independent, pytest.mark.long]


def stacks(folder: Path) -> Path:
    """A folder of stacks: what users bake, and what they take for it."""
    sources, out = folder / "sources", folder / "stacks"
    colours = np.dstack([waves(3), waves(6), waves(9)])
    whole = {"wood_base_color": np.dstack([COLOUR, OPACITY]), "wood_emissive": colours}
    baked(packed_sets.orm(sources / "wood", **whole), out, "godot")
    see_through = {"leaf_base_color": np.dstack([COLOUR, OPACITY]), "leaf_normal_gl": encoded(NORMALS)}
    leaf = packed_sets.write(
        sources / "leaf", leaf_roughness=ROUGH, wood_base_color=None, wood_normal_gl=None, **see_through
    )
    clamped = ["--wrap-u", "clamp", "--wrap-v", "clamp"]
    baked(leaf, out, "godot", "--method", "neural", "--sampler", "anisotropic", "--alpha-cutoff", "0.5", *clamped)
    baked(packed_sets.tiles(sources / "wall", wall_metallic=METAL), out, "godot")
    baked(packed_sets.orm(sources / "plank"), out, "unity")
    odd = {"odd_normal_gl": encoded(NORMALS[:12, :12]), "odd_roughness": AO[:12, :12]}
    baked(packed_sets.write(sources / "odd", wood_base_color=None, wood_normal_gl=None, **odd), out, "godot")
    shutil.copytree(out / "wood", out / "torn")
    (out / "torn" / "wood_orm.dds").unlink()
    (out / "other").mkdir()
    (out / "other" / "stack.json").write_text("[1, 2]")
    return out


class Made(NamedTuple):
    """What the addon made of each manifest in a folder, and what a shader reads of the textures of "wood"."""

    folder: Path
    results: dict[str, Any]
    texels: dict[str, np.ndarray]
    lines: list[str]


@pytest.fixture(scope="module")
def made(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Made:
    out = stacks(tmp_path_factory.mktemp("godot"))
    files = {f"stacks/{path.relative_to(out).as_posix()}": path.read_bytes() for path in out.rglob("*.*")}
    addon = {f"addons/mipbake/{path.name}": path.read_bytes() for path in ADDON.iterdir()}
    plugin = addon["addons/mipbake/plugin.gd"].decode()
    for editor, stand_in in EDITOR.items():
        assert plugin.count(editor) == 1
        plugin = plugin.replace(editor, stand_in)
    addon["addons/mipbake/plugin.gd"] = plugin.encode()
    addon["editor.gd"] = (HERE / "editor.gd").read_bytes()
    lines = played(browser, (HERE / "main.gd").read_text(), {**files, **addon})
    found = [line.removeprefix("out FOUND ") for line in lines if line.startswith("out FOUND ")]
    levels = [line.split()[2:] for line in lines if line.startswith("out LEVELS ")]
    assert found and levels, "\n".join(lines)
    texels = {name: np.frombuffer(base64.b64decode(text), np.uint8).reshape(-1, SIZE, 4) for name, text in levels}
    return Made(out, json.loads(found[0]), texels, lines)


def test_each_stack_has_a_material_beside_its_folder(made: Made) -> None:
    places = {manifest: result["place"] for manifest, result in made.results.items() if "place" in result}
    assert places == {
        "wood/stack.json": "wood.tres",
        "leaf/stack.json": "leaf.tres",
        "wall/stack.1001.json": "wall.1001.tres",
        "wall/stack.1002.json": "wall.1002.tres",
    }


def test_a_shader_reads_every_level_as_it_is_in_the_file(made: Made) -> None:
    for name, channels in {"albedo": 4, "normal": 2, "orm": 3, "emission": 3}.items():
        levels = openimageio_levels(made.folder / "wood" / f"wood_{name}.dds", 4)
        assert len(levels) * SIZE == len(made.texels[name])
        for index, level in enumerate(levels):
            height, width = level.shape[:2]
            seen = made.texels[name][index * SIZE :][:height, :width]
            error = np.abs(seen[..., :channels].astype(int) - level[..., :channels])
            assert error.max() <= 1, (name, index)  # decoders of BC5 round differently


def test_materials_follow_the_manifest(made: Made) -> None:
    wood, leaf, wall = (made.results[f"{name}.json"] for name in ("wood/stack", "leaf/stack", "wall/stack.1001"))
    assert wood["features"] == [True, True, True] and leaf["features"] == wall["features"] == [True, False, False]
    assert [each["repeat"] for each in (wood, leaf)] == [True, False]
    assert [each["filter"] for each in (wood, leaf)] == [LINEAR, ANISOTROPIC]
    assert [each["transparency"] for each in (wood, leaf, wall)] == [ALPHA, SCISSOR, 0]
    assert leaf["cutoff"] == 0.5
    assert wood["textures"] == [f"wood_{name}.dds" for name in ("albedo", "normal", "orm", "emission")]
    assert leaf["textures"] == ["leaf_albedo.dds", "leaf_normal.dds", "leaf_orm.dds", ""]
    assert all(each["lambert"] for each in (wood, leaf, wall))


def test_an_update_keeps_what_the_user_set(made: Made) -> None:
    """Between two calls main.gd changes the tiling, and takes the texture of the albedo away."""
    wood = made.results["wood/stack.json"]
    assert wood["tiling"] == 3 and wood["textures"][0] == "wood_albedo.dds"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("plank", "is not of files for Godot: bake the set again with mipbake bake SET --preset godot."),
        ("odd", "has a side of 12, and Godot needs powers of two: resize the maps of the set and bake it again."),
        ("torn", "wood_orm.dds cannot be loaded: bake the set again with mipbake bake SET --preset godot."),
        ("other", "does not describe a stack of mipbake: bake the set again with mipbake bake SET --preset godot."),
    ],
)
def test_what_cannot_be_used_gets_a_sentence_and_no_material(made: Made, name: str, said: str) -> None:
    result = made.results[f"{name}/stack.json"]
    assert result["problem"].startswith("user://stacks/") and result["problem"].endswith(said)
    assert not result["material there"]


def test_the_entries_of_the_menu(made: Made) -> None:
    """One makes all materials, complains of what it cannot use, and names the other, which switches the limiter off."""
    places = sorted(f"user://stacks/{result['place']}" for result in made.results.values() if "place" in result)
    (told,) = [line.removeprefix("out PLUGIN ") for line in made.lines if line.startswith("out PLUGIN ")]
    updated, limiter = json.loads(told)
    assert sorted(updated) == places
    assert limiter is False
    said = "\n".join(made.lines)
    assert all(f"out mipbake: made {place}" in said for place in places)
    for result in made.results.values():
        assert f"mipbake: {result.get('problem', 'made')}" in said
    assert "the roughness limiter is on, so bumps count twice: choose Project > Tools > mipbake: Switch the" in said
    assert "out ENTRIES 0" in said


def test_a_floor_is_closer_to_the_supersampled_one(browser: Any, tmp_path: Path) -> None:
    """By 3 dB at least with levels of the method `neural` than with averages, in linear radiance."""
    leather = ADDON.parents[3] / "examples" / "lacquered_leather"
    files = {f"addons/mipbake/{path.name}": path.read_bytes() for path in ADDON.iterdir()}
    for method in ("linear", "neural"):
        baked(leather, tmp_path / method, "godot", "--method", method)
        folder = tmp_path / method / leather.name
        files |= {f"{method}/{path.name}": path.read_bytes() for path in folder.iterdir()}
    lines = played(browser, (HERE / "floor.gd").read_text(), files)
    seen = {}
    for name, png in (line.split()[2:] for line in lines if line.startswith("out SEEN ")):
        with Image.open(io.BytesIO(base64.b64decode(png))) as picture:
            seen[name] = srgb_to_linear(np.asarray(picture.convert("RGB")) / 255)
    assert len(seen) == 3, "\n".join(lines)
    height, width = seen["linear"].shape[:2]
    reference = seen["reference"].reshape(height, 8, width, 8, 3).mean((1, 3))
    assert reference.max() > 2 * reference.mean() > 0.05  # the sun is seen in the floor
    errors = {name: np.square(seen[name] - reference).mean() for name in ("linear", "neural")}
    assert 10 * np.log10(errors["linear"] / errors["neural"]) > 3, errors


def test_scripts_follow_the_style_of_the_engine() -> None:
    linter = pytest.importorskip("gdtoolkit.linter", reason="gdtoolkit is not installed (pip install gdtoolkit)")
    scripts = sorted([*ADDON.glob("*.gd"), *HERE.glob("*.gd")])
    assert len(scripts) == 5
    for script in scripts:
        problems = linter.lint_code(script.read_text(encoding="utf-8"))
        assert not problems, f"{script.name}: {problems[0].line}: {problems[0].description}"
