"""The lobes of glTF materials that can be baked: a material itself and its clearcoat, with what enters the texels."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from mipbake.base.errors import InputError
from mipbake.source.gltf import slots as gltf
from mipbake.source.gltf.document import Document, Json, extensions_in, member, number
from mipbake.source.gltf.images import Images


@dataclass(frozen=True)
class Part:
    """A lobe of a material that can be baked.

    Args:
        index: of the material. name: for messages.
        slots: that share texels.
        factors: of the roles "normal", "roughness" and "metallic".
        colour: factor of the base colour, with alpha.
        occluded: whether the red channel of the roughness's image is shown as well.
        opacity: whether the alpha of the base colour counts; cutoff: what it is tested against.
        strength, rotation: of the anisotropy.
        elsewhere: the base colour, where it does not share the texels.
        notes: of the material, in sentences.
    """

    index: int
    name: str
    lobe: gltf.Lobe
    slots: dict[str, gltf.Slot]
    factors: dict[str, float]
    colour: tuple[float, ...]
    occluded: bool
    opacity: bool = False
    cutoff: float | None = None
    strength: float = 0.0
    rotation: float = 0.0
    elsewhere: gltf.Slot | None = None
    notes: tuple[str, ...] = ()

    @property
    def main(self) -> gltf.Slot:
        """The slot whose place on the surface and whose wrap the set has."""
        return next(iter(self.slots.values()))

    def key(self, images: Images) -> tuple[Any, ...]:
        """Equal for parts that are baked as one: everything that texels are made from."""
        textures = tuple((name, images.key(slot.image), slot.wrap) for name, slot in sorted(self.slots.items()))
        constants = (*self.factors.values(), self.opacity, self.cutoff, self.strength, self.rotation)
        return textures, constants

    def warnings(self, animated: Collection[str]) -> list[str]:
        """What samplers do that a stack is not made for, and which of the factors that are baked in are animated."""
        found, slots, main = [], self.slots.values(), self.main.name
        if bare := [s.name for s in slots if s.without_levels]:
            found.append(
                f"{self.name}: the samplers of {', '.join(bare)} show level 0 alone (minFilter NEAREST or LINEAR), so "
                "that the other levels will not be seen: set LINEAR_MIPMAP_LINEAR"
            )
        if other := [s.name for s in slots if s.wrap != self.main.wrap]:
            found.append(
                f"{self.name}: {', '.join(other)} repeat in another way at the borders than {main}: all are "
                f"filtered as {main} repeats"
            )
        if mirrored := [s.name for s in slots if s.mirrored]:
            found.append(
                f"{self.name}: {', '.join(mirrored)} are mirrored at the borders, and are filtered as if clamped"
            )
        roughness, normal = self.lobe.roughness, self.lobe.normal
        values = zip(self.lobe.factors, (self.factors["roughness"], self.factors["metallic"]), strict=False)
        baked = {"/".join((*gltf.PLACES[roughness].keys, name)): value for (name, _), value in values}
        if normal in self.slots:
            baked["/".join((*gltf.PLACES[normal].keys, normal, "scale"))] = self.factors["normal"]
        if self.strength:
            baked[f"extensions/{gltf.ANISOTROPY}/anisotropyStrength"] = self.strength
            baked[f"extensions/{gltf.ANISOTROPY}/anisotropyRotation"] = self.rotation
        if self.cutoff is not None:
            baked["alphaCutoff"] = self.cutoff * self.colour[3]
        return found + [
            f"{self.name}: an animation sets {path}, which is baked in as {baked[path]:g}, its value at rest: what the "
            "animation sets comes on top of that, so look at it in the result"
            for path in sorted(baked.keys() & animated)
        ]


class SkippedError(Exception):
    """A material is left as it is; the sentence says why, `loud` whether the user should look at it."""

    def __init__(self, sentence: str, loud: bool = False) -> None:
        super().__init__(sentence)
        self.loud = loud


def base_of(document: Document, index: int, material: Json, images: Images, _animated: set[str]) -> Part:
    """A material itself; SkippedError where it is left as it is."""
    where, path = gltf.label_of(index, material), document.path
    extensions = member(material, "extensions", where, path)
    if gltf.UNLIT in extensions:
        raise SkippedError(f"{where} is unlit and is left as it is")
    if gltf.SPECULAR_GLOSSINESS in extensions:  # the conversion says why it was not converted
        raise SkippedError(f"{where} is given in specular and glossiness and is left as it is")
    slots = _slots(document, material, where, gltf.NORMAL, gltf.METALLIC_ROUGHNESS, gltf.BASE_COLOUR, gltf.ANISOTROPIC)
    if not {gltf.NORMAL, gltf.METALLIC_ROUGHNESS} & slots.keys():
        raise SkippedError(
            f"{where} has neither a normal nor a metallicRoughness texture: nothing in it is prefiltered"
        )
    anisotropy = extensions.get(gltf.ANISOTROPY, {})
    scale = _scale(document, material, slots, gltf.NORMAL, where)
    strength = number(anisotropy.get("anisotropyStrength", 0.0), f"anisotropyStrength of {where}", path, 0, 1)
    if strength == 0:
        slots.pop(gltf.ANISOTROPIC, None)
    base = slots.pop(gltf.BASE_COLOUR, None)
    _check_shared(where, slots)
    main = next(iter(slots.values()))
    elsewhere = base if base is not None and base.mapping != main.mapping else None
    if base is not None and elsewhere is None:
        slots[gltf.BASE_COLOUR] = base
    pbr = member(material, "pbrMetallicRoughness", where, path)
    colour = pbr.get("baseColorFactor", [1.0, 1.0, 1.0, 1.0])
    if not isinstance(colour, list) or len(colour) != 4:
        raise InputError(f"{path}: baseColorFactor of {where} is {colour!r}, expected four numbers: export it again")
    factors = tuple(number(c, f"baseColorFactor of {where}", path, 0, 1) for c in colour)
    turned = anisotropy.get("anisotropyRotation", 0.0) if strength else 0.0
    opacity, cutoff, notes = _alpha(document, material, slots.get(gltf.BASE_COLOUR), factors[3], images, where)
    return Part(
        index,
        where,
        gltf.BASE,
        slots,
        {"normal": scale, **_factors(document, material, gltf.BASE, where)},
        factors,
        _occluded(document, material, gltf.BASE, slots, images, where),
        opacity,
        cutoff,
        strength,
        number(turned, f"anisotropyRotation of {where}", path, -1e6, 1e6),
        elsewhere,
        notes,
    )


def coat_of(document: Document, index: int, material: Json, images: Images, animated: set[str]) -> Part | None:
    """A material's clearcoat; None where there is none that shows, or one without textures to be filtered."""
    extensions = extensions_in(material)
    held = extensions.get(gltf.CLEARCOAT)
    if not isinstance(held, dict) or {gltf.UNLIT, gltf.SPECULAR_GLOSSINESS} & set(extensions):
        return None
    where = f"the clearcoat of {gltf.label_of(index, material)}"
    amount = number(held.get("clearcoatFactor", 0.0), f"clearcoatFactor of {where}", document.path, 0, 1)
    if amount == 0 and f"extensions/{gltf.CLEARCOAT}/clearcoatFactor" not in animated:
        return None
    factors = _factors(document, material, gltf.COATING, where)
    slots = _slots(document, material, where, gltf.COATING.normal, gltf.COATING.roughness)
    occluded = _occluded(document, material, gltf.COATING, slots, images, where)
    if factors["roughness"] == 0:
        slots.pop(gltf.COATING.roughness, None)  # a smooth coat, whatever its texture says
    if not slots:
        return None
    scale = _scale(document, material, slots, gltf.COATING.normal, where)
    _check_shared(where, slots)
    occluded = occluded and gltf.COATING.roughness in slots
    return Part(index, where, gltf.COATING, slots, {"normal": scale, **factors}, (0.0, 0.0, 0.0, 1.0), occluded)


