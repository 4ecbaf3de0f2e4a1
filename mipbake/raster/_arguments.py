"""Checks of the arguments of the raster primitives that both doors share: types, shapes and dtypes by name."""

from __future__ import annotations

import numbers
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

from mipbake.base.errors import UsageError

Shape = tuple[int, ...]

REAL = ("float32", "float64")
MAX_SIDE = 2**15
MAX_TRIANGLES = {"float32": 2**24, "float64": 2**31 // 3}
"""What an id that is stored as a number, and an edge's 3 t + e as an int32, can count."""
MAX_SPARSITY = 16
"""Vertices per index up to which a topology counts by vertex; beyond, the vertices are numbered anew first."""


class Described(NamedTuple):
    """An argument as the checks see it."""

    name: str
    shape: Shape
    dtype: str
    device: str


def check_context(ctx: Any, kind: type) -> None:
    """UsageError unless ctx is None or a context of that kind."""
    if ctx is not None and not isinstance(ctx, kind):
        raise UsageError(f"ctx is a {type(ctx).__name__}: expected a RasterizeContext or None")


def size_of(resolution: Any) -> tuple[int, int]:
    """(height, width) as integers."""
    two = isinstance(resolution, Sequence) and not isinstance(resolution, str) and len(resolution) == 2
    try:
        height, width = (operator.index(side) for side in resolution) if two else (0, 0)
    except TypeError:
        height, width = 0, 0
    if not (1 <= height <= MAX_SIDE and 1 <= width <= MAX_SIDE):
        raise UsageError(f"resolution is {resolution!r}: expected (height, width), two integers from 1 to {MAX_SIDE}")
    return height, width


def check_mesh(pos: Described, tri: Described) -> None:
    """pos (V, 4) or (B, V, 4), tri (T, 3)."""
    _check_real(pos)
    if len(pos.shape) not in (2, 3) or pos.shape[-1] != 4:
        raise UsageError(
            f"pos has shape {pos.shape}: expected (vertices, 4) in range mode or (batch, vertices, 4) in instanced "
            "mode, clip-space x, y, z, w"
        )
    check_triangles(tri, pos)
    limit = MAX_TRIANGLES[pos.dtype]
    if tri.shape[0] > limit:
        raise UsageError(
            f"tri has {tri.shape[0]} triangles: expected at most {limit}, what {pos.dtype} can number; split the mesh"
        )


def check_triangles(tri: Described, like: Described | None = None) -> None:
    """tri (T, 3) int32, on the device of `like`."""
    if tri.dtype != "int32":
        raise UsageError(f"tri is {tri.dtype}: expected int32")
    if len(tri.shape) != 2 or tri.shape[1] != 3:
        raise UsageError(f"tri has shape {tri.shape}: expected (triangles, 3), the indices of each triangle's vertices")
    if like is not None:
        _check_device(tri, like)


def image_shape(pos: Described, tri: Described, ranges: Described | None, size: tuple[int, int]) -> Shape:
    """(B, H, W) of a rasterisation."""
    check_mesh(pos, tri)
    if len(pos.shape) == 3:
        return (pos.shape[0], *size)
    if ranges is None:
        raise UsageError(
            f"pos has shape {pos.shape} and ranges is missing: expected ranges (batch, 2), the first triangle and the "
            "number of triangles of each image, or pos (batch, vertices, 4)"
        )
    if ranges.dtype != "int32":
        raise UsageError(f"ranges is {ranges.dtype}: expected int32")
    if len(ranges.shape) != 2 or ranges.shape[1] != 2:
        raise UsageError(f"ranges has shape {ranges.shape}: expected (batch, 2), a start and a count for each image")
    if ranges.device != "cpu":
        raise UsageError(f"ranges is on {ranges.device}: expected the CPU, whatever the device of pos")
    return (ranges.shape[0], *size)


def attributes_of(
    attr: Described, rast: Described, tri: Described, rast_db: Described | None, diff_attrs: Any
) -> list[int]:
    """Checks the arguments of interpolate; the attributes whose derivatives are wanted and can be had."""
    _check_real(attr)
    if len(attr.shape) not in (2, 3):
        raise UsageError(
            f"attr has shape {attr.shape}: expected (vertices, attributes) in range mode or (batch, vertices, "
            "attributes) in instanced mode"
        )
    check_triangles(tri, attr)
    _check_image(rast, attr, 4, "u, v, z/w, triangle_id")
    if len(attr.shape) == 3 and attr.shape[0] not in (1, rast.shape[0]):
        batch = "1" if rast.shape[0] == 1 else f"1 or {rast.shape[0]}"
        raise UsageError(f"attr has a batch of {attr.shape[0]}: expected {batch}, as rast has")
    selected = _selected(diff_attrs, attr.shape[-1])
    if rast_db is None:
        return []
    _check_image(rast_db, attr, 4, "du/dX, du/dY, dv/dX, dv/dY")
    if rast_db.shape != rast.shape:
        raise UsageError(f"rast_db has shape {rast_db.shape}: expected {rast.shape}, as rast has")
    return selected


def check_antialias(color: Described, rast: Described, pos: Described, tri: Described) -> None:
    """Checks the arrays of antialias."""
    check_mesh(pos, tri)
    _check_image(rast, pos, 4, "u, v, z/w, triangle_id")
    _check_image(color, pos, None, "any number of channels")
    if color.shape[:3] != rast.shape[:3]:
        raise UsageError(
            f"color has shape {color.shape}: expected (batch, height, width) to be {rast.shape[:3]}, as in rast"
        )
    if len(pos.shape) == 3 and pos.shape[0] != rast.shape[0]:
        raise UsageError(f"pos has a batch of {pos.shape[0]}: expected {rast.shape[0]}, as rast has")


def check_topology(count: int, device: str, tri: Described) -> None:
    """UsageError unless a topology of `count` triangles on that device can belong to tri."""
    if count != tri.shape[0] or device != tri.device:
        raise UsageError(
            f"topology_hash is of {count} triangles on {device}: expected the {tri.shape[0]} on {tri.device} of tri; "
            "build it with antialias_construct_topology_hash(tri)"
        )


def boost_of(value: Any) -> float:
    """pos_gradient_boost as a float."""
    number = isinstance(value, (int, float, numbers.Real)) and not isinstance(value, bool)
    if not number or not abs(value) < float("inf"):
        raise UsageError(f"pos_gradient_boost is {value!r}: expected a finite number")
    return float(value)


def _selected(diff_attrs: Any, count: int) -> list[int]:
    if diff_attrs is None:
        return []
    if isinstance(diff_attrs, str):
        if diff_attrs != "all":
            raise UsageError(f"diff_attrs is {diff_attrs!r}: expected 'all', a list of attribute indices or None")
        return list(range(count))
    try:
        selected = [operator.index(k) for k in diff_attrs]
    except TypeError:
        raise UsageError(f"diff_attrs is {diff_attrs!r}: expected 'all', a list of integers or None") from None
    for k in selected:
        if not 0 <= k < count:
            raise UsageError(f"diff_attrs holds {k}: expected indices of attributes from 0 to {count - 1}")
    return selected


def _check_real(array: Described) -> None:
    if array.dtype not in REAL:
        raise UsageError(f"{array.name} is {array.dtype}: expected float32 or float64")
    if array.dtype == "float64" and array.device.startswith("cuda"):
        raise UsageError(f"{array.name} is float64 on {array.device}: expected float32, or the CPU")


def _check_image(image: Described, like: Described, channels: int | None, meaning: str) -> None:
    """(B, H, W, channels) in the dtype of `like`, where it is."""
    if image.dtype != like.dtype:
        raise UsageError(f"{image.name} is {image.dtype}: expected {like.dtype}, as {like.name} is")
    if len(image.shape) != 4 or (channels is not None and image.shape[3] != channels):
        last = "channels" if channels is None else channels
        raise UsageError(f"{image.name} has shape {image.shape}: expected (batch, height, width, {last}), {meaning}")
    if max(image.shape[1:3]) > MAX_SIDE:
        raise UsageError(f"{image.name} has shape {image.shape}: expected at most {MAX_SIDE} pixels a side")
    _check_device(image, like)


def _check_device(array: Described, like: Described) -> None:
    if array.device != like.device:
        raise UsageError(f"{array.name} is on {array.device}: expected {like.device}, where {like.name} is")
