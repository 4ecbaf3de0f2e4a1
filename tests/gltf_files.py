"""glTF files with many materials, written by hand, and a checker of their structure that takes nothing from mipbake."""

from __future__ import annotations

import base64
import json
import struct
import tempfile
import urllib.parse
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mipbake.source.images.gpu_format import GPU_FORMATS, GpuTexture, level_size
from mipbake.source.images.ktx2 import encoded as ktx2_file

from .input_files import encoded, height_field, write_image

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
DRACO = bytes(range(7, 107))
"""Opaque bytes: nothing here decodes them."""


@cache
def png(kind: str, size: int = 16, channels: int = 3) -> bytes:
    """A PNG whose pixels follow from its arguments; `kind` "normal" is a smooth normal map, green up, "smooth" a ramp
    that blocks hold, and all else is noise."""
    rng = np.random.default_rng([size, channels, *kind.encode()])
    pixels = rng.integers(30, 220, (size, size, channels)).astype(np.uint8)
    if kind.startswith("normal"):
        pixels = encoded(height_field(size, size, seed=len(kind)))
    elif kind.startswith("smooth"):
        ramp = np.add.outer(np.arange(size) * 4, np.arange(size) * 8)[..., None]
        pixels = (20 + ramp * 200 // (12 * size) + len(kind) * np.arange(channels)).astype(np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        return write_image(Path(folder) / "a.png", pixels).read_bytes()


@cache
def ktx2(seed: int, srgb: bool = False, width: int = 8, height: int = 8) -> bytes:
    """A KTX 2 file of UASTC's format; what its blocks show is of no matter."""
    rng = np.random.default_rng(seed)
    sizes = [level_size(width, height, level) for level in range(max(width, height).bit_length())]
    made = GPU_FORMATS[f"UASTC_RGB_{'SRGB' if srgb else 'UNORM'}_BLOCK"]
    return ktx2_file(GpuTexture(made, width, height, tuple(rng.bytes(made.level_size(*s)) for s in sizes), {}), False)


class GltfFile:
    """A document that grows; images lie in bufferViews until it is written otherwise."""

    def __init__(self) -> None:
        self.data = b""
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "by hand", "extras": {"author": "nobody"}},
            "extras": {"texture": 1, "bufferView": 3},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "materials": [],
            "accessors": [],
            "bufferViews": [],
            "samplers": [{"wrapS": 10497, "wrapT": 10497, "minFilter": 9987, "magFilter": 9729}],
            "textures": [],
            "images": [],
            "extensionsUsed": [],
        }

    def view(self, data: bytes, alignment: int = 4, **more: Any) -> int:
        self.data += bytes(-len(self.data) % alignment)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, **more: Any) -> int:
        rows = values.reshape(len(values), -1)
        made = {"componentType": CODES[rows.dtype.str[1:]], "count": len(rows), "type": TYPES[rows.shape[1]]}
        if "bufferView" not in more:
            made["bufferView"] = self.view(rows.tobytes(), target=34963 if rows.dtype.kind == "u" else 34962)
        self.json["accessors"].append({**made, **more})
        return len(self.json["accessors"]) - 1

    def image(self, data: bytes, name: str, mime: str = "image/png") -> int:
        self.json["images"].append({"name": name, "mimeType": mime, "bufferView": self.view(data)})
        return len(self.json["images"]) - 1

    def texture(self, image: int, sampler: int | None = 0, **more: Any) -> int:
        chosen = {} if sampler is None else {"sampler": sampler}
        self.json["textures"].append({**chosen, "source": image, **more})
        return len(self.json["textures"]) - 1

    def material(self, name: str, **members: Any) -> int:
        self.json["materials"].append({"name": name, **members})
        return len(self.json["materials"]) - 1

    def squares(self) -> None:
        """A square for every material; the last one claims to be compressed by Draco too."""
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
        positions = np.hstack([corners - 0.5, np.zeros((4, 1), np.float32)])
        attributes = {
            "POSITION": self.accessor(positions, min=positions.min(0).tolist(), max=positions.max(0).tolist()),
            "NORMAL": self.accessor(np.tile(np.float32([0, 0, 1]), (4, 1))),
            "TANGENT": self.accessor(np.tile(np.float32([1, 0, 0, 1]), (4, 1))),
            "TEXCOORD_0": self.accessor(corners),
            "TEXCOORD_1": self.accessor(corners[::-1].copy()),
        }
        indices = self.accessor(np.array([0, 1, 2, 0, 2, 3], np.uint16))
        for index in range(len(self.json["materials"])):
            primitive = {"attributes": attributes, "indices": indices, "material": index}
            self.json["meshes"].append({"primitives": [primitive], "extras": {"number": index}})
            self.json["nodes"].append({"mesh": index, "translation": [float(index), 0.0, 0.0]})
            self.json["scenes"][0]["nodes"].append(index)
        draco = {"bufferView": self.view(DRACO), "attributes": {"POSITION": 0, "NORMAL": 1}}
        last = dict(self.json["meshes"][-1]["primitives"][0], extensions={"KHR_draco_mesh_compression": draco})
        self.json["meshes"][-1]["primitives"][0] = last
        self.uses("KHR_draco_mesh_compression")

    def uses(self, *names: str) -> None:
        used = self.json["extensionsUsed"]
        used += [name for name in names if name not in used]

    def write(self, path: Path, kind: str = "glb") -> Path:
        """Writes a document as "glb"; as "external": .gltf with .bin and .png files; "embedded": .gltf with data
        URIs."""
        document = json.loads(json.dumps({k: v for k, v in self.json.items() if v != []}))
        buffer: dict[str, Any] = {"byteLength": len(self.data), "name": "everything"}
        document["buffers"] = [buffer, *document.get("buffers", [])]
        if kind == "glb":
            path = path.with_suffix(".glb")
            path.write_bytes(glb(document, self.data))
            return path
        path = path.with_suffix(".gltf")
        for image in document.get("images", []):
            view = document["bufferViews"][image.pop("bufferView")]
            data = self.data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
            if kind == "external":
                name = f"{image['name']} of {path.stem}.png"
                (path.parent / name).write_bytes(data)
                image["uri"] = urllib.parse.quote(name)
                del image["mimeType"]
            else:
                image["uri"] = f"data:{image['mimeType']};base64,{base64.b64encode(data).decode()}"
        if kind == "external":
            (path.parent / "the buffer.bin").write_bytes(self.data)
            buffer["uri"] = "the%20buffer.bin"
        else:
            buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        path.write_text(json.dumps(document), encoding="utf-8")
        return path


