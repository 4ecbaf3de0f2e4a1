"""Gaussians in the plane, blended nearest first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mipbake.base.aligned import dense
from mipbake.base.arguments import checked, device_of, empty, is_array, whole
from mipbake.base.errors import UsageError
from mipbake.raster import _arguments

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    Array = TypeVar("Array", NDArray[Any], Tensor)

MOST_SHOWN = 64
"""Splats that a pixel lists at most, as in the native core."""


def splats(
    centers: Array, conics: Array, paint: Array, depth: Array, resolution: Sequence[int], most: int = 16
) -> tuple[Array, Array]:
    """Draws Gaussians in the plane over each other, nearest first, and lists which of them make up each pixel.

    At an offset (x, y) from its centre a splat has alpha = opacity exp(-(a x^2 + 2 b x y + c y^2) / 2), at most 0.99;
    below 1/255 it is not drawn. Its weight is alpha times what comes through the splats before it, and a pixel is the
    sum of weights times colours. Where less than 1e-4 comes through, nothing more is drawn (Kerbl et al. 2023, 3D
    Gaussian Splatting for Real-Time Radiance Field Rendering, equations 3 and 4 and appendix C).

    Args:
        centers: (N, 2) float32, x and y in pixels: pixel (row i, column j) is centred at (j + 1/2, i + 1/2).
        conics: (N, 3) float32, a, b and c: the inverse of the covariance [[a, b], [b, c]], in pixels^-2. A splat whose
            conic is no ellipse is not drawn.
        paint: (N, 4) float32, red, green, blue and opacity.
        depth: (N,) float32. A splat at 0 or less, or NaN, is behind the eye and is not drawn. Among equal ones the
            first is nearer.
        resolution: (height, width) in pixels, each from 1 to 32768.
        most: how many splats a pixel lists, 0 to 64.

    Returns:
        - (H, W, 4) float32: the sum of weights times colours, before black, and the sum of weights.
        - (H, W, most) int32: the splats with a weight of 1/255 or more, those of largest weight where there are more,
          nearest first; -1 behind the last. `mipbake.stochastic` takes them as what a pixel was made of.

    There are no gradients, and arguments on a GPU are refused. Results are the same bits whatever the number of
    threads and on every instruction set of x86. The plain twin is `mipbake.raster.reference.splats`.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit.
    """
    from mipbake import _native

    height, width = _arguments.size_of(resolution)
    count = whole(most)
    if count is None or not 0 <= count <= MOST_SHOWN:
        raise UsageError(f"most is {most!r}: expected a whole number from 0 to {MOST_SHOWN}")
    checked("centers", centers, None, ("float32",), (("splats", 2),), "x and y in pixels")
    if device_of(centers) != "cpu":
        raise UsageError(f"centers is on {device_of(centers)}: expected the CPU, where splats are drawn")
    like, splat_count = ("centers", centers), centers.shape[0]
    checked("conics", conics, like, ("float32",), ((splat_count, 3),), "a, b and c of each splat")
    checked("paint", paint, like, ("float32",), ((splat_count, 4),), "red, green, blue and opacity of each splat")
    checked("depth", depth, like, ("float32",), ((splat_count,),), "a number for each splat")
    image: Array = empty(centers, (height, width, 4))
    shown: Array = empty(centers, (height, width, count), "int32")
    given: tuple[Any, ...] = (centers, conics, paint, depth)
    if not is_array(centers):
        given = tuple(each.detach() for each in given)
    numbers = np.asarray(given[3])
    order = np.argsort(numbers, kind="stable")
    order = order[numbers[order] > 0].astype(np.int32)
    _native.splats(order, dense(given[0]), dense(given[1]), dense(given[2]), image, shown)
    return image, shown
