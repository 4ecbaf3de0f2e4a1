"""The colour spaces that names of files tell, and MaterialX's and OpenEXR's files: how each becomes linear Rec.709.

colour-science has them, too, and many more. It takes a hundred megabytes and a second to import, so what most sets need
is here; tests/test_names_colour.py compares the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mipbake.base.srgb import srgb_to_linear

Values = NDArray[np.floating]


@dataclass(frozen=True)
class ColourSpace:
    """A colour space of red, green and blue.

    Args:
        to_rec709: (3, 3) matrix from its linear values to linear Rec.709, with Bradford's chromatic adaptation.
        decoded: encoded values to linear ones; None where values are stored linear.
    """

    to_rec709: tuple[tuple[float, ...], ...]
    decoded: Callable[[Values], Values] | None


def _acescc(encoded: Values) -> Values:
    """S-2014-003 of the Academy."""
    linear = 2 ** (encoded * 17.52 - 9.72)
    linear = np.where(encoded < (9.72 - 15) / 17.52, (linear - 2**-16) * 2, linear)
    return np.where(encoded >= (np.log2(65504) + 9.72) / 17.52, 65504, linear)


def _acescct(encoded: Values) -> Values:
    """S-2016-001 of the Academy."""
    straight = (encoded - 0.0729055341958355) / 10.5402377416545
    return np.where(encoded > 0.155251141552511, 2 ** (encoded * 17.52 - 9.72), straight)


def _bt2020(encoded: Values) -> Values:
    """ITU-R BT.709, and BT.2020 for 10 bits."""
    a, joint = 1.099, 0.018
    curved = (np.maximum(encoded, 0) + (a - 1)) / a
    return np.where(encoded < a * joint**0.45 - (a - 1), encoded / 4.5, curved ** (1 / 0.45))


def _powered(encoded: Values, exponent: float) -> Values:
    return np.asarray(np.maximum(encoded, 0) ** exponent)


_AP1 = (
    (1.7050509926579844, -0.6217921206570046, -0.0832588720009786),
    (-0.1302564175070437, 1.1408047365754013, -0.010548319068358044),
    (-0.024003356804618025, -0.12896897606497057, 1.152972332869589),
)
_AP0 = (
    (2.5216861865669222, -1.1341309882187154, -0.3875551985963978),
    (-0.27647991412700446, 1.3727190876428328, -0.09623917344609703),
    (-0.015378064975651647, -0.15297533586456552, 1.1683534008913892),
)
_P3 = (
    (1.2249401762805596, -0.22494017628055965, 0.0),
    (-0.042056954709688156, 1.0420569547096883, 0.0),
    (-0.019637554590334443, -0.07863604555063182, 1.0982736001409663),
)
_REC2020 = (
    (1.6604910021084347, -0.5876411387885495, -0.07284986331988486),
    (-0.12455047452159082, 1.1328998971259603, -0.00834942260436945),
    (-0.01815076335490522, -0.10057889800800741, 1.1187296613629127),
)
_ADOBE = (
    (1.3983671735286696, -0.39834512250568316, 5.401616569927928e-06),
    (-1.0317634073403049e-05, 0.9999916496057166, -3.945858604255301e-06),
    (-3.7086719795080537e-07, -0.042926950998185075, 1.0429319655961493),
)

_REC709 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

COLOUR_SPACES: Mapping[str, ColourSpace] = {
    "ACEScg": ColourSpace(_AP1, None),
    "ACES2065-1": ColourSpace(_AP0, None),
    "ACEScc": ColourSpace(_AP1, _acescc),
    "ACEScct": ColourSpace(_AP1, _acescct),
    "Display P3": ColourSpace(_P3, srgb_to_linear),
    "ITU-R BT.709": ColourSpace(_REC709, _bt2020),
    "ITU-R BT.2020": ColourSpace(_REC2020, _bt2020),
    "Adobe RGB (1998)": ColourSpace(_ADOBE, partial(_powered, exponent=563 / 256)),
}
"""By the names of colour-science; sRGB and linear Rec.709 have code of their own. The matrices are colour-science's."""
