"""`mipbake bake` of UDIM tiles: one folder for all of them, in which engines find every tile of a map."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.cli.main import main
from mipbake.source.images.read import read_image

from .command_line import fails
from .gltf_files import check_structure
from .gpu_textures import halved
from .input_files import bytes_of, encoded, height_field, plain_set, write_image
from .packed_sets import grey
from .test_cli_bake_documents import LINEAR, bake
from .test_presets import run


def tiles(folder: Path, name: str = "rock") -> Path:
    """1001 and 1002 side by side, and 1021 apart from both."""
    folder.mkdir(parents=True)
    for number, tile in enumerate((1001, 1002, 1021)):
        for role, pixels in (
            ("base_color", bytes_of(np.full((8, 8, 3), 0.2 + 0.2 * number))),
            ("normal_gl", encoded(height_field(8, 8, seed=number))),
            ("roughness", grey(number, 8)),
        ):
            write_image(folder / f"{name}_{role}.{tile}.png", pixels)
    return folder


TILES = (1001, 1002, 1021)


@pytest.mark.parametrize("source", ["", "rock_base_color.<UDIM>.png"])
def test_tiles(tmp_path, source) -> None:
    folder = tiles(tmp_path / "rock")
    code, report = bake(folder / source if source else folder, "-o", tmp_path / "out", "--format", "png")
    assert code == 0
    out = tmp_path / "out" / "rock"
    assert [Path(result["out"]) for result in report["results"]] == [out / f"stack.{tile}.json" for tile in TILES]
    listed = sorted(Path(file["path"]) for result in report["results"] for file in result["files"])
    assert listed == sorted(out.iterdir())  # nothing else
    for tile in TILES:
        assert out / f"rock_roughness.{tile}_mip00.png" in listed  # names stay names
        assert out / f"metallic.{tile}_mip00.png" in listed  # what the source has no file for carries its tile, too
        stack = mipbake.open_stack(out / f"stack.{tile}.json")
        assert (stack.tile, stack.name) == (tile, f"rock_{tile}")
        assert [level.shape[:2] for level in stack.levels] == [(h, w) for w, h in halved(8, 8)]


@pytest.mark.long
def test_names_of_presets_end_with_the_tile(tmp_path) -> None:
    assert bake(tiles(tmp_path / "rock"), "-o", tmp_path / "out", "--preset", "arnold")[0] == 0
    names = {p.name for p in (tmp_path / "out" / "rock").iterdir()}
    roles = ("base_color", "normal", "roughness", "metallic")
    assert names == {f"rock_{r}.{t}.tx" for r in roles for t in TILES} | {f"stack.{t}.json" for t in TILES}


@pytest.mark.long
def test_every_tile_has_a_sidecar_of_its_own(tmp_path) -> None:
    more = ("--sidecar", "ntc", "--format", "png")
    assert bake(tiles(tmp_path / "rock"), "-o", tmp_path / "out", *more)[0] == 0
    for tile in TILES:
        (listed,) = (tmp_path / "out" / "rock").glob(f"ntc.{tile}.json")
        assert all(str(tile) in each["fileName"] for each in json.loads(listed.read_text())["textures"])
    assert bake(tmp_path / "rock", "-o", tmp_path / "out", *more)[0] == 0


@pytest.mark.long
def test_a_folder_that_is_called_like_a_tile(tmp_path) -> None:
    assert bake(tiles(tmp_path / "rock_1002"), "-o", tmp_path / "out", "--preset", "arnold")[0] == 0
    (folder,) = (tmp_path / "out").iterdir()
    assert folder.name == "rock_1002"
    assert {p.name for p in folder.glob("*normal*")} == {f"rock_1002_normal.{tile}.tx" for tile in TILES}


@pytest.mark.long
def test_tiles_as_mudbox_counts_them(tmp_path) -> None:
    folder = tiles(tmp_path / "rock")
    for path in list(folder.iterdir()):
        for tile, pair in ((1001, "_u1_v1"), (1002, "_u2_v1"), (1021, "_u1_v3")):
            if f".{tile}." in path.name:
                path.rename(folder / path.name.replace(f".{tile}", pair))
    assert bake(folder, "-o", tmp_path / "out")[0] == 0
    names = {p.name for p in (tmp_path / "out" / "rock").iterdir()}
    assert {"rock_normal_gl_u1_v3.exr", "metallic.1021.exr", "stack.1021.json"} <= names


@pytest.mark.long
def test_tiles_are_replaced_by_their_own_source_alone(tmp_path, capsys) -> None:
    folder = tiles(tmp_path / "rock")
    out = tmp_path / "out"
    assert bake(folder, "-o", out, "--format", "png")[0] == 0
    write_image(folder / "rock_roughness.1021.png", grey(9, 8))
    for path in folder.glob("*.1001.png"):
        path.unlink()
    assert bake(folder, "-o", out)[0] == 0
    assert {p.suffix for p in (out / "rock").iterdir()} == {".exr", ".json"}
    assert not list((out / "rock").glob("*1001*"))
    before = sorted((p.name, p.read_bytes()) for p in (out / "rock").iterdir())
    other = tiles(tmp_path / "others" / "rock", "stone")
    assert "of other source files" in fails(capsys, 4, "bake", other, "-o", out, *LINEAR)
    (out / "rock" / "mine.txt").write_text("notes")
    assert "not mipbake's" in fails(capsys, 4, "bake", folder, "-o", out, *LINEAR)
    (out / "rock" / "mine.txt").unlink()
    assert sorted((p.name, p.read_bytes()) for p in (out / "rock").iterdir()) == before


@pytest.mark.long
def test_stacks_of_tiles_are_told_apart(tmp_path, capsys) -> None:
    folder = tiles(tmp_path / "rock")
    assert bake(folder, "-o", tmp_path / "out")[0] == 0
    place = tmp_path / "out" / "rock"
    said = fails(capsys, 3, "validate", plain_set(tmp_path / "alone"), place)
    assert "holds the stacks of 3 tiles: name one of them, such as" in said and "stack.1001.json" in said
    assert "is a baked stack" in fails(capsys, 3, "inspect", place)
    code, said = run("info", place, "--json")
    assert code == 0 and [each["stack"]["tile"] for each in json.loads(said)["tiles"]] == list(TILES)
    code, said = run("info", place / "stack.1002.json")
    assert code == 0 and "rock_1002, gltf, 8 x 8, 4 levels" in said and "1021" not in said
    assert "  holds: RGB normal\n" in said


def test_filtering_crosses_the_borders_of_tiles(tmp_path) -> None:
    folder = tiles(tmp_path / "rock")
    assert bake(folder, "-o", tmp_path / "out", "--format", "exr:float")[0] == 0
    first = mipbake.open_stack(tmp_path / "out" / "rock" / "stack.1001.json").levels[2][..., 0]
    assert (first[:, -1] > first[:, 0] + 1e-4).all()  # 1002 to its right is brighter


@pytest.mark.long
def test_tiles_that_a_glb_cannot_hold_are_resampled(tmp_path) -> None:
    """Tiles are resampled as other sets are, and each tile still continues in the next."""
    (folder := tmp_path / "rock").mkdir()
    for tile, value in ((1001, 0.2), (1002, 0.8)):
        write_image(folder / f"rock_base_color.{tile}.png", bytes_of(np.full((6, 10, 3), value)))
        write_image(folder / f"rock_normal_gl.{tile}.png", encoded(height_field(6, 10, seed=tile)))
        write_image(folder / f"rock_roughness.{tile}.png", bytes_of(np.full((6, 10), value)))
    code, report = bake(folder, "-o", tmp_path / "out", "--format", "png,glb")
    assert code == 0
    for result in report["results"]:
        assert any("resampled from 10 x 6 to 12 x 8" in note for note in result["set"]["notes"])
        (made,) = (Path(f["path"]) for f in result["files"] if f["path"].endswith(".glb"))
        check_structure(made.read_bytes())
        stack = mipbake.open_stack(result["out"])
        assert stack.size == (8, 12)
    left = mipbake.open_stack(report["results"][0]["out"]).levels[0][..., 0]
    assert np.ptp(left[:, :-2]) < 0.01  # nothing of its own other side, nor of the next tile's


@pytest.mark.usefixtures("quick_validation")
@pytest.mark.long
@pytest.mark.parametrize("side", [8, 12])
def test_tiles_that_touch_may_differ_in_size(tmp_path, side) -> None:
    (folder := tmp_path / "rock").mkdir()
    for tile, size in ((1001, 16), (1002, side)):
        heights = height_field(16, 16, seed=4)[:size, :size]
        write_image(folder / f"rock_normal_gl.{tile}.png", encoded(heights))
        write_image(folder / f"rock_roughness.{tile}.png", bytes_of(np.full((size, size), 0.4)))
        write_image(folder / f"rock_height.{tile}.png", grey(tile, size))
    alone = tmp_path / "alone"
    alone.mkdir()
    for path in folder.glob("*.1002.png"):
        (alone / path.name.replace(".1002", "")).write_bytes(path.read_bytes())
    (out := tmp_path / "out").mkdir()
    assert bake(alone, "-o", out, "--wrap-u", "clamp", "--wrap-v", "clamp", "--format", "exr:float")[0] == 0
    assert bake(folder, "-o", out, "--format", "exr:float")[0] == 0
    for tile, size in ((1001, 16), (1002, side)):
        stack = mipbake.open_stack(out / "rock" / f"stack.{tile}.json")
        assert stack.size == (size, size) and len(stack.levels) == len(halved(size, size))
    by_itself = mipbake.open_stack(out / "alone").extra["height"]
    same = [(a == b).all() for a, b in zip(stack.extra["height"], by_itself, strict=True)]
    assert all(same[:3] if side == 12 else same)  # coarser levels of 12 texels are looked up between texels
    code, said = run("validate", folder, out, "--json")
    assert code == 0
    found = {row["lod"]: row["snr"] for row in json.loads(said)["results"][1]["rows"] if row["method"] == "baked"}
    code, said = run("validate", alone, out / "alone", "--wrap-u", "clamp", "--wrap-v", "clamp", "--json")
    wanted = {row["lod"]: row["snr"] for row in json.loads(said)["results"][0]["rows"] if row["method"] == "baked"}
    assert all(found[lod] > wanted[lod] - 1 for lod in wanted)
    assert bake(folder, "-o", out, "--format", "png", "--keep-level0")[0] == 0
    for path in folder.glob("*_roughness.*"):
        written = out / "rock" / f"{path.stem}_mip00.png"
        assert (read_image(written).pixels == read_image(path).pixels).all()


@pytest.mark.parametrize("role", ["normal_gl", "roughness"])
def test_a_tile_that_lacks_a_map_is_named(tmp_path, capsys, role) -> None:
    folder = tiles(tmp_path / "rock")
    (folder / f"rock_{role}.1002.png").unlink()
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), *LINEAR, "--format", "png"]) == 3
    said = capsys.readouterr().err
    assert "mipbake: tile 1002: " in said and f"no {role.removesuffix('_gl')} map" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()  # all tiles or none
