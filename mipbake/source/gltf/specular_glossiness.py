"""Turns materials of KHR_materials_pbrSpecularGlossiness into metallic-roughness, in a document without the extension.

`mipbake.material.specular_glossiness` has the formula. What is read after this is an ordinary document.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.colour import SRGB, decode, unit_range
from mipbake.base.errors import InputError
from mipbake.base.messages import listed
from mipbake.base.srgb import linear_to_srgb
from mipbake.material.specular_glossiness import Loss, metallic_roughness
from mipbake.source.decode import upsample
from mipbake.source.gltf.buffers import merged
from mipbake.source.gltf.document import Document, Json, member, number
from mipbake.source.gltf.extracted import Extracted, png_of
from mipbake.source.gltf.images import PNG
from mipbake.source.gltf.slots import (
    BASE_COLOUR,
    DIFFUSE,
    METALLIC_ROUGHNESS,
    SPECULAR_AND_GLOSS,
    SPECULAR_GLOSSINESS,
    UNLIT,
    Slot,
    label_of,
    slot_of,
    surface_mapping,
)
from mipbake.source.gltf.uses import animated_members, extensions_of, image_uses, texture_uses, view_uses

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
    """What the extension says of a material."""

    diffuse: Slot | None
    packed: Slot | None
    factors: tuple[float, ...]
    """Diffuse red, green, blue and alpha; specular red, green, blue; glossiness."""
    with_alpha: bool


@dataclass(frozen=True, eq=False)
class _Made:
    """A material in metallic and roughness: pixels, loss, and the PNG files of what is not the same everywhere."""

    base: Pixels
    metallic: Pixels
    roughness: Pixels
    loss: Loss
    base_file: bytes | None
    packed_file: bytes | None


@dataclass(frozen=True, eq=False)
class _Want:
    """A textureInfo that is to show a PNG file; the index of its texture is still to be found."""

    info: Json
    sampler: int | None
    data: bytes
    name: str

    @property
    def content(self) -> str:
        """Equal for equal files."""
        return hashlib.sha256(self.data).hexdigest()


@dataclass
class _Told:
    """Sentences; one sentence names all materials that it is about."""

    notes: dict[str, list[str]] = field(default_factory=dict)
    warnings: dict[str, list[str]] = field(default_factory=dict)
    errors: dict[str, list[str]] = field(default_factory=dict)


def without_specular_glossiness(document: Document, folder: Path) -> Converted:
    """The document with its materials of specular and glossiness converted to metallic-roughness, every factor baked in
    except the factor of alpha. A metallic-roughness material that lay beside, for readers without the extension, is
    dropped.

    Args:
        document: from `read_document`.
        folder: an existing, empty one for files that are of no use afterwards; the caller deletes it.
    """
    wanted = [
        (index, material)
        for index, material in enumerate(document.all("materials"))
        if SPECULAR_GLOSSINESS in (extensions := _extensions(material)) and UNLIT not in extensions
    ]
    if not wanted:
        return Converted(document)
    images, told = Extracted(document, folder), _Told()
    animated = animated_members(document.json)
    known: dict[tuple[Any, ...], _Made] = {}
    done: list[tuple[int, _Given, _Made]] = []
    for index, material in wanted:
        where = label_of(index, material)
        try:
            given = _given(document, material, images, where)
            if any(name.startswith(f"extensions/{SPECULAR_GLOSSINESS}/") for name in animated.get(index, ())):
                raise _KeptError("an animation sets its factors, which metallic-roughness does not have")
            key = _key(given, images)
            if key not in known:
                known[key] = _converted(given, images)
        except _KeptError as kept:
            told.warnings.setdefault(f"given in specular and glossiness and left as it is: {kept}", []).append(where)
        except InputError as error:
            told.errors.setdefault(error.full, []).append(where)
        else:
            done.append((index, given, known[key]))
            loss = known[key].loss
            said = "converted from specular and glossiness to metallic-roughness"
            if loss.lossless:
                told.notes.setdefault(f"{said}, which holds every texel to within 0.01", []).append(where)
            else:
                told.warnings.setdefault(f"{said}: {loss}; see docs/conventions.md", []).append(where)
    changed = _rewritten(document, done) if done else document
    return Converted(
        changed,
        tuple(f"{listed(names)}: {sentence}" for sentence, names in told.notes.items()),
        tuple(f"{listed(names)}: {sentence}" for sentence, names in told.warnings.items()),
        tuple(f"{sentence} ({listed(names)} cannot be baked)" for sentence, names in told.errors.items()),
    )


class _KeptError(Exception):
    """A material stays as it is; the sentence says why."""


def _extensions(material: Json) -> Json:
    found = material.get("extensions")
    return found if isinstance(found, dict) else {}


def _given(document: Document, material: Json, images: Extracted, where: str) -> _Given:
    held = member(_extensions(material), SPECULAR_GLOSSINESS, where, document.path)
    diffuse, packed = (slot_of(document, material, name, where) for name in (DIFFUSE, SPECULAR_AND_GLOSS))
    if diffuse and packed and diffuse.mapping != packed.mapping:
        raise _KeptError(
            f"its {DIFFUSE} and its {SPECULAR_AND_GLOSS} lie on different texture coordinates or have different "
            "transforms, so that no texture holds both"
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


def _key(given: _Given, images: Extracted) -> tuple[Any, ...]:
    """Equal for materials that become the same textures."""
    slots = tuple(None if s is None else (images.key(s.image), s.wrap) for s in (given.diffuse, given.packed))
    return slots, given.factors[:3], given.factors[4:], given.with_alpha


def _converted(given: _Given, images: Extracted) -> _Made:
    colours, alpha = _read(given.diffuse, images)
    specular, gloss = _read(given.packed, images)
    height, width = (max(a, b) for a, b in zip(colours.shape[:2], specular.shape[:2], strict=True))
    slot = given.diffuse or given.packed
    wrap = slot.wrap if slot else ("wrap", "wrap")
    colours, alpha, specular, gloss = (
        np.ascontiguousarray(upsample(each, width, height, wrap)) for each in (colours, alpha, specular, gloss)
    )
    red, green, blue, _, *others = given.factors
    base, metallic, loss = metallic_roughness(
        colours * np.array([red, green, blue], np.float32), specular * np.array(others[:3], np.float32)
    )
    roughness = np.float32(1) - gloss * np.float32(others[3])
    base_file = packed_file = None
    if given.with_alpha or not _is_constant(base):
        encoded = linear_to_srgb(base.astype(np.float64))
        base_file = png_of(np.concatenate([encoded, alpha], -1) if given.with_alpha else encoded)
    if not (_is_constant(metallic) and _is_constant(roughness)):
        packed_file = png_of(np.concatenate([np.ones_like(metallic), roughness, metallic], -1))
    return _Made(base, metallic, roughness, loss, base_file, packed_file)


def _read(slot: Slot | None, images: Extracted) -> tuple[Pixels, Pixels]:
    """Linear colours (H, W, 3) and alpha (H, W, 1) of a slot's image; one texel of ones where there is none."""
    if slot is None:
        return np.ones((1, 1, 3), np.float32), np.ones((1, 1, 1), np.float32)
    header, pixels = images.header(slot.image), images.pixels(slot.image)
    stored = pixels[..., :3] if header.channels - (header.alpha >= 0) >= 3 else pixels[..., :1]
    colours = decode(np.broadcast_to(stored, (*stored.shape[:2], 3)), SRGB)
    if header.alpha < 0:
        return colours, np.ones((*stored.shape[:2], 1), np.float32)
    return colours, unit_range(pixels[..., header.alpha : header.alpha + 1])


