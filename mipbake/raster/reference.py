"""The plain torch twins of rasterize, interpolate and antialias: slow, readable, and nothing native.

They are the oracle of the tests. Everything is computed in float64, the decisions that no gradient passes through
(coverage, depth, silhouettes) apart from the values that have one, which autograd differentiates; results are
rounded to the dtype of the input. Source: Laine et al., Modular Primitives for High-Performance Differentiable
Rendering, 2020, sections 3.3, 3.4 and 3.6, with its equation numbers; coverage after Olano and Greer, Triangle
Scan Conversion using 2D Homogeneous Coordinates, 1997.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

__all__ = ["antialias", "interpolate", "rasterize", "silhouettes", "splats"]


def rasterize(
    pos: Tensor,
    tri: Tensor,
    resolution: tuple[int, int],
    ranges: Tensor | None = None,
    grad_db: bool = True,
    previous: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """`mipbake.raster.rasterize` without its context; `previous` is the result whose next layer is wanted.

    Args:
        pos: (B, V, 4), or (V, 4) with ranges; float32 or float64.
        tri: (T, 3) integers.
        resolution: (height, width).
        ranges: (B, 2) integers: first triangle and number of triangles of each item.
        grad_db: whether the derivatives (the second output) have a gradient.
        previous: (B, H, W, 4): what is drawn must lie behind its depth; nothing is drawn where it is empty.

    Returns:
        (B, H, W, 4) with u, v, z/w, triangle + 1, and (B, H, W, 4) with du/dX, du/dY, dv/dX, dv/dY.
    """
    height, width = resolution
    with torch.no_grad():
        ids, depth = _visible(pos, tri, resolution, ranges, previous)
    batch, row, column = torch.nonzero(ids, as_tuple=True)
    corners = _corners(pos, tri, batch, ids[batch, row, column] - 1)  # (N, 3, 4)
    x = (2 * column + 1).double() / width - 1
    y = (2 * row + 1).double() / height - 1
    n = _edges(corners)  # (N, 3, 3): the lines n . (x, y, 1) = 0 opposite to each vertex
    E = n[..., 0] * x[:, None] + n[..., 1] * y[:, None] + n[..., 2]
    total = E.sum(-1, keepdim=True)
    barycentric = (E / total)[:, :2]
    # The derivatives of E_i / sum E by X and Y in pixels: from one column to the next E_i grows by 2 n_ix / W.
    slope = n[..., :2] * n.new_tensor([2 / width, 2 / height])
    derivative = (slope[:, :2] - barycentric[..., None] * slope.sum(1, keepdim=True)) / total[..., None]
    if not grad_db:
        derivative = derivative.detach()
    # Rounding may leave [0, 1]; what brings it back has no gradient.
    barycentric = barycentric + (barycentric.clamp(0, 1) - barycentric).detach()
    rast = torch.stack([*barycentric.unbind(-1), depth[batch, row, column], ids[batch, row, column].double()], -1)
    shape = (*ids.shape, 4)
    return (
        rast.new_zeros(shape).index_put((batch, row, column), rast).to(pos.dtype),
        rast.new_zeros(shape).index_put((batch, row, column), derivative.flatten(1)).to(pos.dtype),
    )


def _visible(
    pos: Tensor, tri: Tensor, resolution: tuple[int, int], ranges: Tensor | None, previous: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Triangle + 1 and z/w of the nearest triangle in each pixel, (B, H, W); 0 where there is none."""
    height, width = resolution
    items = pos.expand(len(ranges), *pos.shape) if ranges is not None else pos
    x = (2 * torch.arange(width, device=pos.device).double() + 1) / width - 1
    y = (2 * torch.arange(height, device=pos.device).double() + 1)[:, None] / height - 1
    ids = torch.zeros(len(items), height, width, dtype=torch.int64, device=pos.device)
    depth = torch.full(ids.shape, torch.inf, dtype=torch.float64, device=pos.device)
    for item, vertices in enumerate(items):
        start, count = (0, len(tri)) if ranges is None else ranges[item].tolist()
        for t in range(start, start + count):
            V = vertices[tri[t].long()].double()
            n = _edges(V)
            E = n[:, 0, None, None] * x + n[:, 1, None, None] * y + n[:, 2, None, None]
            sign = _sign_of_determinant(V)
            if sign == 0:
                continue
            covered = torch.ones_like(ids[item], dtype=torch.bool)
            for i in range(3):
                covered &= _inside(E[i] * sign, V[(i + 1) % 3], V[(i + 2) % 3], sign)
            # z/w is affine in x and y. Rounded as it is stored, before it is compared.
            z = (V[:, 2, None, None] * E).sum(0) / (V[0, [0, 1, 3]] @ n[0])
            z = z.to(pos.dtype).double()
            if torch.all(V[:, 2].abs() <= V[:, 3]):
                z = z.clamp(-1, 1)  # what lies on the near or far plane is not clipped by rounding
            covered &= (z >= -1) & (z <= 1)
            if previous is not None:
                covered &= (previous[item, ..., 3] > 0) & (z > previous[item, ..., 2])
            covered &= z < depth[item]  # equal depths: the first triangle stays
            ids[item][covered], depth[item][covered] = t + 1, z[covered]
    return ids, depth.masked_fill(ids == 0, 0.0)


