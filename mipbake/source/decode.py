"""From the stored values of a file to the values of a role: decoding, inversion, clipping, resampling."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake.base import memory
from mipbake.base.colour import LINEAR, SRGB, decode, unit_range
from mipbake.base.errors import InputError
from mipbake.material.directions import untangled
from mipbake.source.images.image import Image, share_beyond, straight, turn_vectors
from mipbake.source.normal import SHORT_LENGTH, decode_normals, held, holes_warning, normalised
from mipbake.source.options import COLOUR_ROLES, PREMULTIPLIED, SCALAR_ROLES, LoadOptions
from mipbake.source.sources import Log, MapSource, spoken, taken

Pixels = NDArray[np.float32]

RANGES = dict.fromkeys(("base_color", "roughness", "metallic", "occlusion", "opacity"), (0.0, 1.0))
"""Role to the least and the greatest value that it has."""

RANGES["emissive"] = (0.0, np.inf)

_FAR = 1.5
"""A median this many times the top of a range belongs to values in other units."""

_MANY = 0.01
"""Share of texels outside the range of a role from which a note becomes a warning."""

_FEW = 1e-3
"""Share of texels whose colours may exceed alpha by the ringing of a filter."""


@dataclass(frozen=True)
class TextureMap:
    """One decoded map: `pixels` (H, W, C) float32 in linear units, and where they come from.

    C is 3 for base_color and emissive (linear Rec.709), normal (unit, green up) and anisotropy (direction x and y,
    unit; strength), 1 for everything else. Maps of a set may be views of one array: texels then lie apart.
    """

    pixels: Pixels
    source: MapSource

    def __repr__(self) -> str:
        """A description in one line."""
        height, width, channels = self.pixels.shape
        origin = self.source.path.name if self.source.path else self.source.reason
        return f"TextureMap({self.source.role}, {width} x {height} x {channels}, {origin})"


def decode_map(source: MapSource, image: Image, options: LoadOptions) -> tuple[TextureMap, list[str]]:
    """The values of one role out of a file's image, at the image's size, and warnings; InputError where they cannot be
    that role's. x and y of normals are as stored: they are turned when it is known what green means."""
    # What is logged here is about the file, whose name is put before every sentence at the end.
    log = Log()
    if source.role == "normal":
        pixels = _normals(source, image, log)
    elif source.role == "anisotropy":
        pixels = _anisotropy(source, image, log)
    else:
        pixels = _values(source, image, options, log)
    label = image.header.path.name
    notes, warnings = ([f"{label}: {each}" for each in said] for said in (log.notes, log.warnings))
    return TextureMap(pixels, replace(source, sha256=image.sha256, notes=(*source.notes, *notes))), warnings


def _values(source: MapSource, image: Image, options: LoadOptions, log: Log) -> Pixels:
    """The values of a role that holds no vectors."""
    stored = taken(source, image)
    if source.alpha == PREMULTIPLIED:
        stored = _divided(stored, image, options.alpha == PREMULTIPLIED, log)
    if source.role in COLOUR_ROLES or source.converted:
        colours = np.broadcast_to(stored, (*stored.shape[:2], 3))
        whole = source.encoding not in (SRGB, LINEAR)  # a product of matrices has other bits, row by row
        pixels = decode(colours, source.encoding) if whole else _by_rows(colours, source.encoding)
    else:
        pixels = _by_rows(stored, LINEAR)
    if source.role == "roughness" and source.channels == "R" and not source.channels_named and _channels_differ(image):
        log.warnings.append("its channels differ; red is taken as the roughness")
    if source.role in RANGES and not (source.encoding in ("data", "sRGB") and stored.dtype.kind == "u"):
        _clip(pixels, source, log)
    if source.role in SCALAR_ROLES and stored.dtype.kind == "u" and stored.max() == 1:
        top = np.iinfo(stored.dtype.name).max
        log.warnings.append(f"its values are 0 and 1 of {top}, which is almost nothing: does 1 stand for the maximum?")
    if source.inverted:
        np.subtract(np.float32(1), pixels, out=pixels)
    return pixels


