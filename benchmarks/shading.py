"""Shading with its gradient: mipbake.shading against the plain torch twin, in one run; prints Markdown.

    python benchmarks/shading.py [--threads 1] [--rounds 7]

One evaluation is one texel of `ggx` under one light-view pair, 11 stored channels; the default size is the batch of
Kemppinen et al. 2023, 64 pairs x 5120 texels. Forward + gradient computes the radiance and, from a given gradient of
it, the gradient of the material. Times are medians over the rounds, which alternate between the candidates; the spread
is (largest - smallest) / median. MIPBAKE_ISA chooses another instruction set than the best.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from timing import arguments, cpu_name, measure, table
from torch import Tensor

from mipbake import _native
from mipbake.shading import reference
from mipbake.shading import shade as kernel_shade

PAIRS, TEXELS, BATCH = 64, 1024, 5
EVALUATIONS = PAIRS * TEXELS * BATCH
REPEATS = 20
"""Calls of the kernel that count as one measurement, for a steady clock."""

Shade = Callable[..., Tensor]


def batch(device: torch.device | str = "cpu") -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Stored channels, lights, views, and a gradient of the radiance."""
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((2, BATCH, PAIRS, 3))
    directions[..., 2] = np.abs(directions[..., 2]) + 0.2
    light, view = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    low, high = np.array([[0, 1]] * 6 + [[-0.4, 0.4]] * 2 + [[-8, 0]] * 2 + [[-1, 1]]).T
    stored = rng.uniform(low, high, (BATCH, TEXELS, 11))
    weights = rng.standard_normal((BATCH, PAIRS, TEXELS, 3))
    a, b, c, d = (torch.from_numpy(each).float().to(device) for each in (stored, light, view, weights))
    return a, b, c, d


def calls(shade: Shade, device: torch.device | str = "cpu", times: int = 1) -> dict[str, Callable[[], object]]:
    """Forward, and forward with the gradient of the material."""
    stored, light, view, weights = batch(device)
    wanted = stored.clone().requires_grad_()

    def forward() -> None:
        for _ in range(times):
            shade("ggx", stored, light, view)

    def both() -> None:
        for _ in range(times):
            torch.autograd.grad(shade("ggx", wanted, light, view), wanted, weights)

    return {"forward": forward, "forward + gradient": both}


def main() -> None:
    options = arguments(__doc__, threads=1, rounds=7)
    torch.set_num_threads(options.threads)
    _native.set_num_threads(options.threads)
    ways: dict[str, tuple[Shade, int]] = {"kernel": (kernel_shade, REPEATS), "torch": (reference.shade, 1)}
    ways["torch.compile"] = torch.compile(reference.shade), 1
    candidates = {f"{who}, {what}": call for who, (shade, times) in ways.items()
                  for what, call in calls(shade, times=times).items()}  # fmt: skip
    rows = []
    found = measure(candidates, options.rounds)
    for name, timing in found.items():
        who, what = name.split(", ")
        label = _native.isa() if who == "kernel" else f"torch {torch.__version__}"
        seconds = timing.median / ways[who][1]
        faster = found[f"torch, {what}"].median / seconds
        each = f"{seconds / EVALUATIONS * 1e9:.1f}"
        rows.append([name, label, str(options.threads), each, f"{timing.spread:.0%}", f"{faster:.1f}"])
    print(f"{EVALUATIONS:,} evaluations of `ggx`, 11 channels; {cpu_name()}\n")
    heads = ["what", "instruction set", "threads", "ns per evaluation", "spread", "times faster than torch"]
    print(table(heads, rows))


if __name__ == "__main__":
    main()
