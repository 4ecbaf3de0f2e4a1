"""Maps that shade, side by side in one array."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base import memory
from mipbake.source.decode import TextureMap
from mipbake.source.sources import Discovery

ORDER = ("base_color", "metallic", "roughness", "normal")
"""Maps in the order in which the models of glTF store them; anisotropy follows where a set has it."""


def places(found: Discovery, channels: Mapping[str, int]) -> dict[str, NDArray[np.float32]]:
    """Where each map that shades lies in one array, which is level 0 as methods take it.

    Methods and measures ask for it again and again, and copies of it would be as large as all those maps together.

    Args:
        channels: of the map of each role.
    """
    widths = {role: channels[role] for role in (*ORDER, "anisotropy") if role in found.sources}
    whole = memory.empty((found.height, found.width, sum(widths.values())))
    ends = np.cumsum([0, *widths.values()])
    return {role: whole[..., start : start + widths[role]] for role, start in zip(widths, ends[:-1], strict=True)}


def put(maps: dict[str, TextureMap], into: Mapping[str, NDArray[np.float32]]) -> None:
    """Moves the maps that do not lie in their places yet; each is let go of as soon as it has been copied."""
    for role, place in into.items():
        if maps[role].pixels is not place:
            place[...] = maps[role].pixels
            maps[role] = replace(maps[role], pixels=place)


def lie_in(whole: NDArray[Any], maps: list[NDArray[np.float32]]) -> bool:
    """Whether maps are the channels of an array, one after the other, all of them."""
    start = 0
    for pixels in maps:
        expected = whole[..., start : start + pixels.shape[-1]] if whole.ndim == 3 else whole
        if pixels.base is not whole or pixels.__array_interface__ != expected.__array_interface__:
            return False
        start += pixels.shape[-1]
    return start == whole.shape[-1] and whole.flags.c_contiguous and whole.dtype == np.float32
