"""`mipbake.bake_all`: what the command line bakes, in one call from Python."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

import mipbake
from mipbake.baking import NotBaked, WrittenFile, bake_sources
from mipbake.cli.main import main
from mipbake.source.jobs import Job
from mipbake.stack.stack import MipStack

from .command_line import tree, write_set
from .gltf_files import png
from .gltf_results import two_textures


@pytest.fixture
def sources(tmp_path: Path) -> list[Path]:
    """A document and a set."""
    return [two_textures(png("normal n"), png("mr")).write(tmp_path / "scene"), write_set(tmp_path / "metal")]


@pytest.mark.long
def test_it_writes_what_the_command_writes(sources: list[Path], tmp_path: Path) -> None:
    made = mipbake.bake_all(sources, tmp_path / "python", method="linear", preset="three")
    options = ["--method", "linear", "--preset", "three", "--quiet"]
    assert main(["bake", *map(str, sources), "-o", str(tmp_path / "command"), *options]) == 0
    files = tree(tmp_path / "command")
    assert tree(tmp_path / "python") == files
    for name in files:
        if (tmp_path / "command" / name).is_file():
            assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "command" / name).read_bytes(), name
    material, metal, scene = made
    assert isinstance(material, mipbake.BakedSet) and isinstance(metal, mipbake.BakedSet)
    assert isinstance(scene, mipbake.BakedDocument)
    assert scene.out == tmp_path / "python" / "scene.glb"
    assert scene.files == (WrittenFile(scene.out, scene.out.stat().st_size),) and scene.bytes == scene.files[0].bytes
    assert material.files == () and set(scene.measured) == {material.set.name}
    assert {file.path.parent for file in metal.files} == {metal.out} == {tmp_path / "python" / "metal"}
    assert metal.bytes == sum(path.stat().st_size for path in metal.out.iterdir())
    assert metal.provenance.method == "linear" and metal.costs and not metal.defects
    assert mipbake.open_stack(metal.out).model == metal.model == metal.set.model == "gltf"


def test_the_rest_is_baked_before_an_error_is_raised(sources: list[Path], tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    options = mipbake.BakeOptions(method="linear", format="png", max_level=1)
    with pytest.raises(mipbake.InputError, match="empty"):
        mipbake.bake_all([empty, sources[1]], tmp_path / "out", options)
    assert len(list((tmp_path / "out" / "metal").glob("normal_mip*.png"))) == 2
    failed, baked = bake_sources([empty, sources[1]], tmp_path / "again", options)
    assert isinstance(failed, NotBaked) and failed.source == empty and failed.error.exit_code == 3
    assert isinstance(baked, mipbake.BakedSet) and baked.levels == 2


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"method": "sharpest"}, "sharpest"),
        ({"filter": "box"}, "unknown option 'filter'"),
        ({"strength": 2.0}, "strength"),
        ({"max_level": -1}, "max_level"),
        ({"target": "ggx", "format": "glb"}, "glb"),
    ],
)
def test_what_cannot_be_is_said_before_anything_is_read(tmp_path: Path, wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(mipbake.UsageError, match=said):
        mipbake.bake_all(tmp_path / "none", tmp_path / "out", **wrong)
    assert tree(tmp_path) == []


class Heard(mipbake.Listener):
    """Keeps what it hears."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def read(self, job: Job, sets: Sequence[mipbake.TextureSet]) -> None:
        self.said += [f"read {each.name}" for each in sets]

    def baked(self, job: Job, stack: MipStack, result: mipbake.BakedSet, timings: object) -> None:
        self.said.append(f"baked {stack.name} into {result.out.name}")

    def failed(self, failure: NotBaked) -> None:
        self.said.append(f"failed {failure.source.name}")


def test_a_listener_hears_what_happens(sources: list[Path], tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    heard = Heard()
    given = [sources[1], tmp_path / "empty"]
    made = bake_sources(given, tmp_path / "out", mipbake.BakeOptions(method="linear"), listener=heard)
    assert heard.said == ["read metal", "baked metal into metal", "failed empty"]
    assert isinstance(made[0], mipbake.BakedSet) and {"read", "write"} <= set(made[0].seconds)
