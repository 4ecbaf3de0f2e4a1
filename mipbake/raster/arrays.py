"""The raster primitives on NumPy arrays: forward only, and without torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.aligned import contiguous
from mipbake.base.errors import UsageError
from mipbake.raster._arguments import (
    MAX_SPARSITY,
    Described,
    attributes_of,
    boost_of,
    check_antialias,
    check_context,
    check_topology,
    check_triangles,
    image_shape,
    size_of,
)
from mipbake.raster.context import RasterizeContext, Topology

__all__ = ["antialias", "antialias_construct_topology_hash", "interpolate", "rasterize"]

Array = NDArray[Any]


def rasterize(
    ctx: RasterizeContext | None,
    pos: Array,
    tri: Array,
    resolution: Sequence[int],
    ranges: Array | None = None,
    grad_db: bool = True,  # noqa: ARG001  arrays have no gradient
    previous: Array | None = None,
) -> tuple[Array, Array]:
    """`mipbake.raster.rasterize`; with `previous`, the first of its results, only what lies behind that."""
    from mipbake import _native

    check_context(ctx, RasterizeContext)
    if pos.ndim == 3:
        ranges = None
    described = None if ranges is None else _described("ranges", ranges)
    size = size_of(resolution)
    shape = (*image_shape(_described("pos", pos), _described("tri", tri), described, size), 4)
    pos, tri = contiguous(pos), contiguous(tri)
    ranges = None if ranges is None else contiguous(ranges)
    rast, rast_db = np.empty(shape, pos.dtype), np.empty(shape, pos.dtype)
    try:
        _native.check_mesh(pos, tri, pos.shape[-2], ranges)
        if rast.size:
            before = None if previous is None else contiguous(previous)
            _native.rasterize(pos, tri, ranges, before, rast, rast_db, 0 if ctx is None else ctx.handle)
    except ValueError as error:
        raise UsageError(str(error)) from None
    return rast, rast_db


def interpolate(
    attr: Array,
    rast: Array,
    tri: Array,
    rast_db: Array | None = None,
    diff_attrs: Sequence[int] | str | None = None,
) -> tuple[Array, Array]:
    """`mipbake.raster.interpolate`."""
    from mipbake import _native

    selected = attributes_of(
        _described("attr", attr),
        _described("rast", rast),
        _described("tri", tri),
        None if rast_db is None else _described("rast_db", rast_db),
        diff_attrs,
    )
    attr, rast, tri = (contiguous(array) for array in (attr, rast, tri))
    rast_db = contiguous(rast_db) if rast_db is not None and selected else None
    out = np.empty((*rast.shape[:3], attr.shape[-1]), attr.dtype)
    out_da = np.empty((*rast.shape[:3], 2 * len(selected)), attr.dtype)
    try:
        _native.check_mesh(None, tri, attr.shape[-2], None)
        if out.size:
            _native.interpolate(attr, rast, tri, rast_db, selected, out, out_da if selected else None)
    except ValueError as error:
        raise UsageError(str(error)) from None
    return out, out_da


def antialias(
    color: Array,
    rast: Array,
    pos: Array,
    tri: Array,
    topology_hash: Topology | None = None,
    pos_gradient_boost: float = 1.0,
) -> Array:
    """`mipbake.raster.antialias`."""
    from mipbake import _native

    triangles = _described("tri", tri)
    check_antialias(_described("color", color), _described("rast", rast), _described("pos", pos), triangles)
    boost_of(pos_gradient_boost)
    color, rast, pos, tri = (contiguous(array) for array in (color, rast, pos, tri))
    out = np.empty_like(color)
    try:
        _native.check_mesh(pos, tri, pos.shape[-2], None)
        following = _topology(tri, pos.shape[-2]) if topology_hash is None else _next_of(topology_hash, triangles)
        if out.size:
            _native.antialias(color, rast, pos, tri, following, out)
    except ValueError as error:
        raise UsageError(str(error)) from None
    return out


def antialias_construct_topology_hash(tri: Array) -> Topology:
    """`mipbake.raster.antialias_construct_topology_hash`."""
    from mipbake import _native

    check_triangles(_described("tri", tri))
    tri = contiguous(tri)
    vertices = int(tri.max(initial=-1)) + 1
    try:
        if vertices > MAX_SPARSITY * tri.size and tri.min(initial=0) >= 0:
            used, inverse = np.unique(tri, return_inverse=True)
            tri, vertices = inverse.reshape(tri.shape).astype(np.int32), len(used)
        _native.check_mesh(None, tri, vertices, None)
        return Topology(_topology(tri, vertices))
    except ValueError as error:
        raise UsageError(str(error)) from None


def _topology(tri: Array, vertices: int) -> Array:
    from mipbake import _native

    following = np.empty_like(tri)
    if tri.size:
        _native.antialias_topology(tri, vertices, following)
    return following


def _next_of(topology: Any, tri: Described) -> Array:
    if not isinstance(topology, Topology) or not isinstance(topology.next, np.ndarray):
        raise UsageError(
            f"topology_hash is a {type(topology).__name__}: expected what antialias_construct_topology_hash(tri) "
            "gives for a NumPy array, or None"
        )
    check_topology(topology.next.shape[0], "cpu", tri)
    return contiguous(topology.next)


def _described(name: str, array: Any) -> Described:
    if not isinstance(array, np.ndarray):
        raise UsageError(f"{name} is a {type(array).__name__}: expected a NumPy array, as the first argument is")
    return Described(name, array.shape, array.dtype.name if array.dtype.isnative else str(array.dtype), "cpu")
