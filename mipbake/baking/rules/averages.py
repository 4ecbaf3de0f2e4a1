"""What the closed forms share: how much unit normals spread, functions of roughness tensors, the way in and out.

The formulas of toksvig.py, vmf.py, godot.py, filament.py and unreal.py turn the length r of an average of unit normals
and the roughness of a level into a wider roughness. They know one alpha^2. Where a material is anisotropic, they treat
the two eigenvalues of its roughness tensor S alike: spread normals widen both axes by the same rule.

1 - r^2 is the variance of the normals, mean |n|^2 - |mean n|^2, and that is how it is computed, about a normal near all
of them. Subtracting r from 1 would leave glossy materials nothing but rounding: alpha^2 goes down to 4e-6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mipbake import material
from mipbake.baking.rules.bands import Array, Image
from mipbake.baking.rules.closed_form import ClosedForm
from mipbake.baking.rules.form import Blur, Form, Part, Texels, Whole, stored_part
from mipbake.material import Kind

_MIN_LENGTH = 1e-3
"""Shortest average of unit normals: opposite normals cancel, and the formulas divide by the length."""


class Averages(NamedTuple):
    """What a RoughnessRule averages of a texel: channels of one image, by their names."""

    colours: Array
    """(..., A) the `averaged` channels of the target."""
    normals: Array
    """(..., 4 or 5) the channels of NormalMoments."""
    alpha2: Array
    """(..., 1 or 3) the tensor of the quantity that stands for alpha^2."""


class NormalMoments(NamedTuple):
    """Moments of unit normals about their centre, by their names: each times the weight of the normal."""

    mean: Array
    """(..., 3) of the difference from the centre."""
    square: Array
    """(..., 1) of its squared length."""
    weight: Array
    """(..., 1) the weight itself; (..., 0) for equal weights."""


@dataclass(frozen=True)
class RoughnessRule(ClosedForm):
    """A method that widens roughness by how much unit normals spread, the same in all directions.

    Reflectances are averaged in the target's channels, normals as unit vectors (their mean is the new normal).
    Functions take and return arrays of one shape, element by element.

    Args:
        name: what users call it.
        summary: one line for help texts.
        averaged: the quantity that stands for alpha^2 in the averages.
        restored: its inverse: alpha^2 of an average.
        widened: alpha^2 of a level and 1 - r^2 of its normals to the new alpha^2; 1 - r^2 runs from 0 to 1. What it
            returns is cut at alpha = 1, or at the level's own alpha where that is beyond.
        weight: the weight of a normal in the average, from its alpha^2; None for equal weights.
        top_blur: width in texels of the box that normals are averaged with at level 0, for the roughness alone, where
            the averaging kernel is `box`, which leaves level 0 as it is; 1 for none.
    """

    name: str
    summary: str
    averaged: Callable[[Array], Array]
    restored: Callable[[Array], Array]
    widened: Callable[[Array, Array], Array]
    weight: Callable[[Array], Array] | None = None
    top_blur: float = 1.0

    def form(self, whole: Whole, target: str) -> Form:
        """See ClosedForm."""
        source, centre = whole.model, whole.centre
        given, wanted = material.model_named(source), material.model_named(target)
        # Round lobes stay one number; other distributions have another alpha for the same lobe.
        isotropic = not given.anisotropic and given.lobe is wanted.lobe

        def alpha2(texels: Texels) -> Array:
            if isotropic:
                return texels.once("own alpha2", lambda: given.roughness_tensor(texels.stored))
            own = texels.converted(source, target)
            return texels.once(("alpha2", target), lambda: wanted.roughness_tensor(own))

        def spread(texels: Texels) -> Array:
            return texels.once("spread", lambda: texels.normals(source) - centre)

        def normals(texels: Texels) -> Array:
            off = spread(texels)
            moments = NormalMoments(off, np.square(off).sum(-1, keepdims=True), off[..., :0])
            if self.weight is not None:
                weight = material.mean_eigenvalue(of_eigenvalues(alpha2(texels), self.weight))
                moments = NormalMoments(weight * moments.mean, weight * moments.square, weight)
            return np.concatenate(moments, -1)

        def averaged(texels: Texels) -> Array:
            return of_eigenvalues(alpha2(texels), self.averaged)

        colours, moments = len(wanted.averaged), 4 if self.weight is None else 5

        def write(channels: Array, blurred: Array | None) -> Array:
            averages = Averages(*split(channels, colours, moments))
            mean, variance = self._spread(averages.normals)
            if blurred is not None:
                variance = self._spread(blurred)[1]
            alpha2 = of_eigenvalues(averages.alpha2, lambda value: self._level(value, variance))
            return stored_channels(averages.colours, mean + centre, alpha2, target)

        of = None if isotropic else target  # the model whose alpha^2 it is
        size = 1 if isotropic or not wanted.anisotropic else 3
        parts = [
            stored_part(source, target, wanted.averaged),
            Part(("normals", self.weight, of if self.weight else None), normals, range(moments)),
            Part(("averaged", self.averaged, of), averaged, range(size)),
        ]
        blur = None if self.top_blur == 1.0 else Blur(self.top_blur, range(colours, colours + moments))
        return Form(parts, write, blur)

    def _spread(self, normals: Array) -> tuple[Array, Array]:
        """(..., 3) mean of the normals about their centre, and (...) 1 - r^2, from averaged NormalMoments."""
        mean, square, weight = NormalMoments(*split(normals, 3, 1))
        if self.weight is not None:
            weight = np.maximum(weight, _MIN_LENGTH)
            mean, square = mean / weight, square / weight
        # Kernels with negative lobes average to variances outside the range.
        return mean, np.clip(square[..., 0] - np.square(mean).sum(-1), 0, 1)

    def _level(self, averaged: Array, variance: Array) -> Array:
        alpha2 = self.restored(averaged)
        return np.minimum(self.widened(alpha2, variance), np.maximum(alpha2, 1))


def split(channels: Array, *widths: int) -> list[Array]:
    """(..., C) as views of so many channels each, and of the channels that are left."""
    return np.split(channels, np.cumsum(widths), -1)


def length(variance: Array) -> Array:
    """r = |mean unit normal| from 1 - r^2, any shape; at least 0.001."""
    return np.asarray(np.sqrt(np.maximum(1 - variance, _MIN_LENGTH**2)))


def perceptual(alpha2: Array) -> Array:
    """Perceptual roughness of alpha^2, any shape: what engines and textures store."""
    return np.asarray(np.sqrt(np.sqrt(alpha2)))


def inverse_kappa(variance: Array) -> Array:
    """1 / kappa = (1 - r^2) / (3 r - r^3) from 1 - r^2: the concentration of a von Mises-Fisher distribution.

    Banerjee, Dhillon, Ghosh and Sra 2005, "Clustering on the unit hypersphere using von Mises-Fisher distributions",
    equation 4.4 in three dimensions. 0 where all normals agree.
    """
    r = length(variance)
    return variance / (r * (3 - r * r))


def of_eigenvalues(tensor: Array, function: Callable[[Array], Array]) -> Array:
    """A function of a symmetric tensor: of its eigenvalues, in its own axes.

    Args:
        tensor: (..., 3) T11, T22, T12, eigenvalues not below 0; or (..., 1), a multiple of the identity.
        function: called with arrays of shape (...).
    """
    if tensor.shape[-1] == 1:
        return np.asarray(function(tensor[..., 0])[..., None])
    t11, t22, t12 = np.moveaxis(tensor, -1, 0)
    mean, d = (t11 + t22) / 2, (t11 - t22) / 2
    radius = np.hypot(d, t12)
    tiny = np.finfo(tensor.dtype).tiny
    high = np.maximum(mean + radius, 0)
    # det / high, not mean - radius: no cancellation where one axis is much narrower than the other.
    low = np.clip((t11 * t22 - t12 * t12) / np.maximum(high, tiny), 0, high)
    at_high, at_low = function(high), function(low)
    centre, slope = (at_high + at_low) / 2, (at_high - at_low) / 2 / np.maximum(radius, tiny)
    return np.stack([centre + slope * d, centre - slope * d, slope * t12], -1)


def stored_channels(colours: Array, normal: Array, tensor: Array, target: str) -> Image:
    """(..., C) stored channels of a model from what a closed form found.

    Args:
        colours: (..., A) the `averaged` channels of the model.
        normal: (..., 3), any length.
        tensor: (..., 3) or (..., 1) roughness tensor S; an isotropic model takes its mean eigenvalue.
    """
    layout = material.model_named(target)
    normal = material.with_unit_length(normal)
    made = {Kind.NORMAL: normal, Kind.NORMAL_XY: normal[..., 0:2], **layout.of_tensor(tensor)}
    channels, start = [], 0
    for each in layout.stored:
        if each.facts.averaged:
            channels.append(colours[..., start : start + each.facts.channels])
            start += each.facts.channels
        else:
            channels.append(made[each.kind])
    return material.regularise(np.concatenate(channels, -1).astype(np.float32), target)
