"""Which texture sets are measured in engines, and the parts of them that are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mipbake
from mipbake import TextureSet


def first_sets(folder: Path, count: int, side: int) -> Iterator[TextureSet]:
    """The middle of each of the first sets by name whose normal and roughness come from files."""
    for path in sorted(each for each in folder.iterdir() if each.is_dir()):
        if count == 0:
            return
        texture_set = mipbake.load(path)
        if all(texture_set.maps[role].source.path for role in ("normal", "roughness")):
            count -= 1
            yield _middle(texture_set, side)


def _middle(texture_set: TextureSet, side: int) -> TextureSet:
    """The middle `side` x `side` texels, which repeat."""
    stored = texture_set.material("gltf")
    top, left = ((length - min(side, length)) // 2 for length in stored.shape[:2])
    part = stored[top : top + side, left : left + side]
    return TextureSet.from_arrays(
        texture_set.name,
        base_color=part[..., 0:3],
        metallic=part[..., 3],
        roughness=part[..., 4],
        normal=part[..., 5:8],
    )
