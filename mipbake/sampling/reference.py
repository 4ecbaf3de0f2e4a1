"""The plain twin of the texture lookups: the same definition in torch operations, for tests and for reading.

It is differentiable by torch alone, knows nothing of the native core, and computes every lookup in every level.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


def sample(levels: Sequence[Tensor], uv: Tensor, lod: Tensor | float, wrap: Sequence[str] = ("wrap", "wrap")) -> Tensor:
    """Arguments, result and gradients of `mipbake.sampling.ops.sample`, whose checks it leaves out."""
    uv = uv.to(levels[0].dtype)
    lod = torch.as_tensor(lod, dtype=levels[0].dtype, device=levels[0].device)
    batches = [*levels[0].shape[:-3], *uv.shape[:-2], *lod.shape[:-1]]
    batch, points = max(batches, default=1), uv.shape[-2]
    repeats = wrap[0] == "wrap", wrap[1] == "wrap"

    uv = uv.expand(batch, points, 2)
    lod = lod.expand(batch, points)
    valid = ~(uv.isnan().any(-1) | lod.isnan())
    for axis in range(2):
        valid = valid & ~uv[..., axis].isinf() if repeats[axis] else valid
    # What is masked out must be finite all the same, or its gradient is NaN times 0.
    uv = torch.where(valid[..., None], uv, 0.0)
    lod = torch.where(valid, lod, 0.0)

    every = torch.stack([_bilinear(level if level.ndim == 4 else level[None], uv, repeats) for level in levels])
    last = len(levels) - 1
    detail = lod.clamp(0, last)
    finer = detail.detach().floor().long()
    coarser = torch.where(lod < 0, finer, (finer + 1).clamp(max=last))
    texels = torch.lerp(_choose(every, finer), _choose(every, coarser), (detail - finer)[..., None])
    return torch.where(valid[..., None], texels, torch.nan).reshape(
        *batches[:1] and [batch], points, levels[0].shape[-1]
    )


def _choose(every: Tensor, level: Tensor) -> Tensor:
    """(L, B, P, C) at level (B, P) to (B, P, C)."""
    index = level[None, :, :, None].expand(1, *every.shape[1:])
    return every.gather(0, index)[0]


def _bilinear(level: Tensor, uv: Tensor, repeats: tuple[bool, bool]) -> Tensor:
    """(1 or B, H, W, C) at (B, P, 2) to (B, P, C)."""
    height, width = level.shape[1:3]
    left, right, x = _axis(uv[..., 0], width, repeats[0])
    top, bottom, y = _axis(uv[..., 1], height, repeats[1])
    item = torch.arange(uv.shape[0], device=uv.device)[:, None] % level.shape[0]
    upper = torch.lerp(level[item, top, left], level[item, top, right], x)
    lower = torch.lerp(level[item, bottom, left], level[item, bottom, right], x)
    return torch.lerp(upper, lower, y)


def _axis(coordinate: Tensor, size: int, repeats: bool) -> tuple[Tensor, Tensor, Tensor]:
    """The texels before and after a coordinate (B, P), and the fraction of the way between them (B, P, 1)."""
    position = coordinate * size - 0.5
    if repeats:
        position = (coordinate - coordinate.detach().floor()) * size - 0.5
    below = position < 0
    if not repeats:
        position = position.clamp(0, size - 1)
    # A coordinate within its own rounding error of a texel centre is at the centre, exactly.
    nearest = position.detach().round()
    error = (coordinate.detach().abs().clamp(min=1) * size * torch.finfo(coordinate.dtype).eps).clamp(max=2.0**-9)
    distance = (position - nearest).detach()
    position = position - torch.where(distance.abs() <= error, distance, 0.0)
    first = position.detach().floor()
    fraction = (position - first)[..., None]
    before = first.long()
    after = before + 1
    if repeats:
        return before % size, after % size, fraction
    return before, torch.where(below, before, after.clamp(max=size - 1)), fraction
