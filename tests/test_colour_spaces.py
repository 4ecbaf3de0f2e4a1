"""Colour spaces that mipbake knows itself, beside colour-science."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake.base import colour
from mipbake.base.colour import canonical_colour_space, decode
from mipbake.base.colour_science import colour_science
from mipbake.base.colour_spaces import COLOUR_SPACES
from mipbake.base.errors import UsageError


@pytest.mark.parametrize("name", COLOUR_SPACES)
def test_values_are_those_of_colour_science(name: str) -> None:
    library = colour_science("a test")
    space = library.RGB_COLOURSPACES[name]
    rec709 = library.RGB_COLOURSPACES["ITU-R BT.709"]
    own = COLOUR_SPACES[name]
    matrix = library.matrix_RGB_to_RGB(space, rec709, "Bradford")
    np.testing.assert_allclose(own.to_rec709, matrix, rtol=0, atol=1e-12)
    values = np.linspace(0, 1.2, 4001)
    linear = values if own.decoded is None else own.decoded(values)
    np.testing.assert_allclose(linear, space.cctf_decoding(values), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("name", COLOUR_SPACES)
def test_colour_science_is_not_asked_for_them(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def asked(user: str) -> None:
        raise UsageError(user)

    monkeypatch.setattr(colour, "colour_science", asked)
    for spelt in (name, name.lower(), f"linear {name}"):
        space = canonical_colour_space(spelt)
        grey = decode(np.full((1, 1, 3), 255, np.uint8), space)
        np.testing.assert_allclose(grey, grey.mean(), rtol=1e-4)
    with pytest.raises(UsageError, match="'ProPhoto RGB', which mipbake does not know itself"):
        canonical_colour_space("ProPhoto RGB")