def _edges(V: Tensor) -> Tensor:
    """n_0 = V_1 x V_2, n_1 = V_2 x V_0, n_2 = V_0 x V_1 of V = (x, y, w); (..., 3, 4) to (..., 3, 3)."""
    return _cross(V.roll(-1, -2), V.roll(-2, -2))


def _cross(a: Tensor, b: Tensor) -> Tensor:
    """The line through two points (x, y, z, w): a x b of their (x, y, w)."""
    (ax, ay, _, aw), (bx, by, _, bw) = a.unbind(-1), b.unbind(-1)
    return torch.stack([ay * bw - aw * by, aw * bx - ax * bw, ax * by - ay * bx], -1)


def _inside(E: Tensor, a: Tensor, b: Tensor, sign: int) -> Tensor:
    """Whether pixel centres, (H, W), lie on the inner side of the line through a and b, where sign * n is positive.

    Where rounding could decide, E = sign * n . (x, y, 1) is recomputed exactly. A centre on the line belongs to the
    side that it would be on if it moved by an infinitesimal step along +x and a smaller one along +y: so one of the
    triangles around an edge or a vertex has it.
    """
    inside = E > 0
    height, width = E.shape
    bound = 1e-14 * (a[[0, 1, 3]].abs().max() * b[[0, 1, 3]].abs().max())  # |x|, |y| < 1
    ax, ay, _, aw = map(Fraction, a.tolist())
    bx, by, _, bw = map(Fraction, b.tolist())
    nx, ny, nw = (sign * c for c in (ay * bw - aw * by, aw * bx - ax * bw, ax * by - ay * bx))
    for row, column in torch.nonzero(E.abs() <= bound).tolist():
        x, y = Fraction(2 * column + 1 - width, width), Fraction(2 * row + 1 - height, height)
        inside[row, column] = next((c > 0 for c in (nx * x + ny * y + nw, nx, ny) if c), False)
    return inside


def _sign_of_determinant(V: Tensor) -> int:
    (ax, ay, _, aw), (bx, by, _, bw), (cx, cy, _, cw) = ([Fraction(c) for c in vertex] for vertex in V.tolist())
    determinant = ax * (by * cw - bw * cy) + ay * (bw * cx - bx * cw) + aw * (bx * cy - by * cx)
    return (determinant > 0) - (determinant < 0)


def _corners(values: Tensor, tri: Tensor, batch: Tensor, triangle: Tensor) -> Tensor:
    """The values of triangles' vertices, (N, 3, C) in float64, out of (V, C), (1, V, C) or (B, V, C)."""
    vertices = tri.long()[triangle]
    if values.ndim == 2:
        return values[vertices].double()
    item = batch if len(values) > 1 else torch.zeros_like(batch)
    return values[item[:, None], vertices].double()


