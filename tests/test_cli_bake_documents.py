"""`mipbake bake` on glTF documents: what it writes beside and in place of them, and what it refuses."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.baking import BakeOptions
from mipbake.cli.main import main
from mipbake.source.intake import jobs
from mipbake.source.options import LoadOptions

from .command_line import fails, tree, write_set
from .gltf_files import GltfFile, check_structure, many_materials, png, split
from .gltf_results import two_textures
from .gpu_textures import openimageio_levels
from .input_files import encoded, height_field, write_image
from .packed_sets import grey, write
from .test_presets import run

LINEAR = ("--method", "linear")


def bake(*arguments: object) -> tuple[int, dict]:
    """Exit code and the JSON of a bake by `linear`."""
    code, said = run("bake", *arguments, *LINEAR, "--json")
    return code, json.loads(said)


def small(name: str = "n") -> GltfFile:
    """A document of one material."""
    return two_textures(png("normal " + name), png("mr"))


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """A document of 14 materials, baked to files and to a GLB."""
    folder = tmp_path_factory.mktemp("many")
    source = many_materials().write(folder / "many")
    code, report = bake(source, "-o", folder / "out", "--format", "png,glb")
    assert code == 0
    return folder, report


@pytest.mark.long
def test_every_material_of_a_document_is_baked(many) -> None:
    folder, report = many
    sets = [result for result in report["results"] if "stack" in result]
    assert {Path(result["out"]).parent for result in sets} == {folder / "out" / "many"}
    names = {Path(result["out"]).name for result in sets}
    # Equal textures and factors once, names that differ by case only apart, nothing for what has no normal map.
    assert {
        "Leather",
        "leather_2",
        "Fence",
        "Two_sets",
        "Shifted",
        "Foreign",
        "Glossy",
        "Brushed",
        "material_13",
    } == names
    for result in sets:
        stack = mipbake.open_stack(result["out"])
        assert stack.size == ((8, 8) if stack.name in ("Two_sets", "Foreign") else (16, 16))
        assert stack.model == ("gltf-anisotropic" if stack.name in ("Brushed", "material_13") else "gltf")
        assert {Path(file["path"]).name for file in result["files"]} == {p.name for p in Path(result["out"]).iterdir()}
    assert [cost["format"] for cost in sets[0]["costs"]] == ["glb", "png:8"]
    assert tree(folder) == sorted(
        ["many.glb", "out", "out/many.glb", *(f"out/{p}" for p in tree(folder / "out") if p != "many.glb")]
    )


def test_factors_of_a_document_are_in_what_is_baked(many) -> None:
    """Its roughnessFactor is 0.8; metallicRoughness has roughness in green."""
    folder, _ = many
    path = folder / "orm.png"
    path.write_bytes(png("orm", channels=3))
    wanted = openimageio_levels(path, 3)[0][..., 1].mean() / 255 * 0.8
    found = mipbake.open_stack(folder / "out" / "many" / "Leather").levels[-1]
    assert found[0, 0, 4] == pytest.approx(wanted, abs=2 / 255)


def test_the_document_comes_back(many) -> None:
    folder, report = many
    before, _ = split((folder / "many.glb").read_bytes())
    after, _ = check_structure((folder / "out" / "many.glb").read_bytes())
    for kind in ("scenes", "nodes", "meshes"):
        assert after[kind] == before[kind]
    assert [m["name"] for m in after["materials"]] == [m["name"] for m in before["materials"]]
    made = after["asset"]["extras"]["mipbake"]
    assert made["version"] == mipbake.__version__ and made["materials"]["Leather"]["method"] == "linear"
    assert report["results"][-1]["files"][0]["path"] == str(folder / "out" / "many.glb")
    assert "KHR_texture_basisu" in after["extensionsUsed"]


def test_coverage_of_a_mask_is_kept_in_8_bits(many) -> None:
    """The fence is tested against 0.4, and its factor is 0.8: 0.5 in the texture."""
    folder, _ = many
    found = mipbake.open_stack(folder / "out" / "many" / "Fence")
    chain = found.extra["opacity"]
    share = (chain[0] >= 0.5).mean()
    for level in chain[1:]:
        assert abs((level >= 0.5).sum() - share * level.size) <= 1


@pytest.mark.long
@pytest.mark.parametrize("kind", ["glb", "external", "embedded"])
def test_glb_only(tmp_path, kind) -> None:
    """One file and nothing else."""
    source = small().write(tmp_path / "bolt", kind)
    code, report = bake(source, "-o", tmp_path / "out", "--format", "glb")
    assert code == 0
    assert tree(tmp_path / "out") == ["bolt.glb"]
    check_structure((tmp_path / "out" / "bolt.glb").read_bytes())
    assert [result["ok"] for result in report["results"]] == [True, True]
    assert report["results"][0]["files"] == []
    # An earlier one of ours may be replaced.
    first = (tmp_path / "out" / "bolt.glb").read_bytes()
    assert bake(source, "-o", tmp_path / "out", "--format", "glb")[0] == 0
    assert (tmp_path / "out" / "bolt.glb").read_bytes() == first


@pytest.mark.parametrize(
    ("asked", "as_glb"),
    [
        ({}, True),
        ({"keep_level0": True}, True),
        ({"target": "gltf-anisotropic"}, True),
        ({"preset": "three"}, True),
        ({"preset": "unreal"}, False),
        ({"format": "png"}, False),
        ({"packing": "orm"}, False),
        ({"write_normals": "directx"}, False),
        ({"target": "ggx"}, False),
    ],
)
def test_a_document_becomes_a_glb_unless_something_else_is_asked_for(tmp_path, asked, as_glb) -> None:
    (job,) = jobs([str(small().write(tmp_path / "bolt"))], LoadOptions(), tmp_path)
    made = BakeOptions(**asked).plan()
    assert (made.wants_glb(job), made.writes_maps(job)) == (as_glb, not as_glb)


def test_documents_and_sets_are_baked_together(tmp_path) -> None:
    source, folder = small().write(tmp_path / "bolt"), write_set(tmp_path / "wood")
    assert bake(source, "-o", tmp_path / "maps", "--packing", "orm")[0] == 0
    assert [path.name for path in (tmp_path / "maps").iterdir()] == ["bolt"]
    assert bake(source, folder, "-o", tmp_path / "both")[0] == 0
    assert sorted(path.name for path in (tmp_path / "both").iterdir()) == ["bolt.glb", "wood"]
    assert (tmp_path / "both" / "wood" / "normal.exr").is_file()


def test_without_the_encoder_a_document_is_refused_before_it_is_read(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "alktx2", None)
    source = small().write(tmp_path / "bolt")
    said = fails(capsys, 2, "bake", source, "-o", tmp_path / "out", *LINEAR)
    assert "alktx2" in said and "--format exr" in said
    assert bake(source, "-o", tmp_path / "out", "--format", "exr")[0] == 0


def test_a_glb_of_a_folder(tmp_path) -> None:
    """A square with the material, beside the description of the stack; sides that glTF forbids are widened and told."""
    folder = write(
        tmp_path / "wood",
        wood_base_color=grey(1, 6),
        wood_normal_gl=encoded(height_field(6, 6)),
        wood_roughness=grey(2, 6),
    )
    code, report = bake(folder, "-o", tmp_path / "out", "--format", "glb")
    assert code == 0 and tree(tmp_path / "out") == ["wood", "wood/stack.json", "wood/wood.glb"]
    document, _ = check_structure((tmp_path / "out" / "wood" / "wood.glb").read_bytes())
    assert len(document["meshes"]) == 1
    assert any("resampled from 6 x 6 to 8 x 8" in note for note in report["results"][0]["set"]["notes"])
    assert bake(folder, "-o", tmp_path / "out", "--format", "png,glb")[0] == 0
    stack = mipbake.open_stack(tmp_path / "out" / "wood")
    assert stack.size == (8, 8) and (tmp_path / "out" / "wood" / "wood.glb").exists()


@pytest.mark.long
def test_maps_that_a_glb_cannot_hold_are_told(tmp_path) -> None:
    folder = write_set(tmp_path / "lamp")
    write_image(folder / "emissive.exr", np.full((8, 8, 3), 3, np.float32))
    write_image(folder / "height.png", grey(1, 8))
    code, report = bake(folder, "-o", tmp_path / "out", "--format", "glb")
    assert code == 0
    warnings = report["results"][0]["warnings"]
    assert any("the map emissive is not in the GLB: it has values above 1" in each for each in warnings)
    assert any("the map height is not in the GLB: glTF has no texture for it" in each for each in warnings)
    code, report = bake(folder, "-o", tmp_path / "out", "--format", "glb,exr")
    assert code == 0 and not any("is not in the GLB" in each for each in report["results"][0]["warnings"])
    assert {"emissive.exr", "height.exr", "lamp.glb"} <= {p.name for p in (tmp_path / "out" / "lamp").iterdir()}


@pytest.mark.parametrize("content", [b"somebody's", b"glTF"])
def test_a_foreign_glb_is_not_overwritten(tmp_path, capsys, content) -> None:
    source = small().write(tmp_path / "bolt")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "bolt.glb").write_bytes(content)
    said = fails(capsys, 4, "bake", source, "-o", tmp_path / "out", "--format", "png,glb", *LINEAR)
    assert "bolt.glb" in said and "was not made by mipbake" in said
    assert tree(tmp_path / "out") == ["bolt.glb"] and (tmp_path / "out" / "bolt.glb").read_bytes() == content


def test_a_glb_of_others_is_not_overwritten(tmp_path, capsys) -> None:
    source = small().write(tmp_path / "bolt")
    (tmp_path / "out").mkdir()
    other = small("other").write(tmp_path / "out" / "bolt").read_bytes()
    assert "was not made by mipbake" in fails(
        capsys, 4, "bake", source, "-o", tmp_path / "out", "--format", "glb", *LINEAR
    )
    assert (tmp_path / "out" / "bolt.glb").read_bytes() == other


def test_the_source_is_not_overwritten(tmp_path, capsys) -> None:
    source = small().write(tmp_path / "bolt")
    before = source.read_bytes()
    said = fails(capsys, 4, "bake", source, "-o", tmp_path, "--format", "glb", *LINEAR)
    assert "it is the source" in said
    assert source.read_bytes() == before and tree(tmp_path) == ["bolt.glb"]


@pytest.mark.parametrize("formats", ["png", "glb"])
def test_a_folder_that_is_a_link_to_nothing_is_found_first(tmp_path, capsys, formats) -> None:
    source, out = small().write(tmp_path / "bolt"), tmp_path / "out"
    out.symlink_to(tmp_path / "nothing")
    said = fails(capsys, 4, "bake", source, "-o", out, "--format", formats, *LINEAR)
    assert f"{out} is a link to nothing" in said
    assert tree(tmp_path) == ["bolt.glb", "out"]


def broken_document(folder: Path) -> Path:
    """Two materials; the pixels of one normal map end early."""
    whole = png("normal broken")
    made = GltfFile()
    for name, data in (("good", png("normal good")), ("bad", whole[: len(whole) * 2 // 3])):
        made.texture(made.image(data, name))
        made.material(name, normalTexture={"index": len(made.json["textures"]) - 1})
    return made.write(folder / "two")


@pytest.mark.long
@pytest.mark.parametrize("formats", ["png", "png,glb", "glb"])
def test_a_broken_image_leaves_the_other_materials(tmp_path, capsys, formats) -> None:
    """It is told once, and the document as a whole is not written."""
    source = broken_document(tmp_path)
    assert main(["bake", str(source), "-o", str(tmp_path / "out"), "--format", formats, *LINEAR]) == 3
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("mipbake: ")]
    assert len(lines) == 1 + ("glb" in formats)
    assert str(source) in lines[0] and "image 1 (bad)" in lines[0] and "(material 1 (bad) cannot be baked)" in lines[0]
    if "glb" in formats:
        assert "two.glb is not written, because some" in lines[1]
    assert (tmp_path / "out" / "two" / "good").is_dir() == ("png" in formats)
    assert not (tmp_path / "out" / "two" / "bad").exists() and not (tmp_path / "out" / "two.glb").exists()


@pytest.mark.long
@pytest.mark.parametrize("formats", ["png,glb", "glb"])
def test_a_missing_image_that_is_not_baked_is_found_first(tmp_path, capsys, formats) -> None:
    made = small()
    made.material("lamp", emissiveTexture={"index": made.texture(0)})
    made.json["images"].append({"uri": "gone.png"})
    made.json["textures"][-1]["source"] = len(made.json["images"]) - 1
    source, other = made.write(tmp_path / "lamp"), write_set(tmp_path / "metal")
    code, report = bake(source, other, "-o", tmp_path / "out", "--format", formats)
    assert code == 3 and not report["results"][0]["ok"] and "gone.png" in report["results"][0]["error"]
    first, second = [line for line in capsys.readouterr().err.splitlines() if line.startswith("mipbake: ")]
    assert "gone.png" in first and "lamp.glb is not written, because some" in second
    assert (tmp_path / "out" / "lamp").exists() == ("png" in formats) and (tmp_path / "out" / "metal").exists()


def test_a_missing_image_that_nothing_shows_stays_an_address(tmp_path) -> None:
    made = small()
    made.json["images"].append({"uri": "gone.png", "name": "spare"})
    code, _ = bake(made.write(tmp_path / "bolt"), "-o", tmp_path / "out", "--format", "glb")
    assert code == 0
    written, _ = split((tmp_path / "out" / "bolt.glb").read_bytes())
    assert {"uri": "gone.png", "name": "spare"} in written["images"]


@pytest.mark.long
def test_a_preset_announces_what_is_written(tmp_path) -> None:
    source, folder = small().write(tmp_path / "bolt"), write_set(tmp_path / "metal")
    code, said = run("bake", source, "-o", tmp_path / "one", "--preset", "three", *LINEAR)
    assert code == 0 and "target auto, glb with ktx2:uastc in it" in said and "packing orm" not in said
    code, said = run("bake", source, folder, "-o", tmp_path / "two", "--preset", "three", *LINEAR)
    assert code == 0 and "ktx2:uastc or finer, packing orm, normals opengl; glb with ktx2:uastc in it" in said
