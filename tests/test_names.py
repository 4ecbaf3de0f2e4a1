"""Names that users give: in any case, with a guess where there is none; the same in Python and in commands."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import mipbake
from mipbake import UsageError
from mipbake.baking import BakeOptions
from mipbake.baking.methods import method_named
from mipbake.base.names import known_name
from mipbake.comparing.films import motion_named
from mipbake.material import model_named
from mipbake.material.aim import sampler_named
from mipbake.material.pixel_filter import filter_named
from mipbake.stack.containers import format_named
from mipbake.stack.presets import preset_named, wanted_outputs

from .command_line import bake, fails, write_set


@pytest.mark.parametrize(
    ("named", "given", "meant"),
    [
        (preset_named, " Unreal", "unreal"),
        (method_named, "LEAN", "lean"),
        (filter_named, "Blackman-Harris", "blackman-harris"),
        (model_named, "GGX", "ggx"),
        (motion_named, "Light", "light"),
    ],
)
def test_names_are_known_in_any_case(named: Callable[[str], object], given: str, meant: str) -> None:
    assert named(given) == named(meant)


def test_samplers_and_formats_are_known_in_any_case() -> None:
    assert sampler_named("Accumulated, Anisotropic") == sampler_named("accumulated, anisotropic")
    assert format_named("KTX2:BC") is format_named("ktx2:bc")
    outputs, glb, texels = wanted_outputs(None, "DDS:RGBA8, GLB:Rgba8")
    assert [each.format for each in outputs] == ["dds:rgba8"] and glb and texels == "rgba8"


def test_a_near_miss_is_guessed() -> None:
    with pytest.raises(UsageError, match=r"^unknown preset 'unrael': did you mean unreal\? Presets: three, babylon, "):
        preset_named("unrael")
    with pytest.raises(UsageError, match=r"^unknown format 'ktx2:bcc': did you mean ktx2:bc\? Formats: ktx2:bc, "):
        format_named("ktx2:bcc")
    with pytest.raises(UsageError, match=r"^unknown preset 'maya': expected one of three, babylon, "):
        preset_named("maya")
    with pytest.raises(UsageError, match=r"^unknown weights 'x': expected one of \(there are none\)$"):
        known_name("weights", "x", ())


def test_python_and_the_command_line_say_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    metal = write_set(tmp_path / "metal")
    with pytest.raises(UsageError) as raised:
        mipbake.bake(metal, "Linaer")
    said = fails(capsys, 2, "bake", metal, "-o", tmp_path / "out", "--method", "Linaer")
    assert said == f"mipbake: {raised.value}\n" and "did you mean linear?" in said
    with pytest.raises(UsageError, match="unknown option 'presett': did you mean preset"):
        mipbake.bake(metal, presett="unreal")


def test_a_bake_records_names_as_lists_have_them(tmp_path: Path) -> None:
    metal = write_set(tmp_path / "metal")
    options = ("--preset", "Arnold", "--target", "GLTF", "--filter", "Box", "--normal-convention", "OpenGL")
    code, said = bake(metal, "-o", tmp_path / "out", *options)
    stack = said["results"][0]["stack"]
    assert code == 0 and stack["model"] == "gltf" and stack["provenance"]["pixel_filter"] == "box"


def test_options_are_the_same_however_they_are_spelt() -> None:
    """So that a bake is found unchanged."""
    spelt: dict[str, Any] = {
        "method": "Linear",
        "preset": "Unreal",
        "format": "DDS, exr",
        "packing": "ORM",
        "write_normals": "DirectX",
    }
    plain: dict[str, Any] = {
        "method": "linear",
        "preset": "unreal",
        "format": "dds,exr",
        "packing": "orm",
        "write_normals": "directx",
    }
    assert BakeOptions(**spelt).plan() == BakeOptions(**plain).plan()
