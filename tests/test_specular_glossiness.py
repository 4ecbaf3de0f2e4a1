"""Materials in specular and glossiness: the formula, glTF documents without the extension, folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.base.colour import srgb_to_linear
from mipbake.material.specular_glossiness import metallic_roughness
from mipbake.source.gltf.document import read_document
from mipbake.source.gltf.specular_glossiness import Converted, without_specular_glossiness
from mipbake.source.images.read import read_image
from mipbake.source.intake import jobs
from mipbake.source.jobs import Job
from mipbake.source.options import LoadOptions
from mipbake.stack.gltf.write import rewritten

from .gltf_files import GltfFile, check_structure, image_of, png
from .gltf_results import infos, results_of
from .input_files import encoded, find, height_field, write_image
from .test_presets import run

SG = "KHR_materials_pbrSpecularGlossiness"


def shaded(base: np.ndarray, metallic: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse albedo and F0 of glTF 2.0, appendix B."""
    return 0.96 * (1 - metallic) * base, 0.04 * (1 - metallic) + metallic * base


def wanted(diffuse: np.ndarray, specular: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse albedo and F0 of the extension."""
    return diffuse * (1 - specular.max(-1, keepdims=True)), specular


def test_what_metallic_roughness_can_represent_is_exact() -> None:
    rng = np.random.default_rng(1)
    base, metallic = rng.random((32, 32, 3)), rng.random((32, 32, 1))
    albedo, specular = shaded(base, metallic)
    diffuse = albedo / (1 - specular.max(-1, keepdims=True))
    found, share, loss = metallic_roughness(np.float32(diffuse), np.float32(specular))
    np.testing.assert_allclose(found, base, atol=2e-3)
    np.testing.assert_allclose(share, metallic, atol=2e-3)
    assert loss.lossless and loss.most < 1e-3


@pytest.mark.parametrize(
    ("diffuse", "specular", "base", "metallic"),
    [
        ((0.5, 0.2, 0.1), (0.04, 0.04, 0.04), (0.5, 0.2, 0.1), 0.0),  # a plastic
        ((0.0, 0.0, 0.0), (1.0, 0.766, 0.336), (1.0, 0.766, 0.336), 1.0),  # the extension's gold
        ((0.01, 0.01, 0.01), (0.041, 0.041, 0.041), (0.01, 0.01, 0.01), 0.0),  # black plastic, rounded: no metal
    ],
)
def test_known_materials(diffuse: Any, specular: Any, base: Any, metallic: float) -> None:
    found, share, _ = metallic_roughness(*(np.float32(each).reshape(1, 1, 3) for each in (diffuse, specular)))
    np.testing.assert_allclose(found[0, 0], base, atol=2e-3)
    assert share[0, 0, 0] == pytest.approx(metallic, abs=2e-3)


def test_the_rest_is_the_nearest_and_its_loss_is_reported() -> None:
    rng = np.random.default_rng(2)
    diffuse, specular = np.float32(rng.random((8, 8, 3))), np.float32(rng.random((8, 8, 3)))
    base, metallic, loss = metallic_roughness(diffuse, specular)
    differences = [a - b for a, b in zip(shaded(base, metallic), wanted(diffuse, specular), strict=True)]
    off = np.abs(differences).max((0, -1))
    assert loss.texels == 64 and loss.most == pytest.approx(off.max(), abs=1e-5)
    assert loss.counts == tuple(
        int(((off >= low) & (off < high)).sum()) for low, high in ((0.01, 0.03), (0.03, 0.1), (0.1, 9))
    )
    target = [each / scale for each, scale in zip(wanted(diffuse, specular), (0.96, 1), strict=True)]
    own = sum(np.square(d).sum(-1) for d in (differences[0] / 0.96, differences[1]))
    for share in np.linspace(0, 1, 101):  # no other metallic with its best base colour is nearer
        q = 1 - share
        best = np.clip((target[0] * q + (target[1] - 0.04 * q) * share) / (q * q + share * share), 0, 1)
        pairs = zip((q * best, 0.04 * q + share * best), target, strict=True)
        assert (sum(np.square(a - b).sum(-1) for a, b in pairs) > own - 0.02).all()


def glossy(**held: Any) -> GltfFile:
    """A material with textures of diffuse (0), of specular and gloss (1), and a normal map (2)."""
    made = GltfFile()
    for name, channels in (("diffuse", 4), ("specular", 4), ("normal", 3)):
        made.texture(made.image(png(name, channels=channels), name))
    textures = {"diffuseTexture": {"index": 0}, "specularGlossinessTexture": {"index": 1}}
    made.material("Glossy", normalTexture={"index": 2}, extensions={SG: {**textures, **held}})
    made.uses(SG)
    made.json["extensionsRequired"] = [SG]
    made.squares()
    return made


def converted(made: GltfFile, folder: Path, kind: str = "glb") -> Converted:
    scratch = folder / "scratch"
    scratch.mkdir()
    return without_specular_glossiness(read_document(made.write(folder / "a", kind)), scratch)


@pytest.mark.parametrize("kind", ["glb", "external"])
def test_a_document_is_converted_texel_by_texel(tmp_path: Path, kind: str) -> None:
    factors = {"diffuseFactor": [1, 0.5, 0.25, 0.7], "specularFactor": [0.5, 1, 1], "glossinessFactor": 0.9}
    found = converted(glossy(**factors), tmp_path, kind)
    (material,) = found.document.all("materials")
    assert SG not in str(found.document.json)
    assert "extensionsRequired" not in found.document.json
    pbr = material["pbrMetallicRoughness"]
    assert pbr["baseColorFactor"] == [1, 1, 1, 0.7] and pbr["metallicFactor"] == pbr["roughnessFactor"] == 1
    colours, packed, before = (tmp_path / name for name in ("base.png", "packed.png", "specular.png"))
    binary = found.document.buffers[0] or b""
    for path, slot in ((colours, "baseColorTexture"), (packed, "metallicRoughnessTexture")):
        path.write_bytes(image_of(found.document.json, binary, pbr[slot]["index"]))
    (tmp_path / "diffuse.png").write_bytes(png("diffuse", channels=4))
    before.write_bytes(png("specular", channels=4))
    diffuse, specular = (read_image(p).pixels / 255 for p in (tmp_path / "diffuse.png", before))
    linear = [srgb_to_linear(each[..., :3]) for each in (diffuse, specular)]
    base, metallic, loss = metallic_roughness(
        np.float32(linear[0] * [1, 0.5, 0.25]), np.float32(linear[1] * [0.5, 1, 1])
    )
    written, orm = (read_image(path).pixels / 65535 for path in (colours, packed))
    np.testing.assert_allclose(srgb_to_linear(written), base, atol=1e-4)
    np.testing.assert_allclose(orm[..., 2:], metallic, atol=1e-4)
    np.testing.assert_allclose(orm[..., 1], 1 - 0.9 * specular[..., 3], atol=1e-4)
    assert any(str(loss) in text and "material 0 (Glossy)" in text for text in found.warnings)
    # What only this material showed has gone; indices of the others are as they were.
    assert len(found.document.all("images")) == len(found.document.all("textures")) == 3
    if kind == "glb":  # the buffers of the others hold them without any view
        assert png("diffuse", channels=4) not in binary and png("specular", channels=4) not in binary


def test_what_is_the_same_everywhere_needs_no_texture(tmp_path: Path) -> None:
    made = glossy(specularFactor=[0.04] * 3, glossinessFactor=0.25)
    held = made.json["materials"][0]["extensions"][SG]
    del held["specularGlossinessTexture"]
    found = converted(made, tmp_path)
    pbr = found.document.all("materials")[0]["pbrMetallicRoughness"]
    assert (pbr["metallicFactor"], pbr["roughnessFactor"]) == (0, 0.75)
    assert "metallicRoughnessTexture" not in pbr and "baseColorTexture" in pbr
    assert found.warnings == () and "holds every texel to within 0.01" in found.notes[0]


def test_opacity_stays(tmp_path: Path) -> None:
    made = glossy()
    made.json["materials"][0]["alphaMode"] = "BLEND"
    found = converted(made, tmp_path)
    index = found.document.all("materials")[0]["pbrMetallicRoughness"]["baseColorTexture"]["index"]
    path, before = tmp_path / "base.png", tmp_path / "diffuse.png"
    path.write_bytes(image_of(found.document.json, found.document.buffers[0] or b"", index))
    before.write_bytes(png("diffuse", channels=4))
    np.testing.assert_array_equal(read_image(path).pixels[..., 3] // 257, read_image(before).pixels[..., 3])


def test_textures_apart_on_the_surface_are_refused(tmp_path: Path) -> None:
    made = glossy(specularGlossinessTexture={"index": 1, "texCoord": 1})
    found = converted(made, tmp_path)
    assert found.document.json["extensionsRequired"] == [SG]
    assert "different texture coordinates" in found.warnings[0]
    code, _ = run("bake", tmp_path / "a.glb", "-o", tmp_path / "out", "--method", "linear")
    assert code == 3 and not (tmp_path / "out").exists()


def test_an_animated_factor_is_refused(tmp_path: Path) -> None:
    made = glossy()
    pointer = f"/materials/0/extensions/{SG}/glossinessFactor"
    target = {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": pointer}}}
    made.json["animations"] = [{"channels": [{"sampler": 0, "target": target}], "samplers": []}]
    assert "an animation sets" in converted(made, tmp_path).warnings[0]


def test_a_broken_texture_is_an_error(tmp_path: Path) -> None:
    made = glossy(diffuseTexture={"index": 77})
    assert "cannot be baked" in converted(made, tmp_path).errors[0]


def test_the_baked_document_has_no_trace_of_it(tmp_path: Path) -> None:
    """Before, it kept the extension, which wins over the metallic-roughness texture that was put beside it."""
    made = glossy()
    # For readers without the extension; the two need not agree.
    made.json["materials"][0]["pbrMetallicRoughness"] = {"roughnessFactor": 0.123, "baseColorTexture": {"index": 0}}
    (job,) = jobs([str(made.write(tmp_path / "shiny"))], LoadOptions(), tmp_path / "scratch")
    assert isinstance(job, Job) and job.document is not None and job.bake is not None
    assert "cannot represent" in job.warnings[0]
    (result,) = results_of((job.bake,), False)
    document, binary = check_structure(rewritten(job.document, [result], {}))
    assert SG not in str(document)
    for slot, info in infos(document["materials"][0]).items():
        assert image_of(document, binary, info["index"]) == result.maps[slot]
    assert b"\x89PNG" not in binary and len(document["images"]) == 3


def write_glossy_set(folder: Path, **files: np.ndarray) -> Path:
    """A folder of 16 x 16 maps in diffuse, specular and glossiness, some replaced or left out (None)."""
    folder.mkdir()
    rng = np.random.default_rng(3)
    maps: dict[str, Any] = {
        "Diffuse": rng.integers(0, 200, (16, 16, 3)).astype(np.uint8),
        "Specular": rng.integers(0, 200, (16, 16, 3)).astype(np.uint8),
        "Glossiness": rng.integers(0, 255, (16, 16, 1)).astype(np.uint8),
        "Normal": encoded(height_field(16, 16)),
        **files,
    }
    for name, pixels in maps.items():
        if pixels is not None:
            write_image(folder / f"rust_{name}.png", pixels)
    return folder


def test_a_folder_is_converted(tmp_path: Path) -> None:
    folder = write_glossy_set(tmp_path / "rust")
    found = mipbake.load(folder)
    linear = [srgb_to_linear(read_image(folder / f"rust_{n}.png").pixels / 255) for n in ("Diffuse", "Specular")]
    base, metallic, loss = metallic_roughness(*(np.float32(each) for each in linear))
    np.testing.assert_allclose(found.maps["base_color"].pixels, base, atol=1e-4)
    np.testing.assert_allclose(found.maps["metallic"].pixels, metallic, atol=1e-4)
    gloss = read_image(folder / "rust_Glossiness.png").pixels / 255
    np.testing.assert_allclose(found.maps["roughness"].pixels, 1 - gloss, atol=1e-6)
    assert any(str(loss) in text for text in found.warnings)
    assert not any("no metallic map" in note for note in found.notes) and not found.ignored
    # What is written has the names of what it is now.
    files = mipbake.bake(found, "linear").save(tmp_path / "out")
    assert [f.stem for f in files] == ["stack", "base_color", "rust_Normal", "rust_Glossiness", "metallic"]
    assert set(mipbake.open_stack(tmp_path / "out").provenance.sources) >= {"rust_Diffuse.png", "rust_Specular.png"}


def test_gloss_in_the_alpha_of_the_specular_map(tmp_path: Path) -> None:
    packed = np.random.default_rng(4).integers(0, 255, (16, 16, 4)).astype(np.uint8)
    folder = write_glossy_set(tmp_path / "rust", Specular=None, Glossiness=None, SpecularSmoothness=packed)
    found = mipbake.load(folder)
    np.testing.assert_allclose(found.maps["roughness"].pixels[..., 0], 1 - packed[..., 3] / 255, atol=1e-6)
    assert found.maps["metallic"].source.converted
    assert not any(role.startswith("carried") for role in found.maps)


@pytest.mark.parametrize("beside", ["Metallic", "Roughness"])
def test_other_sets_are_as_they_were(tmp_path: Path, beside: str) -> None:
    """A metallic map says what the workflow is; a specular map beside a roughness may be an amount for dielectrics."""
    grey = np.full((16, 16, 1), 99, np.uint8)
    files = {beside: grey} | ({"Glossiness": None} if beside == "Roughness" else {})
    found = find(write_glossy_set(tmp_path / "rust", **files))
    assert not found.maps["metallic"].converted
    assert [item.path.name for item in found.ignored] == ["rust_Specular.png"]


def test_a_specular_map_is_chosen_or_left_out_by_option(tmp_path: Path) -> None:
    folder = write_glossy_set(tmp_path / "rust")
    assert not find(folder, maps={"specular": None}).maps["metallic"].converted
    (folder / "rust_Specular.png").rename(folder / "shine.png")
    maps = {"specular": "shine.png"}
    assert find(folder, maps=maps).maps["metallic"].converted
    with pytest.raises(mipbake.UsageError, match="beside a metallic map"):
        find(folder, maps={**maps, "metallic": 0.5})
