"""The textures of a glTF document that nothing is prefiltered with: colours and amounts, averaged level by level."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TypeAlias

from mipbake.base.errors import InputError
from mipbake.base.messages import listed, one_line
from mipbake.source.gltf import slots as gltf
from mipbake.source.gltf.document import Document
from mipbake.source.gltf.images import Images
from mipbake.source.gltf.uses import texture_uses
from mipbake.source.images.image import Header

MaterialSlot: TypeAlias = tuple[int, str]
"""A material's index, and the name of a slot."""

PREFILTERED = (
    *(gltf.NORMAL, gltf.METALLIC_ROUGHNESS, gltf.ANISOTROPIC, gltf.COAT_NORMAL, gltf.COAT_ROUGHNESS),
    *(gltf.DIFFUSE, gltf.SPECULAR_AND_GLOSS),  # slots of materials that were not converted, and are left as they are
)
"""Slots whose averages say something else than their texels: they are baked, or left as they are."""

SIDE = 4
"""KHR_texture_basisu takes textures whose sides are multiples of it."""

LEAST_SIDE = 16
"""Texels along a side; smaller images are palettes, ramps and icons, of which every texel counts."""


@dataclass(frozen=True)
class PlainTexture:
    """A texture that is averaged.

    Args:
        image: index of its image.
        holds: `COLOUR`, of sRGB-encoded colours, or `DATA`.
        wrap: addressing along u and v, each "wrap" or "clamp".
        alpha: whether the alpha channel is read.
        opacity: whether that is opacity, which the colours count by. cutoff: what it is tested against; None: blended.
        uses: what shows it.
    """

    image: int
    holds: str
    wrap: tuple[str, str]
    alpha: bool
    opacity: bool
    cutoff: float | None
    uses: tuple[MaterialSlot, ...]


def plain_textures(
    document: Document, filled: Collection[MaterialSlot], images: Images
) -> tuple[tuple[PlainTexture, ...], tuple[str, ...]]:
    """The textures of materials that averages are right for, and what is to be said of all textures beside those that
    bakes have `filled`."""
    found: dict[tuple[str, tuple[str, str]], dict[MaterialSlot, gltf.Slot]] = {}
    names: dict[MaterialSlot, str] = {}
    kept: dict[str, list[str]] = {}
    untouched = _untouched(document, filled)
    for index, material in enumerate(document.all("materials")):
        for name in gltf.PLACES:
            use = (index, name)
            if name in PREFILTERED or use in filled or gltf.info_of(material, name) is None:
                continue
            where = gltf.label_of(index, material)
            names[use] = f"{name} of {where}"
            try:
                slot = gltf.slot_of(document, material, name, where)
                if slot is None:
                    continue
                unfit = _unfit(slot, images.header(slot.image))
                if slot.texture in untouched or unfit:
                    kept.setdefault(unfit or "something else shows the same texture", []).append(names[use])
                else:
                    found.setdefault((images.key(slot.image), slot.wrap), {})[use] = slot
            except InputError as error:
                kept.setdefault(one_line(error.full), []).append(names[use])
    made = [texture for uses in found.values() for texture in _split(document, uses, images)]
    notes = [f"{listed(uses)} stay as they are in a GLB: {reason}" for reason, uses in kept.items()]
    shown = [names[use] for texture in made for use in texture.uses]
    if shown:
        given = "not prefiltered, and given plain antialiased levels in a GLB where blocks hold them well"
        notes.insert(0, f"{given}: {listed(shown)}")
    return tuple(made), tuple(notes)


def shown_by(document: Document, texture: PlainTexture) -> str:
    """What shows a texture, for messages."""
    materials = document.all("materials")
    return listed(f"{slot} of {gltf.label_of(index, materials[index])}" for index, slot in texture.uses)


def _unfit(slot: gltf.Slot, header: Header) -> str:
    """Why the image of a slot stays as it is, whatever is in it; empty where it does not have to."""
    sides = (header.width, header.height)
    if slot.single_texels:
        return "the sampler shows single texels (magFilter NEAREST), which blocks and averages would change"
    if min(sides) < LEAST_SIDE or any(side % SIDE for side in sides):
        return (
            f"an image of {header.width} x {header.height} texels would have to be resampled or is small: expected "
            f"sides of {LEAST_SIDE} texels at least that are multiples of {SIDE}"
        )
    return ""


def _untouched(document: Document, filled: Collection[MaterialSlot]) -> set[int]:
    """Textures that stay as they are because something else shows them."""
    known = {}
    for index, material in enumerate(document.all("materials")):
        for name in gltf.PLACES:
            info = gltf.info_of(material, name)
            if info is not None and (name not in PREFILTERED or (index, name) in filled):
                known[id(info)] = info
    return {index for parent, index in texture_uses(document.json) if id(parent) not in known}


def _split(document: Document, uses: dict[MaterialSlot, gltf.Slot], images: Images) -> list[PlainTexture]:
    """What one image becomes: a texture of colours, one of numbers, or both; alpha alone goes with either."""
    holds = {use: gltf.PLACES[use[1]].holds for use in uses}
    kinds = [kind for kind in (gltf.COLOUR, gltf.DATA) if kind in holds.values()] or [gltf.DATA]
    made = []
    for kind in kinds:
        here = {
            use: s for use, s in uses.items() if holds[use] == kind or (holds[use] == gltf.ALPHA and kind == kinds[0])
        }
        first = next(iter(here.values()))
        apart: dict[tuple[bool, float | None], list[MaterialSlot]] = {}
        for use in here:
            apart.setdefault(_opacity(document, use, first, images), []).append(use)
        for (opacity, cutoff), several in apart.items():
            read = opacity or any(holds[use] == gltf.ALPHA for use in several)
            alpha = read and images.header(first.image).alpha >= 0
            made.append(PlainTexture(first.image, kind, first.wrap, alpha, opacity, cutoff, tuple(several)))
    return made


def _opacity(document: Document, use: MaterialSlot, slot: gltf.Slot, images: Images) -> tuple[bool, float | None]:
    """Whether alpha counts as opacity, and what the texture's alpha is tested against."""
    material = document.all("materials")[use[0]]
    mode = material.get("alphaMode", "OPAQUE")
    if use[1] != gltf.BASE_COLOUR or mode == "OPAQUE" or images.header(slot.image).alpha < 0:
        return False, None
    factors = material["pbrMetallicRoughness"].get("baseColorFactor", (1, 1, 1, 1))
    cutoff = material.get("alphaCutoff", 0.5)
    try:
        tested = cutoff / factors[3]  # the material tests the product
    except (TypeError, IndexError, ZeroDivisionError):
        return True, None
    return True, tested if mode == "MASK" and 0 < tested <= 1 else None
