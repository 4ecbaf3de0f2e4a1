"""Turns materials of KHR_materials_pbrSpecularGlossiness into metallic-roughness, in a document without the extension.

`mipbake.material.specular_glossiness` has the formula. What is read after this is an ordinary document.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError
from mipbake.base.messages import listed
from mipbake.base.srgb import linear_to_srgb
from mipbake.material.specular_glossiness import Loss, metallic_roughness
from mipbake.source.decode import upsample
from mipbake.source.gltf import slots as gltf
from mipbake.source.gltf.document import Document, Json, extensions_in, member, number
from mipbake.source.gltf.images import PNG, Images, png_of
from mipbake.source.gltf.lobes import SkippedError
from mipbake.source.gltf.rewriting import Want, drop_empty, drop_extensions, retextured
from mipbake.source.gltf.uses import animated_members

Pixels = NDArray[np.float32]

_HALF_STEP = 0.5 / 65535  # half a step of the 16 bits that are written


@dataclass(frozen=True)
class Converted:
    """A document without specular and glossiness, except for the materials that warnings and errors name.

    Args:
        document: the same one where it has no such material.
        notes, warnings, errors: what became of the materials, in sentences; errors are of those that cannot be read.
    """

    document: Document
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    errors: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Given:
    """What the extension says of a material.

    Args:
        diffuse, packed: its slots; `packed` has specular colours and glossiness.
        factors: diffuse red, green, blue and alpha; specular red, green, blue; glossiness.
        with_alpha: whether the alpha of the diffuse texture counts.
    """

    diffuse: gltf.Slot | None
    packed: gltf.Slot | None
    factors: tuple[float, ...]
    with_alpha: bool

    def key(self, images: Images) -> tuple[Any, ...]:
        """Equal for materials that become the same textures."""
        slots = tuple(None if s is None else (images.key(s.image), s.wrap) for s in (self.diffuse, self.packed))
        return slots, self.factors[:3], self.factors[4:], self.with_alpha


def without_specular_glossiness(document: Document, folder: Path) -> Converted:
    """The document with its materials of specular and glossiness converted to metallic-roughness, every factor baked in
    except the factor of alpha. A metallic-roughness material that lay beside, for readers without the extension, is
    dropped. The folder is empty, for files that are of no use afterwards; the caller deletes it."""
    wanted = [
        (index, material)
        for index, material in enumerate(document.all("materials"))
        if gltf.SPECULAR_GLOSSINESS in (extensions := extensions_in(material)) and gltf.UNLIT not in extensions
    ]
    if not wanted:
        return Converted(document)
    images, animated = Images(document, folder), animated_members(document.json)
    notes: dict[str, list[str]] = {}
    warnings: dict[str, list[str]] = {}
    errors: dict[str, list[str]] = {}
    known: dict[tuple[Any, ...], tuple[Mapping[str, bytes], Json, Loss]] = {}
    made: Json = copy.deepcopy(document.json)
    wants: list[Want] = []
    for index, material in wanted:
        where = gltf.label_of(index, material)
        try:
            given = _given(document, material, images, where)
            if any(name.startswith(f"extensions/{gltf.SPECULAR_GLOSSINESS}/") for name in animated.get(index, ())):
                raise SkippedError("an animation sets its factors, which metallic-roughness does not have")
            key = given.key(images)
            if key not in known:
                known[key] = _converted(given, images)
        except SkippedError as kept:
            warnings.setdefault(f"given in specular and glossiness and left as it is: {kept}", []).append(where)
        except InputError as error:
            errors.setdefault(error.full, []).append(where)
        else:
            files, members, loss = known[key]
            wants += _rewrite(material, made["materials"][index], given, files, members)
            said = "converted from specular and glossiness to metallic-roughness"
            if loss.lossless:
                notes.setdefault(f"{said}, which holds every texel to within 0.01", []).append(where)
            else:
                warnings.setdefault(f"{said}: {loss}; see docs/conventions.md", []).append(where)
    return Converted(
        _finished(document, made, wants) if known else document,
        tuple(f"{listed(names)}: {sentence}" for sentence, names in notes.items()),
        tuple(f"{listed(names)}: {sentence}" for sentence, names in warnings.items()),
        tuple(f"{sentence} ({listed(names)} cannot be baked)" for sentence, names in errors.items()),
    )


def _given(document: Document, material: Json, images: Images, where: str) -> _Given:
    held = member(extensions_in(material), gltf.SPECULAR_GLOSSINESS, where, document.path)
    diffuse, packed = (
        gltf.slot_of(document, material, name, where) for name in (gltf.DIFFUSE, gltf.SPECULAR_AND_GLOSS)
    )
    if diffuse and packed and diffuse.mapping != packed.mapping:
        raise SkippedError(
            f"its {gltf.DIFFUSE} and its {gltf.SPECULAR_AND_GLOSS} lie on different texture coordinates or have "
            "different transforms, so that no texture holds both"
        )
    factors: list[float] = []
    for name, count in (("diffuseFactor", 4), ("specularFactor", 3), ("glossinessFactor", 1)):
        found = held.get(name, [1.0] * count)
        values = found if isinstance(found, list) else [found]
        if len(values) != count:
            raise InputError(f"{document.path}: {name} of {where} is {found!r}, expected {count} numbers: export again")
        factors += [number(value, f"{name} of {where}", document.path, 0, 1) for value in values]
    seen = material.get("alphaMode", "OPAQUE") != "OPAQUE"
    with_alpha = seen and diffuse is not None and images.header(diffuse.image).alpha >= 0
    return _Given(diffuse, packed, tuple(factors), with_alpha)


def _converted(given: _Given, images: Images) -> tuple[Mapping[str, bytes], Json, Loss]:
    """A material in metallic and roughness: slot to PNG, of what is not the same everywhere; members of
    pbrMetallicRoughness beside them; and what is lost."""
    read = [part for slot in (given.diffuse, given.packed) for part in _read(slot, images)]
    height, width = (max(part.shape[axis] for part in read) for axis in (0, 1))
    slot = given.diffuse or given.packed
    wrap = slot.wrap if slot else ("wrap", "wrap")
    colours, alpha, specular, gloss = (np.ascontiguousarray(upsample(part, width, height, wrap)) for part in read)
    factors = np.array(given.factors, np.float32)
    base, metallic, loss = metallic_roughness(colours * factors[:3], specular * factors[4:7])
    roughness = np.float32(1) - gloss * factors[7]
    files = {}
    members: Json = {"baseColorFactor": [1.0, 1.0, 1.0], "metallicFactor": 1.0, "roughnessFactor": 1.0}
    if given.with_alpha or not _is_constant(base):
        encoded = linear_to_srgb(base.astype(np.float64))
        files[gltf.BASE_COLOUR] = png_of(np.concatenate([encoded, alpha], -1) if given.with_alpha else encoded)
    else:
        members["baseColorFactor"] = [round(float(x), 6) for x in base[0, 0]]
    if not (_is_constant(metallic) and _is_constant(roughness)):
        files[gltf.METALLIC_ROUGHNESS] = png_of(np.concatenate([np.ones_like(metallic), roughness, metallic], -1))
    else:
        constants = {"metallicFactor": metallic, "roughnessFactor": roughness}
        members |= {name: round(float(values[0, 0, 0]), 6) for name, values in constants.items()}
    return files, members, loss


def _read(slot: gltf.Slot | None, images: Images) -> tuple[Pixels, Pixels]:
    """Linear colours (H, W, 3) and alpha (H, W, 1) of a slot's image; ones where there is none."""
    if slot is None:
        return np.ones((1, 1, 3), np.float32), np.ones((1, 1, 1), np.float32)
    colours, alpha = images.linear(slot.image)
    return colours, np.ones((*colours.shape[:2], 1), np.float32) if alpha is None else alpha


