"""What lights the pixels of an estimate: light-view pairs of groups, or of each pixel, or many lights at once.

Every illumination shades samples of pixels. The samples keep an axis of their own, so that one function weighs and
averages the samples of all illuminations (estimate.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.metrics.pairs import LightViewPairs
from mipbake.quality.reference.samples import Span
from mipbake.shading import shade, shade_lit

Image = NDArray[np.float32]


class Illumination:
    """What an estimate needs to know of an illumination. Inherited by those below, which have (G, ...) `light`."""

    light: Image

    @property
    def groups(self) -> int:
        """Groups, each of which looks pixels up by itself."""
        return len(self.light)

    @property
    def renders(self) -> int:
        """K, renders of a pixel in a group."""
        return 1

    def shaded(self, model: str, texels: Image, span: Span) -> Image:
        """Radiance of (R, S, n, C) texels, S samples of n pixels in R groups: (R, K, S, 1, n, 3) or (R, 1, S, K, n, 3).

        With (1, S, n, C) texels, which all groups see: (1, R K, S, 1, n, 3) or (1, 1, S, K, n, 3).
        """
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class GroupPairs(Illumination):
    """K light-view pairs of each of G groups, for all pixels of the group.

    Args:
        light, view: (G, K, 3) unit vectors.
    """

    light: Image
    view: Image

    @property
    def renders(self) -> int:
        return int(self.light.shape[1])

    def shaded(self, model: str, texels: Image, span: Span) -> Image:
        rows, samples, count, channels = texels.shape
        light, view = (each[span.groups].reshape(rows, -1, 3) for each in (self.light, self.view))
        seen = shade(model, texels.reshape(rows, -1, channels), light, view)
        return seen.reshape(rows, -1, samples, 1, count, 3)


def common_pairs(pairs: LightViewPairs) -> GroupPairs:
    """Pairs that all pixels have: one group."""
    return GroupPairs(pairs.light[None], pairs.view[None])


@dataclass(frozen=True, eq=False)
class PixelPairs(Illumination):
    """K light-view pairs of each pixel's own; one group.

    Args:
        light, view: (K, P, 3) unit vectors.
    """

    light: Image
    view: Image

    @property
    def groups(self) -> int:
        return 1

    @property
    def renders(self) -> int:
        return len(self.light)

    def shaded(self, model: str, texels: Image, span: Span) -> Image:
        # Samples are the batch: the pairs of a pixel repeat for each of them.
        shaded: Image = shade(model, texels[0], self.light[None, :, span.pixels], self.view[None, :, span.pixels])
        return shaded[None, None]


@dataclass(frozen=True, eq=False)
class SummedLights(Illumination):
    """Directional lights of each of G groups, seen from one side and all at once: one render, their sum.

    Args:
        light: (G, L, 3) unit vectors. view: (G, 3) unit vectors. power: (G, L, 3) irradiance of each light.
    """

    light: Image
    view: Image
    power: Image

    def shaded(self, model: str, texels: Image, span: Span) -> Image:
        rows, samples, count, channels = texels.shape
        light, view, power = (each[span.groups] for each in (self.light, self.view, self.power))
        points = samples * count
        frame = np.broadcast_to(np.eye(3, dtype=np.float32), (points, 3, 3))
        seen = np.broadcast_to(view[:, None], (len(view), points, 3))
        lit = shade_lit(model, texels.reshape(rows, points, channels), frame, seen, light, power)
        return lit.reshape(rows, 1, samples, 1, count, 3)