def _slots(document: Document, material: Json, where: str, *names: str) -> dict[str, gltf.Slot]:
    return {name: slot for name in names if (slot := gltf.slot_of(document, material, name, where)) is not None}


def _factors(document: Document, material: Json, lobe: gltf.Lobe, where: str) -> dict[str, float]:
    """What roughness and metallic are multiplied with; the metallic of a lobe that has none is 0."""
    held = gltf.holder_of(material, lobe.roughness, where, document)
    values = [number(held.get(n, default), f"{n} of {where}", document.path, 0, 1) for n, default in lobe.factors]
    return dict(zip(("roughness", "metallic"), (*values, 0.0), strict=False))


def _scale(document: Document, material: Json, slots: dict[str, gltf.Slot], name: str, where: str) -> float:
    """The scale of a normal map, 1 where there is none."""
    info = gltf.info_of(material, name) or {}
    scale = number(info.get("scale", 1.0), f"scale of {name} of {where}", document.path, -1e6, 1e6)
    if name not in slots:
        return 1.0
    if scale < 0:
        raise SkippedError(
            f"{where}: the scale of its {name} is {scale:g}, which inverts its bumps along x and y, and is left "
            "as it is: invert red and green of the normal map and make the scale positive to have it baked",
            loud=True,
        )
    return scale


def _check_shared(where: str, slots: dict[str, gltf.Slot]) -> None:
    """SkippedError where textures do not lie at the same place of the surface as the first."""
    main, *others = slots.values()
    for slot in others:
        if slot.mapping != main.mapping:
            raise SkippedError(
                f"{where}: its {slot.name} and its {main.name} lie on different texture coordinates or have "
                "different transforms, so that they share no texels to be filtered together; they are left as they are",
                loud=True,
            )


def _occluded(
    document: Document, material: Json, lobe: gltf.Lobe, slots: dict[str, gltf.Slot], images: Images, where: str
) -> bool:
    """Whether the texture that may follow in the red channel is the roughness's image."""
    red, packed = gltf.slot_of(document, material, lobe.red, where), slots.get(lobe.roughness)
    return red is not None and packed is not None and images.key(red.image) == images.key(packed.image)


def _alpha(
    document: Document, material: Json, base: gltf.Slot | None, factor: float, images: Images, where: str
) -> tuple[bool, float | None, tuple[str, ...]]:
    """Whether the alpha of the base colour counts, the cutoff in its terms, and what is to be noted."""
    mode = material.get("alphaMode", "OPAQUE")
    if mode not in ("OPAQUE", "MASK", "BLEND"):
        raise InputError(
            f"{document.path}: alphaMode of {where} is {mode!r}, expected OPAQUE, MASK or BLEND: export it again"
        )
    if mode == "OPAQUE" or base is None or images.header(base.image).alpha < 0:
        return False, None, ()
    if mode == "BLEND":
        return True, None, ()
    cutoff = number(material.get("alphaCutoff", 0.5), f"alphaCutoff of {where}", document.path, 0, 1e6)
    if 0 < cutoff <= factor:
        return True, cutoff / factor, ()  # the material tests the product
    side = "opaque" if cutoff == 0 else "transparent"
    return True, None, (f"{where}: no alpha reaches both sides of its cutoff, so that it is {side} everywhere",)
