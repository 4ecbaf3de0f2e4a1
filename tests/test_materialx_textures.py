"""How MaterialX documents say that textures are decoded, placed, tiled and included."""

from __future__ import annotations

from pathlib import Path

import pytest

import mipbake
from mipbake.base.errors import InputError
from mipbake.source.mtlx.materials import read_materialx

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


# --- colour spaces and placement


@pytest.mark.parametrize(
    ("around", "own", "expected"),
    [
        ("", "srgb_texture", "sRGB"),
        ("", "lin_rec709", "linear Rec.709"),
        ("", "raw", "linear Rec.709"),
        ("", "acescg", "linear ACEScg"),
        ("", "lin_ap1_scene", "linear ACEScg"),
        ("", "srgb_displayp3", "Display P3"),
        ("", "lin_rec2020_scene", "linear ITU-R BT.2020"),
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
def test_doubtful_colour_spaces_are_told(folder: Path, around: str, own: str, warning: str) -> None:
    space = f'colorspace="{own}"' if own else ""
    outer = f'colorspace="{around}"' if around else ""
    found = only(document(folder, surface(image("b", "color3", "color.png", space), base_color="b"), outer))
    assert any(warning in w for w in found.warnings)


def test_data_in_an_encoded_colour_space_is_told(folder: Path) -> None:
    orm = image("orm", "color3", "orm.png", 'colorspace="srgb_texture"')
    one = node("extract", "n", "float", link("in", "orm"), value("index", "1", "integer"))
    assert any("read as data" in w for w in only(document(folder, surface(orm, one, specular_roughness="n"))).warnings)


@pytest.mark.parametrize(
    ("tilings", "told"), [(("2, 2", "2, 2"), False), (("1, 1", "3, 3"), True), ((None, "1, 1"), False)]
)
def test_maps_that_lie_otherwise_are_told(folder: Path, tilings: tuple[str | None, str], told: bool) -> None:
    rows = [
        image(
            stem, kind, f"{stem}.png", "", "tiledimage", "" if tiling is None else value("uvtiling", tiling, "vector2")
        )
        for (stem, kind), tiling in zip((("metal", "float"), ("rough", "float")), tilings, strict=True)
    ]
    body = "".join(rows) + material("standard_surface", link("specular_roughness", "rough"), link("metalness", "metal"))
    assert any("lies differently" in w for w in only(document(folder, body)).warnings) is told


@pytest.mark.parametrize(
    ("mode", "wrap", "told"), [("periodic", "wrap", False), ("clamp", "clamp", False), ("mirror", "clamp", True)]
)
def test_addressing(folder: Path, mode: str, wrap: str, told: bool) -> None:
    rough = image("r", "float", "rough.png", "", "image", value("vaddressmode", mode, "string"))
    found = only(document(folder, rough + material("standard_surface", link("specular_roughness", "r"))))
    assert found.options.wrap == ("wrap", wrap)
    assert any("addressed as" in w for w in found.warnings) is told


# --- tiles


def test_udim_tiles(folder: Path) -> None:
    for tile in (1001, 1012):
        write_image(folder / f"n.{tile}.png", pixels_for("normal", 8))
        write_image(folder / f"r.{tile}.png", pixels_for("roughness", 8))
    write_image(folder / "m_u2_v2.png", pixels_for("metallic", 8))
    body = (
        image("n", "vector3", "n.&lt;UDIM&gt;.png")
        + node("normalmap", "nm", "vector3", link("in", "n"))
        + image("r", "float", "r.&lt;UDIM&gt;.png")
        + image("m", "float", "m_&lt;UVTILE&gt;.png")
        + material("standard_surface", link("normal", "nm"), link("specular_roughness", "r"), link("metalness", "m"))
    )
    found = only(document(folder, body))
    assert found.udim
    assert short(found, folder)["roughness"] == "r.<UDIM>.png:R"
    assert len(found.files) == 5
    tiles = found.tiles()
    assert {tile: sorted(f.name for f in files) for tile, (files, _) in tiles.items()} == {
        1001: ["n.1001.png", "r.1001.png"],
        1012: ["m_u2_v2.png", "n.1012.png", "r.1012.png"],
    }
    for files, options in tiles.values():
        assert options.name == "Wood"
        assert mipbake.load(files, options).width == 8


def test_a_tile_without_roughness_is_refused(folder: Path) -> None:
    for name in ("n.1001.png", "n.1002.png", "r.1001.png"):
        write_image(folder / name, pixels_for("normal" if name[0] == "n" else "roughness", 8))
    body = (
        image("n", "vector3", "n.&lt;UDIM&gt;.png")
        + node("normalmap", "nm", "vector3", link("in", "n"))
        + image("r", "float", "r.&lt;UDIM&gt;.png")
        + material("standard_surface", link("normal", "nm"), link("specular_roughness", "r"))
    )
    with pytest.raises(InputError, match=r"tile 1002 has no roughness map: expected .*r\.1002\.png"):
        only(document(folder, body)).tiles()


# --- includes


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
