"""Normals that no surface has: counted, filled from around them, and no specks in what is baked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake import shading
from mipbake.baking.adjust import Adjustments, adjusted
from mipbake.baking.methods import METHODS
from mipbake.base.errors import InputError
from mipbake.cli.main import main
from mipbake.material import MIN_NORMAL_Z
from mipbake.quality.metrics.pairs import pair_set
from mipbake.source.normal import held
from mipbake.source.texture_set import TextureSet

from .input_files import height_field, write_image
from .quick_methods import NONE, quick_methods

BROKEN = {(3, 5): (0.8, 0.1, -0.6), (3, 6): (0, 0, -1.0), (10, 11): (1, 0, 1e-3), (15, 0): (0, 0, 0), (9, 2): (0, 1, 0)}
SLOPE = 0.05


def normals(broken: bool = True, size: int = 16) -> np.ndarray:
    """Normals of a surface that is nearly flat, with texels that no surface has."""
    made = height_field(size, size, steepness=SLOPE)
    for place, vector in BROKEN.items() if broken else ():
        made[place] = vector
    return made


def load(folder: Path, made: np.ndarray, **options: object) -> TextureSet:
    folder.mkdir()
    write_image(folder / "metal_normal.png", np.rint((made + 1) / 2 * 65535).astype(np.uint16))
    for name, value in (("base_color", (200, 180, 160)), ("roughness", (80,)), ("metallic", (255,))):
        write_image(folder / f"metal_{name}.png", np.full((16, 16, len(value)), value, np.uint8))
    return mipbake.load(folder, normal_convention="opengl", **options)


def test_broken_normals_take_the_mean_of_those_around() -> None:
    made = normals()
    length = np.linalg.norm(made, axis=-1).astype(np.float32)
    unit = (made / np.maximum(length, 1e-3)[..., None]).astype(np.float32)
    found, count = held(unit, length)
    assert count == len(BROKEN)
    kept = np.ones(unit.shape[:2], bool)
    kept[tuple(np.array(list(BROKEN)).T)] = False
    np.testing.assert_array_equal(found[kept], unit[kept])
    assert np.linalg.norm(found, axis=-1) == pytest.approx(np.ones((16, 16)), abs=1e-6)
    around = unit[9:12, 10:13].reshape(9, 3)[[0, 1, 2, 3, 5, 6, 7, 8]].mean(0)
    assert found[10, 11] == pytest.approx(around / np.linalg.norm(around), abs=1e-6)


def test_holes_are_filled_from_their_rims_inwards() -> None:
    made = np.full((12, 12, 3), (0, 0.6, 0.8), np.float32)
    made[2:9, 3:11] = (0.6, 0, -0.8)
    found, count = held(made)
    assert count == 56 and found == pytest.approx(np.broadcast_to(made[:1, :1], found.shape), abs=1e-6)
    flat, count = held(np.full((2, 3, 3), (1, 0, 0), np.float32))
    assert count == 6 and (flat == (0, 0, 1)).all()
    whole = normals(False).astype(np.float32)
    assert held(whole)[0] is whole


def test_the_range_ends_where_it_says() -> None:
    def at(z: float) -> np.ndarray:
        return np.array([[[np.sqrt(1 - z * z), 0, z], [0, 0, 1]]], np.float32)

    assert held(at(MIN_NORMAL_Z * 1.001))[1] == 0 and held(at(MIN_NORMAL_Z * 0.999))[1] == 1


def test_they_are_counted_for_the_user(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    texture_set = load(tmp_path / "metal", normals())
    (warning,) = texture_set.warnings
    assert warning.startswith(f"metal_normal.png: {len(BROKEN)} of 256 normals along the surface, into it or without")
    assert main(["bake", str(tmp_path / "metal"), "-o", str(tmp_path / "out"), "--method", "linear"]) == 0
    assert warning in capsys.readouterr().out
    assert load(tmp_path / "fine", normals(False)).warnings == ()


def test_arrays_too() -> None:
    steep = normals(False)
    steep[4, 4] = (1, 0, 1e-3)
    texture_set = TextureSet.from_arrays("metal", normal=steep, roughness=0.3)
    assert "1 of 256 normals" in texture_set.warnings[0]
    assert texture_set.maps["normal"].pixels[..., 2].min() > 0.9
    with pytest.raises(InputError, match="points into the surface"):
        TextureSet.from_arrays("metal", normal=normals(), roughness=0.3)


def test_a_level_0_that_is_kept_is_that_of_the_file_elsewhere(tmp_path: Path) -> None:
    made = normals()
    made[:8] *= 0.9  # not unit: to be seen whether it is kept
    texture_set = load(tmp_path / "metal", made)
    stack = adjusted(mipbake.bake(texture_set, "linear"), texture_set, Adjustments(keep_level0=True))
    kept, wanted = stack.levels[0][..., 5:8], np.rint((made + 1) / 2 * 65535) / 65535 * 2 - 1
    for place in BROKEN:
        wanted[place] = texture_set.maps["normal"].pixels[place]
    assert kept == pytest.approx(wanted, abs=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("target", ["gltf", "gltf-anisotropic", "ggx"])
@pytest.mark.parametrize("method", METHODS)
def test_no_texel_of_any_level_is_darker_than_those_around(method: str, target: str, tmp_path: Path) -> None:
    """Five broken texels of a glossy surface, of every method: no speck at any level."""

    def levels(texture_set: TextureSet) -> list[np.ndarray]:
        model = texture_set.source_model
        bake = quick_methods(NONE)[method]
        return bake(texture_set.material(model), model, target, "gaussian", texture_set.wrap, lambda _: None).levels

    broken, whole = (load(tmp_path / str(each), normals(each)) for each in (True, False))
    pairs = pair_set("near-mirror", 1, 64)
    for level, other in zip(levels(broken), levels(whole), strict=True):
        seen, wanted = (
            shading.shade(target, each.reshape(-1, each.shape[-1]), pairs.light, pairs.view).mean((0, 2))
            for each in (level, other)
        )
        # A speck is nearly black. Blends of both sets differ by chance: 0.78 was seen.
        assert (seen > 0.7 * wanted.min()).all() and (seen < 1.25 * wanted.max()).all(), level.shape
