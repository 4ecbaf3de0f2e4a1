"""The renderer `torch`: mipbake's own kernels, whose exact gradients stochastic ones are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.meshes.mesh_render import Shot, candidate
from mipbake.comparing.meshes.visible import Points, Surface
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.renderer import Array, Frame, Levels
from mipbake.fitting.views import View
from mipbake.material import model_named

if TYPE_CHECKING:
    from torch import Tensor

_KEPT = (
    2  # stacks of other sizes that are kept decoded: the one that is fitted, and level 0 that references are made of
)


@dataclass(eq=False)
class TorchRenderer:
    """Renders meshes by the library's own kernels: one trilinear lookup for each pixel, shaded once, in float32.

    Levels of any material model will do. It has what renderers need not have: `exact_gradient`.
    """

    called = "torch"
    """What provenance calls it."""

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

    def exact_gradient(
        self, parameters: Parameters, values: Array, wrap: tuple[str, str], view: View, reference: Array
    ) -> tuple[float, Array]:
        """The sum of squared differences of a view from a reference image, and its gradient, by backpropagation.

        Args:
            parameters, values: (texels, channels) of a stack, as `Parameters.values` gives them.
            reference: (H, W, 3).

        Returns:
            The sum over pixels that show the mesh, and its gradient, (texels, channels) float32. A normal's z is taken
            from x and y, and gets no gradient.
        """
        import torch

        surface = Surface(view.mesh, view.camera, view.size)
        points = surface.seen(view.offset)
        leaf = torch.tensor(values, requires_grad=True)
        image = _lit(_decode(leaf, parameters), parameters, points, view, wrap)
        wanted = torch.from_numpy(np.ascontiguousarray(reference[::-1].reshape(-1, 3)[points.index]))
        loss = (image - wanted).square().sum()
        (gradient,) = torch.autograd.grad(loss, leaf)
        return float(loss.detach()), gradient.numpy()


def _decode(values: Tensor, parameters: Parameters) -> Tensor:
    """Stored channels of values, as `Parameters.stored` decodes them."""
    import torch

    from mipbake.material import Kind
    from mipbake.material.kinds import COLOUR, SIGNED

    parts = []
    for each in parameters.model.stored:
        own = values[:, parameters.model.maps[each.name]]
        if each.facts.encoding == COLOUR:
            powered = ((own.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4
            own = torch.where(own <= 0.04045, own / 12.92, powered)
        elif each.facts.encoding == SIGNED:
            own = 2 * own - 1
        if each.kind is Kind.NORMAL:
            own = torch.cat([own[:, :2], (1 - own[:, :2].square().sum(-1, keepdim=True)).clamp_min(1e-6).sqrt()], -1)
        parts.append(own)
    return torch.cat(parts, -1)


def _lit(stored: Tensor, parameters: Parameters, points: Points, view: View, wrap: tuple[str, str]) -> Tensor:
    """(P, 3) radiance, of all lights together."""
    from mipbake import sampling
    from mipbake.shading import reference as twin

    def of(array: NDArray[Any]) -> Tensor:
        import torch

        return torch.from_numpy(np.ascontiguousarray(array, np.float32))

    levels = _cut(stored, parameters)
    texels = sampling.texture(
        levels[0], of(points.uv)[None, None], of(points.uv_da)[None, None], mip=levels[1:],
        filter_mode="linear-mipmap-linear", boundary_mode=wrap,
    )[0, 0]  # fmt: skip
    light, radiance = of(view.lighting.direction), of(view.lighting.radiance)
    return twin.shade_lit(parameters.model.name, texels, of(points.frame), of(points.view), light, radiance)


def _cut(stored: Tensor, parameters: Parameters) -> Sequence[Tensor]:
    starts = parameters.starts
    return [
        stored[first:last].reshape(1, *size, -1)
        for size, first, last in zip(parameters.sizes, starts[:-1], starts[1:], strict=True)
    ]
