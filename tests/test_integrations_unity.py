"""integrations/unity, compiled and run with a stand-in for Unity's classes; skipped where Mono is missing."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from . import packed_sets
from .packed_sets import COLOUR, OPACITY, baked, every_map

SCRIPT = Path(__file__).parents[1] / "integrations" / "unity" / "Editor" / "MipbakePostprocessor.cs"
STAND_IN = Path(__file__).parent / "unity" / "UnityStandIn.cs"
STANDARD, UNIVERSAL, HIGH_DEFINITION = "Standard", "Universal Render Pipeline/Lit", "HDRP/Lit"

pytestmark = pytest.mark.independent


@pytest.fixture(scope="module")
def editor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program that imports a folder of assets as the script tells it."""
    if not (shutil.which("mcs") and shutil.which("mono")):
        pytest.skip("Mono is not installed (Debian's mono-mcs)")
    program = tmp_path_factory.mktemp("unity") / "editor.exe"
    command = ["mcs", "-langversion:7", "-warnaserror", f"-out:{program}", STAND_IN, SCRIPT]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stdout + compiled.stderr
    return program


def imported(editor: Path, assets: Path, *arguments: str) -> list[str]:
    """Lines of what is imported from `assets`, a folder of that name."""
    command = ["mono", editor, *arguments]
    done = subprocess.run(command, cwd=assets.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def assets_of(source: Path, *options: str, preset: str = "unity") -> Path:
    """The folder Assets beside the set, with the stack in it."""
    return baked(source, source.parent / "Assets", preset, *options).parent


TEXTURES = [
    f"texture Assets/wood/wood_{name}.dds Trilinear Repeat Repeat {srgb} 1 Assets/wood/stack.json"
    for name, srgb in {"BaseMap": True, "Emission": True, "Height": False, "MaskMap": False, "Normal": False}.items()
]
MATERIALS = {
    STANDARD: "_BumpMap=Normal _EmissionColor=white _EmissionMap=Emission _GlossMapScale=1 _MainTex=BaseMap "
    "_MetallicGlossMap=MaskMap _OcclusionMap=MaskMap _OcclusionStrength=1 _SmoothnessTextureChannel=0 "
    "| _EMISSION _METALLICGLOSSMAP _NORMALMAP _OCCLUSIONMAP | BakedEmissive 0",
    UNIVERSAL: "_BaseMap=BaseMap _BumpMap=Normal _EmissionColor=white _EmissionMap=Emission _MainTex=BaseMap "
    "_MetallicGlossMap=MaskMap _OcclusionMap=MaskMap _OcclusionStrength=1 _Smoothness=1 _SmoothnessTextureChannel=0 "
    "| _EMISSION _METALLICSPECGLOSSMAP _NORMALMAP _OCCLUSIONMAP | BakedEmissive 0",
    HIGH_DEFINITION: "_AORemapMax=1 _AORemapMin=0 _BaseColorMap=BaseMap _EmissiveColor=white "
    "_EmissiveColorMap=Emission _EnableGeometricSpecularAA=0 _MainTex=BaseMap _MaskMap=MaskMap _MetallicRemapMax=1 "
    "_MetallicRemapMin=0 _NormalMap=Normal _Smoothness=1 _SmoothnessRemapMax=1 _SmoothnessRemapMin=0 "
    "| _EMISSIVE_COLOR_MAP _MASKMAP _NORMALMAP _NORMALMAP_TANGENT_SPACE | BakedEmissive 0",
}


@pytest.mark.parametrize("shader", MATERIALS)
def test_textures_and_materials_of_each_pipeline(editor: Path, tmp_path: Path, shader: str) -> None:
    said = imported(editor, assets_of(every_map(tmp_path / "wood")), shader)
    material = f"material Assets/wood.mat {shader} {MATERIALS[shader]}"
    assert said[:5] == TEXTURES and said[5] == "log mipbake: made Assets/wood.mat"
    assert said[6].replace("=wood_", "=").replace(".dds", "") == material and len(said) == 7


def test_a_material_that_is_there_keeps_what_the_user_set(editor: Path, tmp_path: Path) -> None:
    said = imported(editor, assets_of(every_map(tmp_path / "wood")), UNIVERSAL, "twice")
    assert [line for line in said if line.startswith("log")] == [
        "log mipbake: made Assets/wood.mat",
        "log mipbake: updated Assets/wood.mat",
    ]
    assert " _OcclusionStrength=0.5 " in said[-1] and "_BaseMap=wood_BaseMap.dds" in said[-1]


def test_sampler_wrap_and_tested_opacity(editor: Path, tmp_path: Path) -> None:
    leaf = packed_sets.orm(tmp_path / "leaf", wood_base_color=np.dstack([COLOUR, OPACITY]))
    options = ["--method", "neural", "--sampler", "anisotropic 4x", "--alpha-cutoff", "0.25", "--wrap-u", "clamp"]
    said = imported(editor, assets_of(leaf, *options), UNIVERSAL)
    assert said[0] == "texture Assets/leaf/leaf_BaseMap.dds Trilinear Clamp Repeat True 4 Assets/leaf/stack.json"
    assert " _AlphaClip=1 " in said[-1] and " _Cutoff=0.25 " in said[-1] and "_ALPHATEST_ON" in said[-1]
    assert said[-1].endswith("EmissiveIsBlack 2450")


def test_tiles_have_a_material_each(editor: Path, tmp_path: Path) -> None:
    said = imported(editor, assets_of(packed_sets.tiles(tmp_path / "wall")), STANDARD)
    assert [line for line in said if line.startswith("log")] == [
        "log mipbake: made Assets/wall.1001.mat",
        "log mipbake: made Assets/wall.1002.mat",
    ]
    textures = [line.split() for line in said if line.startswith("texture")]
    assert {words[1].split(".")[1] + words[-1] for words in textures} == {
        "1001Assets/wall/stack.1001.json",
        "1002Assets/wall/stack.1002.json",
    }


def test_what_cannot_be_used_gets_a_sentence_and_no_material(editor: Path, tmp_path: Path) -> None:
    assets = assets_of(every_map(tmp_path / "wood"))
    assets_of(packed_sets.orm(tmp_path / "plank"), preset="godot")
    (assets / "wood" / "wood_Normal.dds").unlink()
    (assets / "stack.json").write_text("not JSON")
    (assets / "stacked_boxes.json").write_text('{"schema": "of others"}')
    said = imported(editor, assets, HIGH_DEFINITION)
    assert [line for line in said if line.startswith(("log", "error", "material"))] == [
        "error mipbake: Assets/plank/stack.json is not of files for Unity: "
        "bake the set again with mipbake bake SET --preset unity.",
        "error mipbake: Assets/wood/wood_Normal.dds was not imported: copy the whole folder that mipbake wrote, "
        "right-click its stack.json and choose Reimport.",
    ]
    plank = [line for line in said if line.startswith("texture Assets/plank")]
    assert len(plank) == 3 and all("Bilinear Repeat Repeat True 1" in line for line in plank)


def test_files_that_lie_in_assets_itself(editor: Path, tmp_path: Path) -> None:
    (tmp_path / "project").mkdir()
    assets = shutil.copytree(assets_of(every_map(tmp_path / "wood")) / "wood", tmp_path / "project" / "Assets")
    said = imported(editor, assets, UNIVERSAL)
    assert "log mipbake: made Assets/material.mat" in said


def test_settings_under_other_names_are_said(editor: Path, tmp_path: Path) -> None:
    said = imported(editor, assets_of(every_map(tmp_path / "wood")), UNIVERSAL, "hide")
    warning = "warning mipbake: set sRGB of Assets/wood/wood_MaskMap.dds in the inspector, on for colours alone."
    assert warning in said and "log mipbake: made Assets/wood.mat" in said
