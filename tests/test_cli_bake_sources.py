"""`mipbake bake` on everything that it takes beside glTF documents: what it writes, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mipbake

from . import mtlx_documents as mtlx
from .command_line import LINEAR, bake, fails, tree, write_set
from .gpu_textures import openimageio_levels
from .test_cli_bake_documents import small

pytestmark = pytest.mark.usefixtures("unmeasured")


@pytest.mark.parametrize("option", [["--gloss"], ["--map", "metallic=1"]])
def test_documents_say_themselves_how_they_are_read(tmp_path, capsys, option) -> None:
    mtlx.write_textures(tmp_path)
    for source in (small().write(tmp_path / "bolt"), mtlx.document(tmp_path, mtlx.surface())):
        said = fails(capsys, 2, "bake", source, "-o", tmp_path / "out", *option, *LINEAR)
        assert f"{source} says itself how its textures are read" in said
    assert not (tmp_path / "out").exists()


def test_a_materialx_document(tmp_path) -> None:
    mtlx.write_textures(tmp_path)
    source = mtlx.document(tmp_path, mtlx.surface(mtlx.image("color", "color3", "color.png"), base_color="color"))
    code, report = bake(source, "-o", tmp_path / "out", "--format", "exr:float", "--filter", "box")
    assert code == 0
    (result,) = report["results"]
    stack = mipbake.open_stack(result["out"])
    wanted = openimageio_levels(tmp_path / "rough.png", 1)[0] / 255
    np.testing.assert_allclose(stack.levels[0][..., 4:5], wanted, atol=1e-6)
    assert result["set"]["maps"]["roughness"]["path"].endswith("rough.png")


@pytest.mark.long
def test_lists_and_globs(tmp_path) -> None:
    for name in ("a", "b", "c"):
        write_set(tmp_path / "sets" / name)
    (tmp_path / "list.txt").write_text("# two\nsets/a\n\nsets/c\n")
    code, report = bake(f"@{tmp_path / 'list.txt'}", "-o", tmp_path / "listed", "--format", "png")
    assert code == 0 and tree(tmp_path / "listed")[0] == "a"
    assert [Path(result["out"]).name for result in report["results"]] == ["a", "c"]
    code, report = bake(tmp_path / "sets" / "*", tmp_path / "sets" / "b", "-o", tmp_path / "all", "--format", "png")
    assert code == 0 and [Path(result["out"]).name for result in report["results"]] == ["a", "b", "c"]


def test_a_list_or_glob_of_nothing(tmp_path, capsys) -> None:
    (tmp_path / "list.txt").write_text("# nothing\n")
    assert "holds no path" in fails(capsys, 3, "bake", f"@{tmp_path / 'list.txt'}", "-o", tmp_path / "out")
    assert "matches nothing" in fails(capsys, 3, "bake", tmp_path / "no*", "-o", tmp_path / "out")
    assert "cannot be read" in fails(capsys, 3, "bake", f"@{tmp_path / 'none.txt'}", "-o", tmp_path / "out")


@pytest.mark.long
def test_results_of_one_name_are_told_apart(tmp_path) -> None:
    """Results are named after the folders around their sources, documents as well as sets; a result that is alone keeps
    its name."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        small(name).write(tmp_path / name / "bolt")
        write_set(tmp_path / name / "metal")
    sources = [tmp_path / folder / name for folder in "ab" for name in ("bolt.glb", "metal")]
    code, _ = bake(*sources, tmp_path / "missing", write_set(tmp_path / "wood"), "-o", tmp_path / "out")
    assert code == 3
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert names == ["a_bolt.glb", "a_metal", "b_bolt.glb", "b_metal", "wood"]
    assert mipbake.open_stack(tmp_path / "out" / "b_metal").name == "b_metal"


def test_max_level_and_adjustments(tmp_path) -> None:
    folder = write_set(tmp_path / "metal")
    more = ["--max-level", "2", "--min-roughness", "0.35", "--keep-level0", "--strength", "0.5"]
    code, report = bake(folder, "-o", tmp_path / "out", "--format", "png,exr", *more)
    assert code == 0 and report["results"][0]["stack"]["levels"] == 3
    names = tree(tmp_path / "out" / "metal")
    assert [n for n in names if n.startswith("roughness")] == [
        "roughness.exr",
        *(f"roughness_mip0{i}.png" for i in range(3)),
    ]
    found = mipbake.open_stack(tmp_path / "out" / "metal")
    assert min(level[..., 4].min() for level in found.levels) >= 0.35 - 1e-3
    assert len(found.provenance.adjustments) == 3
    source = mipbake.load(folder).material("gltf")
    np.testing.assert_allclose(found.levels[0][..., :3], source[..., :3], atol=1e-3)
