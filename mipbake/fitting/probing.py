"""What is tried before the first step: whether pictures follow the maps, and the texels that frames name."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake import stochastic
from mipbake.base.errors import RendererError
from mipbake.fitting.loop import Loop
from mipbake.fitting.prepared import Prepared
from mipbake.fitting.renderer import Array, Levels

_TRIED = 8
"""So many views are tried, spread over all of them."""

_LEAK = 0.25
"""A view is warned of where so much of what all texels change in its picture is changed by texels that its frame does
not name. Drivers round levels of detail, so that a little is no mistake."""


def probe(loop: Loop, values: Array, views: Sequence[Prepared]) -> list[str]:
    """Tries whether pictures follow the maps, in some of the views.

    Args:
        values: (texels, channels) of the stack that the fit starts from.

    Returns:
        Sentences on views that nothing, or the wrong thing, would be learned from.

    Raises:
        RendererError: no picture follows the maps, or they differ as much where the maps are the same.
    """
    tried = views[:: math.ceil(len(views) / _TRIED)]
    resting = loop.levels(values)
    none = np.array([_energy(_shown(loop, resting, view), _shown(loop, resting, view)) for view in tried])
    every, others = [], []
    for side in stochastic.perturb(values, loop.parameters.channels, 0, loop.settings.seed):
        moved = loop.levels(side)
        every.append([_shown(loop, moved, view) for view in tried])
        others.append([_without(loop, side, values, view) for view in tried])
    moves = np.array([_energy(*both) for both in zip(*every, strict=True)])
    unnamed = np.array([_energy(*both) for both in zip(*others, strict=True)])
    follow = moves > 0
    if not follow.any():
        raise RendererError(
            f"{tried[0].name}: the picture is the same when every texel is another one, and so it is in all of "
            f"{len(tried)} views that were tried: expected a renderer that looks its maps up in `levels`"
        )
    change, noise = float(moves.sum()), float(none.sum())
    if 2 * noise > change:
        raise RendererError(
            f"{tried[int(none.argmax())].name}: two renders of the same maps differ more ({math.sqrt(noise):.3g} "
            f"in {len(tried)} views) than renders of perturbed maps do ({math.sqrt(change):.3g}): expected a renderer "
            "whose picture follows from its maps alone, so turn off its noise, temporal filters and animations"
        )
    warnings = []
    if 2 * np.count_nonzero(follow) <= len(tried):
        warnings.append(
            f"of {len(tried)} views that were tried, {_some(tried, ~follow)} look the same when every texel is another "
            "one, so that nothing is learned from such views: expected views that show the maps"
        )
    leaks = follow & (unnamed - none > _LEAK * moves)
    if leaks.any():
        warnings.append(
            f"in {_some(tried, leaks)} of {len(tried)} views that were tried, the picture changes with texels "
            "that its frame does not name, so that errors are credited to the wrong ones: expected `uv` with `lod` of "
            "trilinear lookups, or with `uv_da` of anisotropic ones"
        )
    return warnings


def _shown(loop: Loop, levels: Levels, view: Prepared) -> Array:
    return loop.compared(levels, view) * view.shown[:, None]


def _without(loop: Loop, side: Array, values: Array, view: Prepared) -> Array:
    """The picture of perturbed values, with the texels that the view names as they were."""
    own = side[view.visible]
    side[view.visible] = values[view.visible]
    picture = _shown(loop, loop.levels(side), view)
    side[view.visible] = own
    return picture


def _energy(first: Array, second: Array) -> float:
    return float(np.sum(np.square(first - second, dtype=np.float64)))


def _some(views: Sequence[Prepared], which: NDArray[np.bool_]) -> str:
    """How many, and the name of the first."""
    count, first = int(which.sum()), views[int(which.argmax())].name
    return f"{count} ({first}, ...)" if count > 1 else f"{count} ({first})"
