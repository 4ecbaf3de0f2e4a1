"""The texture slots of a material, resolved: which image they show, where on the surface, and repeated how."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mipbake.base.errors import InputError
from mipbake.source.gltf.document import Document, Json, member
from mipbake.source.gltf.images import source_of

TRANSFORM = "KHR_texture_transform"
ANISOTROPY = "KHR_materials_anisotropy"
UNLIT = "KHR_materials_unlit"

BASE_COLOUR = "baseColorTexture"
METALLIC_ROUGHNESS = "metallicRoughnessTexture"
NORMAL = "normalTexture"
ANISOTROPIC = "anisotropyTexture"
OCCLUSION = "occlusionTexture"
EMISSIVE = "emissiveTexture"

CLEARCOAT = "KHR_materials_clearcoat"
COAT = "clearcoatTexture"
COAT_ROUGHNESS = "clearcoatRoughnessTexture"
COAT_NORMAL = "clearcoatNormalTexture"

SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
DIFFUSE = "diffuseTexture"
SPECULAR_AND_GLOSS = "specularGlossinessTexture"

COLOUR, DATA, VECTORS, ALPHA = "colour", "data", "vectors", "alpha"
"""What a slot reads of its texture: sRGB-encoded colours, numbers or directions in red, green and blue; or alpha
alone, which is never encoded."""


@dataclass(frozen=True)
class Place:
    """Where in a material a slot is, and what its texture holds.

    Args:
        keys: of the objects that lead to the one that holds the textureInfo.
        holds: `COLOUR`, `DATA`, `VECTORS` or `ALPHA`.
    """

    keys: tuple[str, ...]
    holds: str


def _of(extension: str, **slots: str) -> dict[str, Place]:
    return {name: Place(("extensions", extension), holds) for name, holds in slots.items()}


PLACES: Mapping[str, Place] = {
    BASE_COLOUR: Place(("pbrMetallicRoughness",), COLOUR),
    METALLIC_ROUGHNESS: Place(("pbrMetallicRoughness",), DATA),
    NORMAL: Place((), VECTORS),
    OCCLUSION: Place((), DATA),
    EMISSIVE: Place((), COLOUR),
    **_of(ANISOTROPY, anisotropyTexture=VECTORS),
    **_of(CLEARCOAT, clearcoatTexture=DATA, clearcoatRoughnessTexture=DATA, clearcoatNormalTexture=VECTORS),
    **_of(SPECULAR_GLOSSINESS, diffuseTexture=COLOUR, specularGlossinessTexture=COLOUR),
    **_of("KHR_materials_sheen", sheenColorTexture=COLOUR, sheenRoughnessTexture=ALPHA),
    **_of("KHR_materials_specular", specularTexture=ALPHA, specularColorTexture=COLOUR),
    **_of("KHR_materials_transmission", transmissionTexture=DATA),
    **_of("KHR_materials_volume", thicknessTexture=DATA),
    **_of("KHR_materials_iridescence", iridescenceTexture=DATA, iridescenceThicknessTexture=DATA),
    **_of(
        "KHR_materials_diffuse_transmission", diffuseTransmissionTexture=ALPHA, diffuseTransmissionColorTexture=COLOUR
    ),
}
"""Every slot of glTF 2.0 and of the extensions that Khronos ratified, by its name."""


@dataclass(frozen=True)
class Lobe:
    """The slots of a microfacet lobe, whose normals and roughness are filtered together.

    Args:
        normal: slot of its normals.
        roughness: slot whose green channel is the roughness.
        red: slot that may show the red channel of the same image.
        factors: members beside the roughness's slot that the roughness, and the metallic where there is one, are
            multiplied with, and the value of each where it is not given.
    """

    normal: str
    roughness: str
    red: str
    factors: tuple[tuple[str, float], ...]


BASE = Lobe(NORMAL, METALLIC_ROUGHNESS, OCCLUSION, (("roughnessFactor", 1.0), ("metallicFactor", 1.0)))
COATING = Lobe(COAT_NORMAL, COAT_ROUGHNESS, COAT, (("clearcoatRoughnessFactor", 0.0),))
"""KHR_materials_clearcoat: a second lobe, of a dielectric, on top of the material."""

_CLAMPED, _MIRRORED, _REPEATED = 33071, 33648, 10497
_NEAREST, _LINEAR = 9728, 9729

Mapping2D = tuple[int, tuple[float, ...], float, tuple[float, ...]]
"""Set of texture coordinates, offset, rotation and scale."""


@dataclass(frozen=True)
class Slot:
    """A texture as a material shows it.

    Args:
        name: of the slot, as glTF calls it.
        texture, image: indices. sampler: index, None for the default one.
        mapping: set of texture coordinates, offset, rotation and scale (KHR_texture_transform).
        wrap: addressing along u and v, each "wrap" or "clamp"; a mirrored texture is nearest to "clamp".
        mirrored: whether it is mirrored along an axis.
        without_levels: whether the sampler shows level 0 alone.
        single_texels: whether it magnifies without interpolation, as pixel art wants.
    """

    name: str
    texture: int
    image: int
    sampler: int | None
    mapping: Mapping2D
    wrap: tuple[str, str]
    mirrored: bool
    without_levels: bool
    single_texels: bool


def label_of(index: int, material: Json) -> str:
    """The name of a material in messages."""
    name = material.get("name")
    return f"material {index} ({name})" if isinstance(name, str) and name else f"material {index}"


def holder_of(material: Json, slot: str, where: str, document: Document) -> Json:
    """The object of a material that holds a slot's textureInfo; empty where the material lacks it."""
    holder = material
    for key in PLACES[slot].keys:
        holder = member(holder, key, where, document.path)
    return holder


