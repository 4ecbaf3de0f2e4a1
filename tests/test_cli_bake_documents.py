"""`mipbake bake` on glTF documents: what it writes beside and in place of them, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

import mipbake
from mipbake.baking import BakeOptions
from mipbake.cli.main import main
from mipbake.source.intake import jobs
from mipbake.source.options import LoadOptions

from .command_line import LINEAR, bake, fails, tree, write_set
from .gltf_files import GltfFile, check_structure, png
from .gltf_results import two_textures
from .input_files import encoded, height_field
from .packed_sets import grey, write


def small(name: str = "n") -> GltfFile:
    """A document of one material."""
    return two_textures(png("normal " + name), png("mr"))


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


def two_materials(folder: Path, broken: bool = False) -> Path:
    """A document of the materials "good" and "bad"; pixels of the normal map of one may be missing."""
    made = GltfFile()
    for name in ("good", "bad"):
        data = png(f"normal {name}")
        made.texture(made.image(data[: len(data) * 2 // 3] if broken and name == "bad" else data, name))
        made.material(name, normalTexture={"index": len(made.json["textures"]) - 1})
    return made.write(folder / "two")


def test_every_material_of_a_document_is_baked(tmp_path) -> None:
    """Into files, and into the document itself."""
    code, report = bake(two_materials(tmp_path), "-o", tmp_path / "out", "--format", "png,glb")
    assert code == 0
    good, bad, document = report["results"]
    assert [Path(each["out"]).name for each in (good, bad, document)] == ["good", "bad", "two.glb"]
    for each in (good, bad):
        assert {Path(file["path"]) for file in each["files"]} == set(Path(each["out"]).iterdir())
        assert mipbake.open_stack(each["out"]).size == (16, 16)
        assert [cost["format"] for cost in each["costs"]] == ["glb", "png:8"]
    after, _ = check_structure((tmp_path / "out" / "two.glb").read_bytes())
    assert [m["name"] for m in after["materials"]] == ["good", "bad"]
    made = after["asset"]["extras"]["mipbake"]
    assert made["version"] == mipbake.__version__ and made["materials"]["good"]["method"] == "linear"
    assert document["files"][0]["path"] == str(tmp_path / "out" / "two.glb")


def test_what_is_not_ours_is_not_overwritten(tmp_path, capsys) -> None:
    source, out = small().write(tmp_path / "bolt"), tmp_path / "out"
    out.mkdir()
    for content in (b"somebody's", b"glTF", small("other").write(tmp_path / "other").read_bytes()):
        (out / "bolt.glb").write_bytes(content)
        said = fails(capsys, 4, "bake", source, "-o", out, "--format", "png,glb", *LINEAR)
        assert "bolt.glb" in said and "was not made by mipbake" in said
        assert tree(out) == ["bolt.glb"] and (out / "bolt.glb").read_bytes() == content
    before = source.read_bytes()
    assert "it is the source" in fails(capsys, 4, "bake", source, "-o", tmp_path, "--format", "glb", *LINEAR)
    assert source.read_bytes() == before


@pytest.mark.parametrize("formats", ["png", "png,glb"])
def test_a_broken_image_leaves_the_other_materials(tmp_path, capsys, formats) -> None:
    """It is told once, and the document as a whole is not written."""
    source = two_materials(tmp_path, broken=True)
    assert main(["bake", str(source), "-o", str(tmp_path / "out"), "--format", formats, *LINEAR]) == 3
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("mipbake: ")]
    assert len(lines) == 1 + ("glb" in formats)
    assert str(source) in lines[0] and "image 1 (bad)" in lines[0]
    assert "glb" not in formats or "two.glb is not written, because some" in lines[1]
    assert tree(tmp_path / "out")[:2] == ["two", "two/good"]
    assert not (tmp_path / "out" / "two" / "bad").exists() and not (tmp_path / "out" / "two.glb").exists()


@pytest.mark.long
def test_a_missing_image_that_is_not_baked_is_found_first(tmp_path, capsys) -> None:
    made = small()
    made.material("lamp", emissiveTexture={"index": made.texture(0)})
    made.json["images"].append({"uri": "gone.png"})
    made.json["textures"][-1]["source"] = len(made.json["images"]) - 1
    source, other = made.write(tmp_path / "lamp"), write_set(tmp_path / "metal")
    code, report = bake(source, other, "-o", tmp_path / "out", "--format", "glb")
    assert code == 3 and not report["results"][0]["ok"] and "gone.png" in report["results"][0]["error"]
    assert not (tmp_path / "out" / "lamp.glb").exists() and (tmp_path / "out" / "metal").exists()
    assert "lamp.glb is not written, because some" in capsys.readouterr().err
