"""MaterialX documents: how textures are decoded, placed and tiled, and what is said of what cannot be read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

import mipbake
from mipbake.base.errors import InputError
from mipbake.source.mtlx.materials import read_materialx
from mipbake.source.mtlx.shaders import SHADERS

from .input_files import pixels_for, write_image
from .mtlx_documents import document, image, link, material, node, only, short, surface, value, write_textures


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with textures beside where the document goes."""
    return write_textures(tmp_path)


def test_backslashes_lead_into_folders_unless_a_file_is_called_so(folder: Path) -> None:
    (folder / "maps").mkdir()
    for name in ("maps/color.png", "maps\\color.png"):
        write_image(folder / name, pixels_for("base_color"))
        found = only(document(folder, surface(image("base", "color3", "maps\\color.png"), base_color="base")))
        assert mipbake.load(found.files, found.options).maps["base_color"].source.path == folder / name


@pytest.mark.parametrize(
    ("around", "own", "expected"),
    [
        ("", "srgb_texture", "sRGB"),
        ("", "raw", "linear Rec.709"),
        ("", "acescg", "linear ACEScg"),
        ("", "lin_ap1_scene", "linear ACEScg"),
        ("lin_rec709", "srgb_texture", "sRGB"),
        ("srgb_texture", "", "sRGB"),
        ("", "", None),
    ],
)
def test_colour_spaces(folder: Path, around: str, own: str, expected: str | None) -> None:
    space = f'colorspace="{own}"' if own else ""
    body = surface(image("base", "color3", "color.png", space), base_color="base")
    found = only(document(folder, body, f'version="1.38" {around and f"colorspace={chr(34)}{around}{chr(34)}"}'))
    assert found.options.colour_space == expected
    assert found.warnings == ()
    assert mipbake.load(found.files, found.options).maps["base_color"].source.encoding == (expected or "sRGB")


@pytest.mark.parametrize(
    ("around", "own", "warning"),
    [("lin_rec709", "", "is linear by the document"), ("", "g22_rec709", "close to"), ("", "mystery", "is not known")],
)
def test_doubtful_colour_spaces_are_reported(folder: Path, around: str, own: str, warning: str) -> None:
    space = f'colorspace="{own}"' if own else ""
    outer = f'colorspace="{around}"' if around else ""
    found = only(document(folder, surface(image("b", "color3", "color.png", space), base_color="b"), outer))
    assert any(warning in w for w in found.warnings)


def test_data_in_an_encoded_colour_space_is_reported(folder: Path) -> None:
    orm = image("orm", "color3", "orm.png", 'colorspace="srgb_texture"')
    one = node("extract", "n", "float", link("in", "orm"), value("index", "1", "integer"))
    assert any("read as data" in w for w in only(document(folder, surface(orm, one, specular_roughness="n"))).warnings)


@pytest.mark.parametrize(
    ("tilings", "reported"), [(("2, 2", "2, 2"), False), (("1, 1", "3, 3"), True), ((None, "1, 1"), False)]
)
def test_maps_that_lie_otherwise_are_reported(folder: Path, tilings: tuple[str | None, str], reported: bool) -> None:
    rows = [
        image(
            stem, kind, f"{stem}.png", "", "tiledimage", "" if tiling is None else value("uvtiling", tiling, "vector2")
        )
        for (stem, kind), tiling in zip((("metal", "float"), ("rough", "float")), tilings, strict=True)
    ]
    body = "".join(rows) + material("standard_surface", link("specular_roughness", "rough"), link("metalness", "metal"))
    assert any("lies differently" in w for w in only(document(folder, body)).warnings) is reported


@pytest.mark.parametrize(
    ("mode", "wrap", "reported"), [("periodic", "wrap", False), ("clamp", "clamp", False), ("mirror", "clamp", True)]
)
def test_addressing(folder: Path, mode: str, wrap: str, reported: bool) -> None:
    rough = image("r", "float", "rough.png", "", "image", value("vaddressmode", mode, "string"))
    found = only(document(folder, rough + material("standard_surface", link("specular_roughness", "r"))))
    assert found.options.wrap == ("wrap", wrap)
    assert any("addressed as" in w for w in found.warnings) is reported


TILED = (
    image("n", "vector3", "n.&lt;UDIM&gt;.png")
    + node("normalmap", "nm", "vector3", link("in", "n"))
    + image("r", "float", "r.&lt;UDIM&gt;.png")
    + image("m", "float", "m_&lt;UVTILE&gt;.png")
    + material("standard_surface", link("normal", "nm"), link("specular_roughness", "r"), link("metalness", "m"))
)


