"""`mipbake validate` measures what the textures of a GLB really hold, material by material."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.cli.main import main
from mipbake.source.intake import jobs
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet
from mipbake.stack.gltf.glb import multiple_of_side
from mipbake.stack.gltf.glb_stacks import stack_in_glb

from .command_line import fails, write_set
from .gltf_files import GltfFile, many_materials, png
from .gltf_results import two_textures
from .test_presets import run

NAMES = "Two sets", "Brushed"
"""Materials of the document that is baked."""

pytestmark = pytest.mark.usefixtures("quick_validation")


def held_by(source: Path, glb: Path, scratch: Path) -> dict[str, tuple[TextureSet, mipbake.MipStack]]:
    """What a GLB holds of every set of a source."""
    scratch.mkdir()
    found = {}
    for job in jobs([str(source)], LoadOptions(), scratch):
        (read,) = job.read(multiple_of_side)
        texture_set = read.texture_set
        found[texture_set.name] = texture_set, stack_in_glb(glb, job, texture_set)
    return found


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`many.glb`, and `out/many.glb`, which it was baked to."""
    folder = tmp_path_factory.mktemp("many")
    source = many_materials(NAMES).write(folder / "many")
    code, said = run("bake", source, "-o", folder / "out", "--method", "lean")
    assert code == 0, said
    return folder


def test_textures_are_read_as_they_were_baked(many: Path) -> None:
    """Every channel of the coarse levels of every material equals the stack's, to within what UASTC loses of noise."""
    found = held_by(many / "many.glb", many / "out" / "many.glb", many / "scratch")
    assert set(found) == {"Two_sets", "Brushed"}
    for name, (texture_set, held) in found.items():
        baked = mipbake.bake(texture_set, "lean")
        assert (held.model, held.size, len(held.levels)) == (baked.model, baked.size, len(baked.levels))
        assert (held.provenance.method, held.provenance.source_hash) == ("lean", baked.provenance.source_hash)
        for level, wanted in list(zip(held.levels, baked.levels, strict=True))[-3:]:
            difference = np.abs(level - wanted)[..., :8].mean((0, 1))
            assert (difference < 0.2).all(), (name, level.shape, difference)


def test_every_material_is_measured_and_other_files_are_refused(many, tmp_path, capsys):
    source, glb = many / "many.glb", many / "out" / "many.glb"
    capsys.readouterr()
    assert main(["validate", str(source), str(glb), "--json"]) == 0
    measured = json.loads(capsys.readouterr().out)["results"]
    assert [(each["name"], each["method"]) for each in measured] == [("Two_sets", "lean"), ("Brushed", "lean")]
    for each in measured:
        assert "source hashes" not in str(each["notes"])
        assert {row["method"] for row in each["rows"]} >= {"baked", "linear (box)"}
    other = GltfFile()
    other.texture(other.image(png("normal a"), "n"))
    other.material("Other", normalTexture={"index": 0})
    bare = other.write(tmp_path / "other")
    assert "was not made by mipbake" in fails(capsys, 3, "validate", bare, bare)
    assert "holds nothing that was baked for Other" in fails(capsys, 3, "validate", bare, glb)
    assert "was baked from a glTF file" in fails(capsys, 3, "validate", write_set(tmp_path / "wood"), glb)


@pytest.mark.long
def test_damage_to_a_texture_is_measured(tmp_path: Path) -> None:
    """What counts is the textures, not what the file says of itself: here the textures of another document."""
    figures = []
    for shown in ("normal a", "normal other"):
        folder = tmp_path / shown
        folder.mkdir()
        source = two_textures(png(shown), png("mr")).write(folder / "bolt")
        assert run("bake", source, "-o", folder / "out", "--method", "linear")[0] == 0
        code, said = run("validate", tmp_path / "normal a" / "bolt.glb", folder / "out" / "bolt.glb", "--json")
        assert code == 0
        rows = json.loads(said)["results"][0]["rows"]
        figures.append(next(r["snr"] for r in rows if (r["method"], r["lod"]) == ("baked", 0.0)))
    assert figures[1] < figures[0] - 3


def test_the_square_of_a_folder_is_read(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "wood")
    assert run("bake", folder, "-o", tmp_path / "out", "--format", "glb", "--method", "linear")[0] == 0
    ((_, held),) = held_by(folder, tmp_path / "out" / "wood" / "wood.glb", tmp_path / "scratch").values()
    baked = mipbake.bake(mipbake.load(folder), "linear")
    assert np.abs(held.levels[-1] - baked.levels[-1]).max() < 0.05