def glb(document: dict[str, Any], data: bytes, *chunks: tuple[bytes, bytes]) -> bytes:
    body = b""
    for kind, plain, pad in ((b"JSON", json.dumps(document).encode(), b" "), (b"BIN\0", data, b"\0")):
        padded = plain + pad * (-len(plain) % 4)
        body += struct.pack("<I4s", len(padded), kind) + padded
    for kind, plain in chunks:
        body += struct.pack("<I4s", len(plain), kind) + plain
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


TRANSFORM = {"KHR_texture_transform": {"offset": [0, 1], "scale": [3, 2], "texCoord": 0}}

LEATHER, RED_LEATHER, WORN_LEATHER, FENCE, TWO_SETS, SHIFTED, APART, GLOW, FOREIGN = range(9)
UNLIT, GLOSSY, PLAIN, BRUSHED, COMBED = range(9, 14)
BASE, ORM, NORMAL, LEAVES, FENCE_NORMAL, SET1_NORMAL, SET1_MR, FOREIGN_NORMAL, DIRECTIONS = range(9)
"""Materials, and images, of `many_materials`. Texture i shows image i; 9 shows ORM as well, 10 LEAVES."""


def many_materials(names: tuple[str, ...] = ()) -> GltfFile:
    """What files in the wild have: see the constants above for the materials.

    Args:
        names: of the materials that it has; none for all.
    """
    made = GltfFile()
    for name, channels in (("base", 3), ("orm", 3), ("normal", 3), ("leaves", 4), ("normal fence", 3)):
        made.texture(made.image(png(name, channels=channels), name))
    for name in ("normal set 1", "metal set 1", "normal foreign", "directions"):
        made.texture(made.image(png(name, 8), name), None)
    made.texture(ORM, 0, extras={"note": "occlusion"})
    made.texture(LEAVES, None)
    leather: dict[str, Any] = {
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": BASE},
            "metallicRoughnessTexture": {"index": ORM},
            "roughnessFactor": 0.8,
        },
        "normalTexture": {"index": NORMAL, "scale": 0.5},
        "occlusionTexture": {"index": 9, "strength": 0.7},
        "emissiveFactor": [0.1, 0.2, 0.3],
    }

    def changed(**pbr: Any) -> dict[str, Any]:
        copied: dict[str, Any] = json.loads(json.dumps(leather))
        copied["pbrMetallicRoughness"] |= pbr
        return copied

    made.material("Leather", **leather, extensions={"EXT_example": {"weights": [1, 2, 3]}})
    made.material("Leather/Red", **changed(baseColorFactor=[1.0, 0.1, 0.1, 1.0]))
    made.material("leather", **changed(roughnessFactor=0.5))
    made.material(
        "Fence",
        pbrMetallicRoughness={
            "baseColorTexture": {"index": LEAVES},
            "baseColorFactor": [1, 1, 1, 0.8],
            "roughnessFactor": 0.6,
            "metallicFactor": 0,
        },
        normalTexture={"index": FENCE_NORMAL},
        alphaMode="MASK",
        alphaCutoff=0.4,
        doubleSided=True,
    )
    set1 = {"metallicRoughnessTexture": {"index": SET1_MR, "texCoord": 1}, "baseColorTexture": {"index": BASE}}
    made.material("Two sets", pbrMetallicRoughness=set1, normalTexture={"index": SET1_NORMAL, "texCoord": 1})
    shifted = json.loads(json.dumps(leather))
    for holder in (shifted, shifted["pbrMetallicRoughness"]):
        for key in [key for key in holder if key.endswith("Texture") and key != "occlusionTexture"]:
            holder[key]["extensions"] = TRANSFORM
    shifted["pbrMetallicRoughness"]["metallicFactor"] = 0.25
    made.material("Shifted", **shifted)
    apart = {"metallicRoughnessTexture": {"index": ORM, "texCoord": 1}}
    made.material("Apart", pbrMetallicRoughness=apart, normalTexture={"index": NORMAL})
    glow = {"emissiveTexture": {"index": 10}, "emissiveFactor": [1, 1, 1]}
    made.material("Glow", **glow, pbrMetallicRoughness={"baseColorTexture": {"index": BASE}})
    foreign = {"EXT_example": {"fuzzTexture": {"index": FOREIGN_NORMAL, "texCoord": 1}, "image": 7}}
    made.material("Foreign", normalTexture={"index": FOREIGN_NORMAL}, extensions=foreign)
    made.material("Unlit", **json.loads(json.dumps(leather)), extensions={"KHR_materials_unlit": {}})
    glossy = {"diffuseTexture": {"index": BASE}}
    extension = {"KHR_materials_pbrSpecularGlossiness": glossy}
    made.material("Glossy", normalTexture={"index": NORMAL}, extensions=extension)
    made.material("Plain", pbrMetallicRoughness={"roughnessFactor": 0.3})
    brushed = {"anisotropyStrength": 0.5, "anisotropyRotation": 0.5, "anisotropyTexture": {"index": DIRECTIONS}}
    extension = {"KHR_materials_anisotropy": brushed, "KHR_materials_clearcoat": {"clearcoatFactor": 1}}
    made.material("Brushed", normalTexture={"index": NORMAL}, extensions=extension)
    combed = {"KHR_materials_anisotropy": {"anisotropyStrength": 0.6}}
    made.material("", normalTexture={"index": NORMAL}, extensions=combed)
    made.uses("EXT_example", "KHR_texture_transform", "KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness")
    made.uses("KHR_materials_anisotropy", "KHR_materials_clearcoat")
    if names:
        made.json["materials"] = [each for each in made.json["materials"] if each["name"] in names]
    made.squares()
    return made


