"""UDIM tile sets: which files are tiles, tiles side by side, and their stacks apart again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.base.errors import InputError, UsageError
from mipbake.material.fill import fill
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet
from mipbake.source.tiles import place, tile_options, tiles_of
from mipbake.source.udim import Mosaic, islands, mosaics
from mipbake.stack.split_tiles import split
from mipbake.stack.stack import MipStack

from .input_files import bytes_of, encoded, height_field, pixels_for, write_image

pytestmark = pytest.mark.usefixtures("unmeasured")

ROUNDING = 2e-6  # of sums of some hundred float32 products, in another order


def names_by_tile(names: Iterable[str], folder: Path = Path("set")) -> dict[int, list[str]]:
    return {tile: [p.name for p in paths] for tile, paths in tiles_of(folder / n for n in names).items()}


@pytest.mark.parametrize(
    ("left", "right", "tiles"),
    [
        ("wood_color.1001.exr", "wood_color.1002.exr", (1001, 1002)),
        ("wood_1001_color.png", "wood_1011_color.png", (1001, 1011)),
        ("wood-color-1001.png", "wood-color-1999.png", (1001, 1999)),
        ("wood_color_u1_v1.tif", "wood_color_u10_v2.tif", (1001, 1020)),
        ("wood_1024_1001.png", "wood_1024_1002.png", (1001, 1002)),
    ],
)
def test_names_that_differ_by_the_tile_are_tiles(left: str, right: str, tiles: tuple[int, int]) -> None:
    assert names_by_tile([right, left]) == {tiles[0]: [left], tiles[1]: [right]}


@pytest.mark.parametrize(
    "names",
    [
        ["wood_1024.png", "wood_2048.png"],
        ["wood_color_1024.png", "wood_normal_1024.png"],
        ["wood_color.1001.png"],
        ["wood_color.1000.png", "wood_color.2000.png"],
        ["wood1001.png", "wood1002.png"],
        ["wood_u0_v1.png", "wood_u1_v1.png", "wood_u11_v1.png"],
    ],
)
def test_other_numbers_are_no_tiles(names: list[str]) -> None:
    assert names_by_tile(names) == {}


def test_a_map_of_one_tile_joins_the_tiles_of_the_others() -> None:
    names = ["a_color.1001.png", "a_color.1002.png", "a_metallic.1001.png", "a_gloss.1005.png", "preview.png"]
    expected = {1001: ["a_color.1001.png", "a_metallic.1001.png"], 1002: ["a_color.1002.png"]}
    assert names_by_tile(names) == expected


@pytest.mark.parametrize(("pattern", "name"), [("a.<UDIM>.png", "a.1012.png"), ("a_<UVTILE>.png", "a_u2_v2.png")])
def test_a_pattern_stands_for_its_files(tmp_path: Path, pattern: str, name: str) -> None:
    for other in (name, "b.1002.png", "a.10012.png", "a_u1_v.png"):
        (tmp_path / other).touch()
    assert names_by_tile([pattern], tmp_path) == {1012: [name]}


@pytest.mark.parametrize("pattern", ["a.<UDIM>.png", "<UDIM>/a.png", "a.<UDIM>.<UDIM>.png", "none/a.<UDIM>.png"])
def test_a_pattern_without_files_is_refused(tmp_path: Path, pattern: str) -> None:
    with pytest.raises(InputError, match="expected"):
        tiles_of([tmp_path / pattern])


def test_options_are_those_of_a_tile(tmp_path: Path) -> None:
    for name in ("n.1002.png", "r_u2_v1.png"):
        (tmp_path / name).touch()
    maps = {"normal": "n.<UDIM>.png", "roughness": "r_<UVTILE>.png:G", "metallic": "m.<UDIM>.png", "opacity": 0.5}
    options = LoadOptions(maps, normal_convention="directx")
    own = tile_options(options, 1002, tmp_path)
    expected = {"normal": "n.1002.png", "roughness": "r_u2_v1.png:G", "metallic": None, "opacity": 0.5}
    assert own == replace(options, maps=expected)
    with pytest.raises(InputError, match="tile 1001 has no normal map"):
        tile_options(options, 1001, tmp_path)


def test_islands_are_tiles_that_touch() -> None:
    assert islands([1012, 1001, 1023, 1005, 1003]) == [[1001, 1003, 1012, 1023], [1005]]


# --- mosaics


def decoded(height: int, width: int, seed: int = 0, anisotropic: bool = False) -> dict[str, np.ndarray]:
    """Arrays of a texture that wraps."""
    rng = np.random.default_rng(seed)
    arrays = {
        "normal": height_field(height, width, seed),
        "roughness": rng.uniform(0.1, 0.9, (height, width)),
        "base_color": rng.random((height, width, 3)),
        "metallic": rng.random((height, width)),
        "occlusion": rng.random((height, width)),
        "height": rng.random((height, width)),
    }
    if anisotropic:
        arrays["anisotropy"] = rng.uniform(0.2, 1, (height, width, 3))
    return arrays


def texture_set(arrays: Mapping[str, Any], rows: slice = slice(None), columns: slice = slice(None)) -> TextureSet:
    return TextureSet.from_arrays("wood", wrap=("clamp", "clamp"), **{k: v[rows, columns] for k, v in arrays.items()})


def cut_up(arrays: Mapping[str, Any], rows: int, columns: int) -> dict[int, TextureSet]:
    """Tiles 1001 and so on; the bottom row of the picture is the first row of tiles."""
    height, width = (n // m for n, m in zip(arrays["normal"].shape[:2], (rows, columns), strict=True))
    return {
        1001 + column + 10 * v: texture_set(
            arrays, slice((rows - 1 - v) * height, (rows - v) * height), slice(column * width, (column + 1) * width)
        )
        for v in range(rows)
        for column in range(columns)
    }


def baked(tiles: Mapping[int, TextureSet], **options: Any) -> tuple[Mosaic, Mapping[int, MipStack]]:
    mosaic = mosaics(tiles)[0]
    return mosaic, split(mipbake.bake(mosaic.texture_set, method="linear", **options), mosaic)


@pytest.mark.parametrize("anisotropic", [False, True])
def test_tiles_of_one_texture_are_cuts_of_its_stack(anisotropic: bool) -> None:
    arrays = decoded(32, 48, anisotropic=anisotropic)
    tiles = cut_up(arrays, 2, 3)
    _, stacks = baked(tiles, pixel_filter="gaussian")
    whole = mipbake.bake(texture_set(arrays), method="linear", pixel_filter="gaussian")
    for tile, stack in stacks.items():
        u, v = place(tile)
        assert [level.shape[:2] for level in stack.levels] == level_sizes(16, 16)
        for index, side in enumerate(level.shape[0] for level in stack.levels):
            here = (slice((1 - v) * side, (2 - v) * side), slice(u * side, (u + 1) * side))
            assert stack.levels[index] == pytest.approx(whole.levels[index][here], abs=ROUNDING)
            for role, chain in stack.extra.items():
                assert chain[index] == pytest.approx(whole.extra[role][index][here], abs=ROUNDING)


def test_holes_take_nothing_foreign() -> None:
    """Around a hole, tiles of one material each keep its values; in the hole there is something between them."""
    tiles = {t: constant_tile(value) for t, value in ((1001, 0.2), (1003, 0.8), (1012, 0.8))}
    mosaic, stacks = baked({t: tiles[t] for t in (1001, 1003)}, pixel_filter="gaussian")
    roughness = mosaic.texture_set.maps["roughness"].pixels[..., 0]
    lowest, highest = (tiles[t].maps["roughness"].pixels.flat[0] for t in (1001, 1003))
    assert (roughness[:, :8] == lowest).all()
    assert (roughness[:, 16:] == highest).all()
    assert (np.diff(roughness, axis=1) >= -1e-6).all()
    assert stacks[1001].levels[0][..., 4] == pytest.approx(float(lowest), abs=0.02)
    assert np.linalg.norm(mosaic.texture_set.maps["normal"].pixels, axis=-1) == pytest.approx(1, abs=1e-5)
    alone, _ = baked({1012: tiles[1012]})
    assert (alone.rows, alone.columns) == (1, 1)


def constant_tile(roughness: float, side: int = 8, **others: Any) -> TextureSet:
    normal = np.broadcast_to([0, 0, 1], (side, side, 3))
    return TextureSet.from_arrays("wood", normal=normal, roughness=roughness, **others)


def test_levels_that_do_not_divide_lie_where_they_should() -> None:
    """A ramp over both tiles: every level of both, side by side, is that ramp at its texels' centres."""
    side = 50
    ramp = np.broadcast_to(np.linspace(0.2, 0.8, 2 * side), (side, 2 * side))
    arrays = decoded(side, 2 * side) | {"roughness": ramp, "height": ramp}
    _, stacks = baked(cut_up(arrays, 1, 2))
    for level in range(4):
        both = np.concatenate([stacks[t].extra["height"][level] for t in (1001, 1002)], 1)[..., 0]
        count = both.shape[1]
        at = (np.arange(count) + 0.5) * 2 * side / count - 0.5
        inner = slice(2, count - 2)
        expected = np.interp(at, np.arange(2 * side), ramp[0])[inner]
        assert both[:, inner] == pytest.approx(np.broadcast_to(expected, both[:, inner].shape), abs=1e-4)
        shading = np.concatenate([stacks[t].levels[level] for t in (1001, 1002)], 1)[:, inner, 4]
        assert shading == pytest.approx(np.broadcast_to(expected, shading.shape), abs=1e-4)


