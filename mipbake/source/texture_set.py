"""What an input is: the maps of one material, decoded to linear float32, and what was found and assumed on the way."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.base import memory
from mipbake.base.errors import UsageError
from mipbake.material import convert
from mipbake.material.directions import untangled
from mipbake.material.filtered_source import FilteredSource
from mipbake.source.arrays import check_shape, checked_array
from mipbake.source.decode import TextureMap, constant_map, decode_map, resized, scaled
from mipbake.source.images.image import turn_vectors
from mipbake.source.images.read import read_image
from mipbake.source.matches import BASE_ALPHA, alpha_note
from mipbake.source.normal import DECIDED_CONFIDENCE, Vectors, held, holes_warning, integrability, is_constant, tiles
from mipbake.source.options import CARRIED, ORIGINS, SHADING_ROLES, WRAP_MODES, LoadOptions
from mipbake.source.sources import Found, IgnoredFile, Log, MapSource, NormalConvention, source_model, spoken
from mipbake.source.specular import as_metallic

__all__ = ["MapSource", "NormalConvention", "TextureMap", "TextureSet", "read", "source_model"]

_ORDER = ("base_color", "metallic", "roughness", "normal")
"""Maps in the order in which the models of glTF store them; anisotropy follows where a set has it."""


@dataclass(frozen=True)
class TextureSet:
    """The maps of one material.

    Args:
        name: of the set, safe as a folder name.
        maps: role to map. base_color, normal, roughness and metallic are always there; with anisotropy, where it is,
            they are height x width. Occlusion, height, emissive and opacity are there where the source has them, at
            their own sizes. Pixels are (H, W, C) float32: see `TextureMap`.
        width, height: size of the maps that shade, in texels.
        wrap: addressing along u and v, each "wrap" or "clamp".
        convention: of the source's normal map, and how it was decided; the pixels here always have green up.
        source_hash: SHA-256 in hexadecimal over the sources and how they were read: equal hashes, equal pixels.
        notes: what was found and assumed, in sentences.
        warnings: what the user should look at, in sentences.
        ignored: files of the folder that fill no role, and why.
        alpha_cutoff: what renderers test opacity against; None where it is blended.
    """

    name: str
    maps: Mapping[str, TextureMap]
    width: int
    height: int
    wrap: tuple[str, str]
    convention: NormalConvention
    source_hash: str
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    ignored: tuple[IgnoredFile, ...] = ()
    alpha_cutoff: float | None = None

    def __repr__(self) -> str:
        """A description in one line."""
        return f"TextureSet({self.name!r}, {self.width} x {self.height}: {', '.join(self.maps)})"

    @property
    def anisotropic(self) -> bool:
        """Whether there is an anisotropy map."""
        return "anisotropy" in self.maps

    @property
    def plain_maps(self) -> Mapping[str, TextureMap]:
        """The maps that do not shade, by role."""
        return {role: m for role, m in self.maps.items() if role not in SHADING_ROLES}

    @property
    def source_model(self) -> str:
        """The material model that the source is given in: "gltf-anisotropic" with an anisotropy map, else "gltf"."""
        return source_model(self.anisotropic)

    @property
    def found(self) -> Found:
        """The facts about the set without its pixels."""
        sources = {role: texture.source for role, texture in self.maps.items()}
        about = (self.name, self.width, self.height, self.source_model, sources, self.convention)
        return Found(*about, self.notes, self.warnings, self.ignored)

    @cached_property
    def _lines(self) -> NDArray[np.float32]:
        """The anisotropy map with signs that agree: what lies between its texels does not depend on who drew it."""
        return untangled(self.maps["anisotropy"].pixels, self.wrap)

    def filtered(self, pixel_filter: str) -> FilteredSource:
        """Level 0 in its own material model, to be seen under a pixel filter."""
        return FilteredSource(self.material(self.source_model), self.source_model, self.wrap, pixel_filter)

    def material(self, model: str) -> NDArray[np.float32]:
        """Stored channels (H, W, C) float32 of level 0 in a material model; see `mipbake.material`."""
        converted = convert(self._stored(), self.source_model, model)
        return np.ascontiguousarray(converted, np.float32)

    def _stored(self) -> NDArray[np.float32]:
        """(H, W, C) of the source's own model: what the maps lie in, where they lie in one array in their order."""
        maps = [*(self.maps[role].pixels for role in _ORDER), *([self._lines] if self.anisotropic else [])]
        whole, start = maps[0].base, 0
        if whole is None or whole.ndim != 3 or whole.shape[-1] != sum(pixels.shape[-1] for pixels in maps):
            return np.concatenate(maps, -1)
        for pixels in maps:
            place = whole[..., start : start + pixels.shape[-1]]
            if pixels.base is not whole or pixels.__array_interface__ != place.__array_interface__:
                return np.concatenate(maps, -1)
            start += pixels.shape[-1]
        return np.ascontiguousarray(whole, np.float32)

    @classmethod
    def from_arrays(
        cls,
        name: str,
        *,
        normal: ArrayLike,
        roughness: ArrayLike | float,
        base_color: ArrayLike | float = 0.5,
        metallic: ArrayLike | float = 0.0,
        anisotropy: ArrayLike | None = None,
        occlusion: ArrayLike | None = None,
        height: ArrayLike | None = None,
        emissive: ArrayLike | None = None,
        opacity: ArrayLike | None = None,
        wrap: tuple[str, str] = ("wrap", "wrap"),
    ) -> TextureSet:
        """A texture set from decoded values, for procedural data.

        Args:
            name: of the set; used as a folder name.
            normal: (H, W, 3) signed, green up; renormalised.
            roughness, metallic, occlusion, opacity: (H, W) or (H, W, 1) in [0, 1], or numbers.
            base_color: (H, W, 3) linear Rec.709 in [0, 1]; (H, W), (H, W, 1) or a number for grey.
            anisotropy: (H, W, 3): direction x and y, signed, renormalised; strength in [0, 1].
            height: (H, W) or (H, W, 1), any range.
            emissive: (H, W, 3) linear Rec.709, at least 0.
            wrap: addressing along u and v.

        Maps that shade and are smaller than the largest are resampled to it; maps that do not shade keep their size.

        Raises:
            InputError: a shape, a range or a value (NaN, infinity) is not as above. UsageError: as `wrap` is not.
        """
        if len(wrap) != 2 or any(mode not in WRAP_MODES for mode in wrap):
            raise UsageError(f"wrap is {wrap!r}: expected two of {', '.join(WRAP_MODES)}")
        given = {
            **{"base_color": base_color, "normal": normal, "roughness": roughness, "metallic": metallic},
            **{"anisotropy": anisotropy, "occlusion": occlusion, "height": height},
            **{"emissive": emissive, "opacity": opacity},
        }
        arrays = {role: checked_array(role, value) for role, value in given.items() if value is not None}
        arrays["normal"], broken = held(arrays["normal"])
        warnings = (f"normal: {holes_warning(broken, arrays['normal'])}",) if broken else ()
        shading = [a for role, a in arrays.items() if role in SHADING_ROLES]
        rows, columns = max((a.shape[:2] for a in shading), key=lambda s: s[0] * s[1])
        maps, digest = {}, hashlib.sha256(repr(wrap).encode())
        for role, array in arrays.items():
            if role in SHADING_ROLES:
                check_shape(role, array, rows, columns)
            digest.update(f"{role} {array.shape}".encode() + array.tobytes())
            texture = TextureMap(array, MapSource.made(role, array.shape[1], array.shape[0], "given as an array"))
            maps[role] = resized(texture, columns, rows, wrap) if role in SHADING_ROLES else texture
        convention = NormalConvention("opengl", "option", 1.0)
        return cls(name, maps, columns, rows, wrap, convention, digest.hexdigest(), warnings=warnings)