def _is_constant(pixels: Pixels) -> bool:
    return float(np.ptp(pixels, (0, 1)).max()) <= _HALF_STEP


def _rewritten(document: Document, done: Iterable[tuple[int, _Given, _Made]]) -> Document:
    """The document with the materials changed. What only they showed gives its place to the new images."""
    made: Json = copy.deepcopy(document.json)
    wants: list[_Want] = []
    for index, given, result in done:
        wants += _rewrite(document.all("materials")[index], made["materials"][index], given, result)
    before, after = ({use.index for use in texture_uses(each)} for each in (document.json, made))
    free = sorted(index for index in before - after if index < len(document.all("textures")))
    textures = made.setdefault("textures", [])
    places: dict[tuple[str, int | None], int] = {}
    for want in wants:
        key = (want.content, want.sampler)
        if key not in places:
            if not free:
                textures.append({})
            places[key] = free.pop(0) if free else len(textures) - 1
            textures[places[key]] = {} if want.sampler is None else {"sampler": want.sampler}
        want.info["index"] = places[key]
    for index in free:  # nothing shows it any more
        textures[index] = {key: value for key, value in textures[index].items() if key == "sampler"}
    buffers = _with_images(document, made, places, {want.content: want for want in reversed(wants)})
    gone = extensions_of(document.json) - extensions_of(made)
    for listing in ("extensionsUsed", "extensionsRequired"):
        kept = [name for name in made.get(listing, []) if name not in gone]
        made.pop(listing, None)
        if kept:
            made[listing] = kept
    for kind in ("images", "textures", "bufferViews", "buffers"):
        if not made.get(kind):
            made.pop(kind, None)
    return Document(document.path, made, buffers, document.chunks)


