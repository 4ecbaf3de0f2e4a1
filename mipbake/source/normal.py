"""Normal maps: decoding, the checks that tell them from other maps, the test of their convention, and their holes.

A tangent-space normal has a height z above 0. Exporters and compression leave a few that have not, or none at all, and
one of them is enough: its slope is without bound, so the mean slope of a pixel is its own, and rules that add up the
variance of slopes make the pixel as rough as can be, and dark. Such a texel says nothing but that it is broken.
"""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base import memory
from mipbake.base.colour import unit_range
from mipbake.base.errors import InputError
from mipbake.material import MIN_NORMAL_Z

Vectors = NDArray[np.float32]
Lengths = NDArray[np.float32]

SHORT_LENGTH = 0.98
"""Mean length below which the source's normals are said to be shorter than one; 8-bit rounding alone gives 0.998."""

DECIDED_CONFIDENCE = 0.75
"""Confidence from which the integrability test is believed."""

_NO_LENGTH = 0.02
"""Length of a stored vector below which its direction is the rounding of 8 bits, or nothing."""

_AT_ONCE = 1 << 15
"""Texels whose temporaries stay in the cache."""


def decode_normals(pixels: NDArray[np.generic], path: Path) -> tuple[Vectors, Lengths | None, list[str]]:
    """File values (H, W, C >= 2) to unit vectors; InputError when they are not tangent-space normals.

    Values are n = 2 v - 1, unless a floating-point file stores signed components. Two channels, or three with a
    constant blue, hold x and y only: z = sqrt(1 - x^2 - y^2).

    Returns:
        (H, W, 3) unit vectors, green as in the source; (H, W) the length of each stored vector, at most 1, None where z
        was reconstructed; what was found, in sentences.
    """
    if pixels.shape[-1] < 2:
        raise InputError(f"{path} has one channel: expected a normal map with red, green and blue; is it a height map?")
    notes = []
    stored = pixels[..., :3]
    signed = pixels.dtype.kind == "f" and _is_signed(stored)
    if signed:
        notes.append("stores signed components")
    out = memory.empty((*pixels.shape[:2], 3))
    blocks = list(memory.some_rows(pixels, _AT_ONCE))
    length: Lengths | None = None
    if stored.shape[-1] == 2 or _has_constant_blue(stored, signed):
        notes.append("holds x and y only: z is reconstructed")
        for some in blocks:
            out[some] = _with_z(_vectors(stored[some], signed)[..., :2])
        _check_looks_like_normals(_sampled(out), out, path)
    else:
        _check_looks_like_normals(_vectors(_sampled(stored), signed), stored, path)
        length = memory.empty(pixels.shape[:2])
        for some in blocks:
            xyz = _vectors(stored[some], signed)
            of = np.sqrt(np.einsum("hwc,hwc->hw", xyz, xyz))
            out[some] = normalised(xyz, of)
            np.minimum(of, 1, out=length[some])
    return out, length, notes


def normalised(vectors: Vectors, length: Lengths | None = None) -> Vectors:
    """(..., 3) scaled to length one; vectors shorter than 1e-3 become +Z. `length` saves computing it."""
    if length is None:
        length = np.sqrt(np.einsum("...c,...c->...", vectors, vectors))
    out: Vectors = vectors / np.maximum(length, np.float32(1e-3))[..., None]
    short = length < 1e-3
    if short.any():
        out[short] = (0, 0, 1)
    return out


def holes(normals: Vectors, length: Lengths | None = None) -> NDArray[np.bool_]:
    """(H, W) which of (H, W, 3) unit vectors are not normals; `length` (H, W): their lengths before they were made
    unit."""
    found = memory.empty(normals.shape[:2], np.bool_)
    np.less(normals[..., 2], np.float32(MIN_NORMAL_Z), out=found)
    if length is not None:
        for row, of in zip(found, length, strict=True):
            np.logical_or(row, of < np.float32(_NO_LENGTH), out=row)
    return found


