"""MaterialX documents: what each shader says, and what the nodes between a texture and it do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.source.mtlx.materials import read_materialx
from mipbake.source.mtlx.shaders import SHADERS

from .input_files import pixels_for, write_image
from .mtlx_documents import document, image, link, material, node, only, short, surface, value, write_textures


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with textures beside where the document goes."""
    return write_textures(tmp_path)


def test_top_level_nodes_with_displacement(folder: Path) -> None:
    """Flat documents of scanned material libraries: image nodes beside the shader, height on the material."""
    body = (
        image("Wood_Color", "color3", "color.png", 'colorspace="srgb_texture"', "tiledimage")
        + image("Wood_Metal", "float", "metal.png", "", "tiledimage")
        + image("Wood_Rough", "float", "rough.png", "", "tiledimage")
        + image("Wood_NormalGL", "vector3", "normal.png", "", "tiledimage")
        + image("Wood_Height", "float", "height.png", "", "tiledimage")
        + node("normalmap", "Wood_nm", "vector3", link("in", "Wood_NormalGL", "vector3"), value("scale", "1.0"))
        + node(
            "displacement", "Wood_disp", "displacementshader", link("displacement", "Wood_Height"), value("scale", "1")
        )
        + material(
            "standard_surface",
            value("base", "1"),
            link("base_color", "Wood_Color", "color3"),
            link("metalness", "Wood_Metal"),
            link("specular_roughness", "Wood_Rough"),
            link("normal", "Wood_nm", "vector3"),
            rest='<input name="displacementshader" type="displacementshader" nodename="Wood_disp"/>',
        )
    )
    found = only(document(folder, body, 'version="1.38" colorspace="lin_rec709"'))
    assert short(found, folder) == {
        "base_color": "color.png",
        "normal": "normal.png",
        "roughness": "rough.png:R",
        "metallic": "metal.png:R",
        "height": "height.png:R",
    }
    assert (found.name, found.udim) == ("Wood", False)
    options = found.options
    assert (options.name, options.colour_space, options.normal_convention) == ("Wood", "sRGB", "opengl")
    assert options.roughness_is_gloss is False
    assert options.factors == {}
    assert found.warnings == ()
    assert sorted(f.name for f in found.files) == ["color.png", "height.png", "metal.png", "normal.png", "rough.png"]
    loaded = mipbake.load(found.files, options)
    assert set(loaded.maps) == {"base_color", "normal", "roughness", "metallic", "height"}
    assert loaded.maps["base_color"].source.encoding == "sRGB"


def test_packed_outputs_of_a_graph_with_a_prefix(folder: Path) -> None:
    """Documents converted from glTF: a node graph, a file prefix, one image for occlusion, roughness and metallic."""
    inner = folder / "textures"
    inner.mkdir()
    for stem in ("color", "normal", "orm"):
        (folder / f"{stem}.png").rename(inner / f"{stem}.png")
    graph = (
        '<nodegraph name="NG">'
        + image("base", "color3", "color.png", 'colorspace="srgb_texture"')
        + image("nrm", "vector3", "normal.png")
        + image("orm", "vector3", "orm.png")
        + node("normalmap", "nm", "vector3", link("in", "nrm", "vector3"), value("scale", "0.5"))
        + '<output name="out_base" type="color3" nodename="base"/><output name="out_nm" type="vector3" nodename="nm"/>'
        + '<output name="out_orm" type="vector3" nodename="orm"/></nodegraph>'
    )
    shader = material(
        "gltf_pbr",
        '<input name="base_color" type="color3" nodegraph="NG" output="out_base"/>',
        '<input name="normal" type="vector3" nodegraph="NG" output="out_nm"/>',
        '<input name="occlusion" type="float" nodegraph="NG" output="out_orm" channels="x"/>',
        '<input name="roughness" type="float" nodegraph="NG" output="out_orm" channels="y"/>',
        '<input name="metallic" type="float" nodegraph="NG" output="out_orm" channels="z"/>',
    )
    found = only(document(folder, graph + shader, 'version="1.38" colorspace="lin_rec709" fileprefix="textures/"'))
    assert short(found, inner) == {
        "base_color": "color.png",
        "normal": "normal.png",
        "roughness": "orm.png:G",
        "metallic": "orm.png:B",
        "occlusion": "orm.png:R",
    }
    assert found.options.factors == {"normal": 0.5}
    assert found.warnings == ()
    packed = pixels_for("packed", 16) / 255
    loaded = mipbake.load(found.files, found.options)
    for channel, role in enumerate(("occlusion", "roughness", "metallic")):
        assert loaded.maps[role].pixels[..., 0] == pytest.approx(packed[..., channel], abs=1e-6)


