"""What the native core does on the CPU alone, with torch's own ops: checks of the numbers in tensors, the topology."""

from __future__ import annotations

import torch
from torch import Tensor

from mipbake.base.errors import UsageError
from mipbake.raster._arguments import BITS, EXACT


def check_with_torch(
    tri: Tensor,
    vertices: int,
    pos: Tensor | None = None,
    ranges: Tensor | None = None,
    rast: Tensor | None = None,
) -> None:
    """`_forward.check_numbers` on any device, all of it, with the sentences of the native core."""
    triangles = tri.shape[0]
    outside = (tri < 0) | (tri >= vertices)
    wrong = outside.any()
    if pos is not None:
        wrong |= ~torch.isfinite(pos).all()
    if rast is not None:
        wrong |= ~_exists(rast[..., 3], triangles).all()
    if wrong.item():
        _raise_about(tri, vertices, pos, rast)
    for item, (start, count) in enumerate([] if ranges is None else ranges.tolist()):
        if start < 0 or count < 0 or start + count > triangles:
            raise UsageError(
                f"ranges[{item}] is ({start}, {count}): "
                f"expected a start and a count within the {triangles} triangles of tri"
            )


def _raise_about(tri: Tensor, vertices: int, pos: Tensor | None, rast: Tensor | None) -> None:
    if at := _first(((tri < 0) | (tri >= vertices)).any(1)):
        indices = tuple(tri[at].tolist())
        fits = f"vertex indices from 0 to {vertices - 1}" if vertices else "no triangles, because there are no vertices"
        raise UsageError(f"tri[{_listed(at)}] is {indices}: expected {fits}")
    if pos is not None and (at := _first(~torch.isfinite(pos).all(-1))):
        values = ", ".join(map(str, pos[at].tolist()))
        raise UsageError(f"pos[{_listed(at)}] is ({values}): expected finite numbers")
    if rast is not None and (at := _first(~_exists(rast[..., 3], tri.shape[0]))):
        value = rast[at][3].item()
        lowest = "" if value > 0 else "0 where it is empty, or an index + 1 of "
        raise UsageError(
            f"rast[{_listed(at)}] has triangle_id {value:.9g}: "
            f"expected {lowest}at most {tri.shape[0]}, the number of triangles"
        )


def _exists(ids: Tensor, triangles: int) -> Tensor:
    last = torch.tensor(triangles, dtype=ids.dtype, device=ids.device)
    if ids.dtype == torch.float32 and triangles > EXACT:
        last = torch.tensor(BITS + triangles, dtype=torch.int32, device=ids.device).view(torch.float32)
    return (ids >= 0) & (ids <= last)  # NaN does not


def _first(where: Tensor) -> tuple[int, ...]:
    """The index of the first that is true, or nothing."""
    return tuple(next(iter(torch.nonzero(where).tolist()), ()))


def _listed(at: tuple[int, ...]) -> str:
    return ", ".join(map(str, at))


def cycles(tri: Tensor, vertices: int) -> Tensor:
    """The topology by sorting the edges, the lower vertex first."""
    ends = torch.stack([tri, tri.roll(-1, 1)], -1).long().view(-1, 2)
    keys, order = torch.sort(ends.amin(1) * vertices + ends.amax(1), stable=True)
    begins = torch.ones_like(keys, dtype=torch.bool)
    begins[1:] = keys[1:] != keys[:-1]
    position = torch.arange(len(keys), device=tri.device)
    first = torch.cummax(torch.where(begins, position, 0), 0).values
    after = torch.where(begins.roll(-1), first, position + 1)  # the last of a group is followed by its first
    following = torch.empty_like(order)
    following[order] = order[after]
    return following.to(torch.int32).view(tri.shape)
