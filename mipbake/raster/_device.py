"""Checks of the numbers in tensors, and the topology: by the native core on the CPU, with torch's own ops elsewhere.

Where torch does it, each check waits for the device once.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mipbake.errors import UsageError

__all__ = ["check_ids", "check_mesh", "check_triangles", "topology"]


def check_mesh(pos: Tensor, tri: Tensor, ranges: Tensor | None) -> None:
    """Finite positions, vertex indices below their number, ranges within the triangles."""
    from mipbake import _native

    vertices = pos.shape[-2]
    if not pos.is_cuda:
        _native.check_mesh(pos, tri, vertices, ranges)
        return
    if ranges is not None:
        _check_ranges(ranges, tri.shape[0])
    wrong = _outside(tri, 0, vertices - 1).any() | ~torch.isfinite(pos).all()
    if wrong.item():
        _raise_about_indices(tri, vertices)
        at = tuple(torch.nonzero(~torch.isfinite(pos).all(-1))[0].tolist())
        values = ", ".join(str(value) for value in pos[at].tolist())
        raise UsageError(f"pos[{_listed(at)}] is ({values}): expected finite numbers")


def check_triangles(tri: Tensor, vertices: int) -> None:
    """Vertex indices below the number of vertices."""
    from mipbake import _native

    if not tri.is_cuda:
        _native.check_mesh(None, tri, vertices, None)
    elif _outside(tri, 0, vertices - 1).any().item():
        _raise_about_indices(tri, vertices)


def check_ids(rast: Tensor, tri: Tensor) -> None:
    """Triangle ids from 0 to the number of triangles. The CPU kernels check it as they read them."""
    if not rast.is_cuda:
        return
    ids = rast[..., 3]
    wrong = ~((ids >= 0) & (ids <= tri.shape[0]))  # NaN is wrong too
    if wrong.any().item():
        at = tuple(torch.nonzero(wrong)[0].tolist())
        raise UsageError(
            f"rast[{_listed(at)}] has triangle_id {ids[at].item():g}: "
            f"expected at most {tri.shape[0]}, the number of triangles"
        )


def topology(tri: Tensor, vertices: int | None) -> Tensor:
    """(T, 3) int32: of each triangle edge the next one, 3 t + e, on the same two vertices, in a cycle."""
    from mipbake import _native

    if vertices is None:
        vertices = int(tri.max()) + 1 if tri.numel() else 0
    check_triangles(tri, vertices)
    following = torch.empty_like(tri)
    if tri.numel() == 0:
        return following
    if tri.is_cuda:
        return cycles(tri, vertices)
    _native.antialias_topology(tri, vertices, following)
    return following


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


def _outside(indices: Tensor, low: int, high: int) -> Tensor:
    return (indices < low) | (indices > high)


def _raise_about_indices(tri: Tensor, vertices: int) -> None:
    wrong = torch.nonzero(_outside(tri, 0, vertices - 1).any(1))
    if len(wrong):
        t = int(wrong[0])
        raise UsageError(f"tri[{t}] is {tuple(tri[t].tolist())}: expected vertex indices from 0 to {vertices - 1}")


def _check_ranges(ranges: Tensor, triangles: int) -> None:
    start, count = ranges.long().unbind(1)
    wrong = torch.nonzero((start < 0) | (count < 0) | (start + count > triangles))
    if len(wrong):
        item = int(wrong[0])
        raise UsageError(
            f"ranges[{item}] is {tuple(ranges[item].tolist())}: "
            f"expected a start and a count within the {triangles} triangles of tri"
        )


def _listed(at: tuple[int, ...]) -> str:
    return ", ".join(map(str, at))
