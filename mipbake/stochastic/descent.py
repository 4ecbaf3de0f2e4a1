"""Several kinds of parameters at once, through any renderer: texels and vertices, splats, a pose and a lamp."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mipbake.base.arguments import REAL, dtype_of, is_array, whole, writable
from mipbake.base.errors import UsageError
from mipbake.stochastic.elements import Channels, Contributions, Moments, given, zeros

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    Array = NDArray[Any] | Tensor


@dataclass(frozen=True, eq=False)
class Group:
    """Parameters of one kind, such as the texels of a map, the vertices of a mesh, or a pose.

    Args:
        values: (N, C) float32, or float64 on the CPU; N elements with C channels each. `Descent` changes them in place.
        channels: how far each channel is perturbed, and its limits.
        rate: what the rate of a step is multiplied by for this group, 0 or more.
    """

    values: Array
    channels: Channels
    rate: float = 1.0


@dataclass(frozen=True, eq=False)
class Shown:
    """What a renderer shows of the values that it was given.

    Args:
        image: (P, C), the pixels in a row, in the dtype of the values.
        touched: for each group (P, K) int32, the elements that a pixel was made of, -1 for none, as `touched_texels`
            and `touched_vertices` list them. None, or a group that is left out: every pixel was made of all elements,
            as it is of a pose, a camera or a lamp (equation 4).
    """

    image: Array
    touched: Mapping[str, Array | None] = field(default_factory=dict)


Render = Callable[[Mapping[str, Any]], Shown]
"""From the values of each group to what is shown of them."""


class Descent:
    """Adam's steps by estimates of equation 8, for several groups of parameters at once.

    All parameters of all groups are perturbed at once, so that an estimate takes two renders whatever the groups are.
    Signs of groups are independent. Results repeat from a seed bit for bit, if the renderer's do.

    Attributes:
        groups: with the values as they stand.
        estimates: how many have been made.
        moments: of each group. Whoever puts other values in an element's place sets the element's moments to 0.
    """

    def __init__(self, groups: Mapping[str, Group], seed: int = 0) -> None:
        """Raises:
        UsageError: there is no group; values are no rows of real numbers with one number for each channel, of the
            same dtype and device in all groups; they cannot be written to; or a seed that is no whole number.
        """
        if not groups:
            raise UsageError("groups is empty: expected at least one group of parameters")
        if (number := whole(seed)) is None:
            raise UsageError(f"seed is {seed!r}: expected a whole number")
        like: tuple[str, Any] | None = None
        dtypes: tuple[str, ...] = REAL
        for name, group in groups.items():
            shape = "N", len(group.channels.magnitude)
            writable(f"group {name!r}", group.values, like, dtypes, (shape,), "a number for each channel")
            like, dtypes = like or (f"group {name!r}", group.values), (dtype_of(group.values),)
        self._like = like, dtypes
        self.groups = dict(groups)
        self.estimates = 0
        self.moments = {name: Moments.of(group.values) for name, group in groups.items()}
        # Numbers far apart, so that no group has the signs of another with a seed beside it.
        self._seeds = {name: (number + 0x9E3779B1 * place) % 2**32 for place, name in enumerate(groups)}
        self._gradients = {name: zeros(group.values, tuple(group.values.shape)) for name, group in groups.items()}
        self._sides = {name: (_copy(group.values), _copy(group.values)) for name, group in groups.items()}

    @property
    def values(self) -> dict[str, Any]:
        """The arrays of the groups, which steps change."""
        return {name: group.values for name, group in self.groups.items()}

    def step(self, views: Iterable[tuple[Render, Array]], rate: float = 1.0) -> float:
        """One step of Adam by the mean of the estimates of some views, each with its own signs (equation 9).

        Elements that no pixel showed, and their moments, stay as they are.

        Args:
            views: for each estimate what renders the values, which must not keep or change them, and (P, C) what should
                be shown.
            rate: in magnitudes of a channel: 1 as in section 5 of the paper, less towards the end.

        Returns:
            The mean squared error of the perturbed pictures, over estimates, pixels and channels.

        Raises:
            UsageError: there is no view, or what a renderer shows has another shape, dtype or device than expected, or
                is not finite.
        """
        from mipbake.stochastic import descend

        listed: dict[str, list[Any]] = {name: [] for name in self.groups}
        views = list(views)
        if not views:
            raise UsageError("views is empty: expected at least one renderer with what it should show")
        try:
            errors = [self._estimate(render, wanted, listed, len(views)) for render, wanted in views]
        except BaseException:  # so that the next step does not take part of this one
            for gradient in self._gradients.values():
                gradient[...] = 0
            raise
        for name, group in self.groups.items():
            values, gradient, moments = group.values, self._gradients[name], self.moments[name]
            elements = _union(listed[name], values)
            descend(values, gradient, moments, group.channels, rate * group.rate, elements)
        return sum(errors) / len(errors)

    def _estimate(self, render: Render, wanted: Any, listed: dict[str, list[Any]], count: int) -> float:
        """Adds one of `count` estimates; returns the mean squared error."""
        from mipbake.stochastic import add_gradient, perturb, pixel_differences

        for name, group in self.groups.items():
            perturb(group.values, group.channels, self.estimates, self._seeds[name], None, self._sides[name])
        sides = [render({name: pair[side] for name, pair in self._sides.items()}) for side in (0, 1)]
        like, _ = self._like
        plus = given("the image", sides[0].image, *self._like, (("P", "C"),))
        shape = tuple(plus.shape)
        minus = given("the second image", sides[1].image, *self._like, (shape,))
        wanted = given("what should be shown", wanted, *self._like, (shape,))
        if 0 in shape:
            raise UsageError(f"the image has shape {shape}: expected a pixel or more")
        error = float((((plus - wanted) ** 2).mean() + ((minus - wanted) ** 2).mean()) / 2)
        if not math.isfinite(error):
            raise UsageError(
                f"the mean squared error of an image is {error}: expected finite numbers in images and in what should "
                "be shown"
            )
        differences = pixel_differences(plus, minus, wanted) / count
        for name, group in self.groups.items():
            touched = [side.touched.get(name) for side in sides]
            if any(each is None for each in touched):
                own, made_of = _whole(differences, group.values)
            else:
                fits = like, ("int32",), ((shape[0], "K"),), "elements of each pixel"
                own, made_of = differences, _made_of(*(given(f"touched[{name!r}]", each, *fits) for each in touched))
            gradient, seed = self._gradients[name], self._seeds[name]
            add_gradient(gradient, own, made_of, group.channels, self.estimates, seed)
            listed[name].append(made_of.elements)
        self.estimates += 1
        return error


def _made_of(plus: Any, minus: Any) -> Contributions:
    """The pixels of each element in one of two pictures."""
    from mipbake.stochastic import contributions

    if is_array(plus):
        import numpy as np

        return contributions(np.concatenate([plus, minus], 1))
    import torch

    return contributions(torch.cat([plus, minus], 1))


def _whole(differences: Any, values: Any) -> tuple[Any, Contributions]:
    """One pixel with the differences of all, which shows all elements."""
    from mipbake.stochastic import contributions

    count = int(values.shape[0])
    if is_array(values):
        import numpy as np

        return differences.sum(keepdims=True), contributions(np.arange(count, dtype=np.int32)[None])
    import torch

    every = torch.arange(count, dtype=torch.int32, device=values.device)[None]
    return differences.sum(0, keepdim=True), contributions(every)


def _union(listed: list[Any], values: Any) -> Any:
    if is_array(values):
        import numpy as np

        return np.unique(np.concatenate(listed)).astype(np.int32)
    import torch

    return torch.unique(torch.cat(listed)).int()


def _copy(values: Any) -> Any:
    return values.copy() if is_array(values) else values.detach().clone()
