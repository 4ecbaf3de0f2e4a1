"""Stochastic gradients per pixel: what a renderer that only renders tells about its parameters.

After Deliot, Heitz and Belcour 2024, *Transforming a Non-Differentiable Rasterizer into a Differentiable One with
Stochastic Gradient Estimation*. All parameters are perturbed at once by random signs, and two images are rendered. The
difference of their errors in a pixel is credited to the parameters that this pixel was made of, and to no others:

    plus, minus = perturb(values, channels, step)                    # theta + s epsilon, theta - s epsilon: algorithm 1
    ...                                                              # render both; say what each pixel was made of
    differences = pixel_differences(image_plus, image_minus, image)  # algorithm 2
    add_gradient(gradient, differences, contributions, channels, step)  # equation 8; with other signs, too: equation 9
    descend(values, gradient, moments, channels)                     # Adam

Parameters lie in *elements*, rows of an array (elements, channels): a texel, a triangle or a vertex. Signs are a hash
of parameter, step and seed, so that nothing is stored between the calls. `touched_texels` and `touched_vertices` say
which elements a pixel was made of, and `contributions` turns that round.

Functions take NumPy arrays, or torch tensors on the CPU or with CUDA, and no gradients flow through them. Results are
the same bits whatever the number of threads. Work is in proportion to what the listed elements and pixels are, and does
not grow with elements that no pixel shows. The plain twins are in `mipbake.stochastic.reference`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from mipbake.errors import UsageError
from mipbake.stochastic._arrays import REAL, device_of, dtype_of, empty, given, is_array, stream_of, writable, zeros

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    Array = TypeVar("Array", NDArray[Any], Tensor)

__all__ = [
    "Channels",
    "Contributions",
    "Moments",
    "add_gradient",
    "contributions",
    "descend",
    "perturb",
    "pixel_differences",
    "touched_texels",
    "touched_vertices",
]

MOST_CHANNELS = 64
MOST_PARAMETERS = 2**32
"""What signs can number."""

MOST_LEVELS = 32
"""Of a MIP stack, as in the native core."""

TEXELS = {"nearest": 1, "trilinear": 8, "anisotropic": 8 * 16}
"""How many texels a lookup reads at most."""

_BOUNDARIES = ("wrap", "clamp", "mirror", "zero")


@dataclass(frozen=True)
class Channels:
    """What the channels of all elements have in common.

    Args:
        magnitude: how far each channel is perturbed, epsilon of equation 4; 0 for a channel that stays as it is. The
            paper takes the quantisation step of the format for texels, and what moves a vertex by 1 to 2 pixels.
        low, high: limits of each channel; both perturbed values and what `descend` makes lie within.
        lifted: the first of three channels that hold a unit vector as (n + 1) / 2; its z follows from x and y, so that
            its magnitude is 0. None: there is no such vector.

    Raises:
        UsageError: numbers of other lengths, that are not finite, or limits in the wrong order, or too close together.
    """

    magnitude: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    lifted: int | None = None

    def __post_init__(self) -> None:
        count = len(self.magnitude)
        if not 1 <= count <= MOST_CHANNELS or len(self.low) != count or len(self.high) != count:
            raise UsageError(
                f"channels have {count} magnitudes, {len(self.low)} lower and {len(self.high)} upper limits: expected "
                f"1 to {MOST_CHANNELS} of each"
            )
        for name in ("magnitude", "low", "high"):
            for number in getattr(self, name):
                if math.isnan(number) or (name == "magnitude" and not 0 <= number < math.inf):
                    raise UsageError(f"{name} holds {number}: expected numbers, and magnitudes from 0 on")
        if any(low > high for low, high in zip(self.low, self.high, strict=True)):
            raise UsageError("a lower limit of channels lies above the upper one: expected low <= high")
        ranges = zip(self.magnitude, self.low, self.high, strict=True)
        if any(high - low < 2 * magnitude for magnitude, low, high in ranges):
            raise UsageError("limits of a channel lie closer together than 2 magnitudes: expected room for both signs")
        if self.lifted is not None and not (0 <= self.lifted <= count - 3 and self.magnitude[self.lifted + 2] == 0):
            raise UsageError(
                f"lifted is {self.lifted}: expected the first of three channels, the third with a magnitude of 0"
            )


@dataclass(frozen=True, eq=False)
class Contributions:
    """For each element the pixels that show it, from `contributions`.

    Args:
        elements: (K,) int32, increasing: the elements that some pixel shows.
        starts: (K + 1,) int64: where the pixels of each begin.
        pixels: int32: numbers of pixels, increasing for each element.
    """

    elements: Any
    starts: Any
    pixels: Any


@dataclass(frozen=True, eq=False)
class Moments:
    """What Adam remembers of each element, from `Moments.of(values)`.

    Args:
        first, second: (N, C), the dtype of values.
        steps: (N,) int32, how often an element has been updated. Elements that no pixel showed stand still.
    """

    first: Any
    second: Any
    steps: Any

    @classmethod
    def of(cls, values: Any) -> Moments:
        """Moments of elements that have never been updated."""
        given("values", values, REAL, (None, None))
        shape = tuple(values.shape)
        return cls(
            zeros(values, shape, dtype_of(values)),
            zeros(values, shape, dtype_of(values)),
            zeros(values, shape[:1], "int32"),
        )


def perturb(
    values: Array,
    channels: Channels,
    step: int,
    seed: int = 0,
    elements: Array | None = None,
    out: tuple[Array, Array] | None = None,
) -> tuple[Array, Array]:
    """theta + s epsilon and theta - s epsilon, with independent signs s (algorithm 1).

    A value that lies nearer to a limit than its magnitude is first moved away from it, so that both results lie within
    the limits, and their difference is 2 epsilon.

    Args:
        values: (N, C) float32, or float64 on the CPU.
        step, seed: which signs; 0 to 2^32 - 1.
        elements: (K,) int32, which are perturbed, each once; None for all. Numbers are not checked.
        out: two arrays like values, which are written where elements are listed, and returned.

    Returns:
        Two arrays like values. Without `out`, elements that are not listed are as in values.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit.
    """
    from mipbake import _native

    values, magnitude, low, high, lifted = _parameters(values, channels)
    elements = _listed(elements, values)
    if out is None:
        out = (_copy(values), _copy(values)) if elements is not None else (_new(values), _new(values))
    plus, minus = (writable(f"out[{i}]", each, (dtype_of(values),), values.shape, values) for i, each in enumerate(out))
    with stream_of(values, "values") as stream:
        _native.stochastic_perturb(
            values, elements, magnitude, low, high, lifted, _key(step), _key(seed), plus, minus, stream
        )
    return plus, minus


def pixel_differences(plus: Array, minus: Array, reference: Array, weights: Array | None = None) -> Array:
    """|I(theta + s epsilon) - I|^2 - |I(theta - s epsilon) - I|^2 of each pixel (algorithm 2).

    Args:
        plus, minus, reference: (P, C) images, the pixels in a row; float32, or float64 on the CPU.
        weights: (P,) factors; None for 1.

    Returns:
        (P,) in the dtype of plus.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit.
    """
    from mipbake import _native

    plus = given("plus", plus, REAL, (None, None))
    dtype, shape = (dtype_of(plus),), tuple(plus.shape)
    minus, reference = given("minus", minus, dtype, shape, plus), given("reference", reference, dtype, shape, plus)
    weights = None if weights is None else given("weights", weights, dtype, shape[:1], plus)
    out: Array = empty(plus, shape[:1], dtype[0])
    with stream_of(plus, "plus") as stream:
        _native.stochastic_differences(plus, minus, reference, weights, out, stream)
    return out


def touched_texels(
    sizes: Sequence[tuple[int, int]],
    uv: Array,
    lod: Array | None = None,
    uv_da: Array | None = None,
    seen: Array | None = None,
    texels: str = "trilinear",
    boundary: tuple[str, str] = ("wrap", "wrap"),
) -> Array:
    """Which texels of a MIP stack each pixel was made of (section 4.4, textures).

    Texels are numbered level after level, finest first, and row by row. A texel that a lookup gives no weight is left
    out.

    Args:
        sizes: (height, width) of each level.
        uv: (P, 2) float32. A pixel whose uv is NaN touches nothing.
        lod: (P,) float32 level of detail; or
        uv_da: (P, 4) float32 derivatives du/dX, du/dY, dv/dX, dv/dY, which it follows from as in `sampling.texture`.
        seen: (P,) uint8, 0 where a pixel shows no texture; None: every pixel does.
        texels: "nearest", one texel of the nearest level, as in the paper; "trilinear", all texels that a trilinear
            lookup reads; "anisotropic", all that up to 16 lookups along the footprint read, for which uv_da is needed.
        boundary: the modes of u and v: "wrap", "clamp", "mirror" or "zero".

    Returns:
        (P, K) int32, -1 behind the last; K is 1, 8 or 128.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit, or a name is unknown.
    """
    from mipbake import _native

    if texels not in TEXELS:
        raise UsageError(f"texels is {texels!r}: expected {', '.join(TEXELS)}")
    if len(boundary) != 2 or any(mode not in _BOUNDARIES for mode in boundary):
        raise UsageError(f"boundary is {boundary!r}: expected two of {', '.join(_BOUNDARIES)}")
    if (lod is None) == (uv_da is None):
        raise UsageError("lod and uv_da are both given, or both missing: expected one of the two")
    if texels == "anisotropic" and uv_da is None:
        raise UsageError("uv_da is missing: expected it for anisotropic lookups, whose footprint is long")
    uv = given("uv", uv, ("float32",), (None, 2))
    count = uv.shape[0]
    lod = None if lod is None else given("lod", lod, ("float32",), (count,), uv)
    uv_da = None if uv_da is None else given("uv_da", uv_da, ("float32",), (count, 4), uv)
    seen = None if seen is None else given("seen", seen, ("uint8",), (count,), uv)
    out: Array = empty(uv, (count, TEXELS[texels]), "int32")
    levels = [(int(height), int(width)) for height, width in sizes]
    if not 1 <= len(levels) <= MOST_LEVELS or sum(height * width for height, width in levels) >= 2**31:
        raise UsageError(
            f"sizes has {len(levels)} levels: expected 1 to {MOST_LEVELS}, with less than 2^31 texels in all"
        )
    if min(map(min, levels)) < 1:
        raise UsageError(f"sizes holds {min(levels, key=min)}: expected heights and widths of 1 or more")
    with stream_of(uv, "uv") as stream:
        _native.stochastic_touched(levels, uv, lod, uv_da, seen, texels, *boundary, out, stream)
    return out


def touched_vertices(ids: Array, triangles: Array) -> Array:
    """Which vertices each pixel was made of, by a buffer of triangles (section 4.4, opaque and transparent geometry).

    Args:
        ids: (P, K) integers: for each pixel the triangles that it shows, one for opaque surfaces, all layers in a deep
            buffer. 0 is none, and t + 1 is triangle t, as `raster.rasterize` counts.
        triangles: (T, 3) int32.

    Returns:
        (P, 3 K) int32 numbers of vertices, -1 for none.

    Raises:
        UsageError: the dtype or shape of an argument does not fit, or a triangle does not exist.
    """
    corners = given("triangles", triangles, ("int32",), (None, 3))
    shown = given("ids", ids, ("int32", "int64", "float32", "float64"), (None, None), corners)
    numbers = shown.astype("int64") if is_array(shown) else shown.long()
    count = corners.shape[0]
    if numbers.shape[0] and numbers.shape[1] and (int(numbers.min()) < 0 or int(numbers.max()) > count):
        raise UsageError(
            f"ids reach from {int(numbers.min())} to {int(numbers.max())}: expected 0 for none, up to {count}"
        )
    with_none = zeros(corners, (count + 1, 3), "int32")
    with_none[0], with_none[1:] = -1, corners
    found: Array = with_none[numbers].reshape(numbers.shape[0], 3 * numbers.shape[1])
    return found


def contributions(touched: Array) -> Contributions:
    """Turns (P, K) int32 elements of each pixel (-1 for none) round: for each element the pixels that show it.

    An element that a pixel names twice counts once: the pixel's error difference is credited to it, and not twice.

    Raises:
        UsageError: another dtype or shape.
    """
    from mipbake import _native

    named = given("touched", touched, ("int32",), (None, None))
    if is_array(named):
        import numpy as np

        counts = np.zeros(int(named.max(initial=-1)) + 1, np.int32)
        _native.stochastic_count(named, counts)
        elements = np.flatnonzero(counts)
        starts = np.concatenate([[0], np.cumsum(counts[elements])]).astype(np.int64)
        cursors = np.zeros(len(counts), np.int64)
        cursors[elements] = starts[:-1]
        pixels = np.empty(int(starts[-1]), np.int32)
        _native.stochastic_fill(named, cursors, pixels)
        return Contributions(elements.astype(np.int32), starts, pixels)
    import torch

    count = max(named.shape[0], 1)
    pixel = torch.arange(named.shape[0], device=named.device)[:, None].expand(named.shape)[named >= 0]
    keys = torch.unique(named[named >= 0].long() * count + pixel)
    of, shown = torch.div(keys, count, rounding_mode="floor"), torch.remainder(keys, count)
    numbers, sizes = torch.unique_consecutive(of, return_counts=True)
    begins = torch.nn.functional.pad(torch.cumsum(sizes, 0), (1, 0))
    return Contributions(numbers.int(), begins, shown.int())


def add_gradient(
    gradient: Array, differences: Array, made_of: Contributions, channels: Channels, step: int, seed: int = 0
) -> None:
    """Adds the estimate of the gradient by every parameter of the elements that pixels show (equation 8).

    All pixels of an element share its signs, so that their differences are summed once for all of its channels. The
    mean of many such estimates is the central difference of the error (equation 3), which is no exact gradient where
    the error is not quadratic in a parameter.

    Args:
        gradient: (N, C), float32, or float64 on the CPU; changed in place.
        differences: (P,), from `pixel_differences`, in the same dtype.
        made_of: from `contributions`, for the same pixels and elements; on a GPU nobody checks that.
        channels, step, seed: as `perturb` had them.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit, or a gradient that cannot be written
            to.
    """
    from mipbake import _native

    gradient = writable("gradient", gradient, REAL, (None, len(channels.magnitude)))
    differences = given("differences", differences, (dtype_of(gradient),), (None,), gradient)
    elements = given("made_of.elements", made_of.elements, ("int32",), (None,), gradient)
    starts = given("made_of.starts", made_of.starts, ("int64",), (elements.shape[0] + 1,), gradient)
    pixels = given("made_of.pixels", made_of.pixels, ("int32",), (None,), gradient)
    if device_of(gradient) == "cpu" and pixels.shape[0]:
        if int(pixels.max()) >= differences.shape[0]:
            raise UsageError(
                f"differences has {differences.shape[0]} pixels, and made_of names pixel {int(pixels.max())}: expected "
                "the same pixels"
            )
        if int(elements.max()) >= gradient.shape[0]:
            raise UsageError(
                f"gradient has {gradient.shape[0]} elements, and made_of names element {int(elements.max())}: expected "
                "the same elements"
            )
    with stream_of(gradient, "gradient") as stream:
        _native.stochastic_gradient(
            differences, elements, starts, pixels, channels.magnitude, _key(step), _key(seed), gradient, stream
        )


def descend(
    values: Array,
    gradient: Array,
    moments: Moments,
    channels: Channels,
    rate: float = 1.0,
    elements: Array | None = None,
    betas: tuple[float, float] = (0.9, 0.999),
    epsilon: float = 1e-20,
) -> None:
    """A step of Adam (Kingma and Ba 2015, algorithm 1) on the listed elements, within the limits of their channels.

    Args:
        values: (N, C) float32, or float64 on the CPU; changed in place.
        gradient: (N, C); set to 0 at the listed elements, for the next step.
        moments: changed in place.
        channels: the rate of each channel is `rate` times its magnitude, as in section 5 of the paper.
        elements: (K,) int32, each once; None for all.
        betas: decays of the two moments.
        epsilon: what is added to the root of the second moment. Gradients of all sizes count alike, so it is next to 0.
            The default is the size of gradients whose squares float32 no longer holds.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit, or an array that cannot be written to.
    """
    from mipbake import _native

    shape = (None, len(channels.magnitude))
    values = writable("values", values, REAL, shape)
    like = ((dtype_of(values),), tuple(values.shape), values)
    gradient = writable("gradient", gradient, *like)
    first, second = writable("moments.first", moments.first, *like), writable("moments.second", moments.second, *like)
    steps = writable("moments.steps", moments.steps, ("int32",), (values.shape[0],), values)
    _, magnitude, low, high, lifted = _parameters(values, channels)
    rates = [rate * number for number in magnitude]
    with stream_of(values, "values") as stream:
        _native.stochastic_adam(
            values, gradient, first, second, steps, _listed(elements, values), rates, low, high, lifted, *betas,
            epsilon, stream,
        )  # fmt: skip


def _parameters(values: Any, channels: Channels) -> tuple[Any, Sequence[float], Sequence[float], Sequence[float], int]:
    values = given("values", values, REAL, (None, len(channels.magnitude)))
    if values.shape[0] * values.shape[1] > MOST_PARAMETERS:
        raise UsageError(f"values has {values.shape[0]} elements: expected at most 2^32 parameters in all")
    lifted = -1 if channels.lifted is None else channels.lifted
    return values, channels.magnitude, channels.low, channels.high, lifted


def _listed(elements: Any, values: Any) -> Any:
    return None if elements is None else given("elements", elements, ("int32",), (None,), values)


def _new(values: Any) -> Any:
    return empty(values, values.shape, dtype_of(values))


def _copy(values: Any) -> Any:
    return values.copy() if is_array(values) else values.clone()


def _key(number: int) -> int:
    if not 0 <= number < 2**32:
        raise UsageError(f"a step or a seed is {number}: expected 0 to 2^32 - 1")
    return number
