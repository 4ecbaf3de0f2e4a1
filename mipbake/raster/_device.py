"""Checks of the numbers in tensors, and the topology: by the native core on the CPU, with torch's own ops elsewhere.

Where torch does it, each check waits for the device once.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mipbake.errors import UsageError
from mipbake.raster._arguments import MAX_SPARSITY

__all__ = ["check_ids", "check_mesh", "topology"]


def check_mesh(pos: Tensor | None, tri: Tensor, vertices: int, ranges: Tensor | None = None) -> None:
    """Vertex indices below the number of vertices, finite positions, ranges within the triangles."""
    from mipbake import _native

    if tri.is_cuda:
        mesh_with_torch(pos, tri, vertices, ranges)
    else:
        _native.check_mesh(pos, tri, vertices, ranges)


def check_ids(rast: Tensor, triangles: int) -> None:
    """Triangle ids from 0 to the number of triangles. The CPU kernels check it as they read them."""
    if rast.is_cuda:
        ids_with_torch(rast, triangles)


def mesh_with_torch(pos: Tensor | None, tri: Tensor, vertices: int, ranges: Tensor | None) -> None:
    """`check_mesh` on any device, with the sentences of the native core."""
    outside = (tri < 0) | (tri >= vertices)
    wrong = outside.any() if pos is None else outside.any() | ~torch.isfinite(pos).all()
    if wrong.item():
        _raise_about_indices(tri, outside, vertices)
        assert pos is not None
        at = torch.nonzero(~torch.isfinite(pos).all(-1))[0].tolist()
        values = ", ".join(map(str, pos[tuple(at)].tolist()))
        raise UsageError(f"pos[{_listed(at)}] is ({values}): expected finite numbers")
    for item, (start, count) in enumerate([] if ranges is None else ranges.tolist()):
        if start < 0 or count < 0 or start + count > len(tri):
            raise UsageError(
                f"ranges[{item}] is ({start}, {count}): "
                f"expected a start and a count within the {len(tri)} triangles of tri"
            )


def ids_with_torch(rast: Tensor, triangles: int) -> None:
    """What the CPU kernels check, on any device, with their sentences."""
    ids = rast[..., 3]
    wrong = ~((ids >= 0) & (ids <= triangles))  # NaN is wrong too
    if wrong.any().item():
        at = torch.nonzero(wrong)[0].tolist()
        value = ids[tuple(at)].item()
        raise UsageError(
            f"rast[{_listed(at)}] has triangle_id {value:.9g}: expected "
            f"{'' if value > 0 else '0 where it is empty, or an index + 1 of '}"
            f"at most {triangles}, the number of triangles"
        )


def topology(tri: Tensor, vertices: int | None) -> Tensor:
    """(T, 3) int32: of each triangle edge the next one, 3 t + e, on the same two vertices, in a cycle."""
    from mipbake import _native

    following = torch.empty_like(tri)
    if tri.numel() == 0:
        return following
    if vertices is None:
        vertices = int(tri.max()) + 1
        if vertices > MAX_SPARSITY * tri.numel() and int(tri.min()) >= 0:
            used, tri = torch.unique(tri, return_inverse=True)
            tri, vertices = tri.int(), len(used)
    check_mesh(None, tri, vertices)
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


def _raise_about_indices(tri: Tensor, outside: Tensor, vertices: int) -> None:
    wrong = torch.nonzero(outside.any(1))
    if len(wrong):
        t = int(wrong[0])
        raise UsageError(f"tri[{t}] is {tuple(tri[t].tolist())}: expected vertex indices from 0 to {vertices - 1}")


def _listed(at: list[int]) -> str:
    return ", ".join(map(str, at))