def _is_constant(pixels: Pixels) -> bool:
    return float(np.ptp(pixels, (0, 1)).max()) <= _HALF_STEP


def _rewrite(before: Json, material: Json, given: _Given, files: Mapping[str, bytes], members: Json) -> list[Want]:
    """Changes a material; returns the textureInfos that are still to be given a texture."""
    held = before["extensions"][gltf.SPECULAR_GLOSSINESS]
    del material["extensions"][gltf.SPECULAR_GLOSSINESS]
    if not material["extensions"]:
        del material["extensions"]
    pbr: Json = {**members, "baseColorFactor": [*members["baseColorFactor"], given.factors[3]]}
    wants = []
    for name, slot in (
        (gltf.BASE_COLOUR, given.diffuse or given.packed),
        (gltf.METALLIC_ROUGHNESS, given.packed or given.diffuse),
    ):
        if name in files and slot is not None:
            pbr[name] = {"index": -1, **gltf.surface_mapping(held[slot.name])}
            label = f"{before.get('name') or 'material'} {name.removesuffix('Texture')}"
            wants.append(Want(pbr[name], slot.texture, slot.sampler, files[name], label))
    material["pbrMetallicRoughness"] = pbr
    return wants


def _finished(document: Document, made: Json, wants: list[Want]) -> Document:
    """The document whose JSON was changed, with the textures that it wants."""
    binary = retextured(document, made, wants, PNG, embed=False)
    drop_extensions(document, made)
    made["buffers"][0]["byteLength"] = len(binary.data)
    drop_empty(made)
    buffers = (bytes(binary.data), *(None for _ in made["buffers"][1:]))
    return Document(document.path, made, buffers, document.chunks)
