"""The texture slots of a material, resolved: which image they show, where on the surface, and repeated how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mipbake.errors import InputError
from mipbake.io.gltf.document import Document, Json, member
from mipbake.io.gltf.images import source_of

TRANSFORM = "KHR_texture_transform"
ANISOTROPY = "KHR_materials_anisotropy"

BASE_COLOUR = "baseColorTexture"
METALLIC_ROUGHNESS = "metallicRoughnessTexture"
NORMAL = "normalTexture"
ANISOTROPIC = "anisotropyTexture"
OCCLUSION = "occlusionTexture"

_CLAMPED, _MIRRORED, _REPEATED = 33071, 33648, 10497
_WITHOUT_LEVELS = (9728, 9729)  # NEAREST, LINEAR

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
    """

    name: str
    texture: int
    image: int
    sampler: int | None
    mapping: Mapping2D
    wrap: tuple[str, str]
    mirrored: bool
    without_levels: bool


def holder_of(material: Json, slot: str, where: str, document: Document) -> Json:
    """The object of a material that holds a slot's textureInfo; empty where the material lacks it."""
    if slot in (BASE_COLOUR, METALLIC_ROUGHNESS):
        return member(material, "pbrMetallicRoughness", where, document.path)
    if slot == ANISOTROPIC:
        extensions = member(material, "extensions", where, document.path)
        return member(extensions, ANISOTROPY, where, document.path)
    return material


def slot_of(document: Document, material: Json, name: str, where: str) -> Slot | None:
    """A slot of a material, None where it has no texture; InputError where its indices lead nowhere."""
    info = member(holder_of(material, name, where, document), name, where, document.path)
    if not info:
        return None
    what = f"{name} of {where}"
    texture = document.one("textures", info.get("index"), what)
    index = int(info["index"])
    image = source_of(document, index, what)
    document.one("images", image, what)
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
        index,
        int(str(image)),
        sampler,
        _mapping(document, info, what),
        (u, v),
        _MIRRORED in modes,
        settings.get("minFilter") in _WITHOUT_LEVELS,
    )


def _mapping(document: Document, info: Json, what: str) -> Mapping2D:
    extensions = member(info, "extensions", what, document.path)
    transform = member(extensions, TRANSFORM, what, document.path)
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