def _divided(stored: NDArray[np.generic], image: Image, insisted: bool, log: Log) -> NDArray[np.generic]:
    """Colours without the alpha that they were multiplied with.

    Colours that exceed their alpha were not multiplied by it, whatever their format means: unless the user insists.
    """
    alpha = image.pixels[..., image.header.alpha]
    if alpha.min() >= (np.iinfo(alpha.dtype.name).max if alpha.dtype.kind == "u" else 1):
        return stored
    share = 0.0 if insisted else share_beyond(stored, alpha)
    if share <= _FEW:
        log.notes.append("its colours are multiplied by alpha, and are divided by it")
        return straight(stored, alpha)
    log.warnings.append(
        f"such files hold colours that are multiplied by alpha, but {share:.0%} of its colours exceed their alpha: all "
        "are taken as they are; say --alpha premultiplied or straight (alpha in Python)"
    )
    return stored


def _by_rows(stored: NDArray[np.generic], colour_space: str) -> Pixels:
    """`decode`, some rows at a time: what lies in between stays in the cache."""
    out = memory.empty(stored.shape)
    for some in memory.some_rows(out):
        out[some] = decode(stored[some], colour_space)
    return out


def constant_map(source: MapSource, width: int, height: int) -> TextureMap:
    """A source without a file, at a size."""
    value = np.array(source.constant, np.float32)
    out = memory.empty((height, width, len(value)))
    out[...] = value
    return TextureMap(out, source)


def scaled(pixels: Pixels, role: str, factor: float) -> Pixels:
    """Values of a role times a factor, within the role's range; x and y of normals are scaled, then normals are made
    unit."""
    if role == "normal":
        return normalised(pixels * np.array([factor, factor, 1], np.float32))
    least, most = RANGES.get(role, (-np.inf, np.inf))
    if role == "anisotropy":
        out = pixels * np.array([1, 1, factor], np.float32)
        out[..., 2] = np.minimum(out[..., 2], 1)
        return out
    return np.asarray(np.clip(pixels * np.float32(factor), least, most), np.float32)


def resized(texture: TextureMap, width: int, height: int, wrap: tuple[str, str]) -> TextureMap:
    """A map at a size no smaller than its own; vectors are made unit again."""
    if texture.pixels.shape[:2] == (height, width):
        return texture
    lines = texture.source.role == "anisotropy"
    pixels = upsample(untangled(texture.pixels, wrap) if lines else texture.pixels, width, height, wrap)
    return replace(texture, pixels=unit_vectors(pixels, texture.source.role))


def upsample(pixels: Pixels, width: int, height: int, wrap: tuple[str, str]) -> Pixels:
    """Bilinear between texel centres, (H, W, C) to (height, width, C), neighbours beyond the border by `wrap`."""
    if pixels.shape[:2] == (height, width):
        return pixels
    out = memory.empty((height, width, pixels.shape[2]))
    for some in memory.some_rows(out):
        rows = np.arange(height)[some]
        part = pixels[some] if len(pixels) == height else _interpolated(pixels, rows, height, 0, wrap[1])
        out[some] = part if part.shape[1] == width else _interpolated(part, np.arange(width), width, 1, wrap[0])
    return out


def _interpolated(pixels: Pixels, index: NDArray[np.int64], size: int, axis: int, mode: str) -> Pixels:
    """Some texels, by index, of an axis that is stretched to a size."""
    count = pixels.shape[axis]
    at = (index + 0.5) * count / size - 0.5
    low = np.floor(at).astype(np.intp)
    weight = (at - low).astype(np.float32).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
    both = [i % count if mode == "wrap" else np.clip(i, 0, count - 1) for i in (low, low + 1)]
    first, second = (np.take(pixels, i, axis) for i in both)
    second -= first
    second *= weight
    second += first
    return np.asarray(second)


def _normals(source: MapSource, image: Image, log: Log) -> Pixels:
    decoded, length, notes = decode_normals(taken(source, image), image.header.path)
    log.notes += notes
    vectors, broken = held(decoded, length)
    if broken:
        log.warnings.append(holes_warning(broken, vectors))
    mean = 1.0 if length is None else float(length.mean(dtype=np.float64))
    if mean < SHORT_LENGTH:
        log.warnings.append(
            f"its normals are shorter than one (mean length {mean:.3f}), as averaging leaves them; they are "
            "renormalised"
        )
    return vectors


