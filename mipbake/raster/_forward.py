"""The raster primitives forward, on arrays or tensors that were checked, and what is checked of the numbers in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mipbake.base.aligned import dense
from mipbake.base.arguments import empty, is_array
from mipbake.base.stream import current_stream, errors_of_data

MAX_SPARSITY = 16
"""Vertices per index up to which a topology counts by vertex; beyond, the vertices are numbered anew first."""


def rasterize(
    pos: Any,
    tri: Any,
    height: int,
    width: int,
    ranges: Any,
    previous: Any,
    scratch: int,
    grad_db: bool = True,  # noqa: ARG001
) -> tuple[Any, Any]:
    """`mipbake.raster.rasterize`; with `previous`, the first of its results, only what lies behind that; `grad_db` is
    for its gradient."""
    from mipbake import _native

    rast, rast_db = empty_rasters(pos, ranges, height, width)
    pos, tri, ranges, previous = dense(pos), dense(tri), optional(ranges), optional(previous)
    with errors_of_data(), current_stream(pos, "pos") as stream:
        check_numbers(tri, pos.shape[-2], pos=pos, ranges=ranges)
        if rast.shape[0]:
            workspace = None
            if on_card(pos):
                size = _native.rasterize_workspace(rast.shape[0], tri.shape[0], height, width)
                workspace = empty(pos, (size,), "uint8")
            _native.rasterize(pos, tri, ranges, previous, rast, rast_db, scratch, workspace, stream)
    return rast, rast_db


def interpolate(attr: Any, rast: Any, tri: Any, rast_db: Any, diff_attrs: Sequence[int]) -> tuple[Any, Any]:
    """`mipbake.raster.interpolate`; rast_db is there where diff_attrs are."""
    from mipbake import _native

    out, out_da = empty_attributes(attr, rast, diff_attrs)
    attr, rast, tri, rast_db = dense(attr), dense(rast), dense(tri), optional(rast_db)
    with errors_of_data(), current_stream(attr, "attr") as stream:
        check_numbers(tri, attr.shape[-2], rast=rast)
        if 0 not in out.shape:
            derivatives = out_da if diff_attrs else None
            _native.interpolate(attr, rast, tri, rast_db, list(diff_attrs), out, derivatives, stream)
    return out, out_da


def antialias(color: Any, rast: Any, pos: Any, tri: Any, following: Any, boost: float) -> Any:  # noqa: ARG001
    """`mipbake.raster.antialias`; the boost is for its gradient."""
    from mipbake import _native

    out = empty(color, color.shape)
    color, rast, pos, tri = dense(color), dense(rast), dense(pos), dense(tri)
    with errors_of_data(), current_stream(color, "color") as stream:
        check_numbers(tri, pos.shape[-2], pos=pos, rast=rast)
        if 0 not in out.shape:
            _native.antialias(color, rast, pos, tri, dense(following), out, silhouette_scratch(pos, tri), stream)
    return out


def topology(tri: Any, vertices: int) -> Any:
    """(T, 3) int32: of each triangle edge the next one, 3 t + e, on the same two vertices, in a cycle.

    `vertices` is -1 where they are not known.
    """
    from mipbake import _native

    tri = dense(tri)
    following = empty(tri, tri.shape)
    if tri.shape[0] == 0:
        return following
    with errors_of_data():
        if vertices < 0:
            vertices = int(tri.max()) + 1
            if vertices > MAX_SPARSITY * 3 * tri.shape[0] and int(tri.min()) >= 0:
                tri, vertices = _numbered_anew(tri)
        check_numbers(tri, vertices)
        if on_card(tri):
            from mipbake.raster import _device

            return _device.cycles(tri, vertices)
        _native.antialias_topology(tri, vertices, following)
    return following


def _numbered_anew(tri: Any) -> tuple[Any, int]:
    """The triangles, with vertices counted from 0 on in their order, and how many vertices there are."""
    if is_array(tri):
        used, tri = np.unique(tri, return_inverse=True)
        return tri.reshape(-1, 3).astype(np.int32), len(used)
    import torch

    used, tri = torch.unique(tri, return_inverse=True)
    return tri.int(), len(used)


def check_numbers(tri: Any, vertices: int, pos: Any = None, ranges: Any = None, rast: Any = None) -> None:
    """Vertex indices below the number of vertices, finite positions, ranges within tri, ids of triangles that exist.

    With CUDA it waits for the device once. On the CPU the kernels check ids as they read them.
    """
    if on_card(tri):
        from mipbake.raster import _device

        _device.check_with_torch(tri, vertices, pos=pos, ranges=ranges, rast=rast)
        return
    from mipbake import _native

    _native.check_mesh(pos, tri, vertices, ranges)


def on_card(value: Any) -> bool:
    """Whether it is a tensor with CUDA."""
    return not is_array(value) and bool(value.is_cuda)


def optional(value: Any) -> Any:
    """`dense`, or None."""
    return None if value is None else dense(value)


def empty_rasters(pos: Any, ranges: Any, height: int, width: int) -> tuple[Any, Any]:
    """Where the results of `rasterize` are written."""
    shape = (pos.shape[0] if ranges is None else ranges.shape[0], height, width, 4)
    return empty(pos, shape), empty(pos, shape)


def empty_attributes(attr: Any, rast: Any, diff_attrs: Sequence[int]) -> tuple[Any, Any]:
    """Where the results of `interpolate` are written."""
    image = rast.shape[:3]
    return empty(attr, (*image, attr.shape[-1])), empty(attr, (*image, 2 * len(diff_attrs)))


def silhouette_scratch(pos: Any, tri: Any) -> Any:
    """A byte for each triangle of each image, with CUDA; the CPU kernels have their own."""
    items = pos.shape[0] if len(pos.shape) == 3 else 1
    return empty(pos, (items, tri.shape[0]), "uint8") if on_card(pos) else None