def test_gltf_nodes_with_factors_and_alpha(folder: Path) -> None:
    body = (
        image(
            "base",
            "multioutput",
            "rgba.png",
            'colorspace="srgb_texture"',
            "gltf_colorimage",
            value("color", "1,1,1,0.5", "color4"),
        )
        + image("nrm", "vector3", "normal.png", "", "gltf_normalmap")
        + image("orm", "vector3", "orm.png", "", "gltf_image")
        + node("separate3", "parts", "multioutput", link("in", "orm", "vector3"))
        + material(
            "gltf_pbr",
            link("base_color", "base", "color3", 'output="outcolor"'),
            link("alpha", "base", "float", 'output="outa"'),
            value("alpha_mode", "1", "integer"),
            value("alpha_cutoff", "0.3"),
            link("normal", "nrm", "vector3"),
            link("roughness", "parts", "float", 'output="outy"'),
            value("metallic", "0"),
        )
    )
    found = only(document(folder, body, 'version="1.39"'))
    expected = {"base_color": "rgba.png", "normal": "normal.png", "roughness": "orm.png:G", "opacity": "rgba.png:A"}
    assert short(found, folder) == expected | {"metallic": 0.0}
    assert found.options.alpha_cutoff == 0.3
    assert found.options.factors == {"opacity": 0.5}


def test_open_pbr(folder: Path) -> None:
    body = (
        image("base", "color3", "color.png", 'colorspace="srgb_rec709_scene"')
        + image("rough", "float", "rough.png")
        + image("metal", "float", "metal.png")
        + image("nrm", "vector3", "normal.png")
        + image("mask", "float", "mask.png")
        + image("glow", "color3", "glow.png", 'colorspace="srgb_texture"')
        + node("normalmap", "nm", "vector3", link("in", "nrm", "vector3"))
        + material(
            "open_pbr_surface",
            value("base_weight", "0.8"),
            link("base_color", "base", "color3"),
            link("base_metalness", "metal"),
            link("specular_roughness", "rough"),
            value("specular_roughness_anisotropy", "0.5"),
            link("geometry_normal", "nm", "vector3"),
            link("geometry_opacity", "mask"),
            value("emission_luminance", "1000"),
            link("emission_color", "glow", "color3"),
        )
    )
    found = only(document(folder, body, 'version="1.39"'))
    assert set(short(found, folder)) == {"base_color", "normal", "roughness", "metallic", "opacity", "emissive"}
    assert found.options.colour_space == "sRGB"
    reported = " ".join(found.notes)
    for part in ("base_weight = 0.8", "anisotropy is the constant 0.5", "emission_luminance = 1000"):
        assert part in reported
    assert mipbake.load(found.files, found.options).source_model == "gltf"


def test_usd_preview_surface(folder: Path) -> None:
    def texture(name: str, file: str, *inputs: str) -> str:
        return image(name, "multioutput", file, "", "UsdUVTexture", "".join(inputs))

    body = (
        texture("base", "color.png", value("sourceColorSpace", "sRGB", "string"), value("wrapS", "clamp", "string"))
        + texture("orm", "orm.png", value("sourceColorSpace", "raw", "string"), value("wrapS", "clamp", "string"))
        + texture(
            "nrm",
            "normal.png",
            value("scale", "2, 2, 2, 1", "vector4"),
            value("bias", "-1, -1, -1, 0", "vector4"),
            value("wrapS", "clamp", "string"),
        )
        + texture("height", "height.png")
        + material(
            "UsdPreviewSurface",
            link("diffuseColor", "base", "color3", 'output="rgb"'),
            link("normal", "nrm", "vector3", 'output="rgb"'),
            link("roughness", "orm", "float", 'output="g"'),
            link("metallic", "orm", "float", 'output="b"'),
            link("displacement", "height", "float", 'output="r"'),
            link("opacity", "base", "float", 'output="a"'),
            value("opacityThreshold", "0.25"),
        )
    )
    write_image(folder / "color.png", pixels_for("packed_alpha", 16))
    found = only(document(folder, body))
    expected = {"base_color": "color.png", "normal": "normal.png", "roughness": "orm.png:G", "metallic": "orm.png:B"}
    assert short(found, folder) == expected | {"opacity": "color.png:A", "height": "height.png:R"}
    assert found.options.wrap == ("clamp", "wrap")
    assert found.options.alpha_cutoff == 0.25
    assert found.options.factors == {}
    assert mipbake.load(found.files, found.options).wrap == ("clamp", "wrap")


