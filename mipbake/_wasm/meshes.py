"""The raster primitives in the core as WebAssembly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mipbake._wasm.given import checked, filled, real_dtype
from mipbake._wasm.machine import run


def check_mesh(pos: Any, tri: Any, vertices: int, ranges: Any) -> None:
    kind = np.dtype(np.float32) if pos is None else real_dtype(pos)
    items = len(pos) if pos is not None and np.ndim(pos) == 3 else 1
    triangles, batch = (0 if each is None else len(each) for each in (tri, ranges))
    run(
        "check_mesh",
        [
            kind == np.float64,
            checked("pos", pos, kind, (*np.shape(pos)[:-2], vertices, 4)),
            np.ndim(pos) == 3,
            items,
            vertices,
        ],
        [
            checked("tri", tri, np.int32, (triangles, 3)),
            triangles,
            checked("ranges", ranges, np.int32, (batch, 2)),
            batch,
        ],
    )


def raster_scratch() -> int:
    """Nothing is kept between calls."""
    return 0


def raster_scratch_free(handle: int) -> None:
    del handle


def rasterize(
    pos: Any,
    tri: Any,
    ranges: Any,
    previous: Any,
    rast: Any,
    rast_db: Any,
    scratch: int = 0,
    workspace: Any = None,
    stream: int = 0,
) -> None:
    del scratch, workspace, stream
    kind, image = real_dtype(rast), np.shape(rast)
    (B, H, W, _), (vertices, _), T = image, np.shape(pos)[-2:], len(tri)
    run(
        "rasterize",
        [kind == np.float64, B, vertices, T, H, W, _positions(pos, kind, B), np.ndim(pos) == 2],
        [checked("tri", tri, np.int32, (T, 3)), checked("ranges", ranges, np.int32, (B, 2))],
        [
            checked("previous", previous, kind, image),
            filled("rast", rast, kind, image),
            filled("rast_db", rast_db, kind, image),
        ],
    )


def rasterize_backward(
    pos: Any, tri: Any, rast: Any, grad_rast: Any, grad_db: Any, grad_pos: Any, stream: int = 0
) -> None:
    del stream
    kind, image = real_dtype(rast), np.shape(rast)
    (B, H, W, _), (vertices, _), T = image, np.shape(pos)[-2:], len(tri)
    run(
        "rasterize_backward",
        [kind == np.float64, B, vertices, T, H, W, _positions(pos, kind, B), np.ndim(pos) == 2],
        [checked("tri", tri, np.int32, (T, 3)), checked("rast", rast, kind, (B, H, W, 4))],
        [checked("grad_rast", grad_rast, kind, image), checked("grad_db", grad_db, kind, image)],
        filled("grad_pos", grad_pos, kind, np.shape(pos)),
    )


def _positions(pos: Any, kind: np.dtype[Any], batch: int) -> Any:
    vertices = np.shape(pos)[-2]
    return checked("pos", pos, kind, (vertices, 4) if np.ndim(pos) == 2 else (batch, vertices, 4))


def interpolate(
    attr: Any, rast: Any, tri: Any, rast_db: Any, diff_attrs: Sequence[int], out: Any, out_da: Any, stream: int = 0
) -> None:
    del stream
    words, kind, image, derivatives = _attributes(attr, rast, tri, rast_db, diff_attrs)
    run("interpolate", words, filled("out", out, kind, image), filled("out_da", out_da, kind, derivatives))


def interpolate_backward(
    attr: Any,
    rast: Any,
    tri: Any,
    rast_db: Any,
    diff_attrs: Sequence[int],
    grad_out: Any,
    grad_da: Any,
    grad_attr: Any,
    grad_rast: Any,
    grad_db: Any,
    stream: int = 0,
) -> None:
    del stream
    words, kind, image, derivatives = _attributes(attr, rast, tri, rast_db, diff_attrs)
    run(
        "interpolate_backward",
        [words, checked("grad_out", grad_out, kind, image), checked("grad_da", grad_da, kind, derivatives)],
        filled("grad_attr", grad_attr, kind, np.shape(attr)),
        [filled("grad_rast", grad_rast, kind, np.shape(rast)), filled("grad_db", grad_db, kind, np.shape(rast))],
    )


def _attributes(
    attr: Any, rast: Any, tri: Any, rast_db: Any, listed: Sequence[int]
) -> tuple[list[Any], np.dtype[Any], tuple[int, ...], tuple[int, ...]]:
    """Words of InterpolateArgs, the dtype, and the shapes of the results."""
    kind, (B, H, W, _), T = real_dtype(rast), np.shape(rast), len(tri)
    vertices, channels = np.shape(attr)[-2:]
    shares = np.ndim(attr) == 2 or len(attr) == 1
    if listed and (rast_db is None or not all(0 <= each < channels for each in listed)):
        raise ValueError("diff_attrs without rast_db, or a channel that is not in attr")
    lead = () if np.ndim(attr) == 2 else (1 if shares else B,)
    words: list[Any] = [kind == np.float64, checked("attr", attr, kind, (*lead, vertices, channels))]
    words += [0 if shares else vertices * channels, vertices, channels, checked("rast", rast, kind, (B, H, W, 4))]
    words += [checked("rast_db", rast_db, kind, (B, H, W, 4)), checked("tri", tri, np.int32, (T, 3)), T]
    words += [np.array(listed, np.int32), len(listed), B, H, W]
    return words, kind, (B, H, W, channels), (B, H, W, 2 * len(listed))


def antialias_topology(tri: Any, vertices: int, next: Any) -> None:
    T = len(tri)
    run(
        "antialias_topology", checked("tri", tri, np.int32, (T, 3)), T, vertices, filled("next", next, np.int32, (T, 3))
    )


def antialias(
    color: Any, rast: Any, pos: Any, tri: Any, next: Any, out: Any, workspace: Any = None, stream: int = 0
) -> None:
    del workspace, stream
    words, kind = _silhouettes(color, rast, pos, tri, next)
    run("antialias", words, filled("out", out, kind, np.shape(color)))


def antialias_backward(
    color: Any,
    rast: Any,
    pos: Any,
    tri: Any,
    next: Any,
    grad: Any,
    boost: float,
    grad_color: Any,
    grad_pos: Any,
    workspace: Any = None,
    stream: int = 0,
) -> None:
    del workspace, stream
    words, kind = _silhouettes(color, rast, pos, tri, next)
    run(
        "antialias_backward",
        [words, checked("grad", grad, kind, np.shape(color)), float(boost)],
        [filled("grad_color", grad_color, kind, np.shape(color)), filled("grad_pos", grad_pos, kind, np.shape(pos))],
    )


def _silhouettes(color: Any, rast: Any, pos: Any, tri: Any, following: Any) -> tuple[list[Any], np.dtype[Any]]:
    """Words of AntialiasArgs, and the dtype."""
    kind, (B, H, W, C), T, vertices = real_dtype(color), np.shape(color), len(tri), np.shape(pos)[-2]
    words: list[Any] = [kind == np.float64, checked("color", color, kind, (B, H, W, C)), C]
    words += [checked("rast", rast, kind, (B, H, W, 4)), _positions(pos, kind, B)]
    words += [0 if np.ndim(pos) == 2 or B == 1 else 4 * vertices, vertices]
    words += [checked("tri", tri, np.int32, (T, 3)), checked("next", following, np.int32, (T, 3)), T, B, H, W]
    return words, kind
