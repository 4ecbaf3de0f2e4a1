"""Packing: sources go out as they came in, engines get what they expect, and nothing is lost on the way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mipbake
from mipbake.base.errors import UsageError
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.layout import LAYOUTS, extra_layout, to_file
from mipbake.stack.output import Output
from mipbake.stack.packing import PACKINGS, Normals, PackedFile, Piece, pack, unpacked

from . import packed_sets
from .gpu_textures import openimageio_levels
from .input_files import encoded
from .packed_sets import AO, METAL, NORMALS, OTHER, ROUGH, box_levels, grey
from .stacks import gltf_level, smooth

SETS = [packed_sets.orm, packed_sets.mask_map, packed_sets.glossy_directx, packed_sets.two_channels]


PNG = Output("png")


def out(folder, output=PNG, method="linear"):
    """Stem to the 8-bit texels of every level, and the stack, of a folder that is baked and written."""
    stack = mipbake.bake(mipbake.load(folder), method, pixel_filter="box")
    files = stack.save(folder.parent / "out", [output])
    levels = {}
    for path in sorted(files[1:]):
        stem = path.stem.rpartition("_mip")[0]
        levels.setdefault(stem, []).append(texels_of(path))
    return levels, stack


def texels_of(path: Path) -> np.ndarray:
    """(H, W) or (H, W, C) as the file has them."""
    level = openimageio_levels(path, 4)[0]
    return level[..., 0] if level.shape[2] == 1 else level


def rounded(values: np.ndarray) -> np.ndarray:
    """The nearest codes of 8 bits."""
    return np.floor(values.astype(np.float64) * 255 + 0.5).astype(np.uint8)


@pytest.mark.parametrize("made", SETS)
@pytest.mark.parametrize("method", ["linear", "lean"])
def test_level_0_of_a_source_is_the_same_files_again(tmp_path, made, method) -> None:
    """Names, channels, gloss and green: `linear` with the box leaves level 0 alone, so its texels are the source's
    texels.

    Values that the method works on may come back off by one, through float32.
    """
    folder = made(tmp_path / "wood")
    levels, _ = out(folder, method=method)
    names = {path.stem for path in folder.iterdir()}
    assert set(levels) - names <= {"metallic"}  # which these sets lack: it is there for shaders that ask for one
    for name in names:
        before = texels_of(folder / f"{name}.png")
        after = levels[name][0]
        assert after.shape == before.shape
        if method == "linear":
            assert np.abs(after.astype(int) - before).max() <= 1, name


@pytest.mark.parametrize("made", [packed_sets.orm, packed_sets.mask_map])
@pytest.mark.parametrize("method", ["linear", "lean"])
def test_occlusion_and_carried_channels_are_plain_averages(tmp_path, made, method) -> None:
    """Level 0 is the same bytes, further levels averages of four, whatever the method makes of roughness."""
    levels, _ = out(made(tmp_path / "wood"), method=method)
    places = {"wood_orm": {0: AO}} if made is packed_sets.orm else {"wood_mask_map": {1: AO, 2: OTHER}}
    ((name, channels),) = places.items()
    for channel, source in channels.items():
        np.testing.assert_array_equal(levels[name][0][..., channel], source)
        for found, wanted in zip(levels[name], box_levels(source), strict=True):
            assert np.abs(found[..., channel] - wanted).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("packing", ["separate", "orm", "mask-map", "metallic-smoothness"])
@pytest.mark.parametrize("convention", ["source", "opengl", "directx"])
@pytest.mark.parametrize("made", [packed_sets.orm, packed_sets.glossy_directx])
def test_green_of_normals_in_every_packing(tmp_path, made, packing, convention) -> None:
    levels, _ = out(made(tmp_path / "wood"), Output("png", packing, Normals(convention)))
    down = made is packed_sets.glossy_directx if convention == "source" else convention == "directx"
    wanted = encoded(NORMALS, directx=down)
    assert np.abs(levels["normal"][0].astype(int) - wanted).max() <= 1


PACKED = {
    "orm": ("orm", {"base_color", "normal", "orm"}, lambda rough: [AO, rough, METAL]),
    "mask-map": (
        *("mask_map", {"base_color", "normal", "mask_map"}),
        lambda rough: [METAL, AO, np.full_like(AO, 255), 255 - rough],
    ),
    "metallic-smoothness": (
        *("metallic_smoothness", {"base_color", "normal", "metallic_smoothness", "occlusion"}),
        lambda rough: [METAL, METAL, METAL, 255 - rough],
    ),
    "separate": ("roughness", {"base_color", "normal", "roughness", "metallic", "occlusion"}, lambda rough: [rough]),
}
"""Packing to the file in question, all files, and what is in its channels."""


@pytest.mark.parametrize("packing", PACKED)
@pytest.mark.parametrize("smooth", [False, True])
def test_packings(tmp_path, packing, smooth) -> None:
    """From maps of roughness, and from maps of smoothness with metallic and occlusion in other places."""
    stem, names, packed = PACKED[packing]
    levels, _ = out((packed_sets.mask_map if smooth else packed_sets.orm)(tmp_path / "wood"), Output("png", packing))
    assert set(levels) == names
    wanted = np.stack(packed(255 - ROUGH if smooth else ROUGH), -1).squeeze().astype(int)
    assert np.abs(levels[stem][0] - wanted).max() <= 1


@pytest.mark.parametrize("side", [8, 32, 12])
def test_a_file_has_the_size_of_what_shades(tmp_path, side) -> None:
    """Occlusion of another size is resampled, baked roughness never is; levels of a common size are the same."""
    occlusion = grey(5, side)
    folder = packed_sets.write(tmp_path / "wood", wood_occlusion=occlusion, wood_roughness=ROUGH)
    levels, stack = out(folder, Output("png", "orm"), method="lean")
    for index, level in enumerate(stack.levels):
        found = levels["orm"][index]
        np.testing.assert_array_equal(found[..., 1], rounded(level[..., 4]))
    assert [level.shape[0] for level in levels["orm"][:4]] == [16, 8, 4, 2]
    own = {level.shape[:2]: level[..., 0] for level in stack.extra["occlusion"]}
    for found, size in zip(levels["orm"], level_sizes(16, 16), strict=True):
        if size in own:
            np.testing.assert_array_equal(found[..., 0], rounded(own[size]))
        assert abs(float(found[..., 0].mean()) - float(occlusion.mean())) < 0.04 * 255
    assert mipbake.open_stack(tmp_path / "out").levels[0].shape == stack.levels[0].shape


def test_coverage_survives_a_file_of_another_size(tmp_path) -> None:
    """Opacity of half the size that is tested against a cutoff: its levels are the file's from level 1 on."""
    mask = (grey(6, 8) > 180).astype(np.uint8) * 255
    folder = packed_sets.write(tmp_path / "wood", wood_opacity=mask, wood_roughness=ROUGH)
    texture_set = mipbake.load(folder, alpha_cutoff=0.5)
    stack = mipbake.bake(texture_set, "linear")
    (file,) = (file for file in stack.files(Output("exr:float", "orm")) if file.layout.name == "base_color")
    for level, own in zip(file.levels[1:], stack.extra["opacity"], strict=True):
        np.testing.assert_array_equal(level[..., 3:], own)


