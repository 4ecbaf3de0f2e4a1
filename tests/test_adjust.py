"""Adjustments of a stack: level 0 as it was, less of an effect, a floor for the roughness."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.baking.adjust import Adjustments, adjusted
from mipbake.base.errors import UsageError
from mipbake.source.images.read import read_image
from mipbake.source.texture_set import TextureSet
from mipbake.stack.output import Output
from mipbake.stack.packing import Normals
from mipbake.stack.stack import MipStack

from .input_files import bytes_of, height_field, write_image
from .stacks import read_output, smooth, unit

NORMAL, ROUGHNESS, DIRECTION, STRENGTH = slice(5, 8), slice(4, 5), slice(8, 10), slice(10, 11)
SHAPES = [(16, 16), (13, 6), (1, 9)]


def made_set(shape: tuple[int, int] = (16, 16), anisotropic: bool = False, **others: object) -> TextureSet:
    """Bumpy, of medium roughness."""
    maps = dict(others)
    if anisotropic:
        direction = unit(smooth(shape, 2, 7) - 0.5)
        maps["anisotropy"] = np.concatenate([direction, smooth(shape, 1, 8)], -1)
    return TextureSet.from_arrays(
        "wood",
        normal=height_field(*shape, steepness=0.8),
        roughness=smooth(shape, 1, 1) * 0.6,
        base_color=smooth(shape, 3, 2),
        metallic=smooth(shape, 1, 3),
        **maps,
    )


def baked(texture_set: TextureSet, method: str = "vmf") -> MipStack:
    return mipbake.bake(texture_set, method)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("anisotropic", [False, True])
def test_keep_level0(shape, anisotropic) -> None:
    texture_set = made_set(shape, anisotropic)
    stack = baked(texture_set)
    source = texture_set.material(stack.model)
    assert np.abs(stack.levels[0] - source).max() > 1e-3  # the pixel filter has changed it
    found = adjusted(stack, texture_set, Adjustments(keep_level0=True))
    if anisotropic:
        source[..., 8:11] = texture_set.maps["anisotropy"].pixels  # as it was drawn, signs and all
    np.testing.assert_array_equal(found.levels[0], source)
    for level, before in zip(found.levels[1:], stack.levels[1:], strict=True):
        if anisotropic:  # the signs of directions follow the level that was kept
            turned = np.sum(level[..., DIRECTION] * before[..., DIRECTION], -1, keepdims=True) < 0
            level[..., DIRECTION] *= np.where(turned, -1, 1)
        np.testing.assert_array_equal(level, before)


def noisy_vectors(top: int, seed: int = 5) -> np.ndarray:
    """(12, 20, 3) normals as compression leaves them: of any length, as integers up to `top`."""
    noise = np.random.default_rng(seed).normal(0, 0.1, (12, 20, 3))
    return bytes_of((height_field(12, 20) * (1 + noise) + 1) / 2, top)


def written(folder: Path, top: int, suffix: str = "png", depth: str | None = None) -> dict[str, np.ndarray]:
    """A set with normals, and directions, that are not unit; file stem to texels."""
    colours, grey = (bytes_of(smooth((12, 20), count, count), top) for count in (3, 1))
    orm, packed = np.dstack([grey, grey // 2, grey]), np.dstack([noisy_vectors(top), grey])
    files = {"wood_base_color": colours, "wood_normal_dx": packed, "wood_orm": orm, "wood_anisotropy": 1 * colours}
    folder.mkdir()
    for stem, pixels in files.items():
        write_image(folder / f"{stem}.{suffix}", pixels / top if depth else pixels, depth)
    return files


@pytest.mark.parametrize(
    ("output", "top", "suffix", "depth"),
    [
        ("png:8", 255, "png", None),
        ("png:16", 65535, "png", None),
        ("tx:8", 255, "png", None),
        ("tx:16", 65535, "png", None),
        ("exr:half", 255, "exr", "half"),
    ],
)
def test_level_0_is_that_of_the_files(tmp_path, output, top, suffix, depth) -> None:
    """Bit for bit, vectors that are not unit and channels without a role too, where depth and packing are the same."""
    written(tmp_path / "wood", top, suffix, depth)
    texture_set = mipbake.load(tmp_path / "wood", normal_convention="directx")
    stack = adjusted(baked(texture_set), texture_set, Adjustments(keep_level0=True))
    stack.save(tmp_path / "out", output)
    files = read_output(tmp_path / "out", 0)
    assert {file.layout.name for file in files} == {path.stem for path in (tmp_path / "wood").iterdir()}
    for file in files:
        name, container = file.layout.name, file.container
        source = read_image(tmp_path / "wood" / f"{name}.{suffix}").pixels
        found = container.read(tmp_path / "out", file.layout, [level.shape[:2] for level in file.levels])[0]
        np.testing.assert_array_equal(found, source, name)


def test_normals_that_were_changed_are_unit(tmp_path) -> None:
    """Scaled, resampled, or with z to be worked out by a shader."""
    written(tmp_path / "wood", 255)
    texture_set = mipbake.load(tmp_path / "wood", normal_convention="directx")
    stack = adjusted(baked(texture_set), texture_set, Adjustments(keep_level0=True))
    assert np.abs(np.linalg.norm(stack.levels[0][..., NORMAL], axis=-1) - 1).max() > 0.1
    (file,) = [f for f in stack.files(Output("png", "separate", Normals("opengl", 2))) if f.layout.name == "normal"]
    np.testing.assert_allclose(file.levels[0], texture_set.maps["normal"].pixels[..., :2], atol=1e-6)
    for changed in (
        mipbake.load(tmp_path / "wood", normal_convention="directx", factors={"normal": 0.5}),
        replace(texture_set, maps={**texture_set.maps, "normal": made_set((12, 20)).maps["normal"]}),
    ):
        kept = adjusted(baked(changed), changed, Adjustments(keep_level0=True)).levels[0][..., NORMAL]
        np.testing.assert_array_equal(kept, changed.maps["normal"].pixels)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("method", ["vmf", "lean"])
def test_strength_0_is_plain_averages(shape, method) -> None:
    """`linear` with the box, whose level 0 is the source."""
    texture_set = made_set(shape)
    stack = baked(texture_set, method)
    plain = mipbake.bake(texture_set, "linear", stack.model, "box")
    found = adjusted(stack, texture_set, Adjustments(strength=0))
    for level, wanted in zip(found.levels, plain.levels, strict=True):
        np.testing.assert_allclose(level, wanted, atol=1e-6)
    np.testing.assert_allclose(found.levels[0], texture_set.material(stack.model), atol=1e-6)


@pytest.mark.parametrize("anisotropic", [False, True])
@pytest.mark.parametrize("strength", [0.25, 0.5, 0.9])
def test_what_lies_between_is_a_mixture(anisotropic, strength) -> None:
    texture_set = made_set(anisotropic=anisotropic)
    stack = baked(texture_set)
    none = adjusted(stack, texture_set, Adjustments(strength=0))
    found = adjusted(stack, texture_set, Adjustments(strength=strength))
    for level, plain, full in zip(found.levels, none.levels, stack.levels, strict=True):
        mixed = (1 - strength) * plain + strength * full
        others = [i for i in range(level.shape[-1]) if i not in (5, 6, 7, 8, 9)]
        np.testing.assert_allclose(level[..., others], mixed[..., others], atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(level[..., NORMAL], axis=-1), 1, atol=1e-5)
        # Between the two, along the arc: as near to each as they are to each other.
        between = (plain[..., NORMAL] * full[..., NORMAL]).sum(-1)
        for end in (plain, full):
            assert ((level[..., NORMAL] * end[..., NORMAL]).sum(-1) >= between - 1e-5).all()
        if anisotropic:
            np.testing.assert_allclose(np.linalg.norm(level[..., DIRECTION], axis=-1), 1, atol=1e-5)


@pytest.mark.parametrize("floor", [0.4, 0.55, 1.0])
@pytest.mark.parametrize("others", [{}, {"keep_level0": True}, {"strength": 0.0}])
def test_min_roughness(floor, others) -> None:
    texture_set = made_set()
    stack = baked(texture_set)
    before = adjusted(stack, texture_set, Adjustments(**others))
    found = adjusted(stack, texture_set, Adjustments(min_roughness=floor, **others))
    assert min(level[..., ROUGHNESS].min() for level in before.levels) < floor
    for level, lower in zip(found.levels, before.levels, strict=True):
        np.testing.assert_array_equal(level[..., ROUGHNESS], np.maximum(lower[..., ROUGHNESS], np.float32(floor)))
        np.testing.assert_array_equal(np.delete(level, 4, -1), np.delete(lower, 4, -1))


def test_colours_that_opacity_hides_stay_hidden_at_every_strength() -> None:
    """Only a level 0 that is kept from the source shows them, since the user asked for it."""
    opacity = np.ones((16, 16), np.float32)
    opacity[:, 5:11] = 0
    colour = np.where(opacity[..., None] > 0, [0, 0.5, 0.2], [1, 0, 0]).astype(np.float32)
    texture_set = TextureSet.from_arrays(
        "leaf", normal=height_field(16, 16), roughness=0.4, base_color=colour, opacity=opacity
    )
    stack = baked(texture_set)
    for strength in (0.0, 0.5, 0.9):
        for keep in (False, True):
            found = adjusted(stack, texture_set, Adjustments(keep, strength))
            assert max(level[..., 0].max() for level in found.levels[1:]) < 1e-6
            assert (found.levels[0][..., 0].max() == 1) == keep


@pytest.mark.parametrize("given", [{"strength": 1.1}, {"strength": -0.1}, {"min_roughness": 2}])
def test_what_is_out_of_range(given) -> None:
    ((name, value),) = given.items()
    with pytest.raises(UsageError, match=rf"{name} is {value}: expected a number from 0 to 1"):
        Adjustments(**given)
    with pytest.raises(UsageError, match="expected a number"):
        Adjustments(**{name: float("nan")})


def test_other_models_cannot_be_adjusted() -> None:
    texture_set = made_set()
    stack = mipbake.bake(texture_set, "lean", "ggx")
    with pytest.raises(UsageError, match="model ggx cannot be adjusted: expected gltf or gltf-anisotropic"):
        adjusted(stack, texture_set, Adjustments(keep_level0=True))


def test_the_provenance_says_what_was_done(tmp_path) -> None:
    texture_set = made_set()
    stack = baked(texture_set)
    found = adjusted(stack, texture_set, Adjustments(True, 0.5, 0.1))
    first, second, third = found.provenance.adjustments
    assert "strength 0.5" in first and "level 0" in second and "0.1" in third
    assert replace(found.provenance, adjustments=()) == stack.provenance and found.extra == stack.extra
    found.save(tmp_path / "s")
    assert mipbake.open_stack(tmp_path / "s").provenance == found.provenance
