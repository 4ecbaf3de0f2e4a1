"""Rotations as quaternions (w, x, y, z), and the matrices that take points to clip space as OpenGL has it."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def projection(slope: float = 0.4, near: float = 0.1, far: float = 60.0) -> Tensor:
    """(4, 4): eye space, looking along -z, to clip space; `slope` is half the picture's width at distance 1."""
    matrix = torch.zeros(4, 4)
    matrix[0, 0] = matrix[1, 1] = 1 / slope
    matrix[2, 2], matrix[2, 3] = -(far + near) / (far - near), -2 * far * near / (far - near)
    matrix[3, 2] = -1
    return matrix


def to_clip(points: Tensor, rotation: Tensor, distance: float | Tensor, slope: float = 0.4) -> Tensor:
    """(B, V, 4): points (V, 3) or (B, V, 3), turned by `rotation` (B, 3, 3), seen from `distance`, a number or (B,)."""
    matrix = projection(slope).to(points)
    turned = points @ rotation.mT
    away = torch.as_tensor(distance, dtype=points.dtype, device=points.device).reshape(-1, 1)
    eye = torch.cat([turned[..., :2], turned[..., 2:] - away[..., None], torch.ones_like(turned[..., :1])], -1)
    return (eye @ matrix.T).contiguous()


def random_quaternions(count: int, generator: torch.Generator) -> Tensor:
    """(count, 4), uniform over the rotations: a normal distribution has no preferred direction."""
    return torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=-1)


def multiply(first: Tensor, second: Tensor) -> Tensor:
    """The product first * second, which turns by `second` and then by `first`."""
    a, u = first[..., :1], first[..., 1:]
    b, v = second[..., :1], second[..., 1:]
    cross = torch.linalg.cross(*torch.broadcast_tensors(u, v))
    return torch.cat([a * b - (u * v).sum(-1, keepdim=True), a * v + b * u + cross], -1)


def rotation_matrix(quaternion: Tensor) -> Tensor:
    """(..., 3, 3) of quaternions (..., 4) of any length but zero."""
    w, x, y, z = torch.nn.functional.normalize(quaternion, dim=-1).unbind(-1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def slerp(start: Tensor, end: Tensor, amount: float | Tensor) -> Tensor:
    """Spherical interpolation [Shoemake 1985] from unit quaternions `start` (0) to `end` (1), by the shorter way."""
    cosine = (start * end).sum(-1, keepdim=True)
    end = torch.where(cosine < 0, -end, end)
    angle = torch.acos(cosine.abs().clamp(max=1 - 1e-6))
    parts = torch.sin((1 - amount) * angle) * start + torch.sin(amount * angle) * end
    return torch.nn.functional.normalize(parts, dim=-1)


def angle_degrees(first: Tensor, second: Tensor) -> Tensor:
    """Angle of the rotation between two poses, 0 to 180 degrees."""
    cosine = (torch.nn.functional.normalize(first, dim=-1) * torch.nn.functional.normalize(second, dim=-1)).sum(-1)
    return 2 * torch.acos(cosine.abs().clamp(max=1)) * (180 / math.pi)
