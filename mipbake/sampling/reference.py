"""The plain twin of the texture lookups: the same definition in torch operations, for tests and for reading.

It is differentiable by torch alone, knows nothing of the native core, and takes the same arguments. Sources: Laine et
al. 2020 (Modular Primitives), section 3.5, for the lookups and their levels; the OpenGL 4.6 specification, section 8.13
(cube maps, table 8.19) and section 8.14 (filtering), and EXT_texture_filter_anisotropic for the taps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from mipbake.sampling._arguments import (
    MAX_TAPS,
    Plan,
    TextureMip,
    check_max_mip_level,
    check_texture,
    level_sizes,
    plan_texture,
)

HALF_TYPES = (torch.float16, torch.bfloat16)


def texture(
    tex: Tensor,
    uv: Tensor,
    uv_da: Tensor | None = None,
    mip_level_bias: Tensor | None = None,
    mip: TextureMip | Sequence[Tensor] | None = None,
    filter_mode: str = "auto",
    boundary_mode: str | Sequence[str] = "wrap",
    max_mip_level: int | None = None,
) -> Tensor:
    """Arguments, result and gradients of `mipbake.sampling.texture`; checks shapes and names only."""
    stack = mip if mip is None or isinstance(mip, TextureMip) else [tuple(level.shape) for level in mip]
    plan = plan_texture(
        tuple(tex.shape),
        tuple(uv.shape),
        None if uv_da is None else tuple(uv_da.shape),
        None if mip_level_bias is None else tuple(mip_level_bias.shape),
        stack,
        filter_mode,
        boundary_mode,
        max_mip_level,
    )
    B, h, w, C = plan.shape
    dtype = _compute_dtype(tex)
    levels = [level.to(dtype) for level in _levels(tex, mip, plan)]
    uv = uv.to(dtype).expand(B, h, w, uv.shape[-1]).reshape(B, h * w, -1)
    if uv_da is not None:
        uv_da = uv_da.to(dtype).expand(B, h, w, uv_da.shape[-1]).reshape(B, h * w, -1, 2)
    bias = None
    if mip_level_bias is not None:
        bias = mip_level_bias.to(dtype).expand(B, h, w).reshape(B, h * w)
    return _lookups(Pyramid.of(levels), uv, uv_da, bias, plan).reshape(B, h, w, C)


def texture_construct_mip(tex: Tensor, max_mip_level: int | None = None, cube_mode: bool = False) -> TextureMip:
    """Arguments and result of `mipbake.sampling.texture_construct_mip`."""
    check_texture("tex", tuple(tex.shape), cube_mode, "cube_mode to True")
    check_max_mip_level(max_mip_level)
    count = len(level_sizes(tex.shape[-3], tex.shape[-2], max_mip_level))
    return TextureMip(tuple(tex.shape), tuple(level.to(tex.dtype) for level in _built(tex.detach(), count)[1:]))


# --- levels ----------------------------------------------------------------------------------------------------------


def _compute_dtype(tex: Tensor) -> torch.dtype:
    return torch.float32 if tex.dtype in HALF_TYPES else tex.dtype


def _levels(tex: Tensor, mip: TextureMip | Sequence[Tensor] | None, plan: Plan) -> list[Tensor]:
    if plan.levels == 1:
        return [tex]
    if mip is not None and not isinstance(mip, TextureMip):
        return [tex, *mip][: plan.levels]
    built = _built(tex, plan.levels)
    if mip is None:
        return built
    # The values of the stack that was made before, the gradient of making it now.
    given = [level.to(own.dtype) for own, level in zip(built[1:], mip.levels, strict=False)]
    return [built[0], *(own + (level - own).detach() for own, level in zip(built[1:], given, strict=True))]


def _built(tex: Tensor, count: int) -> list[Tensor]:
    """Levels by repeated box filtering (section 3.5, figure 2 a), area-weighted where a size is odd.

    In the compute dtype; the values of half types are rounded to the texture's as they are stored, level by level.
    """
    levels = [tex.to(_compute_dtype(tex))]
    while len(levels) < count:
        level = _halved(_halved(levels[-1], -3), -2)
        if tex.dtype in HALF_TYPES:
            level = level + (level.to(tex.dtype).to(level.dtype) - level).detach()
        levels.append(level)
    return levels


def _halved(level: Tensor, axis: int) -> Tensor:
    """Box filter to half the size along an axis: texel i of n covers [i, i + 1] size / n of the finer ones."""
    size = level.shape[axis]
    n = max(1, size // 2)
    if size == 1:
        return level
    first = 2 * torch.arange(n, device=level.device)
    if size % 2 == 0:
        return (level.index_select(axis, first) + level.index_select(axis, first + 1)) / 2
    # size = 2 n + 1: texel i ends at (i + 1) (2 + 1 / n), so that it covers n - i, n and i + 1 of n parts.
    shape = [-1 if a == level.ndim + axis else 1 for a in range(level.ndim)]
    i = (first // 2).to(level.dtype).reshape(shape)
    taps = [level.index_select(axis, first + k) for k in range(3)]
    # The weighted mean in the form that returns equal texels exactly.
    return taps[1] + ((taps[0] - taps[1]) * (n - i) + (taps[2] - taps[1]) * (i + 1)) / size


@dataclass(frozen=True)
class Pyramid:
    """All texels of all levels side by side, (B | 1, N, C), with where each level begins and its size, (levels,)."""

    texels: Tensor
    first: Tensor
    height: Tensor
    width: Tensor
    base: tuple[int, int]

    @staticmethod
    def of(levels: Sequence[Tensor]) -> Pyramid:
        flat = [level.reshape(level.shape[0], -1, level.shape[-1]) for level in levels]
        device = flat[0].device
        counts = torch.tensor([0, *(level.shape[1] for level in flat)], device=device)
        sizes = torch.tensor([level.shape[-3:-1] for level in levels], device=device)
        return Pyramid(
            torch.cat(flat, 1),
            counts.cumsum(0)[:-1],
            sizes[:, 0],
            sizes[:, 1],
            (levels[0].shape[-3], levels[0].shape[-2]),
        )

    def fetch(self, level: Tensor, row: Tensor, column: Tensor, face: Tensor) -> Tensor:
        """(B, P) indices to (B, P, C) texels."""
        height, width = self.height[level], self.width[level]
        index = self.first[level] + (face * height + row) * width + column
        item = torch.arange(index.shape[0], device=index.device)[:, None] % self.texels.shape[0]
        return self.texels[item, index]


# --- lookups ---------------------------------------------------------------------------------------------------------


def _lookups(pyramid: Pyramid, uv: Tensor, uv_da: Tensor | None, bias: Tensor | None, plan: Plan) -> Tensor:
    """(B, P, C) of (B, P, 2 | 3) coordinates, their (B, P, 2 | 3, 2) derivatives and a (B, P) bias."""
    blank = torch.zeros(uv.shape[:-1], dtype=torch.bool, device=uv.device)
    face = torch.zeros_like(blank, dtype=torch.long)
    if plan.boundary[0] == "cube":
        blank = ~uv.isfinite().all(-1) | (uv == 0).all(-1)
        # What is masked out must be harmless all the same, or its gradient is NaN times 0.
        uv = torch.where(blank[..., None], torch.ones_like(uv), uv)
        face, uv, uv_da = _project(uv, uv_da)
    undefined = uv.isnan().any(-1)
    for axis, mode in enumerate(plan.boundary):
        if mode in ("wrap", "mirror"):
            undefined = undefined | uv[..., axis].isinf()

    lod = torch.zeros(uv.shape[:-1], dtype=uv.dtype, device=uv.device)
    taps, reach = torch.ones_like(lod), torch.zeros_like(uv)
    if plan.filter not in ("nearest", "linear"):
        if uv_da is not None:
            lod, taps, reach = _footprint(uv_da, pyramid, plan.filter == "anisotropic")
        if bias is not None:
            lod = lod + bias
        undefined = undefined | lod.isnan()
    uv = torch.where(undefined[..., None], torch.zeros_like(uv), uv)
    lod = torch.where(undefined, torch.zeros_like(lod), lod)

    total = torch.zeros((*uv.shape[:-1], pyramid.texels.shape[-1]), dtype=uv.dtype, device=uv.device)
    for tap in range(int(taps.max()) if taps.numel() else 1):
        at = uv + ((tap + 0.5) / taps - 0.5)[..., None] * reach
        value = _one_tap(pyramid, at, lod, face, plan)
        total = total + torch.where((tap < taps)[..., None], value / taps[..., None], 0)
    total = torch.where(undefined[..., None], torch.nan, total)
    return torch.where(blank[..., None], 0, total)


def _footprint(uv_da: Tensor, pyramid: Pyramid, anisotropic: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Level of detail, number of taps and the major axis in units of uv of (B, P, 2, 2) derivatives.

    The footprint of a pixel is its image under the Jacobian J in texels of level 0. Its major and minor axes are the
    singular values of J (section 3.5: "the texture-space length of the major axis"). Where both are equal the
    derivative of the larger is the mean of its one-sided derivatives.
    """
    scale = torch.tensor([pyramid.base[1], pyramid.base[0]], dtype=uv_da.dtype, device=uv_da.device)
    jacobian = uv_da * scale[:, None]
    infinite = jacobian.isinf().any((-1, -2)) & ~jacobian.isnan().any((-1, -2))
    jacobian = torch.where(infinite[..., None, None], 0, jacobian)
    a, b, c, d = (jacobian[..., i, j] for i in range(2) for j in range(2))
    major = (_length(a + d, b - c) + _length(a - d, b + c)) / 2
    zero = major <= 0  # NaN is not
    lod = torch.where(zero, -torch.inf, torch.log2(torch.where(zero, 1, major)))
    lod = torch.where(infinite, torch.inf, lod)
    if not anisotropic:
        return lod, torch.ones_like(lod), torch.zeros_like(uv_da[..., 0])

    # EXT_texture_filter_anisotropic: N = min(ceil(Pmax / Pmin), maximum), lambda = log2(Pmax / N). A ratio barely above
    # a whole number counts as that number, so that circles take one tap whatever their rounding.
    with torch.no_grad():
        minor = (a * d - b * c).abs() / torch.where(zero, 1, major)
        taps = (major / minor - 2.0**-10).ceil().clamp(1, MAX_TAPS)
        taps = torch.where(zero | infinite | major.isnan(), 1, taps)
    # The major axis is the eigenvector of J J^T of the larger eigenvalue, at half the angle of (across, along).
    along, across = a * a + b * b - c * c - d * d, 2 * (a * c + b * d)
    single = taps == 1
    angle = torch.atan2(torch.where(single, 0, across), torch.where(single, 1, along)) / 2
    axis = major[..., None] * torch.stack([angle.cos(), angle.sin()], -1) / scale
    return lod - torch.log2(taps), taps, torch.where(single[..., None], 0, axis)


