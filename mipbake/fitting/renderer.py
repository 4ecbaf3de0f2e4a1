"""What a fit asks of a renderer: it renders levels, and says where each pixel looked them up."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
V_contra = TypeVar("V_contra", contravariant=True)


_STAMPS = itertools.count(1)


def new_stamp() -> int:
    """A number that no level of this process has been given yet."""
    return next(_STAMPS)


@dataclass(frozen=True, eq=False)
class Levels:
    """A MIP stack as a renderer gets it: what files of 8 bits would hold, before they are rounded.

    Args:
        model: a name in `mipbake.material.MODELS`.
        maps: name of each map of the model to its levels, finest first: (H_L, W_L, channels) float32. Colours are
            sRGB-encoded from 0 to 1, vectors are (x + 1) / 2, roughness, metallic and strength are as they are.
            Logarithms (of `ggx` and `beckmann`) are as they are, too. The arrays may be views, and change after the
            call.
        wrap: addressing along u and v, each "wrap" or "clamp".
        stamps: a number for each level, which is another one whenever the texels of that level are others. A renderer
            that keeps textures uploads the levels whose number it does not have yet.
    """

    model: str
    maps: Mapping[str, Sequence[Array]]
    wrap: tuple[str, str]
    stamps: tuple[int, ...]

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(height, width) of each level."""
        first = next(iter(self.maps.values()))
        return [(level.shape[0], level.shape[1]) for level in first]


@dataclass(frozen=True, eq=False)
class Frame:
    """What a renderer made of a view, rows from the top.

    Args:
        image: (H, W, 3), linear radiance; or what a display gets, for fits that compare it as it is.
        uv: (H, W, 2) where the pixel's centre looked the maps up; u to the right and v down, any real numbers where
            the maps repeat.
        lod: (H, W) level of detail of a trilinear lookup; or None, then `uv_da` is given.
        uv_da: (H, W, 4) du/dX, du/dY, dv/dX, dv/dY per pixel, which the level of detail follows from; or None.
        id: (H, W) integers, 0 where a pixel shows nothing of the maps. None: every pixel shows them.

    Any array of numbers will do; a fit checks shapes, and that values are finite.
    """

    image: Any
    uv: Any
    lod: Any = None
    uv_da: Any = None
    id: Any = None


class Renderer(Protocol[V_contra]):
    """Anything that renders. It may be a game engine, or a few lines of Python.

    The same levels and the same view must give the same frame, as far as that is possible: a fit follows differences
    between frames.

    Two more methods are used where a renderer has them: `image(levels, view)` gives the image of a frame alone, without
    what does not change with the maps; and `mipbake fit` calls `close()` at the end.
    """

    def render(self, levels: Levels, view: V_contra) -> Frame:
        """The frame of a view, with the maps looked up in `levels` as the engine looks its textures up."""