@pytest.mark.parametrize("shader", SHADERS)
def test_what_a_shader_leaves_out_is_its_default(folder: Path, shader: str) -> None:
    body = image("rough", "float", "rough.png") + material(shader, link(SHADERS[shader].inputs["roughness"], "rough"))
    found = only(document(folder, body))
    defaults = {role: value for role, value in SHADERS[shader].defaults.items() if role != "roughness"}
    assert short(found, folder) == defaults | {"roughness": "rough.png:R"}
    loaded = mipbake.load(found.files, found.options)
    assert loaded.convention.decided_by == "flat"
    assert (loaded.maps["metallic"].pixels == np.float32(defaults["metallic"])).all()


def test_a_material_that_cannot_be_read_does_not_hide_others(folder: Path) -> None:
    body = surface() + material("standard_surface", value("specular_roughness", "0.1"), name="Glass")
    found = only(document(folder, body))
    assert any("left out" in w and "Glass" in w for w in found.warnings)


def test_a_missing_texture_is_an_error_of_its_material(folder: Path) -> None:
    lost = image("gone", "float", "gone.png") + image("tiles", "float", "gone.&lt;UDIM&gt;.png")
    lost += "".join(
        material("standard_surface", link("specular_roughness", name), name=f"of {name}") for name in ("gone", "tiles")
    )
    found = read_materialx(document(folder, lost + surface()))
    assert len(found.materials) == 1 and not any("left out" in w for w in found.materials[0].warnings)
    file, pattern = found.errors
    assert "the material of gone names gone.png, which is not there" in file and "stands for no file" in pattern


def test_shaders_without_a_material_are_read(folder: Path) -> None:
    shader = f'<gltf_pbr name="Bare" type="surfaceshader">{link("roughness", "rough")}</gltf_pbr>'
    assert only(document(folder, image("rough", "float", "rough.png") + shader)).name == "Bare"


def test_interface_names_inside_and_outside(folder: Path) -> None:
    graph = (
        '<nodegraph name="NG"><input name="tex" type="filename" value="rough.png"/>'
        '<input name="amount" type="float" nodename="half"/>'
        '<image name="img" type="float"><input name="file" type="filename" interfacename="tex"/></image>'
        '<multiply name="mul" type="float"><input name="in1" type="float" nodename="img"/>'
        '<input name="in2" type="float" interfacename="amount"/></multiply>'
        '<output name="out" type="float" nodename="mul"/></nodegraph>'
    )
    half = node("constant", "half", "float", value("value", "0.5"))
    shader = material("standard_surface", '<input name="specular_roughness" type="float" nodegraph="NG"/>')
    found = only(document(folder, graph + half + shader))
    assert short(found, folder)["roughness"] == "rough.png:R"
    assert found.options.factors == {"roughness": 0.5}


def test_nodes_that_the_document_defines(folder: Path) -> None:
    custom = (
        '<nodedef name="ND_gloss" node="gloss_of"><input name="tex" type="filename" value=""/>'
        '<input name="amount" type="float" value="1"/><output name="out" type="float"/></nodedef>'
        '<nodegraph name="NG_gloss" nodedef="ND_gloss">'
        '<image name="img" type="float"><input name="file" type="filename" interfacename="tex"/></image>'
        '<invert name="inv" type="float"><input name="in" type="float" nodename="img"/>'
        '<input name="amount" type="float" interfacename="amount"/></invert>'
        '<output name="out" type="float" nodename="inv"/></nodegraph>'
        '<gloss_of name="g" type="float"><input name="tex" type="filename" value="rough.png"/></gloss_of>'
    )
    found = only(document(folder, custom + material("standard_surface", link("specular_roughness", "g"))))
    assert short(found, folder)["roughness"] == "rough.png:R"
    assert found.options.roughness_is_gloss is True


