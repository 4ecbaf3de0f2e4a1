"""Which level three.js samples, seen with level-coloured textures, and that `linear` makes WebGL's own levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from browser import numbers
from engine_textures import KINDS, EngineMap, level_coloured, write_map
from numpy.typing import NDArray
from three_page import ThreePage

from mipbake.base.srgb import linear_to_srgb, srgb_to_linear
from mipbake.material.pixel_filter import filtered_levels

SIDE = 256
"""Texels a side of the test textures."""

_PIXELS = 32
_LEVELS = SIDE.bit_length()
_COLOUR_TOLERANCE = 0.02  # tolerance for the mix of two levels: WebGL leaves the precision of a level to its maker
_UNIT = 1 / 255
_GENERATED_TOLERANCE = 1.5 * _UNIT  # WebGL rounds each level and makes the next from it


def check_levels(three: ThreePage) -> list[str]:
    """What was seen, a line a check; AssertionError where a level is not honoured."""
    seen = [_check_coloured(three, kind) for kind in KINDS if kind != "float"]
    return [*seen, _check_generated(three, False), _check_generated(three, True)]


def expected_colour(lod: float, colours: NDArray[np.floating]) -> NDArray[np.float64]:
    """The trilinear mix of (levels, 3) colours at a level of detail, clamped to the levels there are."""
    lod = min(max(lod, 0.0), len(colours) - 1.0)
    low = min(int(lod), len(colours) - 2)
    return np.asarray(colours[low] + (lod - low) * (colours[low + 1] - colours[low]), np.float64)


def _check_coloured(three: ThreePage, kind: str) -> str:
    texture = level_coloured(SIDE)
    colours = np.stack([level[0, 0, :3] for level in texture.levels])
    lods = np.arange(-2, 2 * _LEVELS) / 2
    # Square footprints, then ones four times as long along u or along v: the longer side decides.
    footprints = [(lod, lod) for lod in lods] + [(lod, lod - 2) for lod in lods] + [(lod - 2, lod) for lod in lods]
    repeats = [[_PIXELS * 2.0**lod / SIDE for lod in each] for each in footprints]
    found = _flat(three, write_map(texture, kind, three.folder), "levels", _PIXELS, repeats)
    worst = 0.0
    for each, image in zip(footprints, found, strict=True):
        wanted = expected_colour(max(each), colours)
        error = float(np.abs(image[..., :3] - wanted).max())
        assert error <= _COLOUR_TOLERANCE, (
            f"{kind}: a pixel of 2^{each[0]:g} by 2^{each[1]:g} texels shows {image[0, 0, :3].round(3)}, "
            f"expected {wanted}"
        )
        worst = max(worst, error)
    return f"{kind}: {_LEVELS} levels honoured, the level is log2 of the longer footprint (largest error {worst:.4f})"


def _check_generated(three: ThreePage, colour: bool) -> str:
    """Levels that WebGL makes from level 0 against ours under a box."""
    values = np.random.default_rng(7).integers(0, 256, (SIDE, SIDE, 4)).astype(np.float32) / 255
    values[..., 3] = 1
    name = "generated-srgb" if colour else "generated"
    decoded = values if not colour else np.concatenate([srgb_to_linear(values[..., :3]), values[..., 3:]], -1)
    written = write_map(EngineMap(name, [decoded], colour), "rgba8", three.folder)
    levels = filtered_levels(decoded, "box", ("wrap", "wrap"))
    worst = 0.0
    for level, ours in enumerate(levels):
        image = _flat(three, written, "generated", len(ours), [[1.0, 1.0]])[0][::-1]
        # Dark colours are stored finely and bright ones coarsely: an error is a difference of stored numbers.
        both = [each[..., :3].astype(np.float64) for each in (image, ours)]
        both = [linear_to_srgb(each) for each in both] if colour else both
        error = float(np.abs(both[0] - both[1]).max())
        assert error <= _GENERATED_TOLERANCE * max(level, 0.2), (
            f"level {level} of {name} differs from ours by {error / _UNIT:.2f} of 255"
        )
        worst = max(worst, error)
    kind = "sRGB colours" if colour else "data"
    return f"generateMipmap of {kind}: as our box average, largest difference {worst / _UNIT:.2f} of 255"


def _flat(
    three: ThreePage, written: dict[str, Any], filter_: str, side: int, repeats: Sequence[Sequence[float]]
) -> list[NDArray[np.float64]]:
    """(side, side, 4) images a pair of repeats, bottom row first."""
    texts = three.page.evaluate("([map, filter, side, repeats]) => proof.flat(map, filter, side, repeats)",
                          [written, filter_, side, [list(each) for each in repeats]])  # fmt: skip
    return [numbers(text, (side, side, 4)) for text in texts]