def interpolate(
    attr: Tensor,
    rast: Tensor,
    tri: Tensor,
    rast_db: Tensor | None = None,
    diff_attrs: Sequence[int] | str | None = None,
) -> tuple[Tensor, Tensor]:
    """`mipbake.raster.interpolate`: arguments, shapes and results.

    A = u A_0 + v A_1 + (1 - u - v) A_2 (eq. 3); autograd differentiates this to eq. 4, and dA/d{X, Y} = (A_0 - A_2)
    du/d{X, Y} + (A_1 - A_2) dv/d{X, Y}.
    """
    count = attr.shape[-1]
    selected = list(range(count)) if diff_attrs == "all" else [int(k) for k in diff_attrs or ()]
    if rast_db is None:
        selected = []
    ids = rast.detach()[..., 3].long()
    pixels = torch.nonzero(ids, as_tuple=True)
    A = _corners(attr, tri, pixels[0], ids[pixels] - 1)
    u, v = rast[pixels].double()[:, :2, None].unbind(1)
    values = u * A[:, 0] + v * A[:, 1] + (1 - u - v) * A[:, 2]
    out = values.new_zeros(*ids.shape, count).index_put(pixels, values).to(attr.dtype)
    out_da = values.new_zeros(*ids.shape, 2 * len(selected))
    if rast_db is not None and selected:
        A = A[..., selected]
        du, dv = rast_db[pixels].double().reshape(-1, 2, 1, 2).unbind(1)
        derivatives = (A[:, 0] - A[:, 2])[..., None] * du + (A[:, 1] - A[:, 2])[..., None] * dv
        out_da = out_da.index_put(pixels, derivatives.flatten(1))
    return out, out_da.to(attr.dtype)


def antialias(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, pos_gradient_boost: float = 1.0) -> Tensor:
    """`mipbake.raster.antialias` (section 3.6), the topology found anew: arguments, shapes and result."""
    height, width = rast.shape[1:3]
    with torch.no_grad():
        crossed = list(_crossed(rast, pos, tri))
    flat = color.double().reshape(-1, color.shape[-1])
    out = flat
    for each in crossed:
        a, b = (_corners(pos, tri, each.batch, each.triangle)[torch.arange(len(each.batch)), e] for e in each.ends)
        # Along the axis of both, from the first pixel's centre to the crossing, in pixels.
        axis, size = (0, width) if each.horizontal else (1, height)
        at_a, at_b = (p[:, 1 - axis] - each.line * p[:, 3] for p in (a, b))
        crossing = (at_b * a[:, axis] - at_a * b[:, axis]) / (at_b * a[:, 3] - at_a * b[:, 3])
        d = (crossing - each.start) * (size / 2)
        d = d.detach() + pos_gradient_boost * (d - d.detach())
        # Half of the slab between the centres belongs to each pixel; the crossing says how much of each half is
        # covered.
        second = d > 0.5
        into, source = torch.where(second, each.second, each.first), torch.where(second, each.first, each.second)
        out = out.index_add(0, into, (d - 0.5).abs()[:, None] * (flat[source] - flat[into]))
    return out.reshape(color.shape).to(color.dtype)


class _Crossed(NamedTuple):
    """Neighbouring pixels that a silhouette edge passes between, along one axis; tensors are (N,)."""

    horizontal: bool
    batch: Tensor
    first: Tensor
    """Index of the pixel in the flattened (B, H, W) image: the left, or the lower in memory."""
    second: Tensor
    start: Tensor
    """x (y where one is above the other) of the first pixel's centre, in NDC."""
    line: Tensor
    """y (x where one is above the other) of both centres."""
    triangle: Tensor
    ends: tuple[Tensor, Tensor]
    """Which vertices of the triangle, 0 to 2, are the ends of the edge."""


