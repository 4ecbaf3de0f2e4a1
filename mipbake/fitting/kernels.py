"""The renderer `torch`: mipbake's own kernels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.meshes.mesh_render import Shot, candidate
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.program import Frame
from mipbake.fitting.renderer import Array, Levels
from mipbake.fitting.views import View
from mipbake.material import model_named

_KEPT = 2  # stacks of other sizes that stay decoded: the one that is fitted, and level 0 that references are made of


@dataclass(eq=False)
class TorchRenderer:
    """Renders meshes by the library's own kernels: one trilinear lookup for each pixel, shaded once, in float32."""

    called = "torch"
    _kept: dict[Any, tuple[tuple[NDArray[np.int64], ...], list[Array]]] = field(default_factory=dict)

    def render(self, levels: Levels, view: View) -> Frame:
        """The frame of a view: linear radiance."""
        shot = Shot(view.mesh, view.camera, view.lighting, view.size)
        seen = candidate(shot, self._stored(levels), levels.model, levels.wrap, offset=view.offset)
        return Frame(seen.image, seen.uv, lod=seen.lod, id=seen.coverage)

    def _stored(self, levels: Levels) -> list[Array]:
        """Stored channels of each level. Tiles that have not changed are not decoded again."""
        model, key = model_named(levels.model), (levels.model, tuple(levels.sizes))
        known, decoded = self._kept.pop(key, (None, None))
        if decoded is None:
            decoded = [np.empty((*size, model.channels), np.float32) for size in levels.sizes]
        for index, parts in enumerate(levels.changed(known)):
            for part in parts:
                texels = np.concatenate([part.of(each[index]) for each in levels.maps.values()], -1, dtype=np.float32)
                alone = Parameters(model, ((part.height, part.width),))
                part.of(decoded[index])[...] = alone.stored(texels.reshape(-1, model.channels))[0]
        self._kept[key] = levels.stamps, decoded  # the last one in the order
        if len(self._kept) > _KEPT:
            del self._kept[next(iter(self._kept))]
        return decoded