def test_smaller_tiles_are_resampled_and_missing_maps_replaced() -> None:
    full = constant_tile(0.3, 16, height=np.full((4, 4), 0.7), occlusion=0.5, anisotropy=np.full((16, 16, 3), 0.6))
    mosaic, stacks = baked({1001: constant_tile(0.5, 8), 1002: full})
    texture = mosaic.texture_set
    assert (texture.height, texture.width) == (16, 32)
    assert any("1001: resampled from 8 x 8 to 16 x 16" in note for note in texture.notes)
    assert any(note.startswith("1001: no occlusion map") for note in texture.notes)
    assert (texture.maps["occlusion"].pixels[:, :1] == 1).all()
    assert texture.maps["height"].pixels == pytest.approx(0.7)
    assert (texture.maps["anisotropy"].pixels[:, :16, 2] == 0).all()
    assert set(stacks) == {1002} and set(stacks[1002].extra) == {"occlusion", "height"}
    assert stacks[1002].extra["height"][0].shape == (4, 4, 1)
    assert {stack.model for stack in stacks.values()} == {"gltf-anisotropic"}


def test_tiles_that_differ_in_size_are_baked_at_their_own() -> None:
    """A ramp over two tiles, the right one stored with half the texels: levels of one footprint continue each other."""
    ramp = np.broadcast_to(np.linspace(0.2, 0.8, 64), (32, 64))
    halves = ramp[:, 32:].reshape(16, 2, 16, 2).mean((1, 3))
    sets = {}
    for tile, roughness in {1001: ramp[:, :32], 1002: halves}.items():
        flat = np.full((*roughness.shape, 3), [0, 0, 1])
        sets[tile] = TextureSet.from_arrays("wood", wrap=("clamp", "clamp"), normal=flat, roughness=roughness)
    stacks: dict[int, MipStack] = {}
    for mosaic in mosaics(sets):
        stacks |= split(mipbake.bake(mosaic.texture_set, method="linear"), mosaic)
    for tile, side in ((1001, 32), (1002, 16)):
        assert [level.shape[:2] for level in stacks[tile].levels] == level_sizes(side, side)
    for level in range(1, 4):
        both = np.concatenate([stacks[1001].levels[level], stacks[1002].levels[level - 1]], 1)[..., 4]
        steps = np.diff(both[:, 2:-2], axis=1)
        assert steps == pytest.approx(np.full(steps.shape, 2**level * 0.6 / 63), rel=0.1)