def _crossed(rast: Tensor, pos: Tensor, tri: Tensor) -> Iterator[_Crossed]:
    _, height, width, _ = rast.shape
    outline = silhouettes(pos, tri)
    ids, depth = rast[..., 3].long(), rast[..., 2]
    depth = torch.where(ids == 0, torch.inf, depth)
    pixel = torch.arange(ids.numel(), device=ids.device).view(ids.shape)
    for horizontal in (True, False):
        rows, columns = (0, 1) if horizontal else (1, 0)
        before, after = np.s_[:, : height - rows, : width - columns], np.s_[:, rows:, columns:]
        chosen = torch.where(depth[before] <= depth[after], ids[before], ids[after])  # the nearer, or the first
        differ = torch.nonzero(ids[before] != ids[after], as_tuple=True)
        batch, row, column = differ
        triangle = chosen[differ] - 1
        x, y = (2 * column + 1).double() / width - 1, (2 * row + 1).double() / height - 1
        start, line = (x, y) if horizontal else (y, x)
        V = _corners(pos, tri, batch, triangle)
        edge = torch.full_like(triangle, -1)
        for e in (2, 1, 0):  # the last that is written is the first in order
            a, b = V[:, e], V[:, (e + 1) % 3]
            n = _cross(a, b)
            upright = n[:, 0].abs() * height >= n[:, 1].abs() * width  # in pixels
            along, size = (0, width) if horizontal else (1, height)
            at_a, at_b = a[:, 1 - along] - line * a[:, 3], b[:, 1 - along] - line * b[:, 3]
            # On the edge, at_b a - at_a b up to a positive factor: both weights positive, and w too.
            crosses = (at_a < 0) != (at_b < 0)
            w = (at_b * a[:, 3] - at_a * b[:, 3]) * (at_b - at_a).sign()
            point = (at_b * a[:, along] - at_a * b[:, along]) * (at_b - at_a).sign()
            d = (point / w - start) * (size / 2)
            found = crosses & (w > 0) & (d >= 0) & (d <= 1) & (upright == horizontal)
            item = batch if len(outline) > 1 else torch.zeros_like(batch)
            edge[found & outline[item, triangle, e]] = e
        kept = edge >= 0
        yield _Crossed(
            horizontal=horizontal,
            batch=batch[kept],
            first=pixel[before][differ][kept],
            second=pixel[after][differ][kept],
            start=start[kept],
            line=line[kept],
            triangle=triangle[kept],
            ends=(edge[kept], (edge[kept] + 1) % 3),
        )


def silhouettes(pos: Tensor, tri: Tensor) -> Tensor:
    """Whether edges 0-1, 1-2 and 2-0 of each triangle are silhouettes: (B, T, 3), or (1, T, 3) of pos (V, 4).

    No other triangle of the edge lies strictly on its opposite side after projection.
    """
    triangles = [tuple(t) for t in tri.tolist()]
    owners: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for t, corners in enumerate(triangles):
        for e in range(3):
            a, b = corners[e], corners[(e + 1) % 3]
            owners[min(a, b), max(a, b)].append((t, e))
    items = pos if pos.ndim == 3 else pos[None]
    result = torch.zeros(len(items), len(triangles), 3, dtype=torch.bool, device=pos.device)
    for item, points in enumerate(items):
        for (low, high), found in owners.items():
            sides = {(t, e): _sign_of_determinant(points[[low, high, triangles[t][(e + 2) % 3]]]) for t, e in found}
            for (t, e), side in sides.items():
                result[item, t, e] = -side not in sides.values() or side == 0
    return result


def splats(
    centers: Tensor, conics: Tensor, paint: Tensor, depth: Tensor, resolution: tuple[int, int], most: int = 16
) -> tuple[Tensor, Tensor]:
    """`mipbake.raster.splats`: every splat over the whole image, in float64."""
    height, width = resolution
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    image, through = torch.zeros(height, width, 3, dtype=torch.float64), torch.ones(height, width, dtype=torch.float64)
    weights = torch.zeros(len(centers), height, width, dtype=torch.float64)
    order = [int(i) for i in torch.argsort(depth, stable=True) if depth[i] > 0]
    for i in order:
        (a, b, c), (*color, opacity) = conics[i].double(), paint[i].double()
        if not (a > 0 and c > 0 and a * c - b * b > 0):
            continue
        across, up = x - centers[i, 0].double(), y - centers[i, 1].double()
        alpha = opacity * torch.exp(-(a * across**2 + 2 * b * across * up + c * up**2) / 2)
        drawn = (alpha >= 1 / 255) & (through >= 1e-4)
        weights[i] = torch.where(drawn, through * alpha.clamp(max=0.99), 0.0)
        image += weights[i, ..., None] * torch.stack(color)
        through = through - weights[i]
    shown = torch.full((height, width, most), -1, dtype=torch.int32)
    for row, column in np.ndindex(height, width):
        listed = [i for i in order if weights[i, row, column] >= 1 / 255]
        kept = sorted(listed, key=lambda i: -float(weights[i, row, column]))[:most]
        for place, i in enumerate(i for i in listed if i in kept):
            shown[row, column, place] = i
    return torch.cat([image, (1 - through)[..., None]], -1).float(), shown
