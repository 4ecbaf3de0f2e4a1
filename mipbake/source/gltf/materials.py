"""What to bake of a glTF document: its materials as texture sets, those that share everything as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mipbake.base.errors import InputError
from mipbake.base.messages import listed
from mipbake.base.safe_names import unique_name
from mipbake.source.gltf.bakes import (
    GltfBake,
    SkippedError,
    add_factor,
    animation_warning,
    check_shared,
    sampler_warnings,
)
from mipbake.source.gltf.clearcoat import coat_bakes
from mipbake.source.gltf.document import Document, Json, member, number
from mipbake.source.gltf.extracted import Extracted
from mipbake.source.gltf.plain import PlainTexture, plain_textures
from mipbake.source.gltf.slots import (
    ANISOTROPIC,
    ANISOTROPY,
    BASE_COLOUR,
    METALLIC_ROUGHNESS,
    NORMAL,
    OCCLUSION,
    SPECULAR_GLOSSINESS,
    UNLIT,
    Slot,
    label_of,
    slot_of,
)
from mipbake.source.gltf.uses import animated_members
from mipbake.source.options import LoadOptions, MapChoice

__all__ = ["GltfBake", "GltfMaterials", "read_materials"]


@dataclass(frozen=True)
class GltfMaterials:
    """The bakes of a document, and what is to be said of the materials that are in none.

    `plain`: the textures beside them that are averaged, level by level. `errors`: what is wrong with the materials that
    should be baked and cannot be read, a sentence each.
    """

    bakes: tuple[GltfBake, ...]
    plain: tuple[PlainTexture, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    errors: tuple[str, ...] = ()


@dataclass
class _Material:
    """A material that can be baked: its index, its slots that share texels, and the factors that enter."""

    index: int
    name: str
    slots: dict[str, Slot]
    elsewhere: Slot | None
    """The material's base colour, where it does not share the texels."""
    occluded: bool
    roughness: float
    metallic: float
    scale: float
    colour: tuple[float, ...]
    opacity: bool
    cutoff: float | None
    strength: float
    rotation: float
    notes: list[str] = field(default_factory=list)

    @property
    def main(self) -> Slot:
        """The slot whose place on the surface and whose wrap the set has."""
        return self.slots.get(NORMAL) or self.slots[METALLIC_ROUGHNESS]


def read_materials(document: Document, folder: Path) -> GltfMaterials:
    """The materials of a document that have a normal or a metallicRoughness texture, as texture sets.

    Materials whose textures and factors are the same are one set; where on the surface they show it does not matter.
    A clearcoat with textures of its own is a set of its own, of a dielectric without a colour.

    roughnessFactor, metallicFactor, the scale of the normal map and the factors of KHR_materials_anisotropy are in the
    set (`mipbake.stack.gltf.write` makes them 1), baseColorFactor and the strength of the occlusion stay in the
    material.

    Args:
        document: from `read_document`.
        folder: an existing, empty one. The images are written there; the caller deletes it.

    Raises:
        InputError: no material can be baked; what is wrong with the first where none can be read.
    """
    images = Extracted(document, folder)
    groups: dict[tuple[Any, ...], list[_Material]] = {}
    notes: list[str] = []
    warnings: list[str] = []
    broken: dict[str, list[str]] = {}
    for index, material in enumerate(document.all("materials")):
        try:
            found = _material(document, index, material, images)
            groups.setdefault(_key(found, images), []).append(found)
        except SkippedError as skipped:
            (warnings if skipped.loud else notes).append(str(skipped))
        except InputError as error:
            broken.setdefault(error.full, []).append(label_of(index, material))
    names: set[str] = set()
    bakes = []
    for materials in groups.values():
        try:
            bakes.append(_bake(document, materials, images, names))
        except InputError as error:
            broken.setdefault(error.full, []).extend(material.name for material in materials)
    bakes += coat_bakes(document, images, names, warnings, broken)
    errors = tuple(f"{reason} ({listed(labels)} cannot be baked)" for reason, labels in broken.items())
    if not bakes and errors:
        raise InputError(errors[0] + (f"; {len(errors) - 1} more are broken in other ways" if errors[1:] else ""))
    if not bakes:
        reasons = [*warnings, *notes]
        shown = "; ".join(reasons[:3]) + (f"; and {len(reasons) - 3} more" if len(reasons) > 3 else "")
        raise InputError(
            f"{document.path} has no material to bake ({shown or 'it has none at all'}): expected one with a normal or "
            "a metallicRoughness texture"
        )
    plain, told = plain_textures(document, bakes, images)
    return GltfMaterials(tuple(bakes), plain, (*notes, *told), tuple(warnings), errors)


