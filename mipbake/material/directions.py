"""Signs of anisotropy directions: a direction d and its opposite shade alike, but lookups average what is stored.

Directions are a field of lines. Texels store them as vectors, lookups average the vectors of neighbours and of two
levels, and shading makes the average a unit vector. Where two of opposite signs are averaged, the result turns through
every direction on its way from one to the other. So a stack needs signs with which neighbours agree, and so do levels.

Where a lobe turns around a point by half a turn, as the lines of a fingerprint do, no signs agree everywhere: a cut is
left. Texels along it keep as much of their anisotropy as the lookups around them point the right way.

All of it is without gradients: training applies the same signs and shares to its own levels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.material import MIN_ROUGHNESS, Array, Lines, model_named

TOGETHER = 1 << 18
"""Texels of the finest level whose signs are found together; finer levels follow what they lie over."""

_LEAST = 1e-3  # strength that counts where there is none: signs are to agree there as well
# What a texel of the next level counts beside a neighbour: a texel has two of these to either side.
_BETWEEN = 2.0

_AXIS = np.array([[max(-p, 0), 1 - abs(p), max(p, 0)] for p in (-0.25, 0.25)], np.float32)
_LOOKUPS = np.kron(_AXIS, _AXIS)
"""(4, 9) weights of a texel and its eight neighbours in four lookups, evenly spread over the square around it."""

# Cosines of neighbours, both guesses. Lookups between neighbours that are nearly at right angles lose nothing by their
# signs, and neighbours that lie close together nobody would give other signs.
_CUT, _CLEAR = -0.2, 0.5
_AT_ONCE = 1 << 15  # texels, whose temporaries stay in the cache

Wrap = tuple[str, str]
"""Addressing along u and along v, each "wrap" or "clamp"."""


def agreeing(levels: list[NDArray[np.float32]], model: str, wrap: Wrap) -> list[NDArray[np.float32]]:
    """Levels as they are stored: of a model that stores directions `aligned` and `eased`, of other models as they are.

    Args:
        levels: (H_L, W_L, C) stored channels, finest first.
        wrap: addressing along u and v.
    """
    return eased(aligned(levels, model, wrap), model, wrap)


def aligned(levels: list[NDArray[np.float32]], model: str, wrap: Wrap) -> list[NDArray[np.float32]]:
    """Levels whose directions have the signs of `signs`; levels of a model that stores none stay as they are."""
    lines = model_named(model).lines
    if lines is None:
        return levels
    out = []
    for level, sign in zip(levels, signs([level[..., lines.channels] for level in levels], wrap), strict=True):
        made = level.copy()
        made[..., lines.direction] *= sign[..., None]
        out.append(made)
    return out


def eased(levels: list[NDArray[np.float32]], model: str, wrap: Wrap) -> list[NDArray[np.float32]]:
    """Levels with less anisotropy along cuts, where lookups turn away from what is stored.

    The logarithm of the ratio of both alphas is multiplied by `shares`, their product stays: a lobe that points all
    ways in turn becomes a round one of the same height. Texels off the cuts stay bit for bit, and so do levels of a
    model that stores no directions.
    """
    lines = model_named(model).lines
    if lines is None:
        return levels
    found = shares([level[..., lines.direction] for level in levels], wrap)
    return [_with_less(level, share, lines) for level, share in zip(levels, found, strict=True)]


def _with_less(level: NDArray[np.float32], share: NDArray[np.float32], lines: Lines) -> NDArray[np.float32]:
    """A level with that share of the anisotropy of each texel."""
    less = share < 1
    if not less.any():
        return level
    texels = level[less]
    roughness, strength = texels[:, lines.roughness], texels[:, lines.strength]
    across = np.square(np.maximum(roughness, MIN_ROUGHNESS))
    along = across + (1 - across) * np.square(strength)
    middle, half = np.log(along * across) / 2, np.log(along / across) / 2 * share[less][:, None]
    across, along = np.exp(middle - half), np.exp(middle + half)
    texels[:, lines.roughness] = np.maximum(np.sqrt(across), roughness)
    texels[:, lines.strength] = np.sqrt(np.clip((along - across) / np.maximum(1 - across, 1e-6), 0, 1))
    out = np.array(level, np.float32)
    out[less] = texels
    return out


def signs(levels: Sequence[Array], wrap: Wrap, together: int = TOGETHER) -> list[NDArray[np.float32]]:
    """1 or -1 for every direction, so that neighbours and levels agree wherever the field of lines allows.

    Every texel is tied to its neighbours and to the texel under it in the next coarser level, the more the stronger
    and the more parallel they are. Those with the strongest ties take one sign, together they are tied by the sum of
    their ties, and so on (Boruvka's tree with votes): a field that can be a field of vectors becomes one, and a cut
    goes where ties are weak. Levels of more than `together` texels take the sign of what the next coarser level has at
    the texel's centre, interpolated bilinearly.

    The result does not depend on the signs of what is given, except for one common sign, which most of level 0 has.

    Args:
        levels: (..., H_L, W_L, 3) direction x, y and strength, finest first; leading axes are images of their own.
        wrap: addressing along u and v.
        together: texels of the finest level whose signs are found together.

    Returns:
        (..., H_L, W_L) of each level.
    """
    lead = levels[0].shape[:-3]
    images = [np.asarray(level, np.float32).reshape(-1, *level.shape[-3:]) for level in levels]
    sides = [image.shape[1] * image.shape[2] for image in images]
    first = next((i for i, texels in enumerate(sides) if texels <= together), len(images) - 1)
    out = _tied(images[first:], wrap)
    for level in range(first - 1, -1, -1):
        out.insert(0, _following(images[level], images[level + 1] * out[0][..., None], wrap))
    common = ((images[0][..., 2] + _LEAST) * out[0]).sum((1, 2), dtype=np.float64)
    common = np.where(common < 0, -1, 1).astype(np.float32)[:, None, None]
    return [(sign * common).reshape(*lead, *sign.shape[1:]) for sign in out]


def untangled(lines: NDArray[np.float32], wrap: Wrap) -> NDArray[np.float32]:
    """(H, W, 3) direction and strength of level 0, of signs that agree; as it is where neighbours agree as it is.

    The signs of a source come from the tool that drew it. What is interpolated between its texels depends on them, and
    so does everything that is measured against it: this makes them one, whatever they were.
    """
    image = lines[None]
    if not _cut(image, wrap, _CLEAR).any():
        return lines
    levels = [image]
    while max(levels[-1].shape[1:3]) > 1:
        levels.append(_halved(levels[-1]))
    out = np.array(lines, np.float32)
    out[..., :2] *= signs([level[0] for level in levels], wrap)[0][..., None]
    return out


def facing(directions: NDArray[np.floating], guide: NDArray[np.floating]) -> NDArray[np.int8]:
    """(...) signs, 1 or -1, with which (..., 2) directions make no obtuse angle with the guide's (..., 2)."""
    return np.where(np.einsum("...c,...c->...", guide, directions) < 0, -1, 1).astype(np.int8)


def led(levels: list[NDArray[np.float32]], model: str) -> list[NDArray[np.float32]]:
    """Levels whose level 0 comes from elsewhere and stays: coarser levels take the signs of finer ones.

    Each direction has the sign of the mean of the directions that lie over it in the next finer level. Levels of a
    model that stores no directions stay as they are.
    """
    lines = model_named(model).lines
    if lines is None:
        return levels
    out = [levels[0]]
    for level in levels[1:]:
        over = out[-1][..., lines.direction] * (out[-1][..., lines.strength] + np.float32(_LEAST))
        for axis in (0, 1):
            over = _mean_of_two(over, axis)
        made = level.copy()
        made[..., lines.direction] *= facing(made[..., lines.direction], over)[..., None]
        out.append(made)
    return out


def shares(levels: Sequence[Array], wrap: Wrap) -> list[NDArray[np.float32]]:
    """The share of each texel's anisotropy that is kept, (..., H_L, W_L) from 0 to 1; 1 off the cuts.

    Lookups in the square around a texel see the stored vectors, interpolated; the lines themselves, interpolated as
    vectors of twice their angle, are what they should see. The product of the two, each of twice its angle, is what a
    lookup gets of the anisotropy that it should see. The share is its sum over lookups, in units of what it would be
    if all neighbours had the texel's own sign; at least 0.

    Args:
        levels: (..., H_L, W_L, 2) unit directions that have their signs. wrap: addressing along u and v.
    """
    out = []
    for level in levels:
        images = np.asarray(level, np.float32).reshape(-1, *level.shape[-3:])
        share = np.ones(images.shape[:3], np.float32)
        found = np.nonzero(_cut(images, wrap))
        for start in range(0, len(found[0]), _AT_ONCE):
            place = tuple(index[start : start + _AT_ONCE] for index in found)
            share[place] = _agreement(images, place, wrap)
        out.append(share.reshape(level.shape[:-1]))
    return out


def _following(fine: NDArray[np.float32], coarse: NDArray[np.float32], wrap: Wrap) -> NDArray[np.int8]:
    """(N, H, W) signs of fine texels that agree with a coarser level, interpolated at their centres."""
    guide = coarse[..., :2]
    for axis in (1, 2):
        guide = _interpolated(guide, axis, fine.shape[axis], wrap[2 - axis])
    return facing(fine[..., :2], guide)


def _halved(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, H, W, 3) directions and strengths at half the size: means of vectors of twice the angle."""
    double = _doubled(image[..., :2]) * image[..., 2:]
    for axis in (1, 2):
        double = _mean_of_two(double, axis)
    x, y = double[..., 0], double[..., 1]
    angle = np.arctan2(y, x) / 2
    return np.asarray(np.stack([np.cos(angle), np.sin(angle), np.hypot(x, y)], -1), np.float32)


def _mean_of_two(image: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Means of every two texels along an axis, without the last of an odd number; one texel stays as it is."""
    size = image.shape[axis]
    if size == 1:
        return image
    even, odd = (np.take(image, np.arange(i, size - size % 2, 2), axis) for i in (0, 1))
    return np.asarray((even + odd) / 2, np.float32)


def _cut(images: NDArray[np.float32], wrap: Wrap, cosine: float = _CUT) -> NDArray[np.bool_]:
    """(N, H, W) whether one of the four neighbours of a texel has the opposite sign."""
    out, images = np.zeros(images.shape[:3], np.bool_), images[..., :2]
    for one, other in _neighbours(images.shape, wrap):
        against = np.einsum("nhwc,nhwc->nhw", images[one], images[other]) < cosine
        if against.any():
            out[one] |= against
            out[other] |= against
    return out


_Window = tuple[slice, slice, slice]


def _neighbours(shape: Sequence[int], wrap: Wrap) -> list[tuple[_Window, _Window]]:
    """Parts of (N, H, W) images that lie beside each other: texels, and those to the right of them or below."""

    def part(axis: int, first: int, last: int) -> _Window:
        rows, columns = (slice(first, last) if a == axis else slice(None) for a in (1, 2))
        return slice(None), rows, columns

    out = []
    for axis in (1, 2):
        size = shape[axis]
        if size > 1:
            out.append((part(axis, 0, size - 1), part(axis, 1, size)))
        if size > 2 and wrap[2 - axis] == "wrap":
            out.append((part(axis, size - 1, size), part(axis, 0, 1)))
    return out


def _agreement(images: NDArray[np.float32], place: Sequence[NDArray[Any]], wrap: Wrap) -> NDArray[np.float32]:
    """(M,) share of the anisotropy of texels that lookups around them leave."""
    image, rows, columns = place[0], place[1], place[2]
    height, width = images.shape[1:3]
    near = np.empty((9, len(rows), 2), np.float32)
    for index, (dy, dx) in enumerate((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)):
        y, x = (
            at % size if mode == "wrap" else np.clip(at, 0, size - 1)
            for at, size, mode in ((rows + dy, height, wrap[1]), (columns + dx, width, wrap[0]))
        )
        near[index] = images[image, y, x]
    own = near[4]
    agreeing = near * facing(near, own)[..., None]
    meant = _four_lookups(_doubled(near))

    def agreement(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        seen = _doubled(_four_lookups(vectors))
        length = np.maximum(np.linalg.norm(seen, axis=-1), np.float32(1e-9))
        return np.asarray((np.einsum("imc,imc->im", seen, meant) / length).sum(0), np.float32)

    best = agreement(agreeing)
    return np.where(best > 1e-3, np.clip(agreement(near) / np.maximum(best, 1e-3), 0, 1), 1).astype(np.float32)


def _doubled(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(..., 2) of twice the angle and the square of the length, the same for d and -d."""
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([x * x - y * y, 2 * x * y], -1)


def _four_lookups(near: NDArray[np.float32]) -> NDArray[np.float32]:
    """(4, M, 2) lookups from a texel and its neighbours."""
    return np.asarray((_LOOKUPS @ near.reshape(9, -1)).reshape(4, *near.shape[1:]), np.float32)


def _interpolated(image: NDArray[np.float32], axis: int, size: int, mode: str) -> NDArray[np.float32]:
    """A coarser image at the centres of `size` texels along an axis."""
    count = image.shape[axis]
    at = (np.arange(size) + 0.5) * count / size - 0.5
    low = np.floor(at).astype(np.intp)
    weight = (at - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(image.ndim)])
    first, second = (i % count if mode == "wrap" else np.clip(i, 0, count - 1) for i in (low, low + 1))
    near, far = np.take(image, first, axis), np.take(image, second, axis)
    return np.asarray(near + weight * (far - near), np.float32)


def _tied(images: Sequence[NDArray[np.float32]], wrap: Wrap) -> list[NDArray[np.int8]]:
    """(N, H, W) signs of levels that are found together."""
    starts = np.cumsum([0, *(image[..., 0].size for image in images)])
    number = [np.arange(a, b).reshape(i.shape[:3]) for a, b, i in zip(starts, starts[1:], images, strict=False)]
    vectors = [image[..., :2] * (image[..., 2:] + np.float32(_LEAST)) for image in images]
    first, second, weight = [], [], []

    def tie(a: NDArray[Any], b: NDArray[Any], v: Array, w: Array, factor: float) -> None:
        first.append(a.ravel())
        second.append(b.ravel())
        weight.append(factor * np.einsum("...c,...c->...", v, w).ravel().astype(np.float64))

    for level, (own, v) in enumerate(zip(number, vectors, strict=True)):
        for one, other in _neighbours(own.shape, wrap):
            tie(own[one], own[other], v[one], v[other], 1.0)
        if level + 1 < len(images):
            under, vector = number[level + 1], vectors[level + 1]
            for axis in (1, 2):
                texels = int(own.shape[axis])
                index = ((np.arange(texels) + 0.5) * int(under.shape[axis]) / texels).astype(np.intp)
                under, vector = np.take(under, index, axis), np.take(vector, index, axis)
            tie(own, under, v, vector, _BETWEEN)
    if not weight:
        return [np.ones(n.shape, np.int8) for n in number]
    sign = _agreeing(int(starts[-1]), np.concatenate(first), np.concatenate(second), np.concatenate(weight))
    return [sign[n] for n in number]


def _agreeing(count: int, a: NDArray[np.int64], b: NDArray[np.int64], weight: NDArray[np.float64]) -> NDArray[np.int8]:
    """(count,) signs of nodes tied by edges (a, b): of positive weight where they should be the same.

    Every group of nodes joins the one that it has the strongest tie with, all at once, until none is left to join.
    """
    group, sign = np.arange(count), np.ones(count, np.int8)
    while len(a):
        rank = np.empty(len(a), np.int64)
        rank[np.argsort(np.abs(weight), kind="stable")] = np.arange(1, len(a) + 1)
        best = np.zeros(count, np.int64)
        np.maximum.at(best, a, rank)
        np.maximum.at(best, b, rank)
        by_rank = np.empty(len(a) + 1, np.int64)
        by_rank[rank] = np.arange(len(a))
        node = np.nonzero(best)[0]
        edge = by_rank[best[node]]
        to, turn = np.arange(count), np.ones(count, np.int8)
        to[node] = np.where(a[edge] == node, b[edge], a[edge])
        turn[node] = np.where(weight[edge] < 0, -1, 1)
        # The strongest tie of two groups that merge belongs to both: the lower group stays.
        stays = (to[to] == np.arange(count)) & (np.arange(count) <= to)
        to[stays], turn[stays] = np.nonzero(stays)[0], 1
        while True:
            further = to[to]
            if np.array_equal(further, to):
                break
            turn = turn * turn[to]
            to = further
        sign, group = sign * turn[group], to[group]
        weight, a, b = weight * turn[a] * turn[b], to[a], to[b]
        apart = a != b
        a, b, weight = a[apart], b[apart], weight[apart]
        if not len(a):
            break
        # Ties between the same two groups are one, the sum of all.
        both = np.minimum(a, b) * count + np.maximum(a, b)
        order = np.argsort(both, kind="stable")
        both, weight = both[order], weight[order]
        start = np.nonzero(np.append(True, both[1:] != both[:-1]))[0]
        weight, both = np.add.reduceat(weight, start), both[start]
        a, b = both // count, both % count
    return sign
