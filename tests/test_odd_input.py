"""Numbers, files and tensors that nobody foresees: each is one sentence about what was given, and never a defect."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from mipbake import raster, sampling, shading
from mipbake.base.errors import UsageError
from mipbake.cli.main import main
from mipbake.library.task import unforeseen
from mipbake.source.jobs import Job

from .command_line import fails
from .input_files import pixels_for, plain_set
from .test_presets import run
from .test_specular_glossiness import glossy

pytestmark = pytest.mark.usefixtures("unmeasured")

MANY, MORE = "9" * 400, "9" * 5000
PROJECT = 'library = "wood"\nout = "out"\n'


@pytest.mark.parametrize(("option", "number"), [("--seed", MANY), ("--seed", f"-{MANY}"), ("--memory", MORE)])
def test_numbers_beyond_all_measure(tmp_path, capsys, option, number):
    folder = plain_set(tmp_path / "wood")
    given = ["validate", folder, tmp_path, option, number]
    code = main([str(each) for each in given])
    said = capsys.readouterr().err
    assert code in (2, 3) and said.startswith("mipbake: ") and len(said) < 320 and said.count("\n") == 1


@pytest.mark.parametrize(
    "line",
    [
        *(f"jobs = {MANY}", f"options.strength = {MORE}"),
        f"options.map.roughness = {MANY}",
        f'memory = "{MANY}"',
        "a = " + "[" * 3000 + "]" * 3000,
        "a" + ".a" * 5000 + " = 1",
    ],
)
def test_project_files(tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str) -> None:
    plain_set(tmp_path / "wood")
    (tmp_path / "mipbake.toml").write_text(PROJECT + line)
    said = fails(capsys, 2, "bake", "--config", tmp_path / "mipbake.toml", "--dry-run")
    assert "mipbake.toml" in said and len(said) < 320


def test_json_that_is_nested_deeply(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, *command in (("a.gltf", "inspect", tmp_path / "a.gltf"), ("stack.json", "info", tmp_path)):
        (tmp_path / name).write_text('{"a":' * 100_000 + "1" + "}" * 100_000)
        assert "nested too deeply" in fails(capsys, 3, *command)


@pytest.mark.long
@pytest.mark.parametrize("index", [-5, 7, True, 1.0])
@pytest.mark.parametrize("place", ["texture", "image", "view", "other"])
def test_indices_of_documents(tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str, index: object) -> None:
    made = glossy(**({"diffuseTexture": {"index": index}} if place == "texture" else {}))
    if place == "image":
        made.json["textures"][0]["source"] = index
    elif place == "view":
        made.json["images"][0]["bufferView"] = index
    elif place == "other":  # in what nobody here knows
        made.json["materials"][0]["extensions"]["EXT_other"] = {"someTexture": {"index": index}, "imageIndex": index}
    file = made.write(tmp_path / "glossy.glb")
    code = main(["bake", str(file), "-o", str(tmp_path / "out"), "--method", "linear", "--format", "glb", "-q"])
    said = capsys.readouterr().err
    assert "defect" not in said and said.count("\n") == (code != 0) and len(said) < 320
    assert code == (0 if place == "other" else 3), said


@pytest.mark.parametrize(
    "error",
    [
        RuntimeError("can't start new thread"),
        ImportError("libtorch_cpu.so: failed to map segment from shared object"),
        MemoryError("std::bad_alloc"),
        OSError(12, "Cannot allocate memory"),
        ValueError("Maximum allowed size exceeded"),
    ],
)
def test_what_the_system_refuses(tmp_path, capsys, monkeypatch, error):
    def breaks(*_arguments: object, **_options: object) -> None:
        raise error

    monkeypatch.setattr(Job, "read", breaks)
    said = fails(capsys, 1, "bake", plain_set(tmp_path / "wood"), "-o", tmp_path / "out", "--method", "linear", "-q")
    assert "not enough memory" in said and "defect" not in said
    assert "not enough memory" in str(unforeseen(error))


TEXELS, LIGHT = torch.rand(5, 8), torch.tensor([[0.0, 0.0, 1.0]])
TEXTURE, UV = torch.rand(1, 4, 4, 3), torch.rand(1, 2, 2, 2)
POS, TRI, RAST = torch.rand(1, 3, 4), torch.zeros(1, 3, dtype=torch.int32), torch.zeros(1, 2, 2, 4)
DOORS: dict[str, Callable[[Any], object]] = {
    "material": lambda tensor: shading.shade("gltf", tensor(TEXELS), LIGHT, LIGHT),
    "light": lambda tensor: shading.shade("gltf", TEXELS, tensor(LIGHT), LIGHT),
    "tex": lambda tensor: sampling.texture(tensor(TEXTURE), UV),
    "uv": lambda tensor: sampling.texture(TEXTURE, tensor(UV)),
    "pos": lambda tensor: raster.rasterize(None, tensor(POS), TRI, (4, 4)),
    "rast": lambda tensor: raster.interpolate(POS, tensor(RAST), TRI),
    "color": lambda tensor: raster.antialias(tensor(RAST), RAST, POS, TRI),
}
KINDS: dict[str, Callable[[torch.Tensor], object]] = {
    "sparse": lambda tensor: tensor.to_sparse(),
    "quantised": lambda tensor: torch.quantize_per_tensor(tensor, 0.1, 0, torch.quint8),
    "nested": lambda tensor: torch.nested.nested_tensor([tensor[0], tensor[0]]),
    "complex": lambda tensor: tensor.to(torch.complex64).conj(),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", DOORS)
def test_tensors_that_are_no_block_of_numbers(name: str, kind: str) -> None:
    with pytest.raises(UsageError, match=f"^{name} is .*expected"):
        DOORS[name](KINDS[kind])


@pytest.mark.parametrize("tensor", [TEXELS.clone().requires_grad_(), TEXELS])
def test_tensors_at_the_door_of_arrays(tensor: torch.Tensor) -> None:
    with pytest.raises(UsageError, match=r"^material is a Tensor: expected a NumPy array$"):
        shading.shade_lit("gltf", tensor, *[LIGHT.numpy()] * 4)


@pytest.mark.parametrize(
    ("format", "height", "texels", "told"),
    [
        ("ktx2", 6, {"rgba8"}, "warning: ktx2: files of 8 x 6 texels are not compressed"),
        ("dds:bc", 6, {"bc"}, "warning: dds:bc: files of 8 x 6 texels are made of blocks"),
    ],
)
def test_sides_that_are_no_whole_blocks(format: str, height: int, texels: set[str], told: str, tmp_path: Path) -> None:
    roles = {"base_color": "base_color", "normal_gl": "normal", "roughness": "roughness", "height": "height"}
    plain_set(tmp_path / "wood", **{stem: pixels_for(role, 8)[:height] for stem, role in roles.items()})
    code, said = run("bake", tmp_path / "wood", "-o", tmp_path / "out", "--method", "linear", "--format", format)
    assert code == 0, said
    (output,) = json.loads((tmp_path / "out" / "wood" / "stack.json").read_text())["outputs"]
    assert {each["texels"] for each in output["maps"].values()} == texels
    assert told in said and ("multiples of 4" in said) == bool(told)
