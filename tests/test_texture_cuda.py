"""Texture lookups with CUDA: they agree with the CPU in every mode."""

from __future__ import annotations

import pytest
import torch

from mipbake import _native, sampling
from mipbake.base.errors import UsageError

from .texture_cases import FILTERS, random_case

NO_CUDA = "no CUDA device and CUDA kernels here: the GPU kernels of the texture lookups are not tested"
pytestmark = pytest.mark.skipif(not (torch.cuda.is_available() and _native.cuda_compiled()), reason=NO_CUDA)


@pytest.mark.parametrize("filter_mode", FILTERS)
def test_cuda_equals_the_cpu(filter_mode: str) -> None:
    for seed in range(60):
        case = random_case(seed, torch.float32, (filter_mode,))
        expected = case.values_and_gradients(sampling)
        actual = case.values_and_gradients(sampling, "cuda")
        assert actual.keys() == expected.keys()
        assert float((actual["out"] - expected["out"]).abs().max()) < 1e-5, seed
        for name, e in expected.items():
            limit = 1e-4 * max(1.0, float(e.abs().max()))
            assert torch.allclose(actual[name], e, rtol=1e-3, atol=limit), (seed, name)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("boundary", ["mirror", "cube"])
def test_half_storage_equals_the_cpu(boundary: str, dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(1)
    cube = boundary == "cube"
    tex = torch.rand(2, *((6, 33) if cube else (35,)), 33, 5, generator=generator).to(dtype)
    uv = torch.randn(2, 30, 40, 3 if cube else 2, generator=generator)
    uv_da = torch.randn(2, 30, 40, 6 if cube else 4, generator=generator) * 0.1
    results = []
    for device in ("cpu", "cuda"):
        leaf = tex.to(device).requires_grad_()
        out = sampling.texture(leaf, uv.to(device), uv_da.to(device), boundary_mode=boundary)
        (grad,) = torch.autograd.grad(out.sum(), leaf)
        results.append([out.cpu(), grad.cpu()])
        assert out.dtype == torch.float32 and grad.dtype == dtype
    eps = torch.finfo(dtype).eps
    torch.testing.assert_close(results[1][0], results[0][0], rtol=0, atol=2 * eps)
    torch.testing.assert_close(results[1][1], results[0][1], rtol=4 * eps, atol=1e-3)


def test_large_textures_equal_the_cpu() -> None:
    generator = torch.Generator().manual_seed(2)
    tex = torch.rand(1, 700, 1021, 4, generator=generator)
    uv = torch.rand(2, 300, 300, 2, generator=generator) * 3 - 1
    uv_da = torch.randn(2, 300, 300, 4, generator=generator) * 0.01
    results = []
    for device in ("cpu", "cuda"):
        leaf = tex.to(device).requires_grad_()
        out = sampling.texture(leaf, uv.to(device), uv_da.to(device), filter_mode="anisotropic")
        (grad,) = torch.autograd.grad(out.square().sum(), leaf)
        results.append([out.detach().cpu(), grad.cpu()])
    # A coordinate's rounding is 1e-4 texels here, and a ratio of axes may fall on either side of a whole number.
    for actual, expected in zip(*results, strict=True):
        error = (actual - expected).norm() / expected.norm()
        assert float(error) < 1e-3


def test_undefined_lookups_have_no_gradients() -> None:
    tex = torch.rand(1, 9, 9, 2, device="cuda", requires_grad=True)
    uv = torch.full((1, 1, 3, 2), 0.3, device="cuda")
    uv[0, 0, 0, 0], uv[0, 0, 1, 1] = torch.nan, torch.inf
    uv.requires_grad_()
    out = sampling.texture(tex, uv, mip_level_bias=torch.full((1, 1, 1), 0.5, device="cuda"))
    assert out.isnan().all(-1).tolist() == [[[True, True, False]]]
    out.sum().backward()
    assert uv.grad is not None and tex.grad is not None
    assert torch.all(uv.grad[0, 0, :2] == 0) and torch.all(tex.grad.isfinite())
    assert float(tex.grad.sum()) == pytest.approx(2)


def test_the_gpu_refuses_double() -> None:
    with pytest.raises(UsageError, match=r"tex is torch\.float64 on cuda:0: expected float32"):
        sampling.texture(torch.ones(1, 2, 2, 1, device="cuda").double(), torch.zeros(1, 1, 1, 2, device="cuda"))