def test_udim_tiles(folder: Path) -> None:
    for tile in (1001, 1012):
        write_image(folder / f"n.{tile}.png", pixels_for("normal", 8))
        write_image(folder / f"r.{tile}.png", pixels_for("roughness", 8))
    write_image(folder / "m_u2_v2.png", pixels_for("metallic", 8))
    found = only(document(folder, TILED))
    assert found.udim and len(found.files) == 5
    tiles = found.tiles()
    assert {tile: sorted(f.name for f in files) for tile, (files, _) in tiles.items()} == {
        1001: ["n.1001.png", "r.1001.png"],
        1012: ["m_u2_v2.png", "n.1012.png", "r.1012.png"],
    }
    for files, options in tiles.values():
        assert mipbake.load(files, options).width == 8
    (folder / "r.1012.png").unlink()
    with pytest.raises(InputError, match=r"tile 1012 has no roughness map: expected .*r\.1012\.png"):
        only(document(folder, TILED)).tiles()


XI = 'version="1.38" xmlns:xi="http://www.w3.org/2001/XInclude"'


def test_includes_are_followed_once(folder: Path) -> None:
    inner = folder / "lib"
    inner.mkdir()
    (folder / "rough.png").rename(inner / "rough.png")
    document(inner, image("rough", "float", "rough.png") + '<xi:include href="more.mtlx"/>', XI, "nodes.mtlx")
    shader = material("standard_surface", link("specular_roughness", "rough"))
    found = only(document(folder, '<xi:include href="lib/nodes.mtlx"/>' + shader, XI))
    assert short(found, inner)["roughness"] == "rough.png:R"
    assert any("includes lib/nodes.mtlx" in n for n in found.notes)
    assert any("more.mtlx" in n and "not followed" in n for n in found.notes)


def test_no_document_is_included_twice(folder: Path) -> None:
    """A document is not even included by itself: every material would come again."""
    document(folder, surface(), XI, "parts.mtlx")
    twice = '<xi:include href="parts.mtlx"/><xi:include href="./parts.mtlx"/><xi:include href="main.mtlx"/>'
    only(document(folder, twice, XI, "main.mtlx"))


@pytest.mark.parametrize("href", ["none.mtlx", "", "/etc/hosts", "https://example.org/a.mtlx"])
def test_includes_that_cannot_be_followed_are_refused(folder: Path, href: str) -> None:
    with pytest.raises(InputError, match="includes"):
        read_materialx(document(folder, f'<xi:include href="{href}"/>' + surface(), XI))


def one(tag: str, *inputs: str, kind: str = "float") -> list[str]:
    return [node(tag, "n", kind, *inputs)]


ROUGH, TWO = link("in1", "rough"), [link("in1", "rough"), link("in2", "orm"), link("in3", "rough")]


@pytest.mark.parametrize(
    ("nodes", "role", "reason"),
    [
        (one("noise2d"), "metallic", "noise2d (n)"),
        (one("invert", link("in", "rough")), "metallic", "one minus rough.png"),
        (one("add", ROUGH, value("in2", "0.1")), "metallic", "plus 0.1"),
        (one("multiply", ROUGH, link("in2", "orm")), "metallic", "two textures"),
        (one("dot", link("in", "nowhere")), "metallic", "nowhere, which is not there"),
        (one("dot", link("in", "n")), "metallic", "a loop"),
        (one("image"), "metallic", "without a file"),
        (one("extract", link("in", "orm"), value("index", "7", "integer")), "metallic", "channel 7"),
        (one("multiply", ROUGH, value("in2", "nan")), "metallic", "the value 'nan'"),
        (one("multiply", ROUGH, value("in2", "1e999")), "metallic", "the value '1e999'"),
        (one("divide", ROUGH, value("in2", "0")), "metallic", "divide (n)"),
        (one("bump", link("height", "rough"), kind="vector3"), "normal", "bump (n)"),
        (one("normalmap", link("in", "orm"), value("space", "object", "string"), kind="vector3"), "normal", "object"),
        (one("combine3", *TWO, kind="color3"), "base_color", "several textures"),
    ],
)
def test_what_cannot_be_read_is_reported(folder: Path, nodes: Sequence[str], role: str, reason: str) -> None:
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


def test_a_constant_colour_is_grey_and_reported(folder: Path) -> None:
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
