"""`mipbake bake --format glb`: ranges in the document, and texels of 8 bits where they are asked for."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.cli.main import main
from mipbake.source.images import ktx2

from .command_line import bumps, fails, write_set
from .gltf_files import check_structure, image_of

MIRROR = {**bumps(64, 64), "roughness": np.full((64, 64), 90, np.uint8)}


def bake(*arguments: object) -> tuple[int, Any]:
    said = io.StringIO()
    with redirect_stdout(said):
        code = main([*(str(a) for a in ("bake", *arguments)), "--method", "linear", "--json"])
    return code, json.loads(said.getvalue())


@pytest.mark.long
@pytest.mark.parametrize(("asked", "texels"), [("glb", "UASTC_RGB_UNORM_BLOCK"), ("glb:rgba8", "R8G8B8A8_UNORM")])
def test_a_mirror_in_a_glb(tmp_path: Path, asked: str, texels: str) -> None:
    folder = write_set(tmp_path / "mirror", **MIRROR)
    code, report = bake(folder, "-o", tmp_path / "out", "--format", asked)
    assert code == 0
    (cost,) = report["results"][0]["costs"]
    assert cost["format"] == asked
    assert cost["texels"]["normal"] == texels
    assert (max(cost["loss"].values()) <= 0.3) == (asked != "glb")
    assert ("--format glb:rgba8" in str(report["results"][0]["warnings"])) == (asked == "glb")
    document, binary = check_structure((tmp_path / "out" / "mirror" / "mirror.glb").read_bytes())
    material = document["materials"][0]
    assert 0 < material["normalTexture"].get("scale", 1) <= 1
    assert material["pbrMetallicRoughness"]["roughnessFactor"] == pytest.approx(90 / 255, abs=1e-5)
    made = ktx2.decoded(image_of(document, binary, material["normalTexture"]["index"]), "it")
    assert (made.format.name, len(made.levels)) == (texels, 7)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("glb:rgba16f", "unknown texels of format glb: 'rgba16f': expected one of uastc, rgba8"),
        ("glb,glb:rgba8", "format glb is asked for twice"),
    ],
)
def test_texels_that_a_glb_does_not_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], asked: str, said: str
) -> None:
    folder = write_set(tmp_path / "mirror")
    assert said in fails(capsys, 2, "bake", folder, "-o", tmp_path / "out", "--format", asked)
    assert not (tmp_path / "out").exists()
