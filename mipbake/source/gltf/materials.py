"""What to bake of a glTF document: the lobes of its materials as texture sets, those that share everything as one.

A clearcoat (KHR_materials_clearcoat) with textures of its own is a set of its own: a dielectric whose base colour and
metallic are 0, so that the reflection of F0 = 0.04 alone is measured and prefiltered, which is all that the layer has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError
from mipbake.base.messages import listed
from mipbake.base.safe_names import unique_name
from mipbake.source.gltf.document import Document
from mipbake.source.gltf.images import Images
from mipbake.source.gltf.lobes import Part, SkippedError, base_of, coat_of
from mipbake.source.gltf.plain import PlainTexture, plain_textures
from mipbake.source.gltf.slots import ANISOTROPIC, BASE, BASE_COLOUR, COATING, Lobe, label_of
from mipbake.source.gltf.uses import animated_members
from mipbake.source.options import LoadOptions, MapChoice


@dataclass(frozen=True)
class GltfBake:
    """One bake of a document: a texture set, and the materials that it is for.

    Args:
        name: safe as a folder name, and no other bake's of the document.
        materials: indices of the materials that show these textures.
        options: how `mipbake.load` reads the set out of `files`, the images. An `occlusion` map in it is the red
            channel of the roughness's image, and has to be the red channel of the baked image as well.
        slots: the slots that baked maps may fill. baseColorTexture is not among them where the base colour has no
            texture, or one that lies elsewhere on the surface: it is not prefiltered.
        notes, warnings: what was found, and what the user should look at, in sentences.
        lobe: whose normals and roughness these are: the material itself, or its clearcoat.
    """

    name: str
    materials: tuple[int, ...]
    options: LoadOptions
    files: tuple[Path, ...]
    slots: tuple[str, ...]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    lobe: Lobe = BASE


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


def read_materials(document: Document, folder: Path) -> GltfMaterials:
    """The materials of a document that have a normal or a roughness texture, and such clearcoats, as texture sets.

    Those whose textures and factors are the same are one set; where on the surface they show it does not matter.

    The factors of roughness and metallic, the scale of the normal map and the factors of KHR_materials_anisotropy are
    in the set (`mipbake.stack.gltf.write` makes them 1), baseColorFactor and the strength of the occlusion stay in the
    material.

    The images are written into the folder, which is empty; the caller deletes it. InputError where no material can be
    baked: what is wrong with the first where none can be read.
    """
    images, animated = Images(document, folder), animated_members(document.json)
    notes: list[str] = []
    warnings: list[str] = []
    broken: dict[str, list[str]] = {}
    bakes: list[GltfBake] = []
    names: set[str] = set()
    for read in (base_of, coat_of):
        groups: dict[tuple[Any, ...], list[Part]] = {}
        for index, material in enumerate(document.all("materials")):
            try:
                part = read(document, index, material, images, animated.get(index, set()))
                if part is not None:
                    groups.setdefault(part.key(images), []).append(part)
            except SkippedError as skipped:
                (warnings if skipped.loud else notes).append(str(skipped))
            except InputError as error:
                broken.setdefault(error.full, []).append(label_of(index, material))
        for parts in groups.values():
            try:
                warned = [text for part in parts for text in part.warnings(animated.get(part.index, set()))]
                bakes.append(_bake(document, parts, images, names, warned))
            except InputError as error:
                broken.setdefault(error.full, []).extend(part.name for part in parts)
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
    plain, others = plain_textures(document, _filled(bakes), images)
    return GltfMaterials(tuple(bakes), plain, (*notes, *others), tuple(warnings), errors)


def _filled(bakes: Sequence[GltfBake]) -> set[tuple[int, str]]:
    """The slots that show baked maps, with those that follow in the red channel, by material."""
    filled = set()
    for bake in bakes:
        red = (bake.lobe.red,) if bake.options.maps.get("occlusion") else ()
        filled |= {(index, slot) for index in bake.materials for slot in (*bake.slots, *red)}
    return filled


def _bake(
    document: Document, parts: Sequence[Part], images: Images, names: set[str], warnings: Sequence[str]
) -> GltfBake:
    """One bake of parts with the same key."""
    first, lobe = parts[0], parts[0].lobe
    is_coat, labels = lobe is COATING, listed(part.name for part in parts)
    notes = [note for part in parts for note in part.notes]
    if is_coat:
        notes.append(f"{labels}: normals and roughness are filtered together, as in a dielectric without a colour")
    files: list[Path] = []
    maps = _maps(parts, images, files, notes)
    packed = ("roughness", "metallic")[: len(lobe.factors)] if lobe.roughness in first.slots else ()
    baked = {role: first.factors[role] for role in ("normal", *packed)}
    factors = {role: value for role, value in baked.items() if not math.isclose(value, 1.0, abs_tol=1e-9)}
    if factors:
        shown = ", ".join(f"{role} {value:g}" for role, value in factors.items())
        what = "clearcoat" if is_coat else "material"
        notes.append(f"factors of the {what} are baked into the textures and become 1 there: {shown}")
    if len(parts) > 1 and not is_coat:
        notes.append(f"{labels} share these textures, which are baked once")
    own, suffix = document.all("materials")[first.index].get("name"), "_clearcoat" if is_coat else ""
    named = f"{own}{suffix}" if isinstance(own, str) and own else None
    name = unique_name(named, f"material_{first.index}{suffix}", names)
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
    made = (lobe.roughness,) if is_coat else (lobe.roughness, lobe.normal, ANISOTROPIC)  # even where there is none yet
    slots = tuple(s for s in dict.fromkeys((BASE_COLOUR, *made, lobe.normal)) if s in made or s in first.slots)
    indices, unique = tuple(part.index for part in parts), tuple(dict.fromkeys(files))
    return GltfBake(name, indices, options, unique, slots, tuple(notes), tuple(warnings), lobe)


def _maps(parts: Sequence[Part], images: Images, files: list[Path], notes: list[str]) -> dict[str, MapChoice]:
    """What fills every role; `files` and `notes` grow."""
    first, lobe = parts[0], parts[0].lobe
    maps: dict[str, MapChoice] = {"normal": None, "opacity": None, "occlusion": None, "height": None, "emissive": None}

    def channels(slot: str, letters: str) -> str:
        image = first.slots[slot].image
        files.append(images.file(image))
        return f"{files[-1].name}:{'R' if letters != 'A' and images.is_grey(image) else letters}"

    def made(path: Path) -> str:
        files.append(path)
        return f"{path.name}:RGB"

    for slot in (lobe.normal, ANISOTROPIC):
        if slot in first.slots:
            images.check_directions(first.slots[slot].image, slot)
    notes += [
        f"{part.name}: its base colour lies elsewhere on the surface than its {part.main.name} and is left as it is"
        for part in parts
        if part.elsewhere is not None
    ]
    colour = None if BASE_COLOUR in first.slots else _mean_colour(parts, images)
    if colour is None:
        maps["base_color"] = channels(BASE_COLOUR, "RGB")
    else:
        is_grey = np.ptp(colour) < 1e-6
        maps["base_color"] = float(np.clip(colour[0], 0, 1)) if is_grey else made(images.colour(colour))
    if lobe.normal in first.slots:
        maps["normal"] = channels(lobe.normal, "RGB")
    packed = lobe.roughness in first.slots
    maps["roughness"] = channels(lobe.roughness, "G") if packed else first.factors["roughness"]
    maps["metallic"] = channels(lobe.roughness, "B") if packed and lobe is BASE else first.factors["metallic"]
    if packed and any(part.occluded for part in parts):
        maps["occlusion"] = channels(lobe.roughness, "R")
        if lobe is BASE:
            notes.append("the occlusion is the red channel of the metallicRoughness image and stays there")
    if first.opacity:
        maps["opacity"] = channels(BASE_COLOUR, "A")
    if first.strength == 1 and first.rotation == 0 and ANISOTROPIC in first.slots:
        maps["anisotropy"] = channels(ANISOTROPIC, "RGB")
    elif first.strength:
        image = first.slots[ANISOTROPIC].image if ANISOTROPIC in first.slots else None
        maps["anisotropy"] = made(images.directions(image, first.strength, first.rotation))
    return maps


def _mean_colour(parts: Sequence[Part], images: Images) -> NDArray[np.float64]:
    """(3,) mean over materials of base colours that are not among the shared texels, linear."""
    colours = [
        np.array(part.colour[:3])
        if part.elsewhere is None
        else images.linear(part.elsewhere.image)[0].mean((0, 1), np.float64)
        for part in parts
    ]
    return np.asarray(np.mean(colours, 0), np.float64)
