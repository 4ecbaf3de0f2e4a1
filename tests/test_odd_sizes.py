"""Files of blocks of 4 x 4 texels, and sides that are no multiples of 4."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from .input_files import pixels_for, plain_set
from .test_presets import run


@pytest.mark.parametrize(
    ("format", "height", "texels", "told"),
    [
        ("dds", 6, {"rgba8"}, "warning: dds: files of 8 x 6 texels are not compressed"),
        ("ktx2", 6, {"rgba8"}, "warning: ktx2: files of 8 x 6 texels are not compressed"),
        ("dds:bc", 6, {"bc"}, "warning: dds:bc: files of 8 x 6 texels are made of blocks"),
        ("ktx2:uastc", 6, {"uastc"}, "resize the maps, or use --format ktx2:rgba8"),
        ("dds:rgba8", 6, {"rgba8"}, ""),
        ("dds:bc", 8, {"bc"}, ""),
    ],
)
def test_sides_that_are_no_whole_blocks(format: str, height: int, texels: set[str], told: str, tmp_path: Path) -> None:
    roles = {"base_color": "base_color", "normal_gl": "normal", "roughness": "roughness", "height": "height"}
    plain_set(tmp_path / "wood", **{stem: pixels_for(role, 8)[:height] for stem, role in roles.items()})
    code, said = run("bake", tmp_path / "wood", "-o", tmp_path / "out", "--method", "linear", "--format", format)
    assert code == 0, said
    (output,) = json.loads((tmp_path / "out" / "wood" / "stack.json").read_text())["outputs"]
    assert {each["texels"] for each in output["maps"].values()} == texels
    assert told in said and ("multiples of 4" in said) == bool(told)
