"""Values that a glTF material's factors stretch: what is stored, what is shown, and what stands in the document."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.cli.main import main
from mipbake.source.images import ktx2 as ktx2_file
from mipbake.source.texture_set import TextureSet
from mipbake.stack.compression import cost
from mipbake.stack.gltf.glb import encoded, output
from mipbake.stack.gltf.ranges import LEAST_SCALE, Ranges, ranges_of
from mipbake.stack.gltf.write import GltfResult, rewritten
from mipbake.stack.map_files import MapFile
from mipbake.stack.stack import MipStack

from .command_line import bumps, fails, write_set
from .gltf_files import GltfFile, check_structure, image_of, ktx2, png
from .gltf_results import opened
from .input_files import height_field

STRETCHED = Ranges(0.125, 0.5)


def mirror(side: int = 64, steepness: float = 0.01) -> tuple[TextureSet, MipStack]:
    """Nearly a mirror, with slopes of a few codes of 8 bits."""
    normal = height_field(side, side, steepness=steepness)
    texture_set = TextureSet.from_arrays("mirror", normal=normal, roughness=0.2, base_color=0.7, metallic=1.0)
    return texture_set, mipbake.bake(texture_set, "linear")


def of(stack: MipStack, name: str) -> MapFile:
    return next(file for file in stack.files(output()) if file.layout.name == name)


def test_stored_normals_are_unit_and_steeper_and_come_back_by_the_formula_of_gltf() -> None:
    normal = of(mirror(steepness=0.3)[1], "normal")
    stored = STRETCHED.stored(normal)
    for before, after in zip(normal.levels, stored.levels, strict=True):
        assert np.linalg.norm(after, axis=-1) == pytest.approx(1, abs=1e-6)
        shown = after * [STRETCHED.normal, STRETCHED.normal, 1]  # its section 3.9.3: multiplied, then normalised
        unit = shown / np.linalg.norm(shown, axis=-1, keepdims=True)
        assert unit == pytest.approx(before, abs=1e-6)
    for level, wanted in zip(STRETCHED.shown(stored).levels, stored.levels, strict=True):
        assert level == pytest.approx(wanted * [0.125, 0.125, 1], abs=1e-7)


def test_roughness_is_stretched_and_its_neighbours_stay() -> None:
    orm = of(mirror()[1], "orm")
    stored = STRETCHED.stored(orm)
    for before, after in zip(orm.levels, stored.levels, strict=True):
        assert after[..., 1] == pytest.approx(2 * before[..., 1])
        assert np.array_equal(after[..., [0, 2]], before[..., [0, 2]])
    assert STRETCHED.shown(stored).levels[0] == pytest.approx(orm.levels[0])


@pytest.mark.parametrize("steepness", [0.0, 0.005, 0.1, 3.0])
def test_scales_hold_as_many_slopes_as_they_should(steepness: float) -> None:
    _, stack = mirror(steepness=steepness)
    scale = ranges_of(stack.levels, "gltf").normal
    assert LEAST_SCALE <= scale <= 1
    slopes = np.concatenate([(np.abs(n[..., 5:7]) / n[..., 7:]).ravel() for n in stack.levels[:2]])
    if LEAST_SCALE < scale < 1:
        assert np.mean(slopes <= scale) == pytest.approx(0.97, abs=0.01)


def test_the_roughest_texel_of_any_level_is_stored_as_1() -> None:
    levels = [np.zeros((2, 2, 8), np.float32), np.zeros((1, 1, 8), np.float32)]
    levels[1][..., 4] = 0.3
    assert 0.3 <= ranges_of(levels, "gltf").roughness < 0.30001
    assert ranges_of(levels[:1], "gltf").roughness > 0


def test_what_is_decoded_is_near_what_was_baked() -> None:
    """Slopes of 1/100: eight bits as they are hold two codes of them."""
    texture_set, stack = mirror(32)
    usual = ranges_of(stack.levels, "gltf")
    made = {each: encoded(stack, ranges=each) for each in (Ranges(), usual)}
    plain, stretched = (cost(texture_set, stack, output(), m.files, ranges=m.ranges) for m in made.values())
    assert stretched.worst < plain.worst - 1.2
    assert stretched.psnr["normal"] > plain.psnr["normal"] + 4


def test_materials_that_had_no_normal_texture_get_one_with_its_scale(tmp_path: Path) -> None:
    made = GltfFile()
    made.texture(made.image(png("mr"), "mr"))
    made.material("M", pbrMetallicRoughness={"metallicRoughnessTexture": {"index": 0}, "roughnessFactor": 0.25})
    document, bakes = opened(made, tmp_path)
    maps = {"normalTexture": ktx2(1), "metallicRoughnessTexture": ktx2(2)}
    material = check_structure(rewritten(document, [GltfResult(bakes[0], maps, STRETCHED)], {}))[0]["materials"][0]
    assert material["normalTexture"]["scale"] == 0.125
    assert material["pbrMetallicRoughness"]["roughnessFactor"] == 0.5


def test_sides_that_ktx2_textures_do_not_have_are_refused() -> None:
    stack = mipbake.bake(TextureSet.from_arrays("odd", normal=height_field(8, 6), roughness=0.5), "linear")
    with pytest.raises(mipbake.UsageError, match="of odd is 6 x 8 texels: KHR_texture_basisu takes multiples of 4"):
        encoded(stack)


@pytest.mark.long
@pytest.mark.parametrize(("asked", "texels"), [("glb", "UASTC_RGB_UNORM_BLOCK"), ("glb:rgba8", "R8G8B8A8_UNORM")])
def test_a_mirror_in_a_glb(tmp_path: Path, capsys: pytest.CaptureFixture[str], asked: str, texels: str) -> None:
    maps = {**bumps(64, 64), "roughness": np.full((64, 64), 90, np.uint8)}
    options = f"--format {asked} --method linear --json".split()
    assert main(["bake", str(write_set(tmp_path / "mirror", **maps)), "-o", str(tmp_path / "out"), *options]) == 0
    (result,) = json.loads(capsys.readouterr().out)["results"]
    (cost,) = result["costs"]
    assert cost["format"] == asked
    assert cost["texels"]["normal"] == texels
    assert max(cost["loss"].values()) <= (1.0 if asked == "glb" else 0.3)
    document, binary = check_structure((tmp_path / "out" / "mirror" / "mirror.glb").read_bytes())
    material = document["materials"][0]
    assert 0 < material["normalTexture"].get("scale", 1) <= 1
    assert material["pbrMetallicRoughness"]["roughnessFactor"] == pytest.approx(90 / 255, abs=1e-5)
    made = ktx2_file.decoded(image_of(document, binary, material["normalTexture"]["index"]), "it")
    assert (made.format.name, len(made.levels)) == (texels, 7)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("glb:rgba16f", "unknown format 'glb:rgba16f': did you mean glb:rgba8? Formats: glb:uastc, glb:rgba8"),
        ("glb,glb:rgba8", "format glb is asked for twice"),
    ],
)
def test_texels_that_a_glb_does_not_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], asked: str, said: str
) -> None:
    folder = write_set(tmp_path / "mirror")
    assert said in fails(capsys, 2, "bake", folder, "-o", tmp_path / "out", "--format", asked)
    assert not (tmp_path / "out").exists()
