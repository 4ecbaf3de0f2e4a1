"""Stacks on disk: both containers give back what was saved, within the rounding that they declare."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake import material
from mipbake.base.errors import InputError, UsageError
from mipbake.material.aim import Sampler
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.layout import MANIFEST, to_file
from mipbake.stack.containers import FORMATS, format_named
from mipbake.stack.output import Output
from mipbake.stack.saving import open_stack
from mipbake.stack.stack import MipStack, Provenance

from .command_line import tree, write_set
from .gltf_files import split
from .input_files import write_image

SIZES = [(16, 16), (5, 7), (13, 6), (1, 9), (9, 1), (1, 1), (20, 70)]
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


@pytest.mark.parametrize(("model", "fmt"), HOLDS)
def test_round_trip(tmp_path, model, fmt):
    stack = make_stack(model, SIZES[HOLDS.index((model, fmt)) % len(SIZES)])
    files = stack.save(tmp_path / "a" / "b", format=fmt)
    assert {p.name for p in files} == {p.name for p in (tmp_path / "a" / "b").iterdir()}
    assert files[0].name == MANIFEST
    found = open_stack(tmp_path / "a" / "b")
    assert_same(found, stack, fmt)
    manifest = json.loads(files[0].read_text())
    (output,) = manifest["outputs"]
    assert f"{output['format']}:{output['maps']['normal']['texels']}" == fmt
    assert [c["encoding"] for c in output["maps"]["normal"]["channels"]][:2] == ["(x + 1) / 2"] * 2
    colour = output["maps"][material.MODELS[model].stored[0].name]
    assert colour["colour_space"] == ("linear Rec.709" if fmt in FLOATING else "sRGB")
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


def test_data_pngs_carry_no_gamma(tmp_path):
    make_stack().save(tmp_path / "s", format="png")
    assert b"gAMA" not in (tmp_path / "s" / "normal_mip00.png").read_bytes()
    assert b"sRGB" in (tmp_path / "s" / "base_color_mip00.png").read_bytes()


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
    with pytest.raises(UsageError, match=r"unknown format 'exr:8'.*exr:half, exr:float"):
        stack.save(tmp_path / "s", format="exr:8")
    bright = replace(stack, extra={"emissive": [1e6 * level + 7e4 for level in stack.extra["emissive"]]})
    with pytest.raises(UsageError, match=r"emissive.*65504"):
        bright.save(tmp_path / "s")
    assert tree(tmp_path / "fits") and not (tmp_path / "s").exists()


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
    make_stack(size=(8, 16)).save(tmp_path / "other", format=fmt)
    assert normal in broken(lambda s: shutil.copy(tmp_path / "other" / normal, s / normal))
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


def texture_set(size: int = 16, **maps: object) -> mipbake.TextureSet:
    rng = np.random.default_rng(size)
    normal = np.concatenate([rng.uniform(-0.3, 0.3, (size, size, 2)), np.ones((size, size, 1))], -1)
    given = {"normal": normal, "roughness": rng.random((size, size)), **maps}
    return mipbake.TextureSet.from_arrays("wood", **given)  # type: ignore[arg-type]


def test_a_glb_knows_what_opacity_is_tested_against(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "wood")
    alpha = np.tile(np.uint8([[0, 255]]), (16, 8))
    write_image(folder / "wood_opacity.png", alpha)
    stack = mipbake.bake(mipbake.load(folder, alpha_cutoff=0.3), "linear")
    stack.save(tmp_path / "a", "glb,exr")
    (material,) = split((tmp_path / "a" / "wood.glb").read_bytes())[0]["materials"]
    assert (material["alphaMode"], material["alphaCutoff"]) == ("MASK", 0.3)
    assert mipbake.open_stack(tmp_path / "a").provenance.alpha_cutoff == 0.3


def test_what_an_engine_does_not_take_is_said(tmp_path: Path) -> None:
    stack = mipbake.bake(texture_set(12), "linear")
    with pytest.warns(UserWarning, match="Unreal Engine needs sides that are powers of two, this set is 12 x 12"):
        stack.save(tmp_path / "a", preset="unreal")
    with pytest.raises(mipbake.UsageError, match="unknown preset 'quake'"):
        stack.save(tmp_path / "b", preset="quake")
    with pytest.raises(mipbake.UsageError, match="takes stacks of gltf, and 'wood' is of ggx"):
        mipbake.bake(texture_set(), "linear", "ggx").save(tmp_path / "b", preset="unreal")
    with pytest.raises(mipbake.UsageError, match="one of the two"):
        stack.save(tmp_path / "b", [Output()], preset="arnold")
    with pytest.raises(mipbake.UsageError, match="unknown format 'jpg'"):
        stack.save(tmp_path / "b", format="jpg")
    assert not (tmp_path / "b").exists()
