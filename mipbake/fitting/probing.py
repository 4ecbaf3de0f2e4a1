"""What is tried before the first step: whether pictures follow the maps, and the texels that frames name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake import stochastic
from mipbake.base.errors import RendererError
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import Prepared, render_pixels
from mipbake.fitting.renderer import Array, Levels, Renderer, Stamps

_TRIED = 8
"""So many views are tried, spread over all of them."""

_LEAK = 0.25
"""A view is told of where so much of what all texels change in its picture is changed by texels that its frame does not
name. Drivers round levels of detail, so that a little is no mistake."""


@dataclass(frozen=True, eq=False)
class Trial:
    """What is tried.

    Args:
        renderer: of all pictures. parameters: how texels become maps, which `wrap` says how to repeat along u and v.
        values: (texels, channels) float32 of the stack that the fit starts from. seed: of the signs.
    """

    renderer: Renderer[Any]
    parameters: Parameters
    wrap: tuple[str, str]
    values: Array
    seed: int


@dataclass(frozen=True, eq=False)
class _Changes:
    """How far pictures of each view move, as sums of squares: (views,) each.

    Args:
        all_texels: where all texels are others. unseen: where those are that the frame does not name.
        none: where all texels are the same.
    """

    all_texels: NDArray[np.float64]
    unseen: NDArray[np.float64]
    none: NDArray[np.float64]


def probe(trial: Trial, views: Sequence[Prepared]) -> list[str]:
    """Tries whether pictures follow the maps, in some of the views.

    Returns:
        Sentences on views that nothing, or the wrong thing, would be learned from.

    Raises:
        RendererError: no picture follows the maps, or they differ as much where the maps are the same.
    """
    tried = views[:: math.ceil(len(views) / _TRIED)]
    found = _changes(trial, tried)
    follow = found.all_texels > 0
    if not follow.any():
        raise RendererError(
            f"{tried[0].name}: the picture is the same when every texel is another one, and so it is in all of "
            f"{len(tried)} views that were tried: expected a renderer that looks its maps up in `levels`"
        )
    change, noise = float(found.all_texels.sum()), float(found.none.sum())
    if 2 * noise > change:
        raise RendererError(
            f"{tried[int(found.none.argmax())].name}: two renders of the same maps differ more ({math.sqrt(noise):.3g} "
            f"in {len(tried)} views) than renders of perturbed maps do ({math.sqrt(change):.3g}): expected a renderer "
            "whose picture follows from its maps alone, so turn off its noise, temporal filters and animations"
        )
    told = []
    if 2 * np.count_nonzero(follow) <= len(tried):
        told.append(
            f"of {len(tried)} views that were tried, {_some(tried, ~follow)} look the same when every texel is another "
            "one, so that nothing is learned from such views: expected views that show the maps"
        )
    leaks = found.unseen - found.none > _LEAK * found.all_texels
    if (follow & leaks).any():
        told.append(
            f"in {_some(tried, follow & leaks)} of {len(tried)} views that were tried, the picture changes with texels "
            "that its frame does not name, so that errors are credited to the wrong ones: expected `uv` with `lod` of "
            "trilinear lookups, or with `uv_da` of anisotropic ones"
        )
    return told


def _changes(trial: Trial, views: Sequence[Prepared]) -> _Changes:
    stamps = Stamps(trial.parameters.sizes)

    def levels(texels: Array) -> Levels:
        return trial.parameters.levels(texels, trial.wrap, stamps.handed_out())

    def compared(shown: Levels, view: Prepared) -> Array:
        return view.compared(render_pixels(trial.renderer, shown, view)) * view.shown[:, None]

    def unseen(side: Array, view: Prepared) -> Array:
        """The picture with the texels that the view names as they were."""
        own = side[view.visible]
        side[view.visible] = trial.values[view.visible]
        stamps.touch(view.tiles)
        picture = compared(levels(side), view)
        side[view.visible] = own
        stamps.touch(view.tiles)
        return picture

    resting = levels(trial.values)
    none = [_energy(compared(resting, view), compared(resting, view)) for view in views]
    every, others = [], []
    for side in stochastic.perturb(trial.values, trial.parameters.channels, 0, trial.seed):
        stamps.touch_all()
        moved = levels(side)
        every.append([compared(moved, view) for view in views])
        others.append([unseen(side, view) for view in views])
    return _Changes(
        np.array([_energy(*both) for both in zip(*every, strict=True)]),
        np.array([_energy(*both) for both in zip(*others, strict=True)]),
        np.array(none),
    )


def _energy(first: Array, second: Array) -> float:
    return float(np.sum(np.square(first - second, dtype=np.float64)))


def _some(views: Sequence[Prepared], which: NDArray[np.bool_]) -> str:
    """How many, and the name of the first."""
    return f"{np.count_nonzero(which)} ({views[int(which.argmax())].name}, ...)" if which.sum() > 1 else (
        f"1 ({views[int(which.argmax())].name})"
    )  # fmt: skip
