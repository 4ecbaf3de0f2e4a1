"""Shift-tolerant LPIPS (Ghildyal and Liu 2022), which stands in for LPIPS: its backbone is on PyPI, and LPIPS's is not.

    python -m pip install --no-deps stlpips-pytorch==0.0.2

Like LPIPS (Zhang et al. 2018) it compares what an AlexNet trained on ImageNet sees, channel by channel, with weights
fitted to judgements of people. Its AlexNet has no strides in convolutions, and blurs before it drops texels. The
package has the weights. This code is written anew, because the package's own needs libraries that are not wanted here.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

_PACKAGE, _WEIGHTS = "stlpips_pytorch", "weights/vST0.0/alex_shift_tolerant.pth"
_LAYERS = (("slice1.0", 2), ("slice2.5", 2), ("slice3.9", 1), ("slice4.11", 1), ("slice5.13", 1))
"""Convolutions, and their padding."""

INSTALL = "python -m pip install --no-deps stlpips-pytorch==0.0.2"


def weights_file() -> Path | None:
    """The weights of the package; None where it is not installed."""
    found = importlib.util.find_spec(_PACKAGE)
    return Path(found.origin).parent / _WEIGHTS if found and found.origin else None


class ShiftTolerantLpips:
    """The measure: 0 for equal pictures, more for what looks less alike."""

    def __init__(self, weights: Path) -> None:
        self.parts = torch.load(weights, map_location="cpu", weights_only=True)

    def __call__(self, picture: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
        """Of two (H, W, 3) pictures as displayed, 0 to 1, of 48 pixels a side at least."""
        both = np.stack([picture, reference]).astype(np.float32)
        images = torch.from_numpy(both).permute(0, 3, 1, 2) * 2 - 1
        shift, scale = (self.parts[f"scaling_layer.{name}"] for name in ("shift", "scale"))
        total = 0.0
        with torch.inference_mode():
            for index, seen in enumerate(self._features((images - shift) / scale)):
                one, other = seen / (seen.norm(dim=1, keepdim=True) + 1e-10)
                change = (one - other).square().mean((1, 2))
                total += float(self.parts[f"lin{index}.model.1.weight"].flatten() @ change)
        return total

    def _features(self, maps: Tensor) -> list[Tensor]:
        """What each layer sees, (2, channels, rows, columns)."""
        found = []
        for index, (layer, padding) in enumerate(_LAYERS):
            if index in (1, 2):
                maps = _blurred(functional.max_pool2d(maps, 3, 1))
            weight, bias = (self.parts[f"net.{layer}.{part}"] for part in ("weight", "bias"))
            maps = functional.conv2d(maps, weight, bias, padding=padding)
            maps = functional.relu(_blurred(maps) if index == 0 else maps)
            found.append(maps)
        return found


def _blurred(maps: Tensor) -> Tensor:
    """Every second texel of maps under the kernel (1, 2, 1) / 4 along both axes, mirrored at the borders."""
    kernel = torch.tensor([0.25, 0.5, 0.25])
    weight = torch.outer(kernel, kernel).expand(maps.shape[1], 1, 3, 3)
    return functional.conv2d(functional.pad(maps, (2,) * 4, mode="reflect"), weight, stride=2, groups=maps.shape[1])