def _material(document: Document, index: int, material: Json, images: Extracted) -> _Material:
    """A material's slots and factors; SkippedError where it is left as it is."""
    where, path = label_of(index, material), document.path
    extensions = member(material, "extensions", where, path)
    if UNLIT in extensions:
        raise SkippedError(f"{where} is unlit and is left as it is")
    if SPECULAR_GLOSSINESS in extensions:  # why it was not converted is told by who did that
        raise SkippedError(f"{where} is given in specular and glossiness and is left as it is")
    names = (NORMAL, METALLIC_ROUGHNESS, BASE_COLOUR, ANISOTROPIC)
    slots = {name: slot for name in names if (slot := slot_of(document, material, name, where)) is not None}
    main = slots.get(NORMAL) or slots.get(METALLIC_ROUGHNESS)
    if main is None:
        raise SkippedError(
            f"{where} has neither a normal nor a metallicRoughness texture: nothing in it is prefiltered"
        )
    pbr = member(material, "pbrMetallicRoughness", where, path)
    anisotropy = extensions.get(ANISOTROPY, {})
    scale = number(material.get(NORMAL, {}).get("scale", 1.0), f"scale of normalTexture of {where}", path, -1e6, 1e6)
    if NORMAL in slots and scale < 0:
        raise SkippedError(
            f"{where}: the scale of its normalTexture is {scale:g}, which inverts its bumps along x and y, and is left "
            "as it is: invert red and green of the normal map and make the scale positive to have it baked",
            loud=True,
        )
    strength = number(anisotropy.get("anisotropyStrength", 0.0), f"anisotropyStrength of {where}", path, 0, 1)
    if strength == 0:
        slots.pop(ANISOTROPIC, None)
    check_shared(where, main, [slots[name] for name in (METALLIC_ROUGHNESS, ANISOTROPIC) if name in slots])
    base = slots.get(BASE_COLOUR)
    elsewhere = slots.pop(BASE_COLOUR) if base is not None and base.mapping != main.mapping else None
    colour = pbr.get("baseColorFactor", [1.0, 1.0, 1.0, 1.0])
    if not isinstance(colour, list) or len(colour) != 4:
        raise InputError(f"{path}: baseColorFactor of {where} is {colour!r}, expected four numbers: export it again")
    factors = tuple(number(c, f"baseColorFactor of {where}", path, 0, 1) for c in colour)
    found = _Material(
        index,
        where,
        slots,
        elsewhere,
        _occluded(document, material, slots.get(METALLIC_ROUGHNESS), images, where),
        number(pbr.get("roughnessFactor", 1.0), f"roughnessFactor of {where}", path, 0, 1),
        number(pbr.get("metallicFactor", 1.0), f"metallicFactor of {where}", path, 0, 1),
        scale,
        factors,
        False,
        None,
        strength,
        number(anisotropy.get("anisotropyRotation", 0.0), f"anisotropyRotation of {where}", path, -1e6, 1e6)
        if strength
        else 0.0,
    )
    _read_alpha(document, found, material, images)
    return found


def _occluded(document: Document, material: Json, packed: Slot | None, images: Extracted, where: str) -> bool:
    """Whether the occlusion is the red channel of the metallicRoughness image."""
    occlusion = slot_of(document, material, OCCLUSION, where)
    return occlusion is not None and packed is not None and images.key(occlusion.image) == images.key(packed.image)


def _read_alpha(document: Document, found: _Material, material: Json, images: Extracted) -> None:
    """Whether the alpha of the base colour is seen, and the cutoff in its terms."""
    mode = material.get("alphaMode", "OPAQUE")
    if mode not in ("OPAQUE", "MASK", "BLEND"):
        raise InputError(
            f"{document.path}: alphaMode of {found.name} is {mode!r}, expected OPAQUE, MASK or BLEND: export it again"
        )
    base = found.slots.get(BASE_COLOUR)
    if mode == "OPAQUE" or base is None or images.header(base.image).alpha < 0:
        return
    found.opacity = True
    if mode == "BLEND":
        return
    cutoff = number(material.get("alphaCutoff", 0.5), f"alphaCutoff of {found.name}", document.path, 0, 1e6)
    factor = found.colour[3]
    if 0 < cutoff <= factor:
        found.cutoff = cutoff / factor  # the material tests the product
    else:
        side = "opaque" if cutoff == 0 else "transparent"
        found.notes.append(f"{found.name}: no alpha reaches both sides of its cutoff, so that it is {side} everywhere")


def _key(found: _Material, images: Extracted) -> tuple[Any, ...]:
    """Equal for materials that are baked as one: everything that texels are made from."""
    textures = tuple((name, images.key(slot.image), slot.wrap) for name, slot in sorted(found.slots.items()))
    constants = (found.roughness, found.metallic, found.scale if NORMAL in found.slots else 1.0)
    return textures, constants, found.opacity, found.cutoff, found.strength, found.rotation


