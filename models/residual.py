"""A latent network that corrects the average instead of only starting from it: `LatentConfig.residual`.

The first P latents *are* the pixel-filtered whitened parameters and one more is the filtered sum of their squares, so
that any level knows mean and variance of what it covers. The output is the mean plus the decoder's correction times
v / (v + c), v the variance: where a material is constant the result is exactly the average, and where it hardly varies
it hardly differs.

The weights `residual-ggx` are all that needs this file. With it go the lines that say `residual` or `fixed_latents` in
latent_config.py, and `fixed_latents` or `filtered` in latent_network.py and latent_inference.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from mipbake.models.latent import pixel_taps
from mipbake.models.latent_config import PARAMETERS
from mipbake.models.latent_network import LatentNetwork
from mipbake.models.parameters import to_parameters
from mipbake.models.tiles import extend

_GATE = 0.01
"""c: variance, in whitened units and summed over parameters, at which half of the correction is applied."""

_STEP = 0.1
"""Scale of the correction: it bounds what one step of Adam, which knows no scale, does to glossy highlights."""


class ResidualNetwork(LatentNetwork):
    """One encoder, and one decoder of the same material model."""

    filtered = True

    def _pass_through(self) -> None:
        """Nothing: the correction starts at zero."""

    def _start_linear(self, samples: Mapping[str, Mapping[str, Tensor]]) -> None:
        """Nothing: it stays linear prefiltering but for the correction."""

    def _encode_periodic(self, stored: Tensor, source: str) -> Tensor:
        return self.encode_extended(extend(stored, self.halo, ("wrap", "wrap")), source)

    def encode_extended(self, stored: Tensor, source: str | None = None) -> Tensor:
        """See LatentNetwork."""
        (model,) = self.config.encoders
        whitened = self.whitening_of(model)(to_parameters(stored, source or model))
        return torch.cat([self._moments(whitened), self.encoder_of(model)(whitened)], -1)

    def _moments(self, whitened: Tensor) -> Tensor:
        """(B, H + 2 halo, W + 2 halo, P) to (B, H, W, P + 1): filtered parameters, filtered sum of their squares."""
        taps = pixel_taps(self.config.latent_filter)
        border = self.halo - len(taps) // 2
        moments = torch.cat([whitened, whitened.square().sum(-1, keepdim=True)], -1)
        moments = moments[:, border : moments.shape[1] - border, border : moments.shape[2] - border]
        for axis in (1, 2):
            size = moments.shape[axis] - len(taps) + 1
            moments = torch.stack([w * moments.narrow(axis, i, size) for i, w in enumerate(taps)]).sum(0)
        return moments

    def whitened(self, latent: Tensor, target: str) -> Tensor:
        """See LatentNetwork."""
        p = PARAMETERS[target]
        mean = latent[..., :p]
        variance = (latent[..., p : p + 1] - mean.square().sum(-1, keepdim=True)).clamp(min=0)
        return mean + _STEP * variance / (variance + _GATE) * super().whitened(latent, target)

    def load_state_dict(self, state_dict: Mapping[str, Any], *args: Any, **kwargs: Any) -> Any:
        """Takes tensors by the names of their release, too, when a network had one encoder and one decoder."""
        if not any(name.startswith("encoders.") for name in state_dict):
            (model,) = self.config.encoders
            parts = {
                "whitening": f"whitening.{model}",
                "encoder": f"encoders.{model}.layers",
                "project": f"encoders.{model}.project",
                "decoder": f"decoders.{model}.layers",
                "output": f"decoders.{model}.output",
            }
            named = {name: name.split(".", 1) for name in state_dict}
            state_dict = {f"{parts.get(part, part)}.{rest}": state_dict[name] for name, (part, rest) in named.items()}
        return super().load_state_dict(state_dict, *args, **kwargs)
