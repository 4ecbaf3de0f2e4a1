"""The rendering loss (section 3.2 of Kemppinen et al. 2023).

A patch is a torus. For each of S levels of detail it is seen by a grid of pixels as fine as its texels, each pixel
somewhere inside its texel (the random sub-pixel jitter). For each light-view pair:

- prediction: the predicted stack looked up once, trilinearly, and shaded once;
- noisy reference: level 0 looked up bilinearly at the pixel plus 2^lod times an offset drawn from the pixel filter,
  shaded; or the mean of several such samples. Its expectation is the filtered render (equation 3), and the optimum of
  the loss is just that (Noise2Noise).

One estimator, in `mipbake.quality.reference`, makes noisy references and the references of measures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import filter_named
from mipbake.models.base import Network
from mipbake.quality.metrics.pairs import cosine_directions, near_mirror_lights
from mipbake.quality.reference.estimate import estimate
from mipbake.quality.reference.lighting import GroupPairs
from mipbake.quality.reference.samples import Pixels
from mipbake.sampling import texture
from mipbake.shading import _forward
from mipbake.training.base import TORUS, Batch, Loss
from mipbake.training.checks import require, require_least, require_power_of_two, require_shares

EPSILON = 1e-4
"""Epsilon of equation 5, per summed value: a render whose mean square radiance lies below it counts less and less. So a
patch that is predicted black, its normals beyond the horizon, does not outweigh thousands of others."""


@dataclass(frozen=True)
class Views:
    """What one step looks at: B patches, K pairs, S levels of detail, N pixels each.

    Args:
        light, view: (B, K, 3) unit vectors.
        lod: (B, S) levels of detail.
        uv: (B, S, N, 2) pixel positions.
    """

    light: Tensor
    view: Tensor
    lod: Tensor
    uv: Tensor


@dataclass(frozen=True)
class SingleLightsBatch(Batch):
    """Of one step, beside the patches.

    Args:
        noisy_reference: (B, S, K, N, 3).
    """

    views: Views
    noisy_reference: Tensor


@dataclass(frozen=True)
class SingleLightsLossConfig(Loss[SingleLightsBatch]):
    """One step's batch and its loss (section 3.2).

    Args:
        crops: material patches a step.
        crop_size: their side in texels, a power of two.
        pairs: light-view pairs a patch.
        near_mirror_fraction: share of the pairs whose light lies near the mirror direction of the view.
        lods: levels of detail drawn for each patch.
        pixel_filter: filter of the noisy reference.
        target_samples: surface samples whose mean is one pixel of the noisy reference; divides `pairs`.
    """

    kind: ClassVar[str] = "single-lights"

    crops: int = 1
    crop_size: int = 32
    pairs: int = 64
    near_mirror_fraction: float = 0.0
    lods: int = 5
    pixel_filter: str = "gaussian"
    target_samples: int = 1

    def __post_init__(self) -> None:
        require_least(1, self, "loss", "crops", "pairs", "lods", "target_samples")
        require_power_of_two("loss.crop_size", self.crop_size)
        require_shares(self, "loss", "near_mirror_fraction")
        require(self.pairs % self.target_samples == 0, "loss.target_samples", "a divisor of pairs", self.target_samples)
        filter_named(self.pixel_filter)

    @property
    def mirror_pairs(self) -> int:
        """How many of the pairs are near the mirror."""
        return round(self.near_mirror_fraction * self.pairs)

    @property
    def drawn(self) -> str:
        """See Loss."""
        return f"{self.mirror_pairs} of them near the mirror direction"

    def draw(self, patches: Tensor, source: str, rng: np.random.Generator) -> SingleLightsBatch:
        """See Loss. The noisy reference is rendered in the model that is read (section 3.5)."""
        views = draw_views(self, rng)
        noisy_reference = draw_noisy_reference(patches, views, source, self.pixel_filter, self.target_samples, rng)
        return SingleLightsBatch(source, patches, views, noisy_reference)

    def value(self, network: Network, batch: SingleLightsBatch) -> Tensor:
        """See Loss."""
        stacks = network(batch.patches, batch.source, self.pixel_filter)
        losses = [
            render_loss(trilinear(levels, batch.views), model, batch.views, batch.noisy_reference)
            for model, levels in stacks.items()
        ]
        return torch.stack(losses).mean() if len(losses) > 1 else losses[0]


def draw_views(config: SingleLightsLossConfig, rng: np.random.Generator) -> Views:
    """Random pairs, levels of detail (uniform to half a level beyond both ends, then clamped) and pixel positions."""
    b, s, n = config.crops, config.lods, config.crop_size
    view = cosine_directions(rng, b * config.pairs).reshape(b, config.pairs, 3)
    light = cosine_directions(rng, b * config.pairs).reshape(b, config.pairs, 3)
    mirror = config.mirror_pairs
    if mirror:
        light[:, :mirror] = near_mirror_lights(rng, view[:, :mirror].reshape(-1, 3)).reshape(b, mirror, 3)
    lod = np.clip(rng.uniform(-0.5, config.max_lod + 0.5, (b, s)), 0, config.max_lod)
    row, column = np.divmod(np.arange(n * n, dtype=np.float32), n)
    uv = (np.stack([column, row], -1) + rng.random((b, s, n * n, 2), np.float32)) / n
    return Views(
        torch.from_numpy(light.astype(np.float32)),
        torch.from_numpy(view.astype(np.float32)),
        torch.from_numpy(lod.astype(np.float32)),
        torch.from_numpy(uv),
    )


def draw_noisy_reference(
    patches: Tensor, views: Views, model: str, pixel_filter: str, samples: int, rng: np.random.Generator
) -> Tensor:
    """Unbiased noisy references (B, S, K, N, 3) of (B, size, size, C) patches, each the mean of `samples` samples.

    A pixel is looked up K times in all. `samples` pairs share as many of the lookups, so that more samples of a noisy
    reference cost shading, which is cheap, and no lookups; with one, every pair has a lookup of its own.
    """
    (b, k), (lods, n) = views.light.shape[:2], views.uv.shape[1:3]
    light, view = (d.numpy().reshape(b, k // samples, samples, 3) for d in (views.light, views.view))
    uv, lod = views.uv.numpy(), views.lod.numpy()
    out = np.empty((b, lods, k // samples, samples, n, 3), np.float32)
    for patch in range(b):
        source = FilteredSource(patches[patch].numpy(), model, TORUS, pixel_filter)
        pairs = GroupPairs(light[patch], view[patch])
        for level in range(lods):
            pixels = Pixels(uv[patch, level], float(lod[patch, level]))
            estimate(source, pixels, pairs, samples, rng, out[patch, level])
    return torch.from_numpy(out.reshape(b, lods, k, n, 3))


def trilinear(levels: list[Tensor], views: Views) -> Tensor:
    """(B, S, N, C) texels of a stack of (B, H_L, W_L, C) levels, looked up once a pixel."""
    lod = views.lod[:, :, None].expand(views.uv.shape[:3])
    return texture(levels[0], views.uv, None, lod, levels[1:], boundary_mode=TORUS)


def render_loss(texels: Tensor, model: str, views: Views, noisy_reference: Tensor) -> Tensor:
    """Shades texels and compares: the mean over all renders of squared error over norm, a scalar (equation 5).

    A render's error and norm are sums over its pixels and channels. The norm is a constant to the gradient.

    Args:
        texels: (B, S, N, C) stored channels, one a pixel.
        noisy_reference: (B, S, K, N, 3).
    """
    out: Tensor = _RenderLoss.apply(texels, model, views, noisy_reference)  # type: ignore[no-untyped-call]
    return out


class _RenderLoss(torch.autograd.Function):
    """Backwards at once. On the processor a level of detail at a time: its renders are used while they are near a core.
    On a graphics card all levels of detail together: calls are few, and renders fit."""

    @staticmethod
    def forward(ctx: Any, texels: Tensor, model: str, views: Views, noisy_reference: Tensor) -> Tensor:
        needed = ctx.needs_input_grad[0]
        renders = noisy_reference.shape[0] * noisy_reference.shape[1] * noisy_reference.shape[2]
        total = texels.new_zeros(())
        gradient = torch.empty_like(texels) if needed else None
        lods, points = texels.shape[1:3]
        together = 1 if texels.device.type == "cpu" else lods
        for first in range(0, lods, together):
            lod = slice(first, first + together)
            given = model, texels[:, lod].flatten(1, 2), views.light, views.view
            render = _forward.shade(*given)
            apart = render.reshape(*render.shape[:2], together, points, 3).movedim(2, 1)  # as the noisy reference
            norm = relative_norms(apart.flatten(0, 1))
            apart -= noisy_reference[:, lod]
            total += (energies(apart.flatten(0, 1)) / norm).sum() / renders
            if gradient is not None:
                apart *= (2 / renders / norm).reshape(len(texels), together, -1, 1, 1)
                found = _forward.shade_backward(*given, render)
                gradient[:, lod] = found.reshape(gradient[:, lod].shape)
        ctx.save_for_backward(gradient)
        return total

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        (gradient,) = ctx.saved_tensors
        return (grads[0] * gradient if gradient is not None else None), *(None,) * 3


def energies(renders: Tensor) -> Tensor:
    """(B, K, N, 3) to (B, K): squares summed over pixels and channels."""
    norms: Tensor = torch.linalg.vector_norm(renders.flatten(2), dim=2)
    return norms.square()


def relative_norms(prediction: Tensor) -> Tensor:
    """The denominators of equation 5 for (B, K, N, 3) predicted renders: (B, K)."""
    return energies(prediction) + EPSILON * prediction[0, 0].numel()
