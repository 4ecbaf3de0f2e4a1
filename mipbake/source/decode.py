"""From the stored values of a file to the values of a role: decoding, inversion, clipping, resampling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake.base import memory
from mipbake.base.colour import LINEAR, SRGB, decode, unit_range
from mipbake.base.errors import InputError
from mipbake.material.directions import untangled
from mipbake.source.images.declared import share_beyond, straight, turn_vectors
from mipbake.source.images.image import Image
from mipbake.source.normal import SHORT_LENGTH, decode_normals, length_resolution, lost_variance, normalised
from mipbake.source.options import COLOUR_ROLES, PREMULTIPLIED, SCALAR_ROLES, LoadOptions
from mipbake.source.sources import MapSource, spoken, taken
from mipbake.source.steep import held, holes, warning

Pixels = NDArray[np.float32]

_RANGES = dict.fromkeys(("base_color", "roughness", "metallic", "occlusion", "opacity"), (0.0, 1.0))
_RANGES["emissive"] = (0.0, np.inf)

_FAR = 1.5
"""A median this many times the top of a range belongs to values in other units."""

_MANY = 0.01
"""Share of texels outside the range of a role from which a note becomes a warning."""


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


@dataclass(frozen=True)
class DecodedMap:
    """A map at its own size, x and y of normals as stored, which are turned when it is known what green means;
    `lost_variance` (H, W) where normals were shorter than one.
    """

    map: TextureMap
    warnings: tuple[str, ...] = ()
    lost_variance: Pixels | None = None


def decode_map(source: MapSource, image: Image, options: LoadOptions, out: Pixels | None = None) -> DecodedMap:
    """The values of one role out of a file's image; InputError when they cannot be that role's.

    `out`: (H, W, C) where they may be written, which saves a copy; not where they are written in any case.
    """
    stored = taken(source, image)
    source = replace(source, sha256=image.sha256)
    if source.role == "normal":
        return _normal(source, stored, options.normal_length, out)
    if source.role == "anisotropy":
        return _anisotropy(source, stored)
    warnings: tuple[str, ...] = ()
    if source.alpha == PREMULTIPLIED:
        stored, notes, warnings = _divided(stored, image, options.alpha == PREMULTIPLIED)
        source = replace(source, notes=(*source.notes, *notes))
    if source.role in COLOUR_ROLES or source.converted:
        colours = np.broadcast_to(stored, (*stored.shape[:2], 3))
        whole = source.encoding not in (SRGB, LINEAR)  # a product of matrices has other bits, row by row
        pixels = decode(colours, source.encoding) if whole else _by_rows(colours, source.encoding, out)
    else:
        pixels = _by_rows(stored, LINEAR, out)
    if source.role == "roughness" and source.channels == "R" and not source.channels_named and _channels_differ(image):
        warnings += (f"{image.header.path.name}: its channels differ; red is taken as the roughness",)
    if source.role in _RANGES and not (source.encoding in ("data", "sRGB") and stored.dtype.kind == "u"):
        pixels, clipped, doubts = _clipped(pixels, source)
        source = replace(source, notes=(*source.notes, *clipped))
        warnings += tuple(doubts)
    if source.role in SCALAR_ROLES and stored.dtype.kind == "u" and stored.max() == 1:
        top = np.iinfo(stored.dtype.name).max
        warnings += (
            f"{image.header.path.name}: its values are 0 and 1 of {top}, which is almost nothing: does 1 stand for the "
            "maximum?",
        )
    if source.inverted:
        np.subtract(np.float32(1), pixels, out=pixels)
    return DecodedMap(TextureMap(pixels, source), warnings)


_FEW = 1e-3
"""Share of texels whose colours may exceed alpha by the ringing of a filter."""


def _divided(
    stored: NDArray[np.generic], image: Image, insisted: bool
) -> tuple[NDArray[np.generic], tuple[str, ...], tuple[str, ...]]:
    """Colours without the alpha that they were multiplied with, a note and a warning.

    Colours that exceed their alpha were not multiplied by it, whatever their format means: unless the user insists.
    """
    alpha, label = image.pixels[..., image.header.alpha], image.header.path.name
    if alpha.min() >= (np.iinfo(alpha.dtype.name).max if alpha.dtype.kind == "u" else 1):
        return stored, (), ()
    share = 0.0 if insisted else share_beyond(stored, alpha)
    if share <= _FEW:
        return straight(stored, alpha), (f"{label}: its colours are multiplied by alpha, and are divided by it",), ()
    warning = (
        f"{label}: such files hold colours that are multiplied by alpha, but {share:.0%} of its colours exceed their "
        "alpha: all are taken as they are; say --alpha premultiplied or straight (alpha in Python)"
    )
    return stored, (), (warning,)


def _by_rows(stored: NDArray[np.generic], colour_space: str, out: Pixels | None) -> Pixels:
    """`decode`, some rows at a time: what lies in between stays in the cache. `out`: where it is written if it fits."""
    if out is None or out.shape != stored.shape:
        out = memory.empty(stored.shape)
    for some in memory.some_rows(out):
        out[some] = decode(stored[some], colour_space)
    return out


def constant_map(source: MapSource, width: int, height: int, out: Pixels | None = None) -> TextureMap:
    """A source without a file, at a size; `out`: where it is written, (height, width, C)."""
    value = np.array(source.constant, np.float32)
    out = memory.empty((height, width, len(value))) if out is None else out
    out[...] = value
    return TextureMap(out, source)


def scaled(pixels: Pixels, role: str, factor: float) -> Pixels:
    """Values of a role times a factor, within the role's range; x and y of normals are scaled, then normals are made
    unit."""
    if role == "normal":
        return normalised(pixels * np.array([factor, factor, 1], np.float32))
    least, most = _RANGES.get(role, (-np.inf, np.inf))
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
    if texture.source.role == "normal":
        pixels = normalised(pixels)
    elif lines:
        pixels[..., :2] = unit_directions(pixels[..., :2])
    return replace(texture, pixels=pixels)


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


def widened(roughness: Pixels, variance: Pixels) -> Pixels:
    """Perceptual roughness (H, W, 1) with `variance` (H, W) added to alpha^2, at most 1."""
    out = memory.empty(roughness.shape)
    for some in memory.some_rows(out):
        alpha2 = np.square(np.square(roughness[some])) + variance[some, :, None]
        out[some] = np.minimum(np.sqrt(np.sqrt(alpha2)), np.float32(1))
    return out


def _normal(source: MapSource, stored: NDArray[np.generic], normal_length: str, out: Pixels | None) -> DecodedMap:
    if source.path is None:
        raise InputError("a normal map from a file needs its path")
    fits = out is not None and out.shape[:2] == stored.shape[:2]
    decoded = decode_normals(stored, source.path, out if fits else None)
    vectors, count = held(decoded.vectors, decoded.length)
    broken = () if count == 0 else (warning(source.path.name, count, vectors.shape[0] * vectors.shape[1]),)
    notes = [f"{source.path.name}: {n}" for n in decoded.notes]
    variance: Pixels | None = None
    warnings: tuple[str, ...] = ()
    if decoded.length is not None and normal_length == "roughness":
        # What is not a normal tells nothing of how normals spread.
        length = np.where(holes(decoded.vectors, decoded.length), np.float32(1), decoded.length)
        variance = lost_variance(length, length_resolution(source.depth))
        mean = float(variance.mean(dtype=np.float64))
        notes.append(
            f"{source.path.name}: its mean length {decoded.mean_length:.3f} adds {mean:.3g} to the squared "
            "roughness alpha on average"
        )
    elif decoded.mean_length < SHORT_LENGTH:
        warnings = (
            f"{source.path.name}: its normals are shorter than one (mean length {decoded.mean_length:.3f}), as "
            "averaging leaves them; they are renormalised; --normal-length roughness (normal_length in Python) would "
            "count what is missing as roughness",
        )
    return DecodedMap(TextureMap(vectors, replace(source, notes=tuple(notes))), (*broken, *warnings), variance)


def _anisotropy(source: MapSource, stored: NDArray[np.generic]) -> DecodedMap:
    """KHR_materials_anisotropy: direction in red and green, strength in blue; grey is a strength along +X.

    Many tools store a grey map as three equal channels, which would otherwise be taken for directions: unless the user
    says which channels are which.
    """
    values = unit_range(stored)
    out = np.empty((*values.shape[:2], 3), np.float32)
    if values.shape[-1] == 1 or (not source.channels_named and _is_grey(values)):
        out[..., 0], out[..., 1] = 1, 0
        label = source.path.name if source.path else source.role
        source = replace(source, notes=(*source.notes, f"{label}: it is grey, and is taken as the strength along +X"))
    else:
        out[..., :2] = unit_directions(values[..., :2] * np.float32(2) - np.float32(1))
        turn_vectors(out, source.orientation)
    np.clip(values[..., -1], 0, 1, out=out[..., 2])
    return DecodedMap(TextureMap(out, source))


def _is_grey(values: Pixels) -> bool:
    """Whether the channels of (H, W, 3) in [0, 1] are equal everywhere, to within the rounding of 8 bits."""
    return all(float(np.abs(values[..., c] - values[..., 0]).max()) <= 1.5 / 255 for c in (1, 2))


def unit_directions(xy: Pixels) -> Pixels:
    """Unit (..., 2); where there is hardly a direction (less than 8-bit noise), +X, as in the extension."""
    length = np.linalg.norm(xy, axis=-1, keepdims=True)
    unit: Pixels = np.where(length > 0.02, xy / np.maximum(length, 0.02), np.array([1, 0], np.float32))
    return unit


def _channels_differ(image: Image) -> bool:
    colours = image.pixels[..., :3]
    if colours.shape[-1] < 3:
        return False
    step = max(1, max(colours.shape[:2]) // 256)
    values = unit_range(colours[::step, ::step])
    return float(np.abs(values - values[..., :1]).max()) > 0.1


def _clipped(pixels: Pixels, source: MapSource) -> tuple[Pixels, Sequence[str], Sequence[str]]:
    """Values within the range of a role, and what is to be said of those that were outside: notes, and warnings.

    InputError where the values cannot be the role's: most are far above its range, as integers in a float file are.
    """
    least, most = _RANGES[source.role]
    label = source.path.name if source.path else source.role
    parts = [pixels[some] for some in memory.some_rows(pixels)]
    outside = sum(int(np.count_nonzero(((part < least) | (part > most)).any(-1))) for part in parts)
    if not outside:
        return pixels, (), ()
    low, high = float(pixels.min()), float(pixels.max())
    if most < np.inf and float(np.median(memory.copied(pixels), overwrite_input=True)) > _FAR * most:
        raise InputError(
            f"{source.path or label} holds values from {low:.4g} to {high:.4g}: expected {spoken(source.role)} from "
            f"{least:g} to {most:g}, divide them by what stands for {most:g} and export it again"
        )
    count = f"{outside} texel{'s' if outside > 1 else ''}"
    # Primaries other than Rec.709's reach colours that it has no positive values for.
    wide = source.role in COLOUR_ROLES and source.encoding not in (SRGB, LINEAR)
    limits = f"below {least:g}" if most == np.inf else f"outside [{least:g}, {most:g}]"
    reach = f"from {low:.4g}" if most == np.inf else f"from {low:.4g} to {high:.4g}"
    told = f"{label}: {count} {limits}{' in linear Rec.709' if wide else ''} clipped ({reach})"
    share = outside / (pixels.shape[0] * pixels.shape[1])
    np.clip(pixels, least, most, out=pixels)
    if share <= _MANY:
        return pixels, (told,), ()
    return pixels, (), (f"{told}, {share:.0%} of all: check that {_cause(source, wide)}",)


def _cause(source: MapSource, wide: bool) -> str:
    """What is to be checked where many values of a source lie outside the range of its role."""
    return f"its colours are {source.encoding}" if wide else f"it is a map of {spoken(source.role)}"
