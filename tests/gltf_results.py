"""Results for the bakes of glTF documents in tests: files of the right kind that show nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mipbake.source.gltf.document import Document, read_document
from mipbake.source.gltf.materials import GltfBake, read_materials
from mipbake.stack.gltf.write import GltfResult, rewritten

from .gltf_files import (
    GltfFile,
    check_structure,
    ktx2,
)

SLOTS = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture", "anisotropyTexture")
PROVENANCE = {"version": "1", "method": "auto"}


def results_of(bakes: tuple[GltfBake, ...], anisotropic: bool) -> list[GltfResult]:
    """A map of its own for every slot of every bake."""
    return [
        GltfResult(
            bake,
            {
                slot: ktx2(10 * number + SLOTS.index(slot), slot == "baseColorTexture")
                for slot in bake.slots
                if anisotropic or slot != "anisotropyTexture"
            },
        )
        for number, bake in enumerate(bakes)
    ]


def opened(made: GltfFile, folder: Path, kind: str = "glb") -> tuple[Document, tuple[GltfBake, ...]]:
    images = folder / "images"
    images.mkdir(exist_ok=True)
    document = read_document(made.write(folder / "many", kind))
    return document, read_materials(document, images).bakes


def baked(made: GltfFile, folder: Path, anisotropic: bool = False) -> tuple[dict[str, Any], bytes, list[GltfResult]]:
    document, bakes = opened(made, folder)
    results = results_of(bakes, anisotropic)
    return *check_structure(rewritten(document, results, {})), results


def infos(material: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Slot to textureInfo of the core and of KHR_materials_anisotropy."""
    anisotropy = material.get("extensions", {}).get("KHR_materials_anisotropy", {})
    everything = {**material, **material.get("pbrMetallicRoughness", {}), **anisotropy}
    return {key: value for key, value in everything.items() if key.endswith("Texture")}


def two_textures(first: bytes, second: bytes) -> GltfFile:
    """A material with a normal map and a metallicRoughness map."""
    made = GltfFile()
    made.texture(made.image(first, "n"))
    made.texture(made.image(second, "mr"))
    packed = {"metallicRoughnessTexture": {"index": 1}}
    made.material("M", normalTexture={"index": 0}, pbrMetallicRoughness=packed)
    return made