def _length(x: Tensor, y: Tensor) -> Tensor:
    """sqrt(x^2 + y^2), with the slope 0 at 0."""
    zero = (x == 0) & (y == 0)
    return torch.where(zero, 0, torch.hypot(torch.where(zero, 1, x), y))


def _one_tap(pyramid: Pyramid, uv: Tensor, lod: Tensor, face: Tensor, plan: Plan) -> Tensor:
    """The lookup at one place: in one level, or linear between the two levels around lod."""
    last = plan.levels - 1
    detail = lod.clamp(0, last)
    finer = detail.detach().floor().long()
    if plan.filter == "nearest":
        return _nearest(pyramid, uv, finer, face, plan.boundary)
    if plan.filter == "linear":
        return _bilinear(pyramid, uv, finer, face, plan.boundary)
    if plan.filter == "linear-mipmap-nearest":
        return _bilinear(pyramid, uv, (detail.detach() + 0.5).floor().long(), face, plan.boundary)
    coarser = torch.where(lod < 0, finer, (finer + 1).clamp(max=last))
    fine = _bilinear(pyramid, uv, finer, face, plan.boundary)
    coarse = _bilinear(pyramid, uv, coarser, face, plan.boundary)
    return fine + (detail - finer)[..., None] * (coarse - fine)


