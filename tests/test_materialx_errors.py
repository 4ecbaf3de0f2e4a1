"""What MaterialX documents hold that cannot be read: what is said of it, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

import mipbake
from mipbake.base.errors import InputError
from mipbake.source.mtlx.materials import read_materialx
from mipbake.source.mtlx.shaders import SHADERS

from .mtlx_documents import document, image, link, material, node, only, short, surface, value, write_textures


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with textures beside where the document goes."""
    return write_textures(tmp_path)


# --- what cannot be read


@pytest.mark.parametrize(
    ("nodes", "role", "reason"),
    [
        ([node("noise2d", "n", "float")], "metallic", "noise2d (n)"),
        ([node("power", "n", "float", link("in1", "rough"), value("in2", "2"))], "metallic", "power (n)"),
        ([node("invert", "n", "float", link("in", "rough"))], "metallic", "one minus rough.png"),
        ([node("add", "n", "float", link("in1", "rough"), value("in2", "0.1"))], "metallic", "plus 0.1"),
        ([node("multiply", "n", "float", link("in1", "rough"), link("in2", "orm"))], "metallic", "two textures"),
        ([node("dot", "n", "float", link("in", "nowhere"))], "metallic", "nowhere, which is not there"),
        ([node("dot", "n", "float", link("in", "n"))], "metallic", "a loop"),
        ([node("image", "n", "float")], "metallic", "without a file"),
        ([node("extract", "n", "float", link("in", "orm"), value("index", "7", "integer"))], "metallic", "channel 7"),
        ([node("multiply", "n", "float", link("in1", "rough"), value("in2", "nan"))], "metallic", "the value 'nan'"),
        (
            [node("multiply", "n", "float", link("in1", "rough"), value("in2", "1e999"))],
            "metallic",
            "the value '1e999'",
        ),
        (
            [node("extract", "n", "float", link("in", "orm"), value("index", "inf", "integer"))],
            "metallic",
            "channel -1",
        ),
        ([node("bump", "n", "vector3", link("height", "rough"))], "normal", "bump (n)"),
        (
            [node("normalmap", "n", "vector3", link("in", "orm"), value("space", "object", "string"))],
            "normal",
            "object",
        ),
        (
            [node("combine3", "n", "color3", link("in1", "rough"), link("in2", "orm"), link("in3", "rough"))],
            "base_color",
            "several textures",
        ),
    ],
)
def test_what_cannot_be_read_is_told(folder: Path, nodes: Sequence[str], role: str, reason: str) -> None:
    name = SHADERS["standard_surface"].inputs[role]
    body = surface(image("orm", "vector3", "orm.png"), *nodes, **{name: "n"})
    found = only(document(folder, body))
    default = SHADERS["standard_surface"].defaults.get(role)
    assert found.options.maps[role] == default
    assert any(reason in w and "cannot be read" in w for w in found.warnings), found.warnings
    mipbake.load(found.files, found.options)


@pytest.mark.parametrize("cutoff", ["0", "2", "-1"])
def test_cutoffs_that_no_opacity_reaches_are_left_out(folder: Path, cutoff: str) -> None:
    body = image("rough", "float", "rough.png") + image("mask", "float", "mask.png")
    inputs = [link("roughness", "rough"), link("alpha", "mask"), value("alpha_mode", "1", "integer")]
    found = only(document(folder, body + material("gltf_pbr", *inputs, value("alpha_cutoff", cutoff))))
    assert found.options.alpha_cutoff is None and "opacity" in short(found, folder)
    assert any(f"either side of the cutoff {cutoff}" in w for w in found.warnings)


def test_long_chains_end_in_a_sentence(folder: Path) -> None:
    nodes = [node("dot", f"n{i}", "float", link("in", f"n{i + 1}")) for i in range(3000)]
    found = only(document(folder, surface(*nodes, metalness="n0")))
    assert any("nodes in a row" in w for w in found.warnings)


