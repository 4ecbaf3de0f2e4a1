"""Stacks on disk: both containers give back what was saved, within the rounding that they declare."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO
import pytest

from mipbake import material
from mipbake.base.errors import InputError, UsageError
from mipbake.material.aim import Sampler
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.layout import LAYOUTS, MANIFEST, extra_layout, from_file, to_file
from mipbake.stack.containers import FORMATS, format_named
from mipbake.stack.saving import open_stack
from mipbake.stack.stack import MipStack, Provenance

SIZES = [(16, 16), (5, 7), (13, 6), (1, 9), (9, 1), (1, 1), (70, 130)]
NAMES = [f"{name}:{texels}" for name, kinds in FORMATS.items() for texels in kinds]
EXACT = [name for name in NAMES if format_named(name).exact]
FLOATING = [name for name in EXACT if "log" in format_named(name).encodings]
HOLDS = [(m, fmt) for m in material.MODELS for fmt in (FLOATING if material.MODELS[m].logarithms else EXACT)]
BITS = {"float": 24, "half": 11, "rgba16f": 11, "16": 16, "8": 8, "rgba8": 8}


def make_stack(model="gltf", size=(8, 8), extra=True, seed=0, wrap=("wrap", "clamp")):
    rng = np.random.default_rng(seed)
    low, high = np.array(material.MODELS[model].limits).T

    def level(shape):
        values = rng.uniform(low, high, (*shape, len(low))).astype(np.float32)
        return material.regularise(values, model)

    def plain(shape, channels):
        return [rng.random((*s, channels), np.float32) for s in level_sizes(*shape)]

    return MipStack(
        name="sample",
        model=model,
        levels=[level(s) for s in level_sizes(*size)],
        extra={"occlusion": plain(size, 1), "emissive": plain((3, 5), 3)} if extra else {},
        wrap=wrap,
        provenance=Provenance(
            method="linear",
            pixel_filter="gaussian",
            weights="w",
            weights_sha256="00",
            tool_version="0",
            sources={"normal.png": "ab"},
            source_hash="cd",
            warnings=("one thing to know.",),
        ),
    )


def tree(folder):
    return sorted(str(p.relative_to(folder)) for p in Path(folder).rglob("*"))


def assert_same(found, expected, fmt):
    assert (found.name, found.model, found.wrap) == (expected.name, expected.model, expected.wrap)
    assert found.provenance == expected.provenance
    assert list(found.extra) == list(expected.extra)
    for (layout, levels), (_, originals) in zip(found.maps(), expected.maps(), strict=True):
        assert len(levels) == len(originals)
        for level, original in zip(levels, originals, strict=True):
            assert level.dtype == np.float32 and level.shape == original.shape
            container = format_named(fmt)
            srgb = container.srgb(layout.alone)
            stored, wanted = (to_file(x, layout.encodings, srgb) for x in (level, original))
            bits = BITS[container.texels]
            whole = container.texels in ("8", "16", "rgba8")
            tolerance = 0.5 / (2**bits - 1) + 1e-6 if whole else np.abs(wanted) * 2.0**-bits + 1e-7
            assert (np.abs(stored - wanted) <= tolerance).all(), layout.name


@pytest.mark.long
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("model", "fmt"), HOLDS)
def test_round_trip(tmp_path, model, fmt, size):
    stack = make_stack(model, size)
    files = stack.save(tmp_path / "a" / "b", format=fmt)
    assert {p.name for p in files} == {p.name for p in (tmp_path / "a" / "b").iterdir()}
    assert files[0].name == MANIFEST
    found = open_stack(tmp_path / "a" / "b")
    assert_same(found, stack, fmt)
    # What was read is exactly representable: a second round changes nothing.
    found.save(tmp_path / "again", format=fmt)
    for first, second in zip(found.levels, open_stack(tmp_path / "again").levels, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("fmt", ["exr", "tx", "png", "ktx2", "dds"])
def test_same_bake_gives_the_same_bytes(tmp_path, fmt):
    for name in ("a", "b"):
        make_stack().save(tmp_path / name, format=fmt)
    for file in tree(tmp_path / "a"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


def test_openexr_reads_level_0(tmp_path):
    stack = make_stack("gltf-anisotropic", (12, 20))
    stack.save(tmp_path / "s")
    for layout in LAYOUTS[stack.model]:
        with OpenEXR.File(str(tmp_path / "s" / f"{layout.name}.exr"), separate_channels=True) as file:
            assert file.header()["wrapmodes"] == "periodic,clamp"
            channels = [file.channels()[name].pixels for name in layout.alone.channel_names]
        expected = to_file(stack.levels[0][..., layout.channels], layout.encodings, srgb=False).astype(np.float16)
        np.testing.assert_array_equal(np.stack(channels, -1), expected)


def test_openimageio_finds_every_level(tmp_path):
    make_stack(size=(5, 12)).save(tmp_path / "s")
    buffer = OpenImageIO.ImageBuf(str(tmp_path / "s" / "normal.exr"))
    assert buffer.nmiplevels == 4
    assert buffer.spec().get_string_attribute("textureformat") == "Plain Texture"


def test_png_values_are_the_nearest(tmp_path):
    stack = make_stack(size=(32, 32), extra=False)
    stack.save(tmp_path / "s", format="png")

    def pixels(name):
        return OpenImageIO.ImageBuf(str(tmp_path / "s" / f"{name}.png")).get_pixels("uint8")

    for index, level in enumerate(stack.levels):
        normal, roughness = pixels(f"normal_mip{index:02}"), pixels(f"roughness_mip{index:02}")
        np.testing.assert_array_equal(normal, np.rint((level[..., 5:8].astype(float) + 1) / 2 * 255))
        np.testing.assert_array_equal(roughness, np.rint(level[..., 4:5].astype(float) * 255))
        linear = level[..., 0:3].astype(float)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        np.testing.assert_array_equal(pixels(f"base_color_mip{index:02}"), np.rint(encoded * 255))


def test_png_covers_its_range():
    layout = extra_layout("occlusion", 1).alone
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16, 1)
    png = FORMATS["png"]["8"]
    for values in (png.dequantise(codes) + 0.49 / 255, png.dequantise(codes) - 0.49 / 255):
        np.testing.assert_array_equal(png.quantise(values, layout), codes)
    colour = extra_layout("emissive", 3).alone
    triple = np.repeat(codes, 3, -1)
    linear = from_file(png.dequantise(triple), colour.encodings, srgb=True)
    np.testing.assert_array_equal(png.quantise(to_file(linear, colour.encodings, srgb=True), colour), triple)


def test_data_pngs_carry_no_gamma(tmp_path):
    make_stack().save(tmp_path / "s", format="png")
    assert b"gAMA" not in (tmp_path / "s" / "normal_mip00.png").read_bytes()
    assert b"sRGB" in (tmp_path / "s" / "base_color_mip00.png").read_bytes()


@pytest.mark.parametrize(("model", "fmt"), HOLDS)
def test_manifest_declares_every_convention(tmp_path, model, fmt):
    stack = make_stack(model, (6, 10))
    stack.save(tmp_path / "s", format=fmt)
    manifest = json.loads((tmp_path / "s" / MANIFEST).read_text())
    (output,) = manifest["outputs"]
    texels = {entry["texels"] for entry in output["maps"].values()}
    assert (manifest["schema"], manifest["schema_version"]) == ("mipbake-stack", 2)
    assert f"{output['format']}:{texels.pop()}" == fmt and not texels
    assert (manifest["width"], manifest["height"], manifest["model"]) == (10, 6, model)
    assert manifest["wrap"] == {"u": "wrap", "v": "clamp"}
    assert output["normal_convention"] == "OpenGL"
    assert manifest["provenance"]["sources"] == {"normal.png": "ab"}
    maps = output["maps"]
    colour = maps[material.MODELS[model].stored[0].name]
    assert colour["colour_space"] == ("linear Rec.709" if fmt in FLOATING else "sRGB")
    assert [c["encoding"] for c in maps["normal"]["channels"]][:2] == ["(x + 1) / 2"] * 2
    assert maps["normal"]["levels"][1] == {"width": 5, "height": 3}
    assert maps["emissive"]["levels"][0] == {"width": 5, "height": 3}
    assert not maps["occlusion"]["shades"] and maps["normal"]["shades"]
    shading = [n for m in LAYOUTS[model] for n in range(*m.channels.indices(99))]
    assert shading == list(range(material.MODELS[model].channels))


def test_png_refuses_what_8_bits_cannot_hold(tmp_path):
    with pytest.raises(UsageError, match=r"log_roughness.*format exr"):
        make_stack("ggx").save(tmp_path / "s", format="png")
    stack = make_stack()
    high = replace(stack, extra={"height": [3 * level for level in stack.extra["occlusion"]]})
    with pytest.raises(UsageError, match=r"height.*outside 0 to 1"):
        high.save(tmp_path / "s", format="png")
    high.save(tmp_path / "fits")
    with pytest.raises(UsageError, match="expected one of exr, tx, ktx2, dds, png"):
        stack.save(tmp_path / "s", format="webp")
    with pytest.raises(UsageError, match=r"exr has no texels '8'.*half, float"):
        stack.save(tmp_path / "s", format="exr:8")
    assert tree(tmp_path / "fits") and not (tmp_path / "s").exists()


def test_half_refuses_what_overflows(tmp_path):
    stack = make_stack()
    bright = replace(stack, extra={"emissive": [1e6 * level + 7e4 for level in stack.extra["emissive"]]})
    with pytest.raises(UsageError, match=r"emissive.*65504"):
        bright.save(tmp_path / "s")
    assert tree(tmp_path) == []


@pytest.mark.parametrize(
    "change",
    [
        {"model": "phong"},
        {"levels": []},
        {"levels": [make_stack().levels[0], make_stack().levels[2]]},
        {"levels": make_stack("ggx").levels},
        {"levels": [level.astype(np.float64) for level in make_stack().levels]},
        {"levels": [np.full_like(level, np.nan) for level in make_stack().levels]},
        {"extra": {"normal": make_stack().extra["emissive"]}},
        {"extra": {"height": make_stack().extra["emissive"][:1] * 2}},
    ],
    ids=["model", "empty", "incomplete", "channels", "dtype", "nan", "name", "extra"],
)
def test_impossible_stacks_are_refused(change):
    with pytest.raises(UsageError):
        replace(make_stack(), **change)


def edit(folder, **changes):
    path = folder / MANIFEST
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize("fmt", FORMATS)
def test_broken_stacks_are_input_errors(tmp_path, fmt):
    good = tmp_path / "good" / "s"
    make_stack().save(good, format=fmt)
    normal = sorted(p.name for p in good.glob("normal*"))[0]

    def broken(action):
        copy = tmp_path / "bad"
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(good, copy)
        action(copy)
        with pytest.raises(InputError) as caught:
            open_stack(copy)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    assert normal in broken(lambda s: (s / normal).unlink())
    assert normal in broken(lambda s: (s / normal).write_bytes((good / normal).read_bytes()[:200]))
    assert normal in broken(lambda s: (s / normal).write_text("no image"))
    other = normal.replace("normal", "metallic")
    assert ("channels" if format_named(fmt).exact else "expected") in broken(
        lambda s: shutil.copy(s / other, s / normal)
    )
    assert MANIFEST in broken(lambda s: (s / MANIFEST).write_text("{"))
    assert "schema" in broken(lambda s: edit(s, schema="other"))
    assert "version" in broken(lambda s: edit(s, schema_version=99))
    assert "gltf" in broken(lambda s: edit(s, model="phong"))
    (output,) = json.loads((good / MANIFEST).read_text())["outputs"]
    entry = output["maps"]["normal"]
    for outputs in ([], [{**output, "format": "webp"}], [{**output, "maps": {}}], [{**output, "maps": {"normal": {}}}]):
        assert "describe" in broken(lambda s, outputs=outputs: edit(s, outputs=outputs))
    assert "describe" in broken(lambda s: edit(s, outputs=[{**output, "maps": {"../good/s/normal": entry}}]))
    assert "describe" in broken(lambda s: edit(s, provenance={}))
    provenance = json.loads((good / MANIFEST).read_text())["provenance"]
    for odd in ("sharpest", None, ["gaussian"]):
        assert "describe" in broken(lambda s, odd=odd: edit(s, provenance={**provenance, "pixel_filter": odd}))
    with pytest.raises(InputError, match="no such folder"):
        open_stack(tmp_path / "none")
    with pytest.raises(InputError, match=r"did you mean .*s"):
        open_stack(tmp_path / "good")


def test_what_a_stack_was_made_for_is_kept_and_missing_in_older_files(tmp_path):
    stack = make_stack()
    made_for = replace(stack.provenance, sampler=Sampler(4, -1.0, 8), aim=0.0)
    replace(stack, provenance=made_for).save(tmp_path / "s")
    assert open_stack(tmp_path / "s").provenance == made_for
    told = json.loads((tmp_path / "s" / MANIFEST).read_text())["provenance"]

    def write(provenance):
        content = json.loads((tmp_path / "s" / MANIFEST).read_text())
        (tmp_path / "s" / MANIFEST).write_text(json.dumps({**content, "provenance": provenance}))

    for odd in (
        {"sampler": "stochastic"},
        {"sampler": {"lookups": 3, "bias": 0, "frames": 1}},
        {"aim": 2},
        {"aim": "much"},
    ):
        write({**told, **odd})
        with pytest.raises(InputError, match="does not describe a stack"):
            open_stack(tmp_path / "s")
    for older in ("trilinear", "anisotropic"):
        write({**told, "sampler": older})
        assert str(open_stack(tmp_path / "s").provenance.sampler) == older
    write({key: value for key, value in told.items() if key not in ("sampler", "aim")})
    found = open_stack(tmp_path / "s").provenance
    assert (found.sampler, found.aim) == (None, None)


def test_importing_the_stack_imports_no_image_library():
    heavy = "torch", "OpenImageIO", "colour", "rich"
    code = f"import sys, mipbake.stack.stack; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
