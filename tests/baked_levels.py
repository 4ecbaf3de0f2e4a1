"""How far two stacks of a material model are apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.material import MIN_ROUGHNESS, model_named


def off(made: str, levels: list[NDArray[np.float32]], others: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Differences of all texels; of directions, which may flip where a lobe is all but round, by what they turn, and of
    roughness as it is shaded."""
    found = []
    for level, other in zip(levels, others, strict=True):
        difference = abs(level - other)
        lines = model_named(made).lines
        if lines is not None:
            strength = level[..., lines.strength]
            x, y, u, v = (each[..., lines.direction][..., i] for each in (level, other) for i in (0, 1))
            difference[..., lines.direction] = (abs(x * v - y * u) * strength[..., 0] ** 2)[..., None]
            narrow, other_narrow = (each[..., lines.roughness].clip(MIN_ROUGHNESS) for each in (level, other))
            difference[..., lines.roughness] = abs(narrow - other_narrow)
            difference[..., lines.strength] = abs(strength**2 - other[..., lines.strength] ** 2)
        found.append(difference.reshape(-1, difference.shape[-1]))
    return np.concatenate(found)