def test_carried_channels_go_through_and_are_1_where_a_tile_lacks_them() -> None:
    with_one = constant_tile(0.3, 8)
    carried = with_one.maps["roughness"]
    pixels = np.random.default_rng(0).random((8, 8, 1)).astype(np.float32)
    source = replace(carried.source, role="carried_1")
    with_one = replace(with_one, maps={**with_one.maps, "carried_1": replace(carried, pixels=pixels, source=source)})
    mosaic, stacks = baked({1001: with_one, 1002: constant_tile(0.3, 8)})
    assert stacks[1001].extra["carried_1"][0] == pytest.approx(pixels)
    assert "carried_1" not in stacks[1002].extra
    assert (mosaic.texture_set.maps["carried_1"].pixels[:, 8:] == 1).all()


def test_opacity_that_is_tested_keeps_the_coverage_of_every_tile() -> None:
    rng = np.random.default_rng(3)
    exponents = {1001: 0.5, 1002: 3}
    tiles = {
        tile: replace(constant_tile(0.3, 64, opacity=rng.random((64, 64)) ** exponent), alpha_cutoff=0.5)
        for tile, exponent in exponents.items()
    }
    mosaic, stacks = baked(tiles)
    assert mosaic.texture_set.alpha_cutoff is None
    for tile, stack in stacks.items():
        levels = stack.extra["opacity"]
        share = np.mean(levels[0] >= 0.5)
        assert levels[0] == pytest.approx(tiles[tile].maps["opacity"].pixels)
        for level in levels[1:]:
            assert abs(np.mean(level >= 0.5) - share) <= 0.5 / level.size + 1e-6