def test_outputs_of_the_document_and_namespaces(folder: Path) -> None:
    body = image("rough", "float", "rough.png") + '<output name="o" type="float" nodename="lib:rough"/>'
    shader = material("standard_surface", '<input name="specular_roughness" type="float" output="o"/>')
    assert short(only(document(folder, body + shader)), folder)["roughness"] == "rough.png:R"


def one(tag: str, *inputs: str) -> list[str]:
    return [node(tag, "n", "float", *inputs)]


ROUGH, INVERTED = link("in", "rough"), node("invert", "a", "float", link("in", "rough"))
SEPARATED = node("separate3", "s", "multioutput", link("in", "orm"))


@pytest.mark.parametrize(
    ("nodes", "expected", "factor", "gloss"),
    [
        (one("extract", link("in", "orm"), value("index", "1", "integer")), "orm.png:G", 1, False),
        ([SEPARATED, *one("dot", link("in", "s", rest='output="outb"'))], "orm.png:B", 1, False),
        (one("swizzle", link("in", "orm"), value("channels", "z", "string")), "orm.png:B", 1, False),
        (one("convert", ROUGH), "rough.png:R", 1, False),
        (one("subtract", value("in1", "1"), link("in2", "rough")), "rough.png:R", 1, True),
        (one("multiply", link("in1", "rough"), value("in2", "0.75")), "rough.png:R", 0.75, False),
        (one("divide", link("in1", "rough"), value("in2", "2")), "rough.png:R", 0.5, False),
        (one("remap", ROUGH, value("outlow", "1"), value("outhigh", "0")), "rough.png:R", 1, True),
        (one("range", ROUGH, value("inhigh", "2")), "rough.png:R", 0.5, False),
        (one("mix", value("fg", "0"), link("bg", "rough"), value("mix", "0.25")), "rough.png:R", 0.75, False),
        (one("clamp", ROUGH), "rough.png:R", 1, False),
        ([INVERTED, *one("multiply", link("in1", "a"), value("in2", "0.5"))], "rough.png:R", 0.5, True),
        ([INVERTED, *one("invert", link("in", "a"))], "rough.png:R", 1, False),
    ],
)
def test_nodes_between(folder: Path, nodes: Sequence[str], expected: str, factor: float, gloss: bool) -> None:
    body = surface(image("orm", "vector3", "orm.png"), *nodes, specular_roughness="n")
    found = only(document(folder, body))
    assert short(found, folder)["roughness"] == expected
    assert found.options.roughness_is_gloss is gloss
    assert found.options.factors.get("roughness", 1) == pytest.approx(factor)


@pytest.mark.parametrize("expected", ["opengl", "directx"])
def test_an_inverted_green_is_directx(folder: Path, expected: str) -> None:
    separated = node("separate3", "s", "multioutput", link("in", "nrm"))
    green = node("invert", "g", "float", link("in", "s", rest='output="outg"'))
    parts = [link(f"in{1 + i}", *("g",) if i == 1 else ("s", "float", f'output="out{c}"')) for i, c in enumerate("rgb")]
    turned = node("combine3", "turned", "vector3", *parts)
    last = "nrm" if expected == "opengl" else "turned"
    normal = node("normalmap", "nm", "vector3", link("in", last), value("scale", "2, 2", "vector2"))
    nodes = (image("nrm", "vector3", "normal.png"), separated, green, turned, normal)
    found = only(document(folder, surface(*nodes, normal="nm")))
    assert found.options.normal_convention == expected
    assert found.options.factors == {"normal": 2}
    assert mipbake.load(found.files, found.options).convention.name == expected


def test_the_document_decides_not_an_option(folder: Path) -> None:
    (folder / "normal.png").rename(folder / "wood_NormalDX.png")
    body = image("bumps", "vector3", "wood_NormalDX.png") + node(
        "normalmap", "vectors", "vector3", link("in", "bumps", "vector3")
    )
    found = only(document(folder, surface(body, normal="vectors")))
    loaded = mipbake.load(found.files, found.options)
    assert loaded.maps["roughness"].source.reason == "the document says so"
    assert loaded.convention.decided_by == "document"
    assert any("its name says DirectX, the document says OpenGL" in warning for warning in loaded.warnings)