def _nearest(pyramid: Pyramid, uv: Tensor, level: Tensor, face: Tensor, boundary: tuple[str, str]) -> Tensor:
    indices, inside = [], torch.ones_like(level, dtype=torch.bool)
    for coordinate, size, mode in zip(uv.unbind(-1), (pyramid.width, pyramid.height), boundary, strict=True):
        extent = size[level]
        position = (_folded(coordinate.detach(), mode) * extent).floor()
        index = position.clamp(-(2.0**31), 2.0**31).long()
        if mode == "mirror":
            index = torch.where(index < 0, -1 - index, index)
        if mode == "zero":
            inside = inside & (index >= 0) & (index < extent)
        indices.append(torch.minimum(index.clamp(min=0), extent - 1))
    column, row = indices
    return torch.where(inside[..., None], pyramid.fetch(level, row, column, face), 0)


def _bilinear(pyramid: Pyramid, uv: Tensor, level: Tensor, face: Tensor, boundary: tuple[str, str]) -> Tensor:
    columns, x = _axis(uv[..., 0], pyramid.width[level], boundary[0])
    rows, y = _axis(uv[..., 1], pyramid.height[level], boundary[1])
    fetch = _fetch_cube if boundary[0] == "cube" else _fetch_flat
    t00, t01, t10, t11 = fetch(pyramid, level, rows, columns, face)
    upper = t00 + x * (t01 - t00)
    lower = t10 + x * (t11 - t10)
    return upper + y * (lower - upper)


