"""Lookups of the pixels of many chunks at once: what they see of a stack's levels, and the way back to its texels.

A round of texel_descent.py looks the same pixels up several times. Where they lie in each level is worked out once,
and a level is read, and written to, in one call.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling
from mipbake.baking.search.crops import Crop
from mipbake.baking.search.picture_samples import PictureChunk
from mipbake.baking.search.pixel_samples import Chunk
from mipbake.quality.reference.problem import Image
from mipbake.sampling.adjoint import scatter_linear


class Lookups:
    """Where the pixels of chunks lie in the crops of levels.

    Args:
        crops: of every level that they look up.
    """

    def __init__(self, crops: Mapping[int, Crop], chunks: Sequence[Chunk | PictureChunk]) -> None:
        self._crops, self._sizes = crops, [len(chunk.uv) for chunk in chunks]
        self._parts: dict[int, list[tuple[int, NDArray[np.float32] | None]]] = {}
        uv: dict[int, list[Image]] = {}
        for index, chunk in enumerate(chunks):
            for level, share in chunk.seen:
                each = None if share is None else share[:, None]
                self._parts.setdefault(level, []).append((index, each))
                uv.setdefault(level, []).append(crops[level].local(chunk.uv))
        self._uv = {level: np.concatenate(each) for level, each in uv.items()}

    def texels(self) -> list[Image]:
        """(P, C) of each chunk: what its pixels see of the levels as they are now."""
        out: list[Image | None] = [None] * len(self._sizes)
        for level, parts in self._parts.items():
            crop, begin = self._crops[level], 0
            seen = sampling.texture(
                crop.now[None], self._uv[level][None, None], filter_mode="linear", boundary_mode=crop.boundary
            )[0, 0]
            for index, share in parts:
                each = seen[begin : begin + self._sizes[index]]
                begin += len(each)
                if share is not None:
                    each *= share
                before = out[index]
                if before is None:
                    out[index] = each
                else:
                    before += each
        return [each for each in out if each is not None]

    def scattered(self, level: int, rows: Sequence[Image]) -> Image | None:
        """(h', w', D): what (P, D) rows of each chunk's pixels pass back to the texels of a crop, in proportion.

        None where no pixel sees the level.
        """
        if level not in self._parts:
            return None
        crop = self._crops[level]
        values = [rows[index] if share is None else rows[index] * share for index, share in self._parts[level]]
        height, width = crop.now.shape[:2]
        return scatter_linear((height, width), self._uv[level], np.concatenate(values), crop.boundary)
