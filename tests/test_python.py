"""What users of Python type: paths in place of texture sets and stacks, presets, the maps of a stack by name."""

from __future__ import annotations

import copy
import pickle
import pydoc
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mipbake

from .command_line import write_set
from .report_cases import made_up
from .source_tree import ROOT

SET = ROOT / "examples" / "glazed_tiles"


@pytest.fixture(scope="module")
def stack() -> mipbake.MipStack:
    return mipbake.bake(SET, "linear", preset="unreal")


def test_a_stack_is_written_for_the_preset_that_it_was_baked_with(stack: mipbake.MipStack, tmp_path: Path) -> None:
    names = sorted(path.name for path in stack.save(tmp_path / "baked"))
    assert names == sorted(["stack.json", *(f"T_glazed_tiles_{map}.dds" for map in ("BC", "H", "N", "ORM"))])
    opened = mipbake.open_stack(tmp_path / "baked")
    assert opened.provenance.preset == "unreal"
    assert sorted(path.name for path in opened.save(tmp_path / "again")) == names
    assert (tmp_path / "unity" / "glazed_tiles_MaskMap.dds") in stack.save(tmp_path / "unity", preset="unity")
    assert (tmp_path / "exr" / "T_glazed_tiles_N.exr") in stack.save(tmp_path / "exr", "exr")


def test_a_stack_has_levels_and_maps_by_name(stack: mipbake.MipStack) -> None:
    assert len(stack) == 9 and len(list(stack)) == 9
    assert [level.shape for level in stack.normal[:2]] == [(256, 256, 3), (128, 128, 3)]
    assert np.array_equal(stack[2]["roughness"], stack.roughness[2])
    assert np.array_equal(stack[-1]["base_color"], stack.levels[-1][..., :3])
    assert list(stack[0]) == ["base_color", "metallic", "roughness", "normal", "occlusion", "height"]
    assert {"base_color", "occlusion", "levels", "save"} <= {*dir(stack)}
    with pytest.raises(AttributeError, match="map 'diffuse': its maps are base_color, metallic, roughness, normal"):
        stack.diffuse  # noqa: B018
    with pytest.raises(IndexError, match="level 9 of a stack of 9"):
        stack[9]
    for same in (copy.copy(stack), copy.deepcopy(stack), pickle.loads(pickle.dumps(stack))):
        assert np.array_equal(same.normal[3], stack.normal[3])


def test_a_map_of_fewer_levels_gives_its_last_one(stack: mipbake.MipStack) -> None:
    made = mipbake.TextureSet.from_arrays(
        "small", normal=np.full((8, 8, 3), (0, 0, 1.0)), roughness=0.5, occlusion=np.full((2, 2), 0.25)
    )
    baked = mipbake.bake(made, "linear")
    assert [baked[level]["occlusion"].shape for level in range(4)] == [(2, 2, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1)]


def test_a_stack_says_its_verdict(stack: mipbake.MipStack) -> None:
    assert stack.verdict is None
    normal = np.random.default_rng(1).normal((0, 0, 2), 0.3, (16, 16, 3))
    assert str(mipbake.bake(mipbake.TextureSet.from_arrays("rough", normal=normal, roughness=0.5)).verdict)


def test_a_bake_takes_the_adjustments_of_the_command() -> None:
    source = mipbake.load(SET)
    changed = mipbake.bake(source, "lean", strength=0.0, keep_level0=True, min_roughness=0.2)
    assert np.array_equal(changed.base_color[1], mipbake.bake(source, "linear", pixel_filter="box").base_color[1])
    assert len(changed.provenance.adjustments) == 3 and changed.roughness[3].min() >= np.float32(0.2)
    with pytest.raises(mipbake.UsageError, match="model ggx cannot be adjusted"):
        mipbake.bake(source, "linear", "ggx", strength=0.5)