def _fetch_flat(
    pyramid: Pyramid, level: Tensor, rows: list[Tensor], columns: list[Tensor], face: Tensor
) -> list[Tensor]:
    """The texels at rows x columns; 0 for an index of -1, which is outside."""
    texels = []
    for row in rows:
        for column in columns:
            inside = (row >= 0) & (column >= 0)
            texel = pyramid.fetch(level, row.clamp(min=0), column.clamp(min=0), face)
            texels.append(torch.where(inside[..., None], texel, 0))
    return texels


def _folded(coordinate: Tensor, mode: str) -> Tensor:
    """The same place within a period: [0, 1) where the texture repeats, [-1, 1) where it is mirrored."""
    if mode == "wrap":
        return coordinate - coordinate.detach().floor()
    if mode == "mirror":
        return coordinate - 2 * ((coordinate.detach() + 1) / 2).floor()
    return coordinate


def _axis(coordinate: Tensor, size: Tensor, mode: str) -> tuple[list[Tensor], Tensor]:
    """The texels before and after a coordinate (B, P), and the fraction of the way between them (B, P, 1).

    Texel i is centred at (i + 1/2) / size. -1 stands for a texel outside; cubes get the indices as they are.
    """
    extent = size.to(coordinate.dtype)
    position = _folded(coordinate, mode) * extent - 0.5
    # A coordinate within its own rounding error of a texel centre is at the centre, exactly.
    error = (coordinate.detach().abs().clamp(min=1) * extent * torch.finfo(extent.dtype).eps).clamp(max=2.0**-9)
    distance = (position - position.round()).detach()
    position = position - torch.where(distance.abs() <= error, distance, 0)
    below = position < 0
    if mode == "clamp":
        position = position.clamp(min=0)
        position = torch.where(position > extent - 1, extent - 1, position)
    elif mode == "zero":
        position = position.clamp(min=-2)
        position = torch.where(position > extent, extent, position)
    before = position.detach().floor().long()
    after = before + 1
    fraction = (position - before)[..., None]
    if mode == "wrap":
        return [before % size, after % size], fraction
    if mode == "mirror":  # texel -1 is texel 0 again, texel n is texel n - 1
        folded = [torch.where(index < 0, -1 - index, index) for index in (before, after)]
        return [torch.where(index >= size, 2 * size - 1 - index, index) for index in folded], fraction
    if mode == "clamp":
        return [before, torch.where(below, before, torch.minimum(after, size - 1))], fraction
    if mode == "zero":
        return [torch.where((index >= 0) & (index < size), index, -1) for index in (before, after)], fraction
    return [before, after], fraction


