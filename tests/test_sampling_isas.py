"""Texture lookups on every instruction set that this processor has."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

# Gradients that are summed item by item and bin by bin, and channel counts with and without a kernel of their own.
SCRIPT = """
import torch
from mipbake import _native
from mipbake.sampling import ops, reference

_native.set_num_threads(2)
generator = torch.Generator().manual_seed(0)
worst = 0.0
for channels in (1, 2, 3, 4, 6, 8, 11):
    dtype, tolerance = (torch.float64, 1e-11) if channels in (2, 6) else (torch.float32, 1e-4)
    for batch, points, sizes in ((3, 300, ((8, 6), (4, 3))), (1, 4500, ((30, 20), (15, 10)))):
        options = {"generator": generator, "dtype": dtype}
        levels = [torch.rand(batch, h, w, channels, **options).requires_grad_() for h, w in sizes]
        uv = torch.randn(batch, points, 2, **options).requires_grad_()
        lod = (torch.rand(batch, points, **options) * 2 - 0.5).requires_grad_()
        grad = torch.randn(batch, points, channels, **options)
        leaves = [*levels, uv, lod]
        results = []
        for door in (ops.sample, reference.sample):
            out = door(levels, uv, lod, ("wrap", "clamp"))
            results.append([out, *torch.autograd.grad(out, leaves, grad)])
        for actual, expected in zip(*results, strict=True):
            error = (actual - expected).abs().max() / expected.abs().max()
            worst = max(worst, float(error) / tolerance)
print(_native.isa(), worst)
"""


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_every_instruction_set_agrees_with_the_twin(isa: str) -> None:
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={**os.environ, "MIPBAKE_ISA": isa},
        capture_output=True,
        text=True,
        check=True,
    )
    used, worst = run.stdout.split()
    if used != isa:
        pytest.skip(f"this processor or build has no {isa}")
    assert float(worst) < 1
