"""Checks of the arguments of the raster primitives: shapes, dtypes and devices, by name."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from typing import Any

from mipbake.base.arguments import REAL, check_kind, checked, device_of, dtype_of, whole
from mipbake.base.errors import UsageError
from mipbake.raster.context import RasterizeContext, Topology

MAX_SIDE = 2**15
MAX_TRIANGLES = 2**31 // 3
"""What an edge's 3 t + e can count as an int32."""

EXACT, BITS = 2**24, 0x4A800000
"""A triangle's number n beyond EXACT is the float32 with the bits BITS + n (csrc/raster/triangle_id.h)."""


def check_context(ctx: Any) -> None:
    """UsageError unless ctx is None or a context."""
    if ctx is not None and not isinstance(ctx, RasterizeContext):
        raise UsageError(f"ctx is a {type(ctx).__name__}: expected a RasterizeContext or None")


def size_of(resolution: Any) -> tuple[int, int]:
    """(height, width) as integers."""
    two = isinstance(resolution, Sequence) and not isinstance(resolution, str) and len(resolution) == 2
    height, width = (whole(side) or 0 for side in resolution) if two else (0, 0)
    if not (1 <= height <= MAX_SIDE and 1 <= width <= MAX_SIDE):
        raise UsageError(f"resolution is {resolution!r}: expected (height, width), two integers from 1 to {MAX_SIDE}")
    return height, width


def check_mesh(pos: Any, tri: Any) -> None:
    """pos (V, 4) or (B, V, 4), tri (T, 3)."""
    modes = "the first in range mode, the second in instanced mode, clip-space x, y, z, w"
    checked("pos", pos, None, REAL, (("vertices", 4), ("batch", "vertices", 4)), modes)
    check_triangles(tri, ("pos", pos))
    if tri.shape[0] > MAX_TRIANGLES:
        raise UsageError(f"tri has {tri.shape[0]} triangles: expected at most {MAX_TRIANGLES}; split the mesh")


def check_triangles(tri: Any, like: tuple[str, Any] | None = None) -> None:
    """tri (T, 3) int32."""
    checked("tri", tri, like, ("int32",), (("triangles", 3),), "the indices of each triangle's vertices")


def checked_ranges(ranges: Any, pos: Any) -> Any:
    """The ranges of range mode, which lie on the CPU."""
    if ranges is None:
        raise UsageError(
            f"pos has shape {tuple(pos.shape)} and ranges is missing: expected ranges (batch, 2), the first triangle "
            "and the number of triangles of each image, or pos (batch, vertices, 4)"
        )
    check_kind("ranges", ranges, ("pos", pos))
    if device_of(ranges) != "cpu":
        raise UsageError(f"ranges is on {ranges.device}: expected the CPU, whatever the device of pos")
    return checked("ranges", ranges, None, ("int32",), (("batch", 2),), "a start and a count for each image")


def attributes_of(attr: Any, rast: Any, tri: Any, rast_db: Any, diff_attrs: Any) -> list[int]:
    """Checks the arguments of interpolate; the attributes whose derivatives are wanted and can be had."""
    modes = "the first in range mode, the second in instanced mode"
    checked("attr", attr, None, REAL, (("vertices", "attributes"), ("batch", "vertices", "attributes")), modes)
    check_triangles(tri, ("attr", attr))
    _check_image("rast", rast, ("attr", attr), 4, "u, v, z/w, triangle_id")
    if len(attr.shape) == 3 and attr.shape[0] not in (1, rast.shape[0]):
        batch = "1" if rast.shape[0] == 1 else f"1 or {rast.shape[0]}"
        raise UsageError(f"attr has a batch of {attr.shape[0]}: expected {batch}, as rast has")
    selected = _selected(diff_attrs, attr.shape[-1])
    if rast_db is None:
        return []
    checked("rast_db", rast_db, ("attr", attr), (dtype_of(attr),), (tuple(rast.shape),), "as rast has")
    return selected


def check_antialias(color: Any, rast: Any, pos: Any, tri: Any) -> None:
    """The arrays of antialias."""
    check_mesh(pos, tri)
    _check_image("rast", rast, ("pos", pos), 4, "u, v, z/w, triangle_id")
    _check_image("color", color, ("pos", pos), "channels", "any number of channels")
    if color.shape[:3] != rast.shape[:3]:
        raise UsageError(
            f"color has shape {tuple(color.shape)}: expected (batch, height, width) to be {tuple(rast.shape[:3])}, "
            "as in rast"
        )
    if len(pos.shape) == 3 and pos.shape[0] != rast.shape[0]:
        raise UsageError(f"pos has a batch of {pos.shape[0]}: expected {rast.shape[0]}, as rast has")


def next_of(topology: Any, tri: Any) -> Any:
    """`Topology.next`, checked to belong to tri."""
    if not isinstance(topology, Topology):
        raise UsageError(
            f"topology_hash is a {type(topology).__name__}: expected what antialias_construct_topology_hash(tri) "
            "gives, or None"
        )
    shape = (tuple(tri.shape),)
    return checked("topology_hash", topology.next, ("tri", tri), (), shape, "of antialias_construct_topology_hash(tri)")


def boost_of(value: Any) -> float:
    """pos_gradient_boost as a float."""
    number = isinstance(value, (int, float, numbers.Real)) and not isinstance(value, bool)
    if not number or not abs(value) < float("inf"):
        raise UsageError(f"pos_gradient_boost is {value!r}: expected a finite number")
    return float(value)


def _selected(diff_attrs: Any, count: int) -> list[int]:
    if diff_attrs is None:
        return []
    if isinstance(diff_attrs, str) and diff_attrs == "all":
        return list(range(count))
    listed = isinstance(diff_attrs, Sequence) or hasattr(diff_attrs, "shape")
    selected = [whole(k) for k in diff_attrs] if listed else [None]
    found = [k for k in selected if k is not None]
    if len(found) < len(selected):
        raise UsageError(f"diff_attrs is {diff_attrs!r}: expected 'all', a list of integers or None")
    for k in found:
        if not 0 <= k < count:
            raise UsageError(f"diff_attrs holds {k}: expected indices of attributes from 0 to {count - 1}")
    return found


def _check_image(name: str, image: Any, like: tuple[str, Any], channels: int | str, meaning: str) -> None:
    """(B, H, W, channels) in the dtype of `like`, where it is."""
    shape = ("batch", "height", "width", channels)
    checked(name, image, like, (dtype_of(like[1]),), (shape,), meaning)
    if max(image.shape[1:3]) > MAX_SIDE:
        raise UsageError(f"{name} has shape {tuple(image.shape)}: expected at most {MAX_SIDE} pixels a side")
