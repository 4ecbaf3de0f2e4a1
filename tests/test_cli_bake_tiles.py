"""`mipbake bake` of UDIM tiles: one folder for all of them, in which engines find every tile of a map."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.cli.main import main

from .command_line import LINEAR, bake, fails, run
from .gpu_textures import halved
from .input_files import bytes_of, encoded, height_field, plain_set, write_image
from .packed_sets import grey

pytestmark = pytest.mark.usefixtures("unmeasured")


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


@pytest.mark.parametrize("role", ["normal_gl", "roughness"])
def test_a_tile_that_lacks_a_map_is_named(tmp_path, capsys, role) -> None:
    folder = tiles(tmp_path / "rock")
    (folder / f"rock_{role}.1002.png").unlink()
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), *LINEAR, "--format", "png"]) == 3
    said = capsys.readouterr().err
    assert "mipbake: tile 1002: " in said and f"no {role.removesuffix('_gl')} map" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()  # all tiles or none


def test_a_verdict_says_which_tile_it_is_about(tmp_path, capsys) -> None:
    assert main(["bake", str(tiles(tmp_path / "rock")), "-o", str(tmp_path / "out"), "--strength", "0.5"]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if "No verdict" in line]
    assert [line.partition(": ")[0] for line in said] == [f"rock_{tile}" for tile in TILES]