def held(normals: Vectors, length: Lengths | None = None) -> tuple[Vectors, int]:
    """Normals (H, W, 3) whose heights are MIN_NORMAL_Z or more, and how many texels had less. `length`: see `holes`.

    Those, and vectors without length, take the mean of their neighbours that have more, made unit; holes of several
    texels are filled from their rims inwards. Other texels stay bit for bit. Where no texel has more, all are flat.
    """
    broken = holes(normals, length)
    count = int(np.count_nonzero(broken))
    if not count:
        return normals, 0
    if count == broken.size:
        flat = np.zeros_like(normals)
        flat[..., 2] = 1
        return flat, count
    out, known = memory.copied(normals), ~broken
    rows, columns = np.nonzero(broken)
    while len(rows):
        total, found = np.zeros((len(rows), 3), np.float32), np.zeros(len(rows), np.bool_)
        for dy, dx in product((-1, 0, 1), repeat=2):
            y, x = rows + dy, columns + dx
            inside = (y >= 0) & (y < out.shape[0]) & (x >= 0) & (x < out.shape[1])
            y, x = np.where(inside, y, rows), np.where(inside, x, columns)
            seen = known[y, x]
            total += np.where(seen[:, None], out[y, x], 0)
            found |= seen
        out[rows[found], columns[found]] = normalised(total[found])
        known[rows[found], columns[found]] = True
        rows, columns = rows[~found], columns[~found]
    return out, count


def holes_warning(count: int, normals: Vectors) -> str:
    """The warning that so many of (H, W, 3) normals are broken, without what they are in."""
    they = "it takes" if count == 1 else "they take"
    return (
        f"{count} of {normals[..., 0].size} normals along the surface, into it or without length (z below "
        f"{MIN_NORMAL_Z:g}): {they} the mean of those around; repair the map if that is too many"
    )


def is_constant(image: NDArray[Any]) -> bool:
    """Whether every texel of (H, W, C) holds the same values."""
    return not np.ptp(_sampled(image), axis=0).any() and bool((image == image[0, 0]).all())