def test_tiles_that_do_not_fit_together() -> None:
    one, other = constant_tile(0.5), constant_tile(0.5)
    with pytest.raises(UsageError, match=r"different alpha cutoffs, none and 0\.5"):
        mosaics({1001: one, 1002: replace(other, alpha_cutoff=0.5)})
    other = replace(other, convention=replace(other.convention, name="directx"))
    (mosaic,) = mosaics({1001: one, 1002: other})
    assert any("1001 as OpenGL and 1002 as DirectX" in warning for warning in mosaic.texture_set.warnings)
    with pytest.raises(UsageError, match="not the stack of the mosaic"):
        split(mipbake.bake(constant_tile(0.5), method="linear"), mosaic)


@pytest.mark.parametrize("size", [(50, 50), (16, 64), (1, 1)])
def test_other_sizes_fill_complete_chains(size: tuple[int, int]) -> None:
    rows, columns = size
    mosaic, stacks = baked(cut_up(decoded(rows, 2 * columns), 1, 2))
    assert bool(mosaic.texture_set.warnings) == (rows != columns or rows & (rows - 1) != 0)
    for stack in stacks.values():
        for chain in (stack.levels, stack.extra["height"]):
            assert [level.shape[:2] for level in chain] == level_sizes(rows, columns)
        for level in stack.levels:
            assert np.linalg.norm(level[..., 5:8], axis=-1) == pytest.approx(1, abs=1e-5)


# --- files


def write_tiles(folder: Path, normals: np.ndarray, roughness: np.ndarray) -> Path:
    folder.mkdir()
    side = normals.shape[0]
    for tile, here in ((1001, slice(0, side)), (1002, slice(side, 2 * side))):
        write_image(folder / f"wood_normal_gl.{tile}.png", encoded(normals[:, here]))
        write_image(folder / f"wood_roughness.{tile}.png", bytes_of(roughness[:, here]))
    return folder


def test_tiles_from_files_keep_their_own_sources(tmp_path: Path) -> None:
    roughness = np.random.default_rng(0).random((16, 32))
    folder = write_tiles(tmp_path / "wood", height_field(16, 32), roughness)
    write_image(folder / "wood_metallic.1002.png", pixels_for("metallic", 16))
    files = tiles_of(sorted(folder.iterdir()))
    sets = {tile: mipbake.load(paths) for tile, paths in files.items()}
    mosaic, stacks = baked(sets)
    assert mosaic.texture_set.name == "wood"
    assert mosaic.texture_set.maps["roughness"].pixels[..., 0] == pytest.approx(bytes_of(roughness) / 255, abs=1e-6)
    for tile, stack in stacks.items():
        assert stack.name == f"wood_{tile}"
        assert set(stack.provenance.sources) == {p.name for p in files[tile]}
        other = {1001: 1002, 1002: 1001}[tile]
        assert any(f"filtered across its borders with {other}" in w for w in stack.provenance.warnings)
        assert stack.wrap == ("clamp", "clamp")
    assert stacks[1001].provenance.source_hash != stacks[1002].provenance.source_hash
    assert not any("metallic" in name for name in stacks[1001].provenance.sources)


@pytest.mark.parametrize(
    ("name", "tile"),
    [("wood_roughness.{}.png", "1001"), ("wood_{}_roughness.png", "1134"), ("wood_roughness_{}.png", "u2_v3")],
)
def test_tiles_do_not_hide_what_a_map_is(tmp_path: Path, name: str, tile: str) -> None:
    write_image(tmp_path / name.format(tile), pixels_for("roughness"))
    loaded = mipbake.load(tmp_path, maps={"normal": None})
    path = loaded.maps["roughness"].source.path
    assert path.name == name.format(tile)


# --- filling


def test_filling_keeps_what_counts_and_ignores_the_rest() -> None:
    rng = np.random.default_rng(0)
    values = rng.random((23, 17, 3)).astype(np.float32)
    weights = (rng.random((23, 17)) > 0.7).astype(np.float32)
    weights[5:12, 3:9] = 0
    foreign = np.where(weights[..., None] > 0, values, np.nan).astype(np.float32)
    filled = fill(foreign, weights)
    known = values[weights > 0]
    assert (filled[weights > 0] == known).all()
    assert (filled == fill(values, weights)).all()
    assert (filled >= known.min(0)).all()
    assert (filled <= known.max(0) + 1e-6).all()


@pytest.mark.parametrize(("mode", "near"), [("clamp", 0.0), ("wrap", 1.0)])
def test_filling_wraps_where_it_should(mode: str, near: float) -> None:
    """Columns 4 and 13 of 16 count: the first column lies nearer to 4, or by wrapping to 13."""
    values, weights = np.zeros((16, 16, 1), np.float32), np.zeros((16, 16))
    values[:, 13:], weights[:, 13], weights[:, 4] = 1, 1, 1
    first = float(fill(values, weights, (mode, mode))[8, 0, 0])
    assert abs(first - near) < 0.5
