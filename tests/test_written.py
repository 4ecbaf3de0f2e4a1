"""What is written is measured as it is read back, between levels too: levels that do not fit together are told."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.baking.methods import METHODS, PrefilterResult
from mipbake.baking.results import DEFECT
from mipbake.baking.rules.linear import Linear
from mipbake.cli.main import main
from mipbake.source.gltf.document import read_document
from mipbake.source.texture_set import TextureSet
from mipbake.stack.compression import cost
from mipbake.stack.gltf.glb import multiple_of_side
from mipbake.stack.output import Output
from mipbake.stack.stack import MipStack
from mipbake.stack.written import WORST_DIP, measure_written

from .command_line import write_png, write_set
from .input_files import height_field
from .stacks import read_output, smooth


def steel() -> tuple[TextureSet, MipStack]:
    """Brushed both ways, in patches."""
    v, u = np.mgrid[:16, :16]
    angle = np.where((u // 8 + v // 8) % 2, 1.55, 0.05) + 0.1 * smooth((16, 16), 1, 4)[..., 0]
    texture_set = TextureSet.from_arrays(
        "steel",
        normal=height_field(16, 16, steepness=0.05),
        roughness=0.3,
        base_color=0.6,
        metallic=1.0,
        anisotropy=np.stack([np.cos(angle), np.sin(angle), np.full_like(angle, 0.8)], -1),
    )
    return texture_set, mipbake.bake(texture_set, "vmf")


def planted(stack: MipStack, *levels: int) -> MipStack:
    """A stack whose directions have the other sign at some levels: each level alone looks as it should."""
    changed = [level.copy() for level in stack.levels]
    for index in levels:
        changed[index][..., 8:10] *= -1
    return replace(stack, levels=changed)


def test_a_good_stack_has_no_dip() -> None:
    texture_set, stack = steel()
    found = measure_written(texture_set, stack, stack.levels)
    assert found.dips == () and found.lods == tuple(index / 2 for index in range(9))
    assert all(np.isfinite(row).all() and len(row) == 9 for row in found.snr.values())
    levels = measure_written(texture_set, stack, planted(stack, *range(5)).levels)  # all of them: d and -d are one
    assert levels == found


@pytest.mark.parametrize("fmt", ["exr", "ktx2:bc"])
def test_planted_signs_are_found_in_what_is_read_back(tmp_path: Path, fmt: str) -> None:
    texture_set, stack = steel()
    wrong = planted(stack, 1)
    wrong.save(tmp_path / "s", [Output(fmt)])
    found = cost(texture_set, stack, Output(fmt), read_output(tmp_path / "s", 0))
    assert {dip.lod for dip in found.written.dips} == {0.5, 1.5}
    for dip in found.written.dips:
        assert min(dip.at_levels) - dip.snr > WORST_DIP
    assert "lod 0.5" in found.defect or "lod 1.5" in found.defect
    assert "levels of" in found.defect and "defect of mipbake" in found.defect and "\n" not in found.defect


def anisotropic_set(folder: Path) -> Path:
    pixels = np.full((16, 16, 3), (192, 238, 220), np.uint8)
    flat, metal = np.full((16, 16, 3), (128, 128, 255), np.uint8), np.full((16, 16), 255, np.uint8)
    write_set(folder, normal=flat, metallic=metal, roughness=metal // 3)
    write_png(folder / "anisotropy.png", pixels)
    return folder


class Turned(Linear):
    """A method with a defect: directions of level 0 have the other sign."""

    def __call__(self, *arguments: Any) -> PrefilterResult:
        result = super().__call__(*arguments)
        result.levels[0][..., 8:10] *= -1
        return result


@pytest.mark.long
def test_a_bake_that_is_wrong_between_levels_says_so(tmp_path, capsys, monkeypatch) -> None:
    """The files are there to be looked at; the exit code, the JSON and stack.json tell."""
    folder, out = anisotropic_set(tmp_path / "metal"), tmp_path / "out"
    arguments = ["bake", str(folder), "-o", str(out), "--method", "linear", "--format", "exr,png"]
    assert main(arguments) == 0
    assert "defect" not in capsys.readouterr().err
    good = json.loads((out / "metal" / "stack.json").read_text())["outputs"]
    assert [each["measured"]["dips"] for each in good] == [[], []]
    assert good[0]["measured"]["lods"][:3] == [0.0, 0.5, 1.0]
    monkeypatch.setitem(METHODS, "linear", Turned())
    assert main([*arguments, "--json"]) == DEFECT
    told = capsys.readouterr()
    assert told.err.count("\n") == 2 and "levels of exr:half do not fit together" in told.err
    assert "out/metal: " in told.err and "levels of png:8" in told.err
    (result,) = json.loads(told.out)["results"]
    assert not result["ok"] and result["exit_code"] == DEFECT and "between them" in result["error"]
    assert result["costs"][0]["written"]["dips"][0]["lod"] == 0.5
    made = json.loads((out / "metal" / "stack.json").read_text())["outputs"]
    assert {dip["lod"] for dip in made[0]["measured"]["dips"]} == {0.5}
    assert mipbake.open_stack(out / "metal").size == (16, 16)


@pytest.mark.long
def test_python_measures_what_the_command_line_measures(tmp_path: Path, capsys) -> None:
    """In stack.json, and in the GLB itself: a GLB is measured as the files of maps are."""
    folder = anisotropic_set(tmp_path / "metal")
    asked = ["--method", "linear", "--format", "png,glb", "--max-level", "2", "--json"]
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), *asked]) == 0
    (result,) = json.loads(capsys.readouterr().out)["results"]
    texture_set = multiple_of_side(mipbake.load(folder))
    stack = mipbake.bake(texture_set, "linear")
    check = mipbake.Check(texture_set, stack)
    stack.save(tmp_path / "python", "png,glb", levels=3, measured=check)
    told, found = (json.loads((tmp_path / at / "stack.json").read_text())["outputs"] for at in ("out/metal", "python"))
    assert [each["format"] for each in found] == ["png", "glb"]
    assert found[0] == told[0]
    for outputs, glb in ((told, tmp_path / "out" / "metal" / "metal.glb"), (found, tmp_path / "python" / "metal.glb")):
        about = read_document(glb).json["asset"]["extras"]["mipbake"]
        assert about["measured"] == outputs[1]["measured"]
        assert about["measured"]["lods"] == [0.0, 0.5, 1.0, 1.5, 2.0]
        assert set(about["measured"]["snr"]) == {"near-mirror", "hemisphere"}
        assert main(["info", str(glb)]) == 0
        assert re.search(r"SNR at lod 0 near-mirror [\d.]+ dB, hemisphere [\d.]+ dB", capsys.readouterr().out)
    assert [cost.format for cost in check.costs] == [cost["format"] for cost in result["costs"]] == ["png:8", "glb"]
    assert check.defects == []
