"""What of a glTF document is beside its materials' own lobes: clearcoats, and textures that are averaged."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.base.colour import srgb_to_linear
from mipbake.base.errors import InputError
from mipbake.material.pixel_filter import filtered_levels
from mipbake.source.gltf.document import read_document
from mipbake.source.gltf.materials import GltfMaterials, read_materials
from mipbake.source.gltf.plain import PlainTexture
from mipbake.source.images.blocks import from_blocks
from mipbake.source.images.ktx2 import decoded
from mipbake.source.images.read import read_image
from mipbake.stack.gltf.glb_plain import averaged

from .gltf_files import GltfFile, check_structure, image_of, png
from .input_files import write_image
from .test_presets import run

CLEARCOAT, SHEEN = "KHR_materials_clearcoat", "KHR_materials_sheen"
NORMAL, COAT, COAT_NORMAL, GLOW, LEAF = range(5)


def car(**coat: Any) -> GltfFile:
    """A material with a normal map, a clearcoat with textures of its own, and one that glows."""
    made = GltfFile()
    for name, size, channels in (("normal", 16, 3), ("coat", 16, 3), ("normal coat", 16, 3), ("smooth", 16, 3)):
        made.texture(made.image(png(name, size, channels), name))
    made.texture(made.image(png("smooth leaf", 16, 4), "leaf"))
    held = {
        "clearcoatFactor": 0.8,
        "clearcoatTexture": {"index": COAT},
        "clearcoatRoughnessFactor": 0.5,
        "clearcoatRoughnessTexture": {"index": COAT},
        "clearcoatNormalTexture": {"index": COAT_NORMAL, "scale": 0.5},
        **coat,
    }
    glow = {"emissiveTexture": {"index": GLOW}, "emissiveFactor": [1, 1, 1]}
    made.material("Car", normalTexture={"index": NORMAL}, **glow, extensions={CLEARCOAT: held})
    made.uses(CLEARCOAT)
    return made


def read(made: GltfFile, folder: Path) -> GltfMaterials:
    images = folder / "images"
    images.mkdir(exist_ok=True)
    return read_materials(read_document(made.write(folder / "a")), images)


def bake(made: GltfFile, folder: Path) -> tuple[dict[str, Any], bytes, str]:
    """The GLB that is written, and what is said."""
    made.squares()
    code, said = run("bake", made.write(folder / "car"), "-o", folder / "out", "--method", "linear", "-v")
    assert code == 0, said
    return *check_structure((folder / "out" / "car.glb").read_bytes()), said


def levels_of(document: dict[str, Any], binary: bytes, texture: int) -> list[np.ndarray]:
    """(H, W, C) uint8 of a texture."""
    return [level * 255 for level in from_blocks(decoded(image_of(document, binary, texture), "a texture"))]


def test_a_clearcoat_is_a_set_of_a_dielectric(tmp_path: Path) -> None:
    car_, coat = read(car(), tmp_path).bakes
    assert (car_.name, coat.name, coat.materials) == ("Car", "Car_clearcoat", (0,))
    assert coat.slots == ("clearcoatRoughnessTexture", "clearcoatNormalTexture")
    assert coat.options.factors == {"roughness": 0.5, "normal": 0.5}
    found = mipbake.load(coat.files, coat.options)
    assert not found.maps["base_color"].pixels.any() and not found.maps["metallic"].pixels.any()
    path = tmp_path / "coat.png"
    path.write_bytes(png("coat"))
    wanted = read_image(path).pixels / 255
    np.testing.assert_allclose(found.maps["roughness"].pixels[..., 0], wanted[..., 1] * 0.5, atol=1e-6)
    np.testing.assert_allclose(found.maps["occlusion"].pixels[..., 0], wanted[..., 0], atol=1e-6)


def test_a_coat_that_is_not_seen_or_has_nothing_to_filter_is_none(tmp_path: Path) -> None:
    for coat in (
        {"clearcoatFactor": 0},
        {"clearcoatRoughnessTexture": {}, "clearcoatNormalTexture": {}},
        {"clearcoatRoughnessFactor": 0, "clearcoatNormalTexture": {}},
    ):
        assert [bake.name for bake in read(car(**coat), tmp_path).bakes] == ["Car"]


def test_a_coat_apart_on_the_surface_or_inverted_is_reported(tmp_path: Path) -> None:
    found = read(car(clearcoatNormalTexture={"index": COAT_NORMAL, "texCoord": 1}), tmp_path)
    assert len(found.bakes) == 1 and "the clearcoat of material 0 (Car)" in found.warnings[0]
    found = read(car(clearcoatNormalTexture={"index": COAT_NORMAL, "scale": -1}), tmp_path)
    assert len(found.bakes) == 1 and "inverts its bumps" in found.warnings[0]


def test_a_broken_coat_is_an_error(tmp_path: Path) -> None:
    found = read(car(clearcoatNormalTexture={"index": 99}), tmp_path)
    assert "clearcoat of material 0 (Car)" in found.errors[0] and len(found.bakes) == 1
    with pytest.raises(InputError, match="clearcoatRoughnessFactor"):
        made = car(clearcoatRoughnessFactor=7)
        del made.json["materials"][0]["normalTexture"]
        read(made, tmp_path)


@pytest.mark.long
def test_a_clearcoat_is_prefiltered_with_its_own_normals(tmp_path: Path) -> None:
    """Its roughness widens with the spread of its own normals, in the file itself."""
    made = car()
    made.squares()
    source = made.write(tmp_path / "car")
    for method in ("linear", "lean"):
        code, said = run("bake", source, "-o", tmp_path / method, "--method", method)
        assert code == 0, said
    means = []
    for method in ("linear", "lean"):
        document, binary = check_structure((tmp_path / method / "car.glb").read_bytes())
        held = document["materials"][0]["extensions"][CLEARCOAT]
        factor = held["clearcoatRoughnessFactor"]  # both are stretched to the eight bits that they have
        assert 0 < factor <= 1 and 0 < held["clearcoatNormalTexture"]["scale"] <= 1
        assert held["clearcoatFactor"] == 0.8
        assert held["clearcoatTexture"]["index"] == held["clearcoatRoughnessTexture"]["index"]
        chain = levels_of(document, binary, held["clearcoatRoughnessTexture"]["index"])
        assert len(chain) == len(levels_of(document, binary, held["clearcoatNormalTexture"]["index"])) == 5
        means.append(factor * chain[3][..., 1].mean())
        path = tmp_path / "coat.png"
        path.write_bytes(png("coat"))
        amount = read_image(path).pixels[..., 0].mean()
        assert chain[-1][0, 0, 0] == pytest.approx(amount, abs=6)  # averaged beside it
    assert means[1] > means[0] + 5


def test_plain_textures_are_reported_and_averaged(tmp_path: Path) -> None:
    made = car()
    del made.json["materials"][0]["extensions"]
    made.json["extensionsUsed"] = []
    document, binary, said = bake(made, tmp_path)
    reported = next(line for line in said.splitlines() if "not prefiltered" in line)
    assert "emissiveTexture of material 0 (Car)" in reported and "plain antialiased levels" in reported
    chain = levels_of(document, binary, document["materials"][0]["emissiveTexture"]["index"])
    assert [len(level) for level in chain] == [16, 8, 4, 2, 1]
    path = tmp_path / "glow.png"
    path.write_bytes(png("smooth"))
    mean = srgb_to_linear(read_image(path).pixels / 255).mean((0, 1))
    np.testing.assert_allclose(srgb_to_linear(chain[-1][0, 0] / 255), mean, atol=0.01)
    (cost,) = document["asset"]["extras"]["mipbake"]["plain"]
    assert re.fullmatch(r"emissiveTexture of material 0 \(Car\): [45]\d\.\d dB", cost) and cost in said


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "size", "noise", "sampler", "reported"),
    [
        ("pixel art.png", (32, 32), False, {"magFilter": 9728}, "single texels (magFilter NEAREST)"),
        ("noise.jpg", (16, 16), True, {"minFilter": 9987}, "stays as it is: blocks would leave it"),
    ],
)
def test_what_blocks_would_harm_stays_byte_for_byte(
    tmp_path: Path, name: str, size: tuple[int, int], noise: bool, sampler: dict[str, int], reported: str
) -> None:
    made = car()
    across, down = (np.arange(side) * 200 // side for side in size)
    pixels = np.random.default_rng(1).integers(0, 256, (*size[::-1], 3)) if noise else np.add.outer(down, across) // 2
    data = write_image(tmp_path / name, pixels.astype(np.uint8)).read_bytes()
    made.json["samplers"].append(sampler)
    glow = made.texture(made.image(data, "mine", "image/jpeg" if name.endswith("jpg") else "image/png"), 1)
    made.json["materials"][0]["emissiveTexture"] = {"index": glow}
    document, binary, said = bake(made, tmp_path)
    texture = document["textures"][document["materials"][0]["emissiveTexture"]["index"]]
    assert image_of(document, binary, glow) == data and document["samplers"][texture["sampler"]] == sampler
    assert any(reported in line and "emissiveTexture of material 0 (Car)" in line for line in said.splitlines())


@pytest.mark.long
def test_colours_and_amounts_of_one_image_part(tmp_path: Path) -> None:
    """The one is sRGB-encoded, the other is not: a file of each; alpha goes with the colours."""
    made = car()
    sheen = {"sheenColorTexture": {"index": LEAF}, "sheenRoughnessTexture": {"index": LEAF}}
    thick = {"thicknessTexture": {"index": LEAF}}
    made.json["materials"][0]["extensions"] |= {SHEEN: sheen, "KHR_materials_volume": thick}
    made.uses(SHEEN, "KHR_materials_volume")
    found = {texture.holds: texture for texture in read(made, tmp_path).plain if texture.image == LEAF}
    assert {slot for _, slot in found["colour"].uses} == {"sheenColorTexture", "sheenRoughnessTexture"}
    assert found["colour"].alpha and not found["data"].alpha
    document, binary, _ = bake(made, tmp_path)
    extensions = document["materials"][0]["extensions"]
    colour, data = extensions[SHEEN]["sheenColorTexture"], extensions["KHR_materials_volume"]["thicknessTexture"]
    assert colour == extensions[SHEEN]["sheenRoughnessTexture"] and colour != data
    formats = [decoded(image_of(document, binary, info["index"]), "").format.name for info in (colour, data)]
    assert formats == ["UASTC_RGBA_SRGB_BLOCK", "UASTC_RGB_UNORM_BLOCK"]


@pytest.mark.parametrize("mode", ["OPAQUE", "MASK", "BLEND"])
def test_the_alpha_of_a_colour_is_kept_where_it_is_seen(tmp_path: Path, mode: str) -> None:
    made = car()
    pbr = {"baseColorTexture": {"index": LEAF}, "baseColorFactor": [1, 1, 1, 0.8]}
    made.material("Leaf", pbrMetallicRoughness=pbr, alphaMode=mode, alphaCutoff=0.4)
    (leaf,) = (texture for texture in read(made, tmp_path).plain if texture.image == LEAF)
    assert leaf.uses == ((1, "baseColorTexture"),)
    assert (leaf.alpha, leaf.opacity, leaf.cutoff) == (
        mode != "OPAQUE",
        mode != "OPAQUE",
        pytest.approx(0.5) if mode == "MASK" else None,
    )


def test_colours_count_by_their_opacity() -> None:
    pixels = np.zeros((4, 4, 4), np.float32)
    pixels[:, :2] = (1, 0.5, 0.25, 1)  # the rest is black and hidden
    texture = PlainTexture(0, "colour", ("wrap", "wrap"), True, True, None, ())
    chain = averaged(texture, pixels)
    np.testing.assert_allclose(chain[-1][0, 0], (1, 0.5, 0.25, 0.5), atol=1e-5)
    blind = PlainTexture(0, "data", ("wrap", "wrap"), True, False, None, ())
    np.testing.assert_allclose(averaged(blind, pixels)[-1], filtered_levels(pixels, "box", ("wrap", "wrap"))[-1])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda j: j["images"][GLOW].update(bufferView=j["images"][LEAF]["bufferView"]), None),
        (lambda j: j["samplers"][0].update(magFilter=9728), "the sampler shows single texels"),
        (lambda j: j.update(extensions={"EXT_example": {"fuzzTexture": {"index": GLOW}}}), "something else shows the"),
        (lambda j: j["textures"][GLOW].update(source=5), "an image of 8 x 8 texels would have to be resampled"),
    ],
)
def test_what_stays_as_it_is_is_reported(tmp_path: Path, change: Any, reason: str | None) -> None:
    made = car()
    made.image(png("small", 8), "small")
    change(made.json)
    found = read(made, tmp_path)
    assert len(found.plain) == (reason is None)
    reported = f"emissiveTexture of material 0 (Car) stay as they are in a GLB: {reason}"
    assert any(note.startswith(reported) for note in found.notes) == (reason is not None)
