"""Texture lookups on every instruction set that this processor has."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

# Gradients that are summed item by item and bin by bin, and channel counts with and without a kernel of their own.
SCRIPT = """
import torch
from mipbake import _native, sampling
from mipbake.sampling import reference

_native.set_num_threads(2)
generator = torch.Generator().manual_seed(0)
worst = 0.0
BOUNDARIES = [("wrap", "clamp"), ("mirror", "zero"), "cube"]
FILTERS = ["nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear", "anisotropic"]
case = 0
for channels in (1, 2, 3, 4, 6, 8, 11):
    dtype, tolerance = (torch.float64, 1e-9) if channels in (2, 6) else (torch.float32, 2e-3)
    for batch, points, size in ((3, 100, 8), (1, 2100, 31)):
        for boundary in BOUNDARIES:
            case += 1
            cube = boundary == "cube"
            filter_mode = FILTERS[case % (4 if cube else 5)]
            options = {"generator": generator, "dtype": dtype}
            tex = torch.rand(batch, *((6, size) if cube else (size - 1,)), size, channels, **options).requires_grad_()
            # Away from the kinks, where single and double precision may fall on different sides.
            uv = (2 * torch.randint(-9000, 9000, (batch, 1, points, 2), generator=generator) + 1).to(dtype) / 8192
            if cube:
                uv = torch.cat([uv.clamp(-0.999, 0.999), torch.ones_like(uv[..., :1])], -1).roll(case, -1)
            uv.requires_grad_()
            uv_da = (torch.randn(batch, 1, points, 6 if cube else 4, **options) * 0.1).requires_grad_()
            bias = (torch.rand(batch, 1, points, **options) - 0.5).requires_grad_()
            grad = torch.randn(batch, 1, points, channels, **options)
            leaves = [tex, uv, uv_da, bias]
            results = []
            for door in (sampling, reference):
                out = door.texture(*leaves, filter_mode=filter_mode, boundary_mode=boundary)
                found = torch.autograd.grad(out, leaves, grad, allow_unused=True, materialize_grads=True)
                results.append([out, *found])
            for actual, expected in zip(*results, strict=True):
                error = (actual - expected).norm() / expected.norm().clamp(min=1e-30)
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