def test_unknown_names_are_usage_errors() -> None:
    maps = [(layout, [gltf_level((4, 4))[..., layout.channels]]) for layout in LAYOUTS["gltf"]]
    with pytest.raises(UsageError, match=r"unknown packing 'rgb': expected one of source, separate, orm"):
        pack(maps, "rgb")
    with pytest.raises(UsageError, match=r"unknown normal convention 'up': expected one of source, opengl, directx"):
        pack(maps, "orm", normals=Normals("up"))
    with pytest.raises(UsageError, match="base_color cannot be inverted"):
        pack(maps, "source", [PackedFile(m.name, (Piece(m.name, 0, inverted=True),)) for m, _ in maps])


def random_source(draw, maps) -> list[PackedFile]:
    """Maps of a stack in files at random, up to four channels each; green of normals up or down, some inverted."""
    files: list[list[Piece]] = [[]]
    for layout, _ in draw(st.permutations(maps)):
        count = len(layout.encodings)
        inverted = [layout.encodings[i] == "unit" and draw(st.booleans()) for i in range(count)]
        if layout.name == "normal":
            inverted[1] = draw(st.booleans())
        if len(files[-1]) + count > 4 or draw(st.booleans()):
            files.append([])
        files[-1] += [Piece(layout.name, i, inverted[i]) for i in range(count)]
    return [PackedFile(f"f{number}", tuple(pieces)) for number, pieces in enumerate(files) if pieces]


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_what_is_packed_can_be_unpacked(data) -> None:
    """In every packing, and with the source's channels anywhere: the maps come back, through what files hold."""
    height, width = data.draw(st.integers(1, 9)), data.draw(st.integers(1, 9))
    anisotropic = data.draw(st.booleans())
    model = "gltf-anisotropic" if anisotropic else "gltf"
    sizes = level_sizes(height, width)
    levels = [gltf_level(size, i, anisotropic) for i, size in enumerate(sizes)]
    maps = [(layout, [level[..., layout.channels] for level in levels]) for layout in LAYOUTS[model]]
    extras = data.draw(st.sets(st.sampled_from(["occlusion", "opacity", "height", "emissive"])))
    for role in sorted(extras):
        channels = 3 if role == "emissive" else 1
        maps.append((extra_layout(role, channels), [smooth(size, channels, i) for i, size in enumerate(sizes)]))
    packing = data.draw(st.sampled_from(sorted(PACKINGS)))
    source = random_source(data.draw, maps) if packing == "source" else []
    convention = data.draw(st.sampled_from(["source", "opengl", "directx"]))
    normals = Normals(convention, data.draw(st.sampled_from([2, 3])))
    files = pack(maps, packing, source, normals)
    assert all(1 <= len(layout.channels) <= 4 for layout, _ in files)
    for layout, chain in files:
        values = [to_file(level, layout.encodings, srgb=False) for level in chain]
        assert all(value.min() > -1e-6 and value.max() < 1 + 1e-6 for value in values)
    found = unpacked(files, model)
    assert set(found) == {layout.name for layout, _ in maps}
    for layout, chain in maps:
        for back, level in zip(found[layout.name], chain, strict=True):
            np.testing.assert_allclose(back, level, atol=2e-3 if layout.name == "normal" else 1e-6)


def test_what_is_not_baked_leaves_the_rest_in_its_place(tmp_path) -> None:
    """Directions and roughness in one file, for a target without anisotropy."""
    both = np.dstack([encoded(NORMALS), ROUGH])
    folder = packed_sets.write(tmp_path / "wood", wood_both=both)
    texture_set = mipbake.load(folder, maps={"anisotropy": "wood_both.png:RGB", "roughness": "wood_both.png:A"})
    for target in ("gltf-anisotropic", "gltf"):
        stack = mipbake.bake(texture_set, "linear", target, "box")
        (file,) = (file for file in stack.files(Output("png")) if file.layout.name == "wood_both")
        assert len(file.layout.channels) == 4 and file.layout.channels[3].map == "roughness"
        np.testing.assert_array_equal(rounded(file.levels[0][..., 3]), rounded(stack.levels[0][..., 4]))
