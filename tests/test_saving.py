"""What Python says and writes in one call: short representations, formats and presets as the command line has them."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.source.gltf.document import read_document
from mipbake.stack.output import Output
from mipbake.stack.presets import PRESETS, wanted_outputs

from .command_line import tree, write_set
from .gltf_files import check_structure, png, split
from .gltf_results import two_textures
from .input_files import write_image
from .quick_methods import quick_methods
from .test_presets import run


def texture_set(size: int = 16, **maps: object) -> mipbake.TextureSet:
    rng = np.random.default_rng(size)
    normal = np.concatenate([rng.uniform(-0.3, 0.3, (size, size, 2)), np.ones((size, size, 1))], -1)
    given = {"normal": normal, "roughness": rng.random((size, size)), **maps}
    return mipbake.TextureSet.from_arrays("wood", **given)  # type: ignore[arg-type]


@pytest.mark.long
def test_everything_shows_itself_in_one_short_line(tmp_path: Path) -> None:
    """Before, an object printed every pixel of its maps."""
    loaded = texture_set(height=np.zeros((16, 16)))
    stack = mipbake.bake(loaded, "linear")
    measured = mipbake.validate(loaded, stack, lods=(0, 1), points=16, samples=4, baselines=())
    document = read_document(two_textures(png("normal"), png("mr")).write(tmp_path / "a"))
    assert repr(loaded) == "TextureSet('wood', 16 x 16: base_color, normal, roughness, metallic, height)"
    assert repr(loaded.maps["normal"]) == "TextureMap(normal, 16 x 16 x 3, given as an array)"
    assert repr(stack) == "MipStack('wood', gltf, 16 x 16, 5 levels, by linear, height beside)"
    assert repr(mipbake.convert(loaded, "ggx")) == "Material('wood', ggx, 16 x 16, height beside)"
    near = measured.snr("baked", "near-mirror", 0)
    assert repr(measured).startswith(
        f"Validation('wood', linear, gltf, at lod 0: near-mirror {near:.1f} dB, hemisphere"
    )
    promise = quick_methods()["auto"](
        loaded.material("gltf"), "gltf", "gltf", "gaussian", loaded.wrap, lambda _: None
    ).measured
    assert promise is not None
    for each in (stack.files(Output())[0], document, promise):
        assert len(repr(each)) < 400 and "array" not in repr(each)


@pytest.mark.long
@pytest.mark.parametrize("preset", PRESETS)
def test_a_stack_is_saved_for_an_engine_in_one_call(tmp_path: Path, preset: str) -> None:
    """The files are the same as from the command line, but for texels that only the source could choose."""
    folder = write_set(tmp_path / "wood")
    code, said = run(
        "bake", folder, "-o", tmp_path / "out", "--preset", preset, "--method", "linear", "--target", "gltf"
    )
    assert code == 0, said
    stack = mipbake.bake(mipbake.load(folder), "linear")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        files = stack.save(tmp_path / "saved", preset=preset)
    assert sorted(file.name for file in files) == tree(tmp_path / "out" / "wood") == tree(tmp_path / "saved")


def test_a_preset_takes_another_format(tmp_path: Path) -> None:
    files = mipbake.bake(texture_set(), "linear").save(tmp_path / "a", "png", preset="unreal")
    assert "T_wood_ORM_mip00.png" in {file.name for file in files}


def test_a_glb_is_a_format_as_any_other(tmp_path: Path) -> None:
    made = texture_set(opacity=np.tile([[0.0, 1.0]], (16, 8)))
    files = mipbake.bake(made, "linear").save(tmp_path / "a", format="glb,png")
    assert {"wood.glb", "roughness_mip00.png"} <= {file.name for file in files}
    document, _ = check_structure((tmp_path / "a" / "wood.glb").read_bytes())
    assert document["materials"][0]["alphaMode"] == "BLEND"
    assert mipbake.open_stack(tmp_path / "a").size == (16, 16)


def test_a_glb_knows_what_opacity_is_tested_against(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "wood")
    alpha = np.tile(np.uint8([[0, 255]]), (16, 8))
    write_image(folder / "wood_opacity.png", alpha)
    stack = mipbake.bake(mipbake.load(folder, alpha_cutoff=0.3), "linear")
    stack.save(tmp_path / "a", "glb,exr")
    (material,) = split((tmp_path / "a" / "wood.glb").read_bytes())[0]["materials"]
    assert (material["alphaMode"], material["alphaCutoff"]) == ("MASK", 0.3)
    assert mipbake.open_stack(tmp_path / "a").provenance.alpha_cutoff == 0.3


def test_what_an_engine_does_not_take_is_said(tmp_path: Path) -> None:
    stack = mipbake.bake(texture_set(12), "linear")
    with pytest.warns(UserWarning, match="Unreal Engine needs sides that are powers of two, this set is 12 x 12"):
        stack.save(tmp_path / "a", preset="unreal")
    with pytest.raises(mipbake.UsageError, match="unknown preset 'quake'"):
        stack.save(tmp_path / "b", preset="quake")
    with pytest.raises(mipbake.UsageError, match="takes stacks of gltf, and 'wood' is of ggx"):
        mipbake.bake(texture_set(), "linear", "ggx").save(tmp_path / "b", preset="unreal")
    with pytest.raises(mipbake.UsageError, match="one of the two"):
        stack.save(tmp_path / "b", [Output()], preset="arnold")
    with pytest.raises(mipbake.UsageError, match="unknown format 'jpg'"):
        stack.save(tmp_path / "b", format="jpg")
    assert not (tmp_path / "b").exists()


def test_formats_are_called_format_everywhere() -> None:
    assert wanted_outputs(format="exr,glb") == ((Output(),), True, ())
    assert wanted_outputs(PRESETS["unity"]) == (PRESETS["unity"].outputs, False, ())
