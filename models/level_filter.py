"""What the levels of a stack are filtered with by networks that correct averages, and for which lookup; without torch.

A level is read by bilinear interpolation, which blurs it once more: by a tent one of its texels wide, of variance 1/6.
The pixel filter alone, followed by that, is too wide. So a level is filtered with the pixel filter and then with
(-a, 1 + 2 a, -a) along both axes: its response 1 + a w^2 + O(w^4) undoes the tent's 1 - w^2 / 12, up to second order,
where a = 1/12. The source is also interpolated bilinearly, where `resample_weights` takes texels for constant: a tent
(1/6) in place of a box (1/12), in texels of level 0. Level L is to keep that: a = 1/12 - 4^-L / 24.

Most lookups lie between two levels, and mix a kernel that is too narrow with one that is too wide. Variances add up to
more than the variance that is wanted there, ((1 - t) + 4 t > 4^t), and a slanted pixel, whose level of detail follows
its longer side, is narrower still across. So every level is a little sharper than it should be by itself, by 1/60.

Closed forms gain by it on real sets, most at the fine levels (figures in docs/research.md); on white noise they lose.

A trilinear lookup takes the level of a footprint's longer side. Seen at a slant, a pixel covers only a strip of what
the texels of that level cover, and films of floors look too blurred. So networks that take the sampler filter
the levels above 0 a little less widely for it (`width_of`). A MIP bias takes another level for the same pixel, whose
texels are narrower or wider than the pixel by the bias; half of that goes into the filter. Frames show points all over
the pixel, whatever the bias, so the filter of a level has no part in that: it stays narrow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.material.aim import LOOKUPS, Sampler
from mipbake.material.pixel_filter import resample_weights

_BETWEEN = 1 / 60
"""What levels are sharper by because lookups lie between them. docs/research.md has what it gains in pictures; the
number is a guess."""

_TRILINEAR = 0.8
"""Width of the pixel filter above level 0 for trilinear lookups; a guess (docs/research.md)."""

_NARROW, _WIDE = 0.5, 4.0
"""Ends of the width; guesses."""

FROM_TOP = 3
"""Levels that are filtered from level 0 itself; each coarser one from box averages so many levels finer than it is."""


def width_of(level: int, sampler: Sampler) -> float:
    """Width of the pixel filter of a level, in units of its own, for a network that takes the sampler.

    Between one lookup and the most it is interpolated by the logarithm of their number. With bias and with frames it is
    a choice from a few widths by what `mipbake-2` shows on four generated sets, which no record holds.
    """
    if not level:
        return 1.0
    if sampler.frames > 1:
        return _TRILINEAR
    share = math.log2(sampler.lookups) / math.log2(LOOKUPS[-1])
    width = _TRILINEAR + (1 - _TRILINEAR) * share
    return float(min(max(width * 2 ** (-sampler.bias / 2), _NARROW), _WIDE))


def sharpening(level: int) -> float:
    """a of a level."""
    return 1 / 12 + _BETWEEN - 4.0**-level / 24


def taps_of_top(kernel: str) -> tuple[NDArray[np.floating], NDArray[np.float32]]:
    """What every texel of level 0 is summed from, (n,) each way, n odd, and the (n - 2,) taps before sharpening."""
    taps = resample_weights(16, 16, kernel, "wrap")[1][0]
    a = sharpening(0)
    return np.convolve(taps, [-a, 1 + 2 * a, -a]), taps


@dataclass(frozen=True)
class Lookup:
    """What levels are made for.

    Args:
        kernel: name of the pixel filter. sampler: that will look the levels up; None where the network takes none.
    """

    kernel: str
    sampler: Sampler | None = None

    def width(self, level: int) -> float:
        """Width of the pixel filter of a level."""
        return 1.0 if self.sampler is None else width_of(level, self.sampler)