def split(data: bytes) -> tuple[dict[str, Any], bytes]:
    """JSON and BIN chunk of a GLB whose container is as section 4.4 of the specification wants it."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    chunks, at = {}, 12
    while at < length:
        size, kind = struct.unpack_from("<I4s", data, at)
        assert size % 4 == 0 and at % 4 == 0
        chunks[kind] = data[at + 8 : at + 8 + size]
        assert len(chunks[kind]) == size
        at += 8 + size
    assert next(iter(chunks)) == b"JSON"
    text = chunks[b"JSON"]
    assert text.rstrip(b" ").endswith(b"}") and len(text) - len(text.rstrip(b" ")) < 4
    document = json.loads(text)
    binary = chunks.get(b"BIN\0", b"")
    if binary:
        declared = document["buffers"][0]["byteLength"]
        assert "uri" not in document["buffers"][0]
        assert 0 <= len(binary) - declared < 4 and not any(binary[declared:])
    return document, binary


def view_of(document: dict[str, Any], binary: bytes, index: int) -> bytes:
    view = document["bufferViews"][index]
    assert view["buffer"] == 0
    start = view.get("byteOffset", 0)
    return binary[start : start + view["byteLength"]]


def image_of(document: dict[str, Any], binary: bytes, texture: int) -> bytes:
    """What a texture shows."""
    found = document["textures"][texture]
    source = found.get("extensions", {}).get("KHR_texture_basisu", found).get("source")
    return view_of(document, binary, document["images"][source]["bufferView"])


def check_structure(data: bytes) -> tuple[dict[str, Any], bytes]:
    """JSON and BIN chunk of a GLB; asserts indices in range, alignment, media types, and declared extensions."""
    document, binary = split(data)
    count = {key: len(value) for key, value in document.items() if isinstance(value, list)}
    for view in document.get("bufferViews", []):
        assert 0 <= view["buffer"] < count["buffers"]
        assert view.get("byteOffset", 0) % 4 == 0 and view["byteLength"] >= 1
        end = view.get("byteOffset", 0) + view["byteLength"]
        assert end <= document["buffers"][view["buffer"]]["byteLength"]
    for accessor in document.get("accessors", []):
        assert 0 <= accessor["bufferView"] < count["bufferViews"]
    for image in document.get("images", []):
        if "bufferView" in image:
            assert "uri" not in image
            start = view_of(document, binary, image["bufferView"])[:12]
            kinds = {"image/png": b"\x89PNG", "image/ktx2": b"\xabKTX 20", "image/jpeg": b"\xff\xd8"}
            assert start.startswith(kinds[image["mimeType"]])
    for texture in document.get("textures", []):
        assert 0 <= texture.get("sampler", 0) < max(1, count.get("samplers", 0))
        basis = texture.get("extensions", {}).get("KHR_texture_basisu")
        if basis is not None:
            assert document["images"][basis["source"]]["mimeType"] == "image/ktx2"
        if "source" in texture:
            assert document["images"][texture["source"]].get("mimeType") != "image/ktx2"
        assert "source" in texture or basis is not None
    found = _check_indices(document, count)
    assert found == set(document.get("extensionsUsed", [])), "declared extensions are those that are there"
    assert set(document.get("extensionsRequired", [])) <= found
    return document, binary


def _check_indices(node: Any, count: dict[str, int]) -> set[str]:
    """Names of extensions beneath; asserts that textureInfos and bufferViews exist."""
    found: set[str] = set()
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        if key in ("extras", "asset"):
            continue
        if key == "extensions":
            found |= set(value)
        if isinstance(key, str) and key.endswith("Texture"):
            assert 0 <= value["index"] < count["textures"]
        if key == "bufferView":
            assert 0 <= value < count["bufferViews"]
        found |= _check_indices(value, count)
    return found
