"""Converted materials: level 0 in another model, as files and from files, and the command that does it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake import material
from mipbake.baking.convert import TARGETS, Conversion, check_material_output
from mipbake.base.errors import InputError, OutputError, UsageError
from mipbake.cli.main import main
from mipbake.source.options import LoadOptions

from .command_line import bumps, fails, tree, write_set

HOLDS = [(model, "exr") for model in TARGETS] + [("gltf", "png"), ("gltf-anisotropic", "png")]
PRECISION = {"exr": 6e-4, "png": 0.5 / 255 + 1e-6}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_set(tmp_path / "metal", occlusion=np.full((4, 4), 200, np.uint8))


@pytest.mark.parametrize(("model", "fmt"), HOLDS)
def test_files_hold_level_0_as_it_was(folder: Path, tmp_path: Path, model: str, fmt: str) -> None:
    texture_set = mipbake.load(folder, wrap=("clamp", "wrap"))
    made = mipbake.convert(texture_set, model)
    expected = texture_set.material(model)
    assert made.stored == pytest.approx(expected, abs=3e-7)  # nothing filtered, unit vectors to the last digit
    files = made.save(tmp_path / "out" / "metal", fmt)
    assert files[0].name == "material.json" and sorted(f.name for f in files) == tree(tmp_path / "out" / "metal")
    assert all("mip" not in f.name for f in files)
    back = mipbake.open_material(tmp_path / "out" / "metal")
    assert (back.name, back.model, back.wrap) == ("metal", model, ("clamp", "wrap"))
    assert back.provenance == made.provenance
    assert set(back.provenance.sources) == {"base_color.png", "normal.png", "roughness.png", "occlusion.png"}
    assert back.provenance.source_model == "gltf" and back.provenance.source_hash == texture_set.source_hash
    high = np.maximum(np.abs(expected), 1)
    colour = 3 if fmt == "png" else 1  # 8-bit colours are sRGB-encoded: steps of twice the size and more
    assert (np.abs(back.stored - expected) <= colour * 2 * PRECISION[fmt] * high).all()
    assert back.extra["occlusion"].shape == (4, 4, 1)
    assert back.extra["occlusion"] == pytest.approx(200 / 255, abs=PRECISION[fmt])
    if model.startswith("gltf"):  # it is a texture set again
        again = mipbake.load(tmp_path / "out" / "metal")
        assert again.source_model == model
        assert again.material(model) == pytest.approx(expected, abs=6 * PRECISION[fmt])


def test_weights_fit_level_0_under_the_pixel_filter(folder: Path, tmp_path: Path) -> None:
    texture_set = mipbake.load(folder)
    made = mipbake.convert(texture_set, "beckmann", "paper-cross")
    stack = mipbake.bake(texture_set, "neural", "beckmann", weights="paper-cross")
    assert np.array_equal(made.stored, stack.levels[0])
    assert set(made.extra) == {"occlusion"}
    by = made.provenance
    assert (by.rule, by.weights, by.weights_sha256) == ("neural", "paper-cross", stack.provenance.weights_sha256)
    assert (by.source_model, by.pixel_filter) == ("gltf", "gaussian")
    made.save(tmp_path / "out")
    assert mipbake.open_material(tmp_path / "out").provenance == by
    with pytest.raises(UsageError, match="weights can convert texture sets only"):
        mipbake.convert(made, "ggx", "paper-cross")
    plain = mipbake.convert(made, "ggx").provenance
    assert (plain.rule, plain.weights, plain.source_model) == ("analytic", None, "beckmann")


@pytest.mark.parametrize("way", [("ggx",), ("gltf-anisotropic", "beckmann", "ggx")])
def test_ways_through_other_models_lead_back(folder: Path, way: tuple[str, ...]) -> None:
    texture_set = mipbake.load(folder)
    made: Any = texture_set
    for model in (*way, "gltf"):
        made = mipbake.convert(made, model)
    assert made.stored == pytest.approx(texture_set.material("gltf"), abs=2e-5)
    assert made.provenance.source_model == way[-1]
    assert made.provenance.sources == mipbake.convert(texture_set, "gltf").provenance.sources


def test_a_material_is_brought_into_the_range_of_its_model() -> None:
    def made_up(model: str, stored: np.ndarray) -> mipbake.Material:
        return mipbake.Material("m", model, stored, {}, ("wrap", "wrap"), Conversion("gltf"))

    rough = np.zeros((1, 1, 12), np.float32)
    rough[..., 8:10], rough[..., 11] = 3, 1.5  # alpha of 4.5
    made = mipbake.convert(made_up("beckmann", rough), "gltf")
    assert made.stored[0, 0, 4] == 1
    assert np.isfinite(made.stored).all()
    with pytest.raises(UsageError, match=r"float32 \(H, W, 12\)"):
        made_up("beckmann", rough[..., :11])
    with pytest.raises(UsageError, match=r"unknown material model 'phong'.*beckmann"):
        mipbake.convert(made, "phong")


def test_nothing_else_is_replaced(folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "out"
    made = mipbake.convert(mipbake.load(folder), "ggx")
    made.save(place)
    made.save(place)  # the same set again
    other = replace(made, provenance=replace(made.provenance, sources={"rock.png": "ab"}))
    with pytest.raises(OutputError, match=r"holds the material 'metal' of other source files \(base_color.png, "):
        other.save(place)
    check_material_output(place, {"normal.png": ""})
    (place / "mine.txt").write_text("keep")
    with pytest.raises(OutputError, match="not mipbake's"):
        made.save(place)
    stack = tmp_path / "stack"
    mipbake.bake(mipbake.load(folder), "linear").save(stack)
    with pytest.raises(OutputError, match="not mipbake's"):
        made.save(stack)
    with pytest.raises(OutputError, match="not mipbake's"):
        mipbake.bake(mipbake.load(folder), "linear").save(place)


def test_broken_materials_are_said_to_be(folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "out"
    mipbake.convert(mipbake.load(folder), "beckmann").save(place)
    manifest = place / "material.json"
    text = manifest.read_text(encoding="utf-8")
    for change, part in (
        ({"schema": "of something else"}, "not the description of a material"),
        ({"schema_version": 99}, "schema version 99, expected 2"),
        ({"model": "phong"}, "unknown material model 'phong'"),
        ({"maps": {}}, "does not describe a material"),
        ({"maps": {"../x": {}}}, "not the name of a file"),
        ({"name": "../x"}, "not the name of a material"),
        ({"wrap": {"u": "wrap", "v": "mirror"}}, "expected wrap or clamp"),
        ({"format": "png"}, "cannot hold the map log_roughness"),
    ):
        manifest.write_text(json.dumps({**json.loads(text), **change}), encoding="utf-8")
        with pytest.raises(InputError, match=part):
            mipbake.open_material(place)
    manifest.write_text(text, encoding="utf-8")
    (place / "log_gamma.exr").unlink()
    with pytest.raises(InputError, match=r"log_gamma\.exr"):
        mipbake.open_material(place)
    with pytest.raises(InputError, match="what `mipbake convert` wrote"):
        mipbake.open_material(tmp_path)


def test_the_command_equals_the_library(folder: Path, tmp_path: Path, capsys: Any) -> None:
    arguments = ["--to", "beckmann", "--map", "metallic=1", "--normal-convention", "directx", "--wrap-u", "clamp"]
    assert main(["convert", str(folder), "-o", str(tmp_path / "out"), *arguments]) == 0
    out, err = capsys.readouterr()
    assert err == "" and "converted from gltf to beckmann" in out and "base_color, normal, roughness" in out
    options = LoadOptions(maps={"metallic": 1.0}, normal_convention="directx", wrap=("clamp", "wrap"))
    mipbake.convert(mipbake.load(folder, options), "beckmann").save(tmp_path / "library")
    for name in tree(tmp_path / "library"):
        assert (tmp_path / "library" / name).read_bytes() == (tmp_path / "out" / "metal" / name).read_bytes(), name
    # And on from there, without the source.
    converted = str(tmp_path / "out" / "metal")
    assert main(["convert", converted, "--to", "gltf", "-o", str(tmp_path / "back"), "--format", "png", "-q"]) == 0
    assert capsys.readouterr() == ("", "")
    assert mipbake.load(tmp_path / "back" / "metal").material("gltf")[..., 3].min() == 1


def test_one_bad_set_does_not_stop_the_others(tmp_path: Path, capsys: Any) -> None:
    sets = [write_set(tmp_path / "a"), write_set(tmp_path / "b", roughness=None), write_set(tmp_path / "c")]
    code = main(["convert", *map(str, sets), "--to", "ggx", "-o", str(tmp_path / "out"), "--json"])
    out, err = capsys.readouterr()
    report = json.loads(out)
    assert code == report["exit_code"] == 3 and err.count("\n") == 1
    good, bad, other = report["results"]
    assert good["ok"] and other["ok"] and not bad["ok"] and "roughness" in bad["error"]
    assert good["bytes"] == sum(Path(f["path"]).stat().st_size for f in good["files"])
    assert good["material"]["model"] == "ggx" and good["material"]["provenance"]["source_model"] == "gltf"
    assert set(good["seconds"]) == {"read", "convert", "write"} and good["set"]["maps"]["normal"]["depth"] == "uint8"
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["a", "c"]


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["x", "-o", "y", "--to", "phong"], f"expected one of {', '.join(material.MODELS)}"),
        (["x", "-o", "y", "--to", "beckmann", "--format", "png"], "cannot hold the map log_roughness"),
    ],
)
def test_usage_errors_exit_2(tmp_path: Path, monkeypatch: Any, capsys: Any, arguments: list[str], part: str) -> None:
    monkeypatch.chdir(tmp_path)
    assert part in fails(capsys, 2, "convert", *arguments)
    assert tree(tmp_path) == []


def test_what_cannot_be_is_said(folder: Path, tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    assert main(["convert", str(folder), "--to", "ggx", "-o", str(out), "-q"]) == 0
    converted = out / "metal"
    assert "leave out the options" in fails(
        capsys, 2, "convert", converted, "--to", "gltf", "-o", tmp_path / "x", "--map", "metallic=1"
    )
    assert "both called metal" in fails(capsys, 2, "convert", folder, converted, "--to", "gltf", "-o", tmp_path / "x")
    assert "converted to ggx" in fails(capsys, 3, "bake", converted, "-o", tmp_path / "x", "--method", "linear")
    mipbake.bake(mipbake.load(folder), "linear").save(tmp_path / "stack")
    assert "is a baked stack" in fails(capsys, 3, "convert", tmp_path / "stack", "--to", "ggx", "-o", tmp_path / "x")
    assert "not mipbake's" in fails(capsys, 4, "convert", folder, "--to", "ggx", "-o", tmp_path)
    assert not (tmp_path / "x").exists()
    before = {name: (converted / name).read_bytes() for name in tree(converted)}
    other = write_set(
        tmp_path / "others" / "metal", **{name: np.roll(pixels, (3, 3), (0, 1)) for name, pixels in bumps().items()}
    )
    assert "other source files" in fails(capsys, 4, "convert", other, "--to", "ggx", "-o", out)
    assert "would be replaced" in fails(capsys, 2, "convert", converted, "--to", "gltf", "-o", out)
    assert {name: (converted / name).read_bytes() for name in tree(converted)} == before
