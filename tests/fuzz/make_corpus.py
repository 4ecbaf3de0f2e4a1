"""`python -m tests.fuzz.make_corpus`: writes the corpus anew. Every file is made here, and as small as it can be."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np

import mipbake
from mipbake.convert import convert

from .. import gltf_files, mesh_files, mtlx_documents
from ..input_files import pixels_for, write_image
from .campaign import CORPUS

SIZE = 8
_FORMATS = {"exr": "exr", "tx": "tx", "png": "png", "ktx2": "ktx2", "uastc": "ktx2:uastc", "dds": "dds"}


def main() -> None:
    for folder in [p for p in CORPUS.iterdir() if p.name != "found"] if CORPUS.exists() else ():
        shutil.rmtree(folder)
    _images(_made("images"))
    source = _made("set")
    for role in ("base_color", "normal", "roughness", "metallic"):
        write_image(source / f"wood_{role}.png", pixels_for(role, SIZE))
    texture_set = mipbake.load(source)
    stack = mipbake.bake(texture_set, method="linear")
    for name, formats in _FORMATS.items():
        stack.save(CORPUS / f"stack-{name}", formats)
    for name in ("dds", "tx"):  # sources may be such files, too
        shutil.copy(CORPUS / f"stack-{name}" / f"wood_base_color.{name}", CORPUS / "images")
    convert(texture_set, "ggx").save(CORPUS / "material")
    document = _document()
    document.write(_made("gltf") / "small.glb")
    document.write(CORPUS / "gltf" / "embedded.gltf", "embedded")
    _materialx(_made("mtlx"))
    mesh = _made("mesh")
    mesh_files.quad().write(mesh / "quad.glb")
    mesh_files.quad().write(mesh / "quad.gltf", "embedded")
    (mesh / "quad.obj").write_text(mesh_files.obj_text(mesh_files.shapes.plane()), encoding="utf-8")
    for suffix in ("hdr", "exr"):
        radiance = np.random.default_rng(0).random((4, 8, 3)).astype(np.float32)
        write_image(_made("environment", new=False) / f"light.{suffix}", radiance)
    lists = _made("list")
    (lists / "list.txt").write_text("# sets\nwood\nwood/*.png\n**\n@list.txt\nwood_<UDIM>.png\n", encoding="utf-8")
    _weights(_made("weights"))


def _made(name: str, new: bool = True) -> Path:
    folder = CORPUS / name
    folder.mkdir(parents=True, exist_ok=not new)
    return folder


def _images(folder: Path) -> None:
    rgb, grey, rgba = (pixels_for(role, SIZE) for role in ("base_color", "roughness", "packed_alpha"))
    for suffix in ("png", "jpg", "tif", "tga", "bmp", "webp", "sgi", "ppm", "jp2"):
        write_image(folder / f"rgb.{suffix}", rgb)
    write_image(folder / "grey.png", grey)
    write_image(folder / "rgba.png", rgba)
    write_image(folder / "deep.png", rgb.astype(np.uint16) * 257)
    write_image(folder / "deep.tif", rgb.astype(np.uint16) * 257, compression="lzw")
    write_image(folder / "zip.tif", rgb / np.float32(255), compression="zip")
    for compression in ("none", "rle", "zip", "piz", "pxr24", "b44", "dwaa"):
        write_image(folder / f"{compression}.exr", (rgb / 255).astype(np.float16), "half", compression=compression)
    write_image(folder / "float.exr", (grey / 255).astype(np.float32))
    write_image(folder / "rgb.hdr", (rgb / 255).astype(np.float32))


def _document() -> gltf_files.GltfFile:
    file = gltf_files.GltfFile()
    textures = {
        kind: file.texture(file.image(gltf_files.png(kind, SIZE), kind))
        for kind in ("colour", "normal", "packed", "aniso")
    }
    packed = file.texture(file.image(gltf_files.ktx2(1), "packed basisu", "image/ktx2"))
    file.json["textures"][packed] = {"extensions": {"KHR_texture_basisu": {"source": packed}}, "sampler": 0}
    file.uses("KHR_texture_basisu", "KHR_materials_anisotropy")
    pbr = {
        "baseColorTexture": {"index": textures["colour"]},
        "metallicRoughnessTexture": {"index": textures["packed"]},
        "roughnessFactor": 0.75,
    }
    file.material(
        "wood",
        pbrMetallicRoughness=pbr,
        normalTexture={"index": textures["normal"], "scale": 0.5},
        occlusionTexture={"index": textures["packed"]},
        extensions={
            "KHR_materials_anisotropy": {"anisotropyStrength": 0.5, "anisotropyTexture": {"index": textures["aniso"]}}
        },
    )
    file.material("packed", pbrMetallicRoughness={"metallicRoughnessTexture": {"index": packed}})
    file.squares()
    return file


def _materialx(folder: Path) -> None:
    for stem, role in (("rough", "roughness"), ("orm", "packed"), ("normal", "normal")):
        write_image(folder / f"{stem}.png", pixels_for(role, SIZE))
    body = mtlx_documents.surface(
        mtlx_documents.image("orm", "vector3", "orm.png"),
        mtlx_documents.node(
            "extract", "metal", "float", mtlx_documents.link("in", "orm", "vector3"), mtlx_documents.value("index", "2")
        ),
        mtlx_documents.image("raw", "vector3", "normal.png"),
        mtlx_documents.node("normalmap", "normal", "vector3", mtlx_documents.link("in", "raw", "vector3")),
        metalness="metal",
        normal="normal",
    )
    mtlx_documents.document(folder, body)


def _weights(folder: Path) -> None:
    import torch
    from safetensors.torch import save

    from mipbake.models.latent_config import LatentConfig
    from mipbake.models.registry import WeightsInfo

    torch.manual_seed(0)
    config = LatentConfig(latent_channels=16, encoder_layers=1, decoder_layers=1, growth=2)
    content = save({key: value.contiguous() for key, value in config.build().state_dict().items()})
    digest = hashlib.sha256(content).hexdigest()
    about = ("nothing", "CC0-1.0", "CC0-1.0", digest)
    info = WeightsInfo("small", config, ("gaussian",), False, 0, "none", *about, folder)
    info.tensors.write_bytes(content)
    (folder / "small.json").write_text(json.dumps(json.loads(info.to_json())), encoding="utf-8")


if __name__ == "__main__":
    main()