def test_shared_nodes_are_read_once(folder: Path) -> None:
    """Each node doubles the one before: read anew at every use, they would take forever."""
    nodes = [
        node("mix", f"n{i}", "float", link("fg", f"n{i + 1}"), link("bg", f"n{i + 1}"), link("mix", f"n{i + 1}"))
        for i in range(40)
    ]
    constant = node("constant", "n40", "float", value("value", "0.25"))
    assert only(document(folder, surface(*nodes, constant, metalness="n0"))).options.maps["metallic"] == pytest.approx(
        0.25
    )


def test_unused_textures_are_told(folder: Path) -> None:
    found = only(document(folder, surface(image("coat", "float", "mask.png"), coat_roughness="coat")))
    assert any("mask.png: fills coat_roughness" in n for n in found.notes)


@pytest.mark.parametrize("input_name", ["emission_color", "specular_anisotropy"])
def test_maps_of_weights_and_anisotropy(folder: Path, input_name: str) -> None:
    found = only(document(folder, surface(image("g", "float", "glow.png"), **{input_name: "g"})))
    if input_name == "emission_color":
        assert found.options.maps["emissive"] is None
        assert any("emission is 0" in n for n in found.notes)
    else:
        assert short(found, folder)["anisotropy"] == "glow.png:R"
        assert any("KHR_materials_anisotropy" in w for w in found.warnings)
        assert mipbake.load(found.files, found.options).anisotropic


def test_a_constant_colour_is_grey_and_told(folder: Path) -> None:
    body = image("r", "float", "rough.png")
    shader = material("standard_surface", link("specular_roughness", "r"), value("base_color", "1, 0, 0", "color3"))
    found = only(document(folder, body + shader))
    assert found.options.maps["base_color"] == pytest.approx(0.2126)
    assert any("1, 0, 0" in n for n in found.notes)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (material("standard_surface", value("specular_roughness", "0.3")), "procedural or constant.*bake it to"),
        (
            node("noise2d", "n", "float") + material("gltf_pbr", link("roughness", "n"), link("normal", "n")),
            r"noise2d \(n\).*bake it to textures first",
        ),
        (material("disney_principled"), "made of disney_principled: expected one of standard_surface"),
        ('<surfacematerial name="M" type="material"/>', "it has no surfaceshader"),
        ("", "holds no material"),
        (surface().replace("rough.png", "none.png"), r"names none\.png, which is not there"),
        (surface().replace("rough.png", "a.&lt;UDIM&gt;.png"), "stands for no file"),
        (
            image("r", "float", "rough.png")
            + material("UsdPreviewSurface", link("roughness", "r"), value("useSpecularWorkflow", "1", "integer")),
            "specular workflow",
        ),
    ],
)
def test_documents_without_textures_to_read_are_refused(folder: Path, body: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_materialx(document(folder, body))


BOMB = '<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><materialx>&b;</materialx>'


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is damaged in line 1"),
        (b'<materialx version="1.38">\n<image>\n</materialx>', r"is damaged in line 3 \(mismatched tag\)"),
        (b"\x89PNG\r\n\x1a\n", "is damaged in line"),
        (b'<?xml version="1.0" encoding="nonsense-8"?><materialx/>', "wood.mtlx is"),
        (BOMB.encode(), "document type"),
        (BOMB.encode("utf-16"), "document type"),
        (b'<!DOCTYPE m SYSTEM "file:///etc/hostname"><materialx/>', "document type"),
        (b"<materialx>&undefined;</materialx>", "is damaged in line 1"),
        (b"<gltf/>", "holds <gltf>"),
        (b'<materialx version="1.36"/>', "MaterialX 1.36: expected 1.38 or 1.39"),
        (b"<materialx>" + b" " * (17 << 20) + b"</materialx>", "larger than 16 MiB"),
    ],
)
def test_damaged_documents_are_refused_in_a_sentence(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "wood.mtlx"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_materialx(path)
    assert "\n" not in str(caught.value)


def test_a_missing_document_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_materialx(tmp_path / "none.mtlx")