def info_of(material: Json, slot: str) -> Json | None:
    """A slot's textureInfo; None where there is no texture."""
    info: Any = material
    for key in (*PLACES[slot].keys, slot):
        info = info.get(key) if isinstance(info, dict) else None
    return info if isinstance(info, dict) and "index" in info else None  # an object without an index is not a texture


def made_holder(material: Json, slot: str) -> Json:
    """The object of a material that holds a slot's textureInfo, which is made where it is not there."""
    for key in PLACES[slot].keys:
        material = material.setdefault(key, {})
    return material


def slot_of(document: Document, material: Json, name: str, where: str) -> Slot | None:
    """A slot of a material, None where it has no texture; InputError where its indices lead nowhere."""
    info = member(holder_of(material, name, where, document), name, where, document.path)
    if not info:
        return None
    what = f"{name} of {where}"
    texture = document.one("textures", info.get("index"), what)
    image = source_of(document, info["index"], what)
    sampler = texture.get("sampler")
    settings = {} if sampler is None else document.one("samplers", sampler, what)
    modes = [settings.get(key, _REPEATED) for key in ("wrapS", "wrapT")]
    for mode in modes:
        if mode not in (_CLAMPED, _MIRRORED, _REPEATED):
            raise InputError(
                f"{document.path}: sampler {sampler} has the wrap mode {mode!r}, expected {_CLAMPED}, {_MIRRORED} or "
                f"{_REPEATED}: export it again"
            )
    u, v = ("wrap" if mode == _REPEATED else "clamp" for mode in modes)
    return Slot(
        name,
        info["index"],
        image,
        sampler,
        _mapping(document, info, what),
        (u, v),
        _MIRRORED in modes,
        settings.get("minFilter") in (_NEAREST, _LINEAR),
        settings.get("magFilter") == _NEAREST,
    )


def _mapping(document: Document, info: Json, what: str) -> Mapping2D:
    transform = member(member(info, "extensions", what, document.path), TRANSFORM, what, document.path)
    try:
        # Two transforms are one where they differ by the rounding of an exporter.
        offset, scale = (
            tuple(round(float(x), 6) for x in transform.get(key, [default] * 2))
            for key, default in (("offset", 0.0), ("scale", 1.0))
        )
        rotation = round(float(transform.get("rotation", 0.0)), 6)
        coordinates = int(transform["texCoord"] if "texCoord" in transform else info.get("texCoord", 0))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{document.path}: the texture coordinates of {what} are not as glTF defines them: export it again"
        ) from error
    return coordinates, offset, rotation, scale


def surface_mapping(info: Json) -> dict[str, Any]:
    """What of a textureInfo says where on the surface it lies, for another textureInfo."""
    kept: dict[str, Any] = {key: info[key] for key in ("texCoord",) if key in info}
    if TRANSFORM in info.get("extensions", {}):
        kept["extensions"] = {TRANSFORM: info["extensions"][TRANSFORM]}
    return kept
