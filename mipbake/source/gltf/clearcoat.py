"""Clearcoats (KHR_materials_clearcoat) as texture sets: a lobe of a dielectric with normals and a roughness of its own.

Base colour and metallic of this set are 0: what is measured and prefiltered is the reflection of F0 = 0.04 alone,
which is all that the extension's layer has. Its roughness is the green channel of an image, as it is in
metallicRoughness, and how much coat there is may be the red one, which is averaged, as an occlusion there is.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mipbake.base.errors import InputError
from mipbake.base.messages import listed
from mipbake.base.safe_names import unique_name
from mipbake.source.gltf import bakes
from mipbake.source.gltf.document import Document, Json, number
from mipbake.source.gltf.extracted import Extracted
from mipbake.source.gltf.slots import (
    CLEARCOAT,
    COAT,
    COAT_NORMAL,
    COAT_ROUGHNESS,
    COATING,
    SPECULAR_GLOSSINESS,
    UNLIT,
    Slot,
    info_of,
    label_of,
    slot_of,
)
from mipbake.source.gltf.uses import animated_members
from mipbake.source.options import LoadOptions, MapChoice

((_FACTOR, _ROUGHNESS),) = COATING.factors


@dataclass(frozen=True)
class _Coat:
    """A coat with something to prefilter: slots and factors. `amount`: whether it shares the roughness's image."""

    index: int
    name: str
    normal: Slot | None
    roughness: Slot | None
    amount: bool
    factor: float
    scale: float

    @property
    def slots(self) -> list[Slot]:
        return [slot for slot in (self.normal, self.roughness) if slot is not None]


def coat_bakes(
    document: Document, images: Extracted, names: set[str], warnings: list[str], broken: dict[str, list[str]]
) -> list[bakes.GltfBake]:
    """The clearcoats of a document that have a normal or a roughness texture, those that share everything as one.

    Args:
        images, names: of the document's bakes.
        warnings: of coats that are left as they are. broken: what is wrong, to the materials that it is wrong with.
    """
    animated = animated_members(document.json)
    groups: dict[tuple[Any, ...], list[_Coat]] = {}
    for index, material in enumerate(document.all("materials")):
        where = label_of(index, material)
        try:
            coat = _coat(document, index, material, images, animated.get(index, set()))
            if coat is not None:
                key = [None if s is None else (images.key(s.image), s.wrap) for s in (coat.normal, coat.roughness)]
                scale = coat.scale if coat.normal else 1.0
                groups.setdefault((*key, coat.factor, scale), []).append(coat)
        except bakes.SkippedError as skipped:
            warnings.append(str(skipped))
        except InputError as error:
            broken.setdefault(error.full, []).append(where)
    made = []
    for coats in groups.values():
        try:
            made.append(_bake(document, coats, images, names, animated))
        except InputError as error:
            broken.setdefault(error.full, []).extend(coat.name for coat in coats)
    return made


def _coat(document: Document, index: int, material: Json, images: Extracted, animated: set[str]) -> _Coat | None:
    """A material's coat; None where there is none that is seen, or one without textures to be filtered."""
    extensions = material.get("extensions")
    held = extensions.get(CLEARCOAT) if isinstance(extensions, dict) else None
    if not isinstance(extensions, dict) or not isinstance(held, dict) or {UNLIT, SPECULAR_GLOSSINESS} & set(extensions):
        return None
    where, path = f"the clearcoat of {label_of(index, material)}", document.path
    amount = number(held.get("clearcoatFactor", 0.0), f"clearcoatFactor of {where}", path, 0, 1)
    if amount == 0 and f"extensions/{CLEARCOAT}/clearcoatFactor" not in animated:
        return None
    factor = number(held.get(_FACTOR, _ROUGHNESS), f"{_FACTOR} of {where}", path, 0, 1)
    normal, roughness, red = (slot_of(document, material, n, where) for n in (COAT_NORMAL, COAT_ROUGHNESS, COAT))
    if factor == 0:
        roughness = None  # a smooth coat, whatever its texture says
    main = normal or roughness
    if main is None:
        return None
    info = info_of(material, COAT_NORMAL) or {}
    scale = number(info.get("scale", 1.0), f"scale of {COAT_NORMAL} of {where}", path, -1e6, 1e6)
    if normal is not None and scale < 0:
        raise bakes.SkippedError(
            f"{where}: the scale of its {COAT_NORMAL} is {scale:g}, which inverts its bumps along x and y, and is left "
            "as it is: invert red and green of the normal map and make the scale positive to have it baked",
            loud=True,
        )
    bakes.check_shared(where, main, [roughness] if roughness else [])
    shared = red is not None and roughness is not None and images.key(red.image) == images.key(roughness.image)
    return _Coat(index, where, normal, roughness, shared, factor, scale)


def _bake(
    document: Document, coats: list[_Coat], images: Extracted, names: set[str], animated: dict[int, set[str]]
) -> bakes.GltfBake:
    first = coats[0]
    maps: dict[str, MapChoice] = dict.fromkeys(("normal", "occlusion", "opacity", "height", "emissive"))
    maps |= {"base_color": 0.0, "metallic": 0.0, "roughness": first.factor}
    factors: dict[str, float] = {}
    files: list[Path] = []

    def channels(slot: Slot, letters: str) -> str:
        path = images.file(slot.image)
        files.append(path)
        return f"{path.name}:{'R' if images.is_grey(slot.image) else letters}"

    if first.normal is not None:
        images.check_directions(first.normal.image, COAT_NORMAL)
        maps["normal"] = channels(first.normal, "RGB")
        bakes.add_factor(factors, "normal", first.scale)
    if first.roughness is not None:
        maps["roughness"] = channels(first.roughness, "G")
        bakes.add_factor(factors, "roughness", first.factor)
        if any(coat.amount for coat in coats):
            maps["occlusion"] = channels(first.roughness, "R")
    notes = [
        f"{listed(coat.name for coat in coats)}: normals and roughness are filtered together, as in a dielectric "
        "without a colour"
    ]
    if factors:
        shown = ", ".join(f"{role} {value:g}" for role, value in factors.items())
        notes.append(f"factors of the clearcoat are baked into the textures and become 1 there: {shown}")
    warnings = [text for coat in coats for text in bakes.sampler_warnings(coat.name, coat.slots, first.slots[0])]
    for coat in coats:
        baked = {f"extensions/{CLEARCOAT}/{_FACTOR}": coat.factor}
        if coat.normal is not None:
            baked[f"extensions/{CLEARCOAT}/{COAT_NORMAL}/scale"] = coat.scale
        for member in sorted(animated.get(coat.index, set()) & baked.keys()):
            warnings.append(bakes.animation_warning(coat.name, member, baked[member]))
    material = document.all("materials")[first.index].get("name")
    named = f"{material}_clearcoat" if isinstance(material, str) and material else None
    name = unique_name(named, f"material_{first.index}_clearcoat", names)
    options = LoadOptions(
        maps=maps,
        colour_space="sRGB",
        normal_convention="opengl",
        wrap=first.slots[0].wrap,
        name=name,
        factors=factors,
        metadata=False,
        origin="document",
    )
    slots = (COAT_ROUGHNESS,) if first.normal is None else (COAT_ROUGHNESS, COAT_NORMAL)
    indices = tuple(coat.index for coat in coats)
    unique = tuple(dict.fromkeys(files))
    return bakes.GltfBake(name, indices, options, unique, slots, tuple(notes), tuple(warnings), COATING)
