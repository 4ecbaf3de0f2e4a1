"""What an input is: the maps of one material, decoded to linear float32, and what was found and assumed on the way."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.base.colour import LINEAR
from mipbake.base.errors import InputError, UsageError
from mipbake.material import GLTF_MODELS, MODELS, convert
from mipbake.material.directions import untangled
from mipbake.material.filtered_source import FilteredSource
from mipbake.source.decode import (
    DecodedMap,
    TextureMap,
    constant_map,
    decode_map,
    resized,
    scaled,
    unit_directions,
    upsample,
    widened,
)
from mipbake.source.discover import find, settle_convention
from mipbake.source.images.declared import turn_vectors
from mipbake.source.images.read import read_image
from mipbake.source.joined import ORDER, lie_in, places, put
from mipbake.source.matches import BASE_ALPHA, alpha_note
from mipbake.source.normal import is_constant, normalised, tiles
from mipbake.source.options import CARRIED, COLOUR_ROLES, ROLES, SHADING_ROLES, WRAP_MODES, LoadOptions
from mipbake.source.sources import DATA, Discovery, IgnoredFile, MapSource, NormalConvention
from mipbake.source.specular import as_metallic
from mipbake.source.steep import held, warning

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Options = TypeVar("_Options", bound="DataclassInstance")

__all__ = ["LoadOptions", "MapSource", "NormalConvention", "TextureMap", "TextureSet", "load"]


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
        """(H, W, C) of the source's own model: what the maps lie in, where they lie in one array."""
        maps = [*(self.maps[role].pixels for role in ORDER), *([self._lines] if self.anisotropic else [])]
        whole = maps[0].base
        if whole is not None and lie_in(whole, maps):
            return whole
        return np.concatenate(maps, -1)

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
            InputError: a shape, a range or a value (NaN, infinity) is not as above.
        """
        if len(wrap) != 2 or any(mode not in WRAP_MODES for mode in wrap):
            raise UsageError(f"wrap is {wrap!r}: expected two of {', '.join(WRAP_MODES)}")
        given = {
            "base_color": base_color,
            "normal": normal,
            "roughness": roughness,
            "metallic": metallic,
            "anisotropy": anisotropy,
            "occlusion": occlusion,
            "height": height,
            "emissive": emissive,
            "opacity": opacity,
        }
        arrays = {role: _checked_array(role, value) for role, value in given.items() if value is not None}
        arrays["normal"], broken = held(arrays["normal"])
        texels = arrays["normal"].shape[0] * arrays["normal"].shape[1]
        warnings = (warning("normal", broken, texels),) if broken else ()
        shading = [a for role, a in arrays.items() if role in SHADING_ROLES]
        rows, columns = max((a.shape[:2] for a in shading), key=lambda s: s[0] * s[1])
        maps, digest = {}, hashlib.sha256(repr(wrap).encode())
        for role, array in arrays.items():
            if role in SHADING_ROLES:
                _check_shape(role, array, rows, columns)
            digest.update(f"{role} {array.shape}".encode() + array.tobytes())
            texture = TextureMap(array, _array_source(role, array))
            maps[role] = resized(texture, columns, rows, wrap) if role in SHADING_ROLES else texture
        convention = NormalConvention("opengl", "option", 1.0)
        return cls(name, maps, columns, rows, wrap, convention, digest.hexdigest(), warnings=warnings)


def load(
    path: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    options: LoadOptions | None = None,
    **overrides: Any,
) -> TextureSet:
    """Reads a texture set.

    Args:
        path: a folder, or the files of one set.
        options: how to read it.
        overrides: single fields of `LoadOptions`, on top of `options`: `load(folder, colour_space="ACEScg")`.

    Raises:
        InputError: the folder or a file cannot be used; the sentence says which and what to do.
        UsageError: an option does not exist or has a value it cannot have.
    """
    options = with_overrides(options or LoadOptions(), overrides)
    found = find(path, options)
    into = places(found, _ARRAY_CHANNELS)
    decoded = _read(found, into)
    normals = decoded["normal"].map.pixels
    some, orientation = tiles(normals), found.sources["normal"].orientation
    turn_vectors(some, orientation)  # green down then looks like red to the left, or like green down
    found = settle_convention(found, some, is_constant(normals))
    warnings = [*found.warnings, *(w for item in decoded.values() for w in item.warnings)]
    maps: dict[str, TextureMap] = {}
    for role in found.sources:
        texture = decoded[role].map
        if role.startswith(CARRIED) and texture.source.channels == "A" and texture.pixels.min() >= 1:
            continue  # an alpha channel that says nothing
        if texture.source.reason == BASE_ALPHA and texture.source.path and texture.pixels.min() >= 1:
            told = alpha_note(texture.source.path)
            found = replace(found, notes=tuple(note for note in found.notes if note != told))
            continue
        if role == "normal" and found.convention.name == "directx":
            texture.pixels[..., 1] *= -1
        if role == "normal":
            turn_vectors(texture.pixels, orientation)
        if role in options.factors:
            texture = replace(texture, pixels=scaled(texture.pixels, role, options.factors[role]))
        maps[role] = resized(texture, found.width, found.height, options.wrap) if role in SHADING_ROLES else texture
    converted, loss = as_metallic(maps)
    warnings += loss
    lost = decoded["normal"].lost_variance
    if lost is not None:
        variance = upsample(lost[..., None], found.width, found.height, options.wrap)[..., 0]
        maps["roughness"] = replace(maps["roughness"], pixels=widened(maps["roughness"].pixels, variance))
    del decoded, normals, texture, lost
    put(maps, into)
    notes = [*found.notes, *converted, *(n for m in maps.values() for n in m.source.notes)]
    if options.alpha_cutoff is not None and "opacity" not in maps:
        warnings.append("the alpha cutoff is left out, because the set has no opacity")
    return TextureSet(
        found.name,
        maps,
        found.width,
        found.height,
        options.wrap,
        found.convention,
        _source_hash(maps, found),
        tuple(notes),
        tuple(warnings),
        found.ignored,
        options.alpha_cutoff,
    )


def source_model(anisotropic: bool) -> str:
    """The material model of sources that have an anisotropy map, or that have none."""
    (model,) = (name for name in GLTF_MODELS if MODELS[name].anisotropic == anisotropic)
    return model


def with_overrides(options: _Options, overrides: Mapping[str, Any]) -> _Options:
    """Options, a dataclass, with single fields replaced; UsageError for a field that there is not."""
    known = [f.name for f in fields(options)]
    for name in overrides:
        if name not in known:
            raise UsageError(f"unknown option {name!r}: expected one of {', '.join(known)}")
    return replace(options, **overrides)


def _read(found: Discovery, into: Mapping[str, NDArray[np.float32]]) -> dict[str, DecodedMap]:
    """Every source decoded at its own size; each file is read once, files side by side. `into`: from `places`."""
    by_file: dict[tuple[Path, tuple[int, str]], list[MapSource]] = {}
    decoded: dict[str, DecodedMap] = {}
    for role, source in found.sources.items():
        if source.path is not None:
            by_file.setdefault((source.path, source.layer), []).append(source)
        elif role in SHADING_ROLES:
            decoded[role] = DecodedMap(constant_map(source, found.width, found.height, into.get(role)))
        else:
            decoded[role] = DecodedMap(constant_map(source, 1, 1))

    def read_file(sources: list[MapSource]) -> dict[str, DecodedMap]:
        first = sources[0]
        assert first.path is not None
        image = read_image(first.path, first.layer, first.metadata)
        return {s.role: decode_map(s, image, found.options, into.get(s.role)) for s in sources}

    # Decoders release the interpreter; more files at once than cores would only hold more memory.
    with ThreadPoolExecutor(max(1, min(4, os.cpu_count() or 1))) as pool:
        for part in pool.map(read_file, by_file.values()):
            decoded.update(part)
    return decoded


def _source_hash(maps: Mapping[str, TextureMap], found: Discovery) -> str:
    """Over everything that decides the pixels: files, channels, encodings, convention and options."""
    read = [(role, m.source) for role, m in maps.items()]
    sources = [(role, s.sha256, s.channels, s.encoding, s.inverted, s.constant, *s.applied) for role, s in read]
    asked = found.options
    factors = sorted(asked.factors.items())
    options = (found.convention.name, asked.normal_length, asked.wrap, factors, asked.alpha)
    return hashlib.sha256(json.dumps([sources, options]).encode()).hexdigest()


_ARRAY_CHANNELS = {role: 3 if role in (*COLOUR_ROLES, "normal", "anisotropy") else 1 for role in ROLES}


def _checked_array(role: str, value: ArrayLike | float) -> NDArray[np.float32]:
    """(H, W, C) float32 of a role, vectors unit; InputError when the shape or a value does not fit the role."""
    channels = _ARRAY_CHANNELS[role]
    array = np.array(value, np.float32)
    if array.ndim == 0 and role not in ("normal", "anisotropy", "emissive"):
        array = np.full((1, 1, channels), array, np.float32)
    elif array.ndim == 2 and (channels == 1 or role == "base_color"):
        array = array[..., None]
    if role == "base_color" and array.ndim == 3 and array.shape[2] == 1:
        array = np.repeat(array, 3, -1)
    if array.ndim != 3 or array.shape[2] != channels or 0 in array.shape:
        shape = "(H, W, 3)" if channels == 3 else "(H, W) or (H, W, 1)"
        raise InputError(f"{role} has shape {np.shape(value)}: expected {shape}, at least 1 x 1")
    if not np.isfinite(array).all():
        raise InputError(f"{role} holds {np.count_nonzero(~np.isfinite(array))} NaN or infinite values: expected none")
    _check_encoding(role, array, np.asarray(value).dtype)
    low, high = _ARRAY_RANGES.get(role, (-np.inf, np.inf))
    values = array[..., 2] if role == "anisotropy" else array
    if values.min() < low or values.max() > high:
        raise InputError(f"{role} runs from {values.min():g} to {values.max():g}: expected values from {low} to {high}")
    if role == "normal":
        if array[..., 2].min() < 0:
            raise InputError("normal points into the surface: expected signed vectors with z at least 0")
        array = normalised(array)
    elif role == "anisotropy":
        array[..., :2] = unit_directions(array[..., :2])
    return np.ascontiguousarray(array)


_TOPS = (1, 255, 65535)
"""The largest encoded value: of floats, of 8 bits and of 16 bits."""


def _check_encoding(role: str, array: NDArray[np.float32], dtype: np.dtype[Any]) -> None:
    """InputError for values as files store them: integers that stand for 0 to 1, vectors moved into 0 to 1."""
    if role in ("normal", "anisotropy"):
        vectors = array[..., :3] if role == "normal" else array[..., :2]
        for top in _TOPS:
            if vectors.min() >= 0 and vectors.max() <= top and _are_unit(2 * vectors / np.float32(top) - 1):
                if _are_unit(vectors):
                    return
                decoded = f"2 * values{'' if top == 1 else f' / {top}'} - 1"
                where = " for x and y" if role == "anisotropy" else ""
                raise InputError(
                    f"{role} is encoded in 0 to {top}, as files store it: expected signed vectors, "
                    f"pass {decoded}{where}"
                )
    bounded = role in _ARRAY_RANGES and role not in ("normal", "anisotropy")
    if bounded and dtype.kind in "iu" and array.max() > 1:
        top = 255 if array.max() <= 255 else 65535
        decoded = f"values / {top}, decoded from sRGB" if role in COLOUR_ROLES else f"values / {top}"
        raise InputError(
            f"{role} holds integers up to {array.max():g}: expected {'linear ' if role in COLOUR_ROLES else ''}values "
            f"from 0 to 1, pass {decoded}"
        )


def _are_unit(vectors: NDArray[np.float32]) -> bool:
    """Whether vectors (H, W, C) have length one, except for rounding to 8 bits and a tenth of outliers."""
    off = np.abs(np.sqrt(np.einsum("hwc,hwc->hw", vectors, vectors)) - 1)
    return float(np.quantile(off, 0.9)) < 0.05


_ARRAY_RANGES = {
    "base_color": (0, 1),
    "roughness": (0, 1),
    "metallic": (0, 1),
    "anisotropy": (0, 1),
    "occlusion": (0, 1),
    "opacity": (0, 1),
    "emissive": (0, np.inf),
}


def _check_shape(role: str, array: NDArray[np.float32], rows: int, columns: int) -> None:
    h, w = array.shape[:2]
    if (h, w) != (1, 1) and (h > rows or w > columns or abs(w * rows - h * columns) > max(rows, columns)):
        raise InputError(f"{role} is {w} x {h} and the largest map is {columns} x {rows}: expected one shape")


def _array_source(role: str, array: NDArray[np.float32]) -> MapSource:
    encoding = LINEAR if role in COLOUR_ROLES else DATA
    return MapSource(role, None, "", array.shape[1], array.shape[0], "float", encoding, False, "given as an array")
