"""Stochastic gradients per pixel: what a renderer that only renders says about its parameters.

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

`Descent` does this for several kinds of parameters at once, from a function that renders them. `Subdivision` refines
control meshes, and says which control vertices a triangle was made of.

Functions take NumPy arrays, or torch tensors on the CPU or with CUDA, and no gradients flow through them. Results are
the same bits whatever the number of threads. Work is in proportion to what the listed elements and pixels are, and does
not grow with elements that no pixel shows. The plain twins are in `mipbake.stochastic.reference`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from mipbake.base.arguments import REAL, device_of, dtype_of, empty, is_array, whole, writable
from mipbake.base.errors import UsageError
from mipbake.base.stream import current_stream
from mipbake.stochastic.descent import Descent, Group, Shown
from mipbake.stochastic.elements import ANY, Channels, Contributions, Moments, given
from mipbake.stochastic.subdivision import Subdivision
from mipbake.stochastic.touching import contributions, touched_texels, touched_vertices

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    Array = TypeVar("Array", NDArray[Any], Tensor)

__all__ = [
    "Channels",
    "Contributions",
    "Descent",
    "Group",
    "Moments",
    "Shown",
    "Subdivision",
    "add_gradient",
    "contributions",
    "descend",
    "perturb",
    "pixel_differences",
    "touched_texels",
    "touched_vertices",
]

MOST_PARAMETERS = 2**32
"""What signs can number."""


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
    the limits, and their difference is 2 epsilon. Normals are an exception: x and y that leave the disc of unit normals
    are brought back to its edge, so that their difference is smaller there.

    Args:
        values: (N, C) float32, or float64 on the CPU.
        step, seed: which signs; 0 to 2^32 - 1.
        elements: (K,) int32, which are perturbed, each once; None for all. On a GPU nobody checks the numbers.
        out: two arrays like values, which are written where elements are listed, and returned.

    Returns:
        Two arrays like values. Without `out`, elements that are not listed are as in values.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit, or an element that does not exist.
    """
    from mipbake import _native

    values, magnitude, low, high, lifted = _parameters(values, channels)
    elements = _listed(elements, values)
    if out is None:
        out = (_copy(values), _copy(values))
    like = ("values", values), (dtype_of(values),), (tuple(values.shape),)
    plus, minus = (writable(f"out[{i}]", each, *like) for i, each in enumerate(out))
    with current_stream(values, "values") as stream:
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

    plus = given("plus", plus, None, REAL, (("P", "C"),))
    like, dtype, shape = ("plus", plus), (dtype_of(plus),), tuple(plus.shape)
    minus, reference = (given(n, v, like, dtype, (shape,)) for n, v in (("minus", minus), ("reference", reference)))
    weights = None if weights is None else given("weights", weights, like, dtype, (shape[:1],))
    out: Array = empty(plus, shape[:1])
    with current_stream(plus, "plus") as stream:
        _native.stochastic_differences(plus, minus, reference, weights, out, stream)
    return out


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

    gradient = writable("gradient", gradient, None, REAL, (("N", len(channels.magnitude)),))
    like = ("gradient", gradient)
    differences = given("differences", differences, like, (dtype_of(gradient),), (("P",),))
    elements = given("made_of.elements", made_of.elements, like, ("int32",), ANY)
    starts = given("made_of.starts", made_of.starts, like, ("int64",), ((elements.shape[0] + 1,),))
    pixels = given("made_of.pixels", made_of.pixels, like, ("int32",), ANY)
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
    with current_stream(gradient, "gradient") as stream:
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
        elements: (K,) int32, each once; None for all. On a GPU nobody checks the numbers.
        betas: decays of the two moments, each from 0 to less than 1.
        epsilon: what is added to the root of the second moment, above 0. Gradients of all sizes count alike, so it is
            next to 0. The default is the size of gradients whose squares float32 no longer holds.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit, an array that cannot be written to, an
            element that does not exist, or a rate, betas or an epsilon outside of their range.
    """
    from mipbake import _native

    if not 0 <= rate < math.inf:
        raise UsageError(f"rate is {rate}: expected a finite number, 0 or more")
    if len(betas) != 2 or not all(0 <= beta < 1 for beta in betas):
        raise UsageError(f"betas is {betas}: expected two numbers from 0 to less than 1")
    if not 0 < epsilon < math.inf:
        raise UsageError(f"epsilon is {epsilon}: expected a finite number above 0")
    values = writable("values", values, None, REAL, (("N", len(channels.magnitude)),))
    like = ("values", values), (dtype_of(values),), (tuple(values.shape),)
    gradient = writable("gradient", gradient, *like)
    first, second = writable("moments.first", moments.first, *like), writable("moments.second", moments.second, *like)
    steps = writable("moments.steps", moments.steps, like[0], ("int32",), ((values.shape[0],),))
    _, magnitude, low, high, lifted = _parameters(values, channels)
    rates = [rate * number for number in magnitude]
    with current_stream(values, "values") as stream:
        _native.stochastic_adam(
            values, gradient, first, second, steps, _listed(elements, values), rates, low, high, lifted, *betas,
            epsilon, stream,
        )  # fmt: skip


def _parameters(values: Any, channels: Channels) -> tuple[Any, Sequence[float], Sequence[float], Sequence[float], int]:
    values = given("values", values, None, REAL, (("N", len(channels.magnitude)),))
    if values.shape[0] * values.shape[1] > MOST_PARAMETERS:
        raise UsageError(f"values has {values.shape[0]} elements: expected at most 2^32 parameters in all")
    lifted = -1 if channels.lifted is None else channels.lifted
    return values, channels.magnitude, channels.low, channels.high, lifted


def _listed(elements: Any, values: Any) -> Any:
    if elements is None:
        return None
    elements = given("elements", elements, ("values", values), ("int32",), ANY)
    if device_of(elements) == "cpu" and elements.shape[0]:
        least, most = int(elements.min()), int(elements.max())
        if least < 0 or most >= values.shape[0]:
            raise UsageError(f"elements reach from {least} to {most}: expected 0 to {values.shape[0] - 1}")
    return elements


def _copy(values: Any) -> Any:
    return values.copy() if is_array(values) else values.clone()


def _key(number: int) -> int:
    found = whole(number)
    if found is None or not 0 <= found < 2**32:
        raise UsageError(f"a step or a seed is {number}: expected 0 to 2^32 - 1")
    return found