def _bake(document: Document, materials: Sequence[_Material], images: Extracted, names: set[str]) -> GltfBake:
    first, notes = materials[0], [n for m in materials for n in m.notes]
    warnings = [
        *(text for m in materials for text in sampler_warnings(m.name, list(m.slots.values()), m.main)),
        *_animation_warnings(document, materials),
    ]
    maps: dict[str, MapChoice] = {"normal": None, "opacity": None, "occlusion": None, "height": None, "emissive": None}
    factors: dict[str, float] = {}
    files: list[Path] = []

    def channels(image: int, letters: str) -> str:
        path = images.file(image)
        files.append(path)
        return f"{path.name}:{'R' if letters != 'A' and images.is_grey(image) else letters}"

    def made(path: Path) -> str:
        files.append(path)
        return f"{path.name}:RGB"

    for slot in (NORMAL, ANISOTROPIC):
        if slot in first.slots:
            images.check_directions(first.slots[slot].image, slot)
    maps["base_color"] = _base_colour(materials, images, channels, made, notes)
    if NORMAL in first.slots:
        maps["normal"] = channels(first.slots[NORMAL].image, "RGB")
        add_factor(factors, "normal", first.scale)
    packed = first.slots.get(METALLIC_ROUGHNESS)
    for role, letter, value in (("roughness", "G", first.roughness), ("metallic", "B", first.metallic)):
        maps[role] = value if packed is None else channels(packed.image, letter)
        if packed is not None:
            add_factor(factors, role, value)
    if packed is not None and any(m.occluded for m in materials):
        maps["occlusion"] = channels(packed.image, "R")
        notes.append("the occlusion is the red channel of the metallicRoughness image and stays there")
    if first.opacity:
        maps["opacity"] = channels(first.slots[BASE_COLOUR].image, "A")
    if first.strength:
        texture = first.slots.get(ANISOTROPIC)
        if texture is not None and first.strength == 1 and first.rotation == 0:
            maps["anisotropy"] = channels(texture.image, "RGB")
        else:
            image = None if texture is None else texture.image
            maps["anisotropy"] = made(images.directions(image, first.strength, first.rotation))
    if factors:
        shown = ", ".join(f"{role} {value:g}" for role, value in factors.items())
        notes.append(f"factors of the material are baked into the textures and become 1 there: {shown}")
    if len(materials) > 1:
        notes.append(f"{listed(m.name for m in materials)} share these textures, which are baked once")
    name = unique_name(document.all("materials")[first.index].get("name"), f"material_{first.index}", names)
    options = LoadOptions(
        maps=maps,
        colour_space="sRGB",
        normal_convention="opengl",
        wrap=first.main.wrap,
        name=name,
        factors=factors,
        alpha_cutoff=first.cutoff,
        metadata=False,
        origin="document",
    )
    slots = [s for s in (BASE_COLOUR,) if s in first.slots] + [METALLIC_ROUGHNESS, NORMAL, ANISOTROPIC]
    indices = tuple(m.index for m in materials)
    return GltfBake(name, indices, options, tuple(dict.fromkeys(files)), tuple(slots), tuple(notes), tuple(warnings))


def _base_colour(
    materials: Sequence[_Material], images: Extracted, channels: Any, made: Any, notes: list[str]
) -> MapChoice:
    """The texture, or the mean over the materials of what is seen where there is none among the shared texels."""
    first = materials[0]
    if BASE_COLOUR in first.slots:
        texture: str = channels(first.slots[BASE_COLOUR].image, "RGB")
        return texture
    notes += [
        f"{m.name}: its base colour lies elsewhere on the surface than its {m.main.name} and is left as it is"
        for m in materials
        if m.elsewhere is not None
    ]
    colours = [images.mean_colour(m.elsewhere.image) if m.elsewhere else np.array(m.colour[:3]) for m in materials]
    colour = np.mean(colours, 0)
    if np.ptp(colour) < 1e-6:
        return float(np.clip(colour[0], 0, 1))
    file: str = made(images.colour(colour))
    return file


def _animation_warnings(document: Document, materials: Sequence[_Material]) -> list[str]:
    """What is baked in at the value that it has without the animation."""
    animated = animated_members(document.json)
    found = []
    for each in materials:
        baked = {
            "pbrMetallicRoughness/roughnessFactor": each.roughness,
            "pbrMetallicRoughness/metallicFactor": each.metallic,
        }
        if NORMAL in each.slots:
            baked[f"{NORMAL}/scale"] = each.scale
        if each.strength:
            baked[f"extensions/{ANISOTROPY}/anisotropyStrength"] = each.strength
            baked[f"extensions/{ANISOTROPY}/anisotropyRotation"] = each.rotation
        if each.cutoff is not None:
            baked["alphaCutoff"] = each.cutoff * each.colour[3]
        found += [
            animation_warning(each.name, member, baked[member])
            for member in sorted(animated.get(each.index, set()) & baked.keys())
        ]
    return found