def tiles(image: NDArray[Any]) -> NDArray[Any]:
    """(H, W, C) to (T, h, w, C): up to 8 x 8 evenly spaced tiles of at most 64 x 64 texels, for `integrability`."""
    height, width = image.shape[:2]
    rows, columns = (max(1, min(8, size // 8)) for size in (height, width))
    step_y, step_x = height // rows, width // columns
    grid = image[: rows * step_y, : columns * step_x].reshape(rows, step_y, columns, step_x, image.shape[2])
    parts = grid[:, : min(step_y, 64), :, : min(step_x, 64)].swapaxes(1, 2)
    return np.ascontiguousarray(parts).reshape(-1, *parts.shape[2:])


def integrability(vectors: Vectors) -> tuple[str, float]:
    """Whether green points up ("opengl") or down ("directx"), from the curl of the slopes, and the confidence, 0 to 1.

    The slopes p = -x/z and q = -y/z of a height field satisfy dp/dy = dq/dx. With the wrong sign of green the two sides
    have opposite signs, so the sign of A = sum(dp/dy dq/dx) tells; with E = sum((dp/dy)^2 + (dq/dx)^2) / 2, A / E = +-1
    where the map is exactly integrable. Derivatives do not cross the borders of tiles, so wrapping does not matter.

    The confidence is erf(|t| / sqrt 2) min(1, |A / E| / 0.1): the first factor asks whether the tiles agree, with
    t = sum(A_i) / sqrt(sum(A_i^2)) (a sign-symmetric test, about normal where there is no preference); the second
    whether the effect is large enough not to be an artefact of compression.

    Args:
        vectors: (T, h, w, 3) unit normals, y as stored, from `tiles`.
    """
    z = np.maximum(vectors[..., 2], 0.2)
    p, q = vectors[..., 0] / z, vectors[..., 1] / z
    # Sobel derivatives; y points up, against the rows.
    dp = p[:, :-2] - p[:, 2:]
    dq = q[:, :, 2:] - q[:, :, :-2]
    dp_dy = dp[:, :, :-2] + 2 * dp[:, :, 1:-1] + dp[:, :, 2:]
    dq_dx = dq[:, :-2] + 2 * dq[:, 1:-1] + dq[:, 2:]
    products = np.einsum("thw,thw->t", dp_dy, dq_dx, dtype=np.float64)
    energy = (np.square(dp_dy).sum(dtype=np.float64) + np.square(dq_dx).sum(dtype=np.float64)) / 2
    if energy <= 1e-12 or not products.any():
        return "opengl", 0.0
    t = products.sum() / np.sqrt(np.square(products).sum())
    effect = products.sum() / energy
    confidence = math.erf(abs(t) / math.sqrt(2)) * min(1.0, abs(effect) / 0.1)
    return "opengl" if effect >= 0 else "directx", float(confidence)


def _sampled(image: NDArray[Any]) -> NDArray[Any]:
    """(N, C) texels of an image on a regular grid of at most about 512 x 512."""
    step = max(1, math.isqrt(image.shape[0] * image.shape[1]) // 512)
    return image[::step, ::step].reshape(-1, image.shape[-1])


def _is_signed(stored: NDArray[np.generic]) -> bool:
    texels = unit_range(_sampled(stored))
    return bool(texels[:, :2].min() < -0.01 or np.abs(texels[:, :2].mean(0)).max() < 0.25)


def _vectors(stored: NDArray[np.generic], signed: bool) -> Vectors:
    values = unit_range(stored)
    return values if signed else values * np.float32(2) - np.float32(1)


def _has_constant_blue(stored: NDArray[np.generic], signed: bool) -> bool:
    """Blue the same everywhere while red or green vary: 0 and 1 are what two-channel formats decode to."""
    blue = float(_vectors(stored[0, 0], signed)[2])
    texels = _sampled(stored)
    if blue not in (-1.0, 0.0, 1.0) or np.ptp(texels[:, 2]) > 0:
        return False
    varies = np.ptp(texels[:, :2], axis=0).max() > 0
    return bool(varies and np.ptp(stored[..., 2]) == 0)


def _with_z(xy: NDArray[np.float32]) -> Vectors:
    squared = np.einsum("hwc,hwc->hw", xy, xy)
    over = np.sqrt(np.maximum(squared, 1))
    z = np.sqrt(np.maximum(1 - squared, 0))
    return np.concatenate([xy / over[..., None], z[..., None]], -1)


def _check_looks_like_normals(texels: Vectors, whole: NDArray[Any], path: Path) -> None:
    """Refuses what cannot be a tangent-space normal map.

    Args:
        texels: (N, 3) vectors of some texels. whole: (H, W, 3) values that all vectors follow from, one by one.

    The limits were set on 130 scanned normal maps and 130 base colours. Normals: z > 0 in every texel, mean tilt (mean
    xy over mean z) at most 0.27, least correlation between two channels at most 0.27. Colours: z > 0 in fewer than 0.91
    of the texels or a tilt above 0.6, and mostly correlations above 0.8. Greys have a tilt of sqrt(2) or no z > 0.
    """
    mean = texels.mean(0, dtype=np.float64)
    expected = "expected tangent-space normals, (0.5, 0.5, 1) where the surface is flat"
    if np.ptp(texels, axis=0).max() == 0 and np.ptp(whole, axis=(0, 1)).max() == 0:
        if np.abs(mean[:2]).max() > 0.02 or mean[2] < 0.9:
            stored = ", ".join(f"{(m + 1) / 2:.3g}" for m in mean)
            raise InputError(f"{path} is constant at ({stored}): {expected}")
        return
    grey = np.abs(texels - texels.mean(1, keepdims=True)).max() <= 0.03
    if grey:
        raise InputError(f"{path} is grey, so it looks like a height map: {expected}")
    upward = float((texels[:, 2] > 0).mean())
    tilt = float(np.hypot(mean[0], mean[1]) / max(mean[2], 1e-6))
    if upward < 0.95 or tilt > 0.6:
        raise InputError(
            f"{path} does not look like a normal map ({1 - upward:.0%} of it points into the surface, its mean tilt is "
            f"{min(math.degrees(math.atan(tilt)), 90):.0f} degrees): {expected}; is it a colour map?"
        )
    if len(texels) >= 256 and np.ptp(texels, axis=0).min() > 0 and np.corrcoef(texels.T.astype(np.float64)).min() > 0.8:
        raise InputError(f"{path} has channels that rise and fall together, like a colour map's: {expected}")
