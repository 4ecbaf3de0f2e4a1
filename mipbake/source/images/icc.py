"""What an ICC profile says of colours, where it is a matrix and curves that have a name."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mipbake.base.colour_spaces import COLOUR_SPACES
from mipbake.base.srgb import srgb_to_linear
from mipbake.source.images.colours import Colour, coded

_TO_D50 = np.array(
    [[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169], [0.0139322, 0.0971045, 0.7141733]]
)
"""Linear Rec.709 to the XYZ of profiles, whose white is D50."""

_PRIMARIES = {
    "Rec.709": np.eye(3),
    "P3": np.array(COLOUR_SPACES["Display P3"].to_rec709),
    "Adobe RGB": np.array(COLOUR_SPACES["Adobe RGB (1998)"].to_rec709),
    "Rec.2020": np.array(COLOUR_SPACES["ITU-R BT.2020"].to_rec709),
    "AP1": np.array(COLOUR_SPACES["ACEScg"].to_rec709),
    "AP0": np.array(COLOUR_SPACES["ACES2065-1"].to_rec709),
}
_NEAR = 0.02
"""Elements of matrices that differ by less are the same, adapted to D50 by another formula."""

_GRID = np.linspace(0, 1, 65)
_CURVES = {
    "sRGB": srgb_to_linear(_GRID),
    "linear": _GRID,
    "gamma 2.2": _GRID ** (563 / 256),
    "BT.709": np.where(_GRID < 0.081, _GRID / 4.5, ((_GRID + 0.099) / 1.099) ** (1 / 0.45)),
}
_SAME = 0.003
"""Curves that differ by less everywhere are the same; sRGB's and the power of 2.2 differ by 0.008."""


def profile_colour(profile: bytes) -> Colour:
    """What an ICC profile says; a broken profile says nothing that is known."""
    try:
        tags = _tags(profile)
        by = f"its ICC profile ({_description(tags)})"
        if b"cicp" in tags:
            return coded(tags[b"cicp"][8], tags[b"cicp"][9], by)
        grey = profile[16:20] == b"GRAY"
        with np.errstate(all="ignore"):
            curves = [_curve(tags[tag]) for tag in ((b"kTRC",) if grey else (b"rTRC", b"gTRC", b"bTRC"))]
        if any(np.abs(curve - curves[0]).max() > _SAME for curve in curves):
            return Colour("a curve for each colour", "", by=by)
        return Colour(_named(curves[0]), "" if grey else _primaries(tags), by=by)
    except (struct.error, KeyError, IndexError, ValueError, ArithmeticError):
        return Colour("of a kind that is not read", by="its ICC profile")


def _tags(profile: bytes) -> Mapping[bytes, bytes]:
    (count,) = struct.unpack_from(">I", profile, 128)
    entries = (struct.unpack_from(">4sII", profile, 132 + 12 * index) for index in range(min(count, 100)))
    return {name: profile[at : at + size] for name, at, size in entries}


def _description(tags: Mapping[bytes, bytes]) -> str:
    data = tags.get(b"desc", b"")
    if data[:4] == b"mluc" and len(data) >= 28:
        size, at = struct.unpack_from(">II", data, 20)
        text = data[at : at + size].decode("utf-16-be", "replace")
    else:
        text = data[12:].split(b"\0")[0].decode("ascii", "replace")
    text = "".join(letter for letter in text if letter.isprintable())[:40].strip()
    return text or "without a name"


def _curve(data: bytes) -> NDArray[np.float64]:
    """A curve's linear values on the grid."""
    kind = data[:4]
    if kind == b"curv":
        (count,) = struct.unpack_from(">I", data, 8)
        if count == 0:
            return _GRID
        values = np.frombuffer(data, ">u2", count, 12).astype(np.float64)
        if count == 1:
            return np.asarray(_GRID ** (values[0] / 256))
        return np.asarray(np.interp(_GRID, np.linspace(0, 1, count), values / 65535))
    if kind != b"para":
        raise ValueError(kind)
    (form,) = struct.unpack_from(">H", data, 8)
    count = (1, 3, 4, 5, 7)[form]
    given = [value / 65536 for value in struct.unpack_from(f">{count}i", data, 12)]
    g, a, b, c, d, e, f = given + [0.0] * (7 - count)
    if form == 0:
        return np.asarray(_GRID**g)
    curved = np.maximum(a * _GRID + b, 0) ** g
    if form in (1, 2):
        return np.asarray(np.where(-b / a <= _GRID, curved, 0) + c)
    return np.asarray(np.where(d <= _GRID, curved + e, c * _GRID + f))


def _named(curve: NDArray[np.float64]) -> str:
    apart = {name: float(np.abs(curve - known).max()) for name, known in _CURVES.items()}
    nearest = min(apart, key=lambda name: apart[name])
    return nearest if apart[nearest] < _SAME else "a curve of its own"


def _primaries(tags: Mapping[bytes, bytes]) -> str:
    columns = [np.frombuffer(tags[tag], ">i4", 3, 8) / 65536 for tag in (b"rXYZ", b"gXYZ", b"bXYZ")]
    to_rec709 = np.linalg.solve(_TO_D50, np.stack(columns, -1))
    return next((n for n, known in _PRIMARIES.items() if np.abs(to_rec709 - known).max() < _NEAR), "its own")
