"""Textures of a glTF whose extensions name images that are not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from mipbake.base.errors import InputError
from mipbake.source.gltf.document import read_document

from .gltf_files import GltfFile, png


@pytest.mark.parametrize("source", [99, -1, "x", None, True, 1.0, [0], {"a": 1}, 10**30])
@pytest.mark.parametrize("alone", [False, True])
def test_a_basisu_source_that_is_no_image_is_refused(tmp_path: Path, source: object, alone: bool) -> None:
    file = GltfFile()
    texture = file.json["textures"][file.texture(file.image(png("colour", 8), "colour"))]
    texture["extensions"] = {"KHR_texture_basisu": {"source": source}}
    if alone:
        del texture["source"]
    file.uses("KHR_texture_basisu")
    with pytest.raises(InputError, match=r"KHR_texture_basisu of texture 0 names .* of its 1 images"):
        read_document(file.write(tmp_path / "a.glb"))
