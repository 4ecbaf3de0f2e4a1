"""Writes the corpus anew, or the folders of some readers: every file is made here, and as small as it can be."""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import mipbake
from mipbake.baking.convert import convert

from .. import gltf_files, mesh_files, mtlx_documents
from ..input_files import pixels_for, write_image
from .campaign import CORPUS
from .readers import STACKS

SIZE = 8


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.make_corpus", description=__doc__)
    parser.add_argument("readers", nargs="*", metavar="READER", help="these folders alone (default: all)")
    names = parser.parse_args().readers or list(MAKERS)
    unknown = [name for name in names if name not in MAKERS]
    if unknown:
        parser.error(f"no reader is called {', '.join(unknown)}: expected some of {', '.join(MAKERS)}")
    for name in names:
        write(CORPUS, name)


def write(corpus: Path, name: str) -> None:
    """Writes the folder of one reader anew, and nothing else."""
    folder = corpus / name
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    MAKERS[name](folder)


def _set(folder: Path) -> None:
    for role in ("base_color", "normal", "roughness", "metallic"):
        write_image(folder / f"wood_{role}.png", pixels_for(role, SIZE))


def _loaded() -> mipbake.TextureSet:
    with TemporaryDirectory() as scratch:
        source = Path(scratch) / "set"
        source.mkdir()
        _set(source)
        return mipbake.load(source)


def _stack(format: str, folder: Path) -> None:
    mipbake.bake(_loaded(), method="linear").save(folder, format)


def _material(folder: Path) -> None:
    convert(_loaded(), "ggx").save(folder)


def _gltf(folder: Path) -> None:
    document = _document()
    document.write(folder / "small.glb")
    document.write(folder / "embedded.gltf", "embedded")


def _mesh(folder: Path) -> None:
    mesh_files.quad().write(folder / "quad.glb")
    mesh_files.quad().write(folder / "quad.gltf", "embedded")
    (folder / "quad.obj").write_text(mesh_files.obj_text(mesh_files.shapes.plane()), encoding="utf-8")


def _environment(folder: Path) -> None:
    for suffix in ("hdr", "exr"):
        radiance = np.random.default_rng(0).random((4, 8, 3)).astype(np.float32)
        write_image(folder / f"light.{suffix}", radiance)


def _list(folder: Path) -> None:
    (folder / "list.txt").write_text("# sets\nwood\nwood/*.png\n**\n@list.txt\nwood_<UDIM>.png\n", encoding="utf-8")


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
    with TemporaryDirectory() as scratch:
        for name in ("dds", "tx"):  # sources may be such files, too
            _stack(name, Path(scratch) / name)
            shutil.copy(Path(scratch) / name / f"wood_base_color.{name}", folder)


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


MAKERS: Mapping[str, Callable[[Path], None]] = {
    "set": _set,
    **{name: partial(_stack, format) for name, format in STACKS.items()},
    "images": _images,
    "material": _material,
    "gltf": _gltf,
    "mtlx": _materialx,
    "mesh": _mesh,
    "environment": _environment,
    "list": _list,
    "weights": _weights,
}
"""What writes the folder of each reader."""


if __name__ == "__main__":
    main()