def _rewrite(before: Json, material: Json, given: _Given, made: _Made) -> list[_Want]:
    """Changes a material; gives the textureInfos that are still to be given a texture."""
    held = before["extensions"][SPECULAR_GLOSSINESS]
    del material["extensions"][SPECULAR_GLOSSINESS]
    if not material["extensions"]:
        del material["extensions"]
    base = [1.0] * 3 if made.base_file else [round(float(x), 6) for x in made.base[0, 0]]
    pbr: Json = {"baseColorFactor": [*base, given.factors[3]]}
    for name, values in (("metallicFactor", made.metallic), ("roughnessFactor", made.roughness)):
        pbr[name] = 1.0 if made.packed_file else round(float(values[0, 0, 0]), 6)
    wants = []
    for name, first, data in ((BASE_COLOUR, DIFFUSE, made.base_file), (METALLIC_ROUGHNESS, "", made.packed_file)):
        slot = given.diffuse if first and given.diffuse else given.packed or given.diffuse
        if data is not None and slot is not None:
            pbr[name] = {"index": -1, **surface_mapping(held[slot.name])}
            wants.append(_Want(pbr[name], slot.sampler, data, f"{before.get('name') or 'material'} {name[:-7]}"))
    material["pbrMetallicRoughness"] = pbr
    return wants


def _with_images(
    document: Document, made: Json, textures: dict[tuple[str, int | None], int], contents: dict[str, _Want]
) -> tuple[bytes | None, ...]:
    """Gives the new textures their images, and the buffers that hold them. What they took the place of is cut out."""
    images, all_views = made.setdefault("images", []), made.setdefault("bufferViews", [])
    before, after = ({use.index for use in image_uses(each)} for each in (document.json, made))
    free = sorted(index for index in before - after if index < len(images))
    shared = [use.index for use in view_uses(document.json)]
    own = {i: images[i]["bufferView"] for i in free if shared.count(images[i].get("bufferView", -1)) == 1}
    placed: dict[int, tuple[bytes, Json]] = {}
    of_content: dict[str, int] = {}
    for content, want in contents.items():
        if not free:
            images.append({})
        of_content[content] = free.pop(0) if free else len(images) - 1
        placed[of_content[content]] = want.data, {"name": want.name}
    # Their numbers stay, for those that others have stay: a texel each.
    placed |= dict.fromkeys(free, (png_of(np.ones((1, 1, 3))), {}))
    for (content, _), texture in textures.items():
        made["textures"][texture]["source"] = of_content[content]
    binary = merged(made, document.buffers, list(own.values()))
    for image, (data, named) in placed.items():
        if image not in own:
            all_views.append({})
        view = own.get(image, len(all_views) - 1)
        all_views[view] = {"buffer": 0, "byteOffset": binary.add(data), "byteLength": len(data)}
        images[image] = {**named, "mimeType": PNG.mime, "bufferView": view}
    everything = binary.taken()
    made["buffers"][0]["byteLength"] = len(everything)
    return (everything, *(None for _ in made["buffers"][1:]))