def _anisotropy(source: MapSource, image: Image, log: Log) -> Pixels:
    """KHR_materials_anisotropy: direction in red and green, strength in blue; grey is a strength along +X.

    Many tools store a grey map as three equal channels, which would otherwise be taken for directions: unless the user
    says which channels are which.
    """
    values = unit_range(taken(source, image))
    out = np.empty((*values.shape[:2], 3), np.float32)
    if values.shape[-1] == 1 or (not source.channels_named and _is_grey(values)):
        out[..., 0], out[..., 1] = 1, 0
        log.notes.append("it is grey, and is taken as the strength along +X")
    else:
        out[..., :2] = unit_directions(values[..., :2] * np.float32(2) - np.float32(1))
        turn_vectors(out, source.orientation)
    np.clip(values[..., -1], 0, 1, out=out[..., 2])
    return out


def _is_grey(values: Pixels) -> bool:
    """Whether the channels of (H, W, 3) in [0, 1] are equal everywhere, to within the rounding of 8 bits."""
    return all(float(np.abs(values[..., c] - values[..., 0]).max()) <= 1.5 / 255 for c in (1, 2))


def unit_directions(xy: Pixels) -> Pixels:
    """Unit (..., 2); where there is hardly a direction (less than 8-bit noise), +X, as in the extension."""
    length = np.linalg.norm(xy, axis=-1, keepdims=True)
    unit: Pixels = np.where(length > 0.02, xy / np.maximum(length, 0.02), np.array([1, 0], np.float32))
    return unit


def unit_vectors(pixels: Pixels, role: str) -> Pixels:
    """Values of a role after they were averaged: normals and directions are made unit, directions in place."""
    if role == "normal":
        return normalised(pixels)
    if role == "anisotropy":
        pixels[..., :2] = unit_directions(pixels[..., :2])
    return pixels


def _channels_differ(image: Image) -> bool:
    colours = image.pixels[..., :3]
    if colours.shape[-1] < 3:
        return False
    step = max(1, max(colours.shape[:2]) // 256)
    values = unit_range(colours[::step, ::step])
    return float(np.abs(values - values[..., :1]).max()) > 0.1


def _clip(pixels: Pixels, source: MapSource, log: Log) -> None:
    """Clips values to the range of a role in place.

    InputError where the values cannot be the role's: most are far above its range, as integers in a float file are.
    """
    least, most = RANGES[source.role]
    parts = [pixels[some] for some in memory.some_rows(pixels)]
    outside = sum(int(np.count_nonzero(((part < least) | (part > most)).any(-1))) for part in parts)
    if not outside:
        return
    low, high = float(pixels.min()), float(pixels.max())
    if most < np.inf and float(np.median(memory.copied(pixels), overwrite_input=True)) > _FAR * most:
        raise InputError(
            f"{source.path} holds values from {low:.4g} to {high:.4g}: expected {spoken(source.role)} from "
            f"{least:g} to {most:g}, divide them by what stands for {most:g} and export it again"
        )
    count = f"{outside} texel{'s' if outside > 1 else ''}"
    # Primaries other than Rec.709's reach colours that it has no positive values for.
    wide = source.role in COLOUR_ROLES and source.encoding not in (SRGB, LINEAR)
    limits = f"below {least:g}" if most == np.inf else f"outside [{least:g}, {most:g}]"
    reach = f"from {low:.4g}" if most == np.inf else f"from {low:.4g} to {high:.4g}"
    sentence = f"{count} {limits}{' in linear Rec.709' if wide else ''} clipped ({reach})"
    share = outside / (pixels.shape[0] * pixels.shape[1])
    np.clip(pixels, least, most, out=pixels)
    if share <= _MANY:
        log.notes.append(sentence)
        return
    cause = f"its colours are {source.encoding}" if wide else f"it is a map of {spoken(source.role)}"
    log.warnings.append(f"{sentence}, {share:.0%} of all: check that {cause}")