def read(found: Found, options: LoadOptions) -> TextureSet:
    """The texture set of what `mipbake.source.discover.find` found with these options: every map decoded. InputError
    where a file cannot be used; the sentence says which and what to do."""
    log = Log([*found.notes], [*found.warnings])
    decoded, warnings = _decoded(found, options)
    normal = found.maps["normal"]
    some = tiles(decoded["normal"].pixels)
    turn_vectors(some, normal.orientation)  # green down then looks like red to the left, or like green down
    convention = found.normal_convention
    if normal.path is not None:
        convention = _decided(convention, normal.path.name, some, is_constant(decoded["normal"].pixels), log)
    log.warnings += warnings
    maps: dict[str, TextureMap] = {}
    for role in found.maps:
        texture = decoded.pop(role)
        if role.startswith(CARRIED) and texture.source.channels == "A" and texture.pixels.min() >= 1:
            continue  # an alpha channel that says nothing
        if texture.source.reason == BASE_ALPHA and texture.source.path and texture.pixels.min() >= 1:
            log.notes.remove(alpha_note(texture.source.path))
            continue
        if role == "normal" and convention.name == "directx":
            texture.pixels[..., 1] *= -1
        if role == "normal":
            turn_vectors(texture.pixels, normal.orientation)
        if role in options.factors:
            texture = replace(texture, pixels=scaled(texture.pixels, role, options.factors[role]))
        maps[role] = resized(texture, found.width, found.height, options.wrap) if role in SHADING_ROLES else texture
    del texture
    as_metallic(maps, log)
    _lay_side_by_side(maps)
    if options.alpha_cutoff is not None and "opacity" not in maps:
        log.warnings.append("the alpha cutoff is left out, because the set has no opacity")
    return TextureSet(
        found.name,
        maps,
        found.width,
        found.height,
        options.wrap,
        convention,
        _source_hash(maps, convention, options),
        (*log.notes, *(note for texture in maps.values() for note in texture.source.notes)),
        tuple(log.warnings),
        found.ignored,
        options.alpha_cutoff,
    )