def test_paths_stand_for_sets_and_stacks(stack: mipbake.MipStack, tmp_path: Path) -> None:
    stack.save(tmp_path / "baked")
    given = mipbake.validate(str(SET), tmp_path / "baked", lods=[1], points=8, samples=8, baselines=())
    same = mipbake.validate(mipbake.load(SET), stack, lods=[1], points=8, samples=8, baselines=())
    assert given.snr("baked", "near-mirror", 1) == pytest.approx(same.snr("baked", "near-mirror", 1), abs=0.5)
    assert mipbake.convert(SET, "ggx").model == "ggx"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"preset": "unreel"}, "unknown preset 'unreel'.*three, babylon"),
        ({"method": "liner"}, "unknown method 'liner'.*auto, neural"),
        ({"sampler": "cubic"}, "'cubic'.*trilinear, anisotropic, accumulated"),
        ({"target": "disney"}, "unknown target 'disney'.*auto, gltf"),
        ({"pixel_filter": "lanczos"}, "'lanczos'.*gaussian, box"),
        ({"strenght": 0.5}, "unknown option 'strenght'.*strength.*preset"),
        ({"strength": "half"}, "strength is 'half': expected a number from 0 to 1"),
        ({"min_roughness": None}, "min_roughness is None: expected a number"),
        ({"keep_level0": "no"}, "keep_level0 is 'no': expected True or False"),
    ],
)
def test_errors_name_the_choices(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(mipbake.UsageError, match=said):
        mipbake.bake(SET, **wrong)


@pytest.mark.parametrize("wrong", [{"normal": np.zeros((4, 4, 3))}, np.zeros((4, 4, 3)), None, 3])
def test_what_is_no_source_is_told(wrong: object) -> None:
    with pytest.raises(mipbake.UsageError, match=r"the source is a \w+: expected a path.*TextureSet.from_arrays"):
        mipbake.bake(wrong)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"format": ["exr"]}, r"the format is \['exr'\]: expected names"),
        ({"format": 5}, "the format is 5: expected names"),
        ({"levels": 0}, "0 levels were asked for: expected 1 or more"),
    ],
)
def test_what_cannot_be_saved_is_told(stack, tmp_path, wrong, said):
    with pytest.raises(mipbake.UsageError, match=said):
        stack.save(tmp_path / "out", **wrong)
    assert not (tmp_path / "out").exists()


def test_a_stack_for_an_engine_of_a_later_version_is_saved(stack: mipbake.MipStack, tmp_path: Path) -> None:
    made = replace(stack, provenance=replace(stack.provenance, preset="cryengine"))
    assert made.save(tmp_path / "out", "exr")[1].suffix == ".exr"
    with pytest.raises(mipbake.UsageError, match="unknown preset 'cryengine'"):
        made.save(tmp_path / "other", preset="cryengine")


def test_a_target_beside_the_preset_of_a_bake_is_written(tmp_path: Path) -> None:
    """As the command does."""
    made = mipbake.bake(SET, "linear", preset="unreal", target="gltf-anisotropic")
    assert made.save(tmp_path / "out")
    with pytest.raises(mipbake.UsageError, match="the preset unreal takes stacks of gltf"):
        made.save(tmp_path / "other", preset="unreal")


def test_a_map_is_no_level(stack: mipbake.MipStack) -> None:
    with pytest.raises(TypeError, match=r"'roughness' is no number of a level.*stack\.roughness"):
        stack["roughness"]
    with pytest.raises(mipbake.UsageError, match="the stack is of type int: expected a MipStack"):
        mipbake.validate(SET, 5)


def test_a_comparison_is_checked_before_any_work() -> None:
    with pytest.raises(mipbake.InputError, match="does not exist"):
        mipbake.compare("nowhere")
    with pytest.raises(mipbake.InputError, match="no such folder"):
        mipbake.compare(SET, stack="nowhere")
    with pytest.raises(mipbake.UsageError, match=r"unknown method 'nerual': did you mean neural"):
        mipbake.compare(SET, methods="linear, nerual")
    with pytest.raises(mipbake.UsageError, match=r"unknown lighting 'stuido': did you mean studio"):
        mipbake.compare(SET, lighting="stuido")
    with pytest.raises(mipbake.InputError, match=r"nowhere\.obj"):
        mipbake.compare(SET, mesh="nowhere.obj")
    with pytest.raises(mipbake.UsageError, match=r"unknown option 'film'.*films"):
        mipbake.compare(SET, film=False)


def test_a_comparison_is_saved_as_its_report(tmp_path: Path) -> None:
    names = [path.name for path in made_up().save(tmp_path / "report")]
    assert names[:2] == ["index.html", "results.json"]


def test_a_script_bakes_a_library_without_a_guard(tmp_path: Path) -> None:
    """The processes of a batch do not run the script that began them."""
    write_set(tmp_path / "textures" / "wood")
    script = tmp_path / "script.py"
    script.write_text("import mipbake\nprint(mipbake.bake_library('textures', 'baked', method='linear'))\n")
    told = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert told.stdout == "Summary(baked=1, documents=0, planned=0, unchanged=0, failures=[])\n"


def test_help_begins_with_what_to_type() -> None:
    first = pydoc.plain(pydoc.render_doc(mipbake)).split("PACKAGE CONTENTS")[0]
    assert 'mipbake.bake("textures/wood", preset="unreal")' in first


def test_the_package_runs_as_a_module() -> None:
    told = subprocess.run([sys.executable, "-m", "mipbake", "presets"], capture_output=True, text=True, check=True)
    assert "unreal" in told.stdout
