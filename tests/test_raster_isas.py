"""The raster primitives on every instruction set that this processor has."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from typing import Any

import pytest
import torch

from mipbake import _native

SCRIPT = """
import sys
import torch
from mipbake import _native
from mipbake.raster import antialias, interpolate, rasterize

generator = torch.Generator().manual_seed(0)
results = []
for dtype in (torch.float32, torch.float64):
    for channels, vertices, triangles in ((1, 30, 20), (4, 900, 700), (11, 90, 60)):
        pos = torch.randn(2, vertices, 4, generator=generator)
        pos[..., 3] = pos[..., 3] / 3 + 1
        tri = torch.randint(0, vertices, (triangles, 3), generator=generator, dtype=torch.int32)
        attr = torch.randn(vertices, channels, generator=generator)
        leaves = [t.to(dtype).requires_grad_() for t in (pos, attr)]
        rast, rast_db = rasterize(None, leaves[0], tri, (70, 101))
        color, slopes = interpolate(leaves[1], rast, tri, rast_db, [0, channels - 1])
        image = antialias(color, rast, leaves[0], tri)
        # Derivatives grow without bound towards the eye.
        near = rast_db.detach().abs().amax(-1, keepdim=True) < 1
        loss = (image**2 * near).sum() + (slopes * near).sum()
        results.append([t.detach() for t in (rast, rast_db, color, slopes, image, *torch.autograd.grad(loss, leaves))])
"""


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_every_instruction_set_agrees(isa: str) -> None:
    """Each agrees with the set in use here: rasters have the same bits, and the rest is equal to rounding."""
    if isa == _native.isa():
        pytest.skip(f"{isa} is what the other tests use")
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT + "torch.save((_native.isa(), results), sys.stdout.buffer)"],
        env={**os.environ, "MIPBAKE_ISA": isa},
        capture_output=True,
        check=True,
    )
    used, scenes = torch.load(io.BytesIO(run.stdout))
    if used != isa:
        pytest.skip(f"this processor or build has no {isa}")
    here: dict[str, Any] = {}
    exec(SCRIPT, here)
    for scene, expected in zip(scenes, here["results"], strict=True):
        assert torch.equal(scene[0], expected[0]) and torch.equal(scene[1], expected[1])
        for actual, value in zip(scene[2:], expected[2:], strict=True):
            assert (actual - value).norm() <= value.norm() * (1e-6 if value.dtype == torch.float32 else 1e-14)