def _decoded(found: Found, options: LoadOptions) -> tuple[dict[str, TextureMap], list[str]]:
    """Every source decoded at its own size, and warnings; each file is read once, files side by side."""
    by_file: dict[tuple[Path, tuple[int, str]], list[MapSource]] = {}
    decoded: dict[str, TextureMap] = {}
    warnings: list[str] = []
    for role, source in found.maps.items():
        if source.path is not None:
            by_file.setdefault((source.path, source.layer), []).append(source)
        else:
            size = (found.width, found.height) if role in SHADING_ROLES else (1, 1)
            decoded[role] = constant_map(source, *size)

    def read_file(place: tuple[Path, tuple[int, str]], sources: list[MapSource]) -> list[tuple[TextureMap, list[str]]]:
        image = read_image(*place, sources[0].metadata)
        return [decode_map(source, image, options) for source in sources]

    # Decoders release the interpreter; more files at once than cores would only hold more memory.
    with ThreadPoolExecutor(max(1, min(4, os.cpu_count() or 1))) as pool:
        for texture, doubts in (each for part in pool.map(read_file, by_file, by_file.values()) for each in part):
            decoded[texture.source.role] = texture
            warnings += doubts
    return decoded, warnings


def _decided(convention: NormalConvention, label: str, vectors: Vectors, flat: bool, log: Log) -> NormalConvention:
    """The convention of a normal map, as far as options and names say it, checked against its pixels, or decided by
    them: `tiles` of its normals as stored. `flat`: whether all of them are the same, so that there is nothing to
    see."""
    name, confidence = integrability(vectors)
    decided = confidence >= DECIDED_CONFIDENCE
    if convention.decided_by in (*ORIGINS, "name"):
        if decided and name != convention.name:
            origin = "its name says" if convention.decided_by == "name" else f"the {convention.decided_by} says"
            log.warnings.append(
                f"{label}: {origin} {spoken(convention.name)}, but the curl of its slopes looks like "
                f"{spoken(name)} (confidence {confidence:.2f})"
            )
        return convention
    if flat:
        return NormalConvention("opengl", "flat", 1.0)
    if decided:
        log.notes.append(f"{label}: {spoken(name)} by the curl of its slopes (confidence {confidence:.2f})")
        return NormalConvention(name, "pixels", confidence)
    log.warnings.append(
        f"{label}: neither its name nor its slopes (confidence {confidence:.2f}, {DECIDED_CONFIDENCE} needed) tell "
        "OpenGL from DirectX; OpenGL is assumed: where dents look like bumps, --normal-convention directx is right"
    )
    return NormalConvention("opengl", "assumed", confidence)


def _lay_side_by_side(maps: dict[str, TextureMap]) -> None:
    """Moves the maps that shade into one array, which is level 0 as methods take it: they ask for it again and again,
    and copies of it would be as large as all those maps together."""
    order = [role for role in (*_ORDER, "anisotropy") if role in maps]
    channels = sum(maps[role].pixels.shape[2] for role in order)
    whole, start = memory.empty((*maps["normal"].pixels.shape[:2], channels)), 0
    for role in order:
        width = maps[role].pixels.shape[2]
        place = whole[..., start : start + width]
        place[...] = maps[role].pixels
        maps[role] = replace(maps[role], pixels=place)  # which lets go of what was copied
        start += width


def _source_hash(maps: Mapping[str, TextureMap], convention: NormalConvention, asked: LoadOptions) -> str:
    """Over everything that decides the pixels: files, channels, encodings, convention and options."""
    read = [(role, m.source) for role, m in maps.items()]
    sources = [(role, s.sha256, s.channels, s.encoding, s.inverted, s.constant, *s.applied) for role, s in read]
    options = (convention.name, asked.wrap, sorted(asked.factors.items()), asked.alpha)
    return hashlib.sha256(json.dumps([sources, options]).encode()).hexdigest()