# --- cube maps -------------------------------------------------------------------------------------------------------

# OpenGL 4.6, table 8.19: the directions of sc, tc and ma for the faces +x, -x, +y, -y, +z, -z.
FACES = (
    ((0, 0, -1), (0, -1, 0), (1, 0, 0)),
    ((0, 0, 1), (0, -1, 0), (-1, 0, 0)),
    ((1, 0, 0), (0, 0, 1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, -1), (0, -1, 0)),
    ((1, 0, 0), (0, -1, 0), (0, 0, 1)),
    ((-1, 0, 0), (0, -1, 0), (0, 0, -1)),
)


def _face_of(vector: Tensor) -> Tensor:
    """The face that (..., 3) vectors point at: their component of largest magnitude, x before y before z."""
    axis = vector.detach().abs().argmax(-1)
    return 2 * axis + (vector.detach().gather(-1, axis[..., None])[..., 0] < 0)


def _project(vector: Tensor, derivatives: Tensor | None) -> tuple[Tensor, Tensor, Tensor | None]:
    """Face, (s, t) on it and their (..., 2, 2) derivatives of (..., 3) vectors with (..., 3, 2) derivatives.

    s = (sc / |ma| + 1) / 2 and t = (tc / |ma| + 1) / 2; their Jacobian by the quotient rule.
    """
    face = _face_of(vector)
    frame = torch.tensor(FACES, dtype=vector.dtype, device=vector.device)[face]
    local = (frame @ vector[..., None])[..., 0]
    ratio, ma = local[..., :2] / local[..., 2:], local[..., 2]
    if derivatives is not None:
        along = frame @ derivatives
        derivatives = (along[..., :2, :] - ratio[..., None] * along[..., 2:, :]) / (2 * ma[..., None, None])
    return face, (ratio + 1) / 2, derivatives


def _fetch_cube(
    pyramid: Pyramid, level: Tensor, rows: list[Tensor], columns: list[Tensor], face: Tensor
) -> list[Tensor]:
    """The texels at rows x columns, beyond an edge the texels of the next face; beyond a corner the mean of the
    others."""
    size = pyramid.width[level]
    texels, corners = [], []
    for row in rows:
        for column in columns:
            corners.append(((row < 0) | (row >= size)) & ((column < 0) | (column >= size)))
            texels.append(pyramid.fetch(level, *_across_edge(row, column, size, face)))
    present = sum(torch.where(corner[..., None], 0, t) for corner, t in zip(corners, texels, strict=True))
    return [torch.where(corner[..., None], present / 3, t) for corner, t in zip(corners, texels, strict=True)]


def _across_edge(row: Tensor, column: Tensor, size: Tensor, face: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Row, column and face of the texel that lies at (row, column) of a face continued over its edges.

    In units of half a texel the cube is [-size, size]^3 and texel centres are whole. A centre beyond an edge folds down
    the next face by as much as it is beyond.
    """
    frames = torch.tensor(FACES, device=row.device)
    sc, tc = 2 * column + 1 - size, 2 * row + 1 - size
    beyond = (sc.abs() - size).clamp(min=0) + (tc.abs() - size).clamp(min=0)
    local = torch.stack([torch.maximum(torch.minimum(c, size), -size) for c in (sc, tc)] + [size - beyond], -1)
    point = (local[..., None] * frames[face]).sum(-2)
    face = _face_of(point)
    sc, tc, _ = (frames[face] * point[..., None, :]).sum(-1).unbind(-1)
    last = size - 1  # a corner folds to no texel of its own: any that exists will do
    return (torch.minimum((tc + last) // 2, last), torch.minimum((sc + last) // 2, last), face)
