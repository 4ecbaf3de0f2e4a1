"""The torch op of shading: gradients, torch.compile, determinism and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from mipbake import _native
from mipbake.base.errors import UsageError
from mipbake.material import MODELS as RECORDS
from mipbake.material import Kind
from mipbake.shading import TurnedAway, reference, shade

from .shading_inputs import MODELS, material, pairs, smooth_material

NO_CUDA = "no CUDA device and CUDA kernels here: the GPU kernels of shading are not tested"
QUICK = ("test_schema", "test_faketensor")  # of an op without a gradient of its own
needs_cuda = pytest.mark.skipif(not (torch.cuda.is_available() and _native.cuda_compiled()), reason=NO_CUDA)


def tensors(
    model: str, B: int, K: int, N: int, dtype: torch.dtype, seed: int = 0, smooth: bool = False
) -> list[Tensor]:
    """A material that requires its gradient, lights and views: float32 values, whatever the dtype."""
    rng = np.random.default_rng(seed)
    stored = (smooth_material if smooth else material)(rng, model, B, N)
    arrays = (stored, *pairs(rng, B, K))
    stored_t, light, view = (torch.from_numpy(a.astype(np.float32)).to(dtype) for a in arrays)
    return [stored_t.requires_grad_(), light, view]


def gradient(call: Any, model: str, arguments: list[Tensor], weights: Tensor) -> Tensor:
    result = call(model, *arguments)
    (grad,) = torch.autograd.grad(result, arguments[0], weights.to(result.dtype))
    return grad.detach()


@pytest.mark.parametrize("rule", ["clamp", "black"])
@pytest.mark.parametrize("model", MODELS)
def test_gradcheck(model: str, rule: TurnedAway) -> None:
    stored, light, view = tensors(model, 2, 5, 3, torch.float64, smooth=True)
    assert torch.autograd.gradcheck(lambda m: shade(model, m, light, view, turned_away=rule), (stored,))


@pytest.mark.parametrize("model", MODELS)
def test_gradients_on_both_sides_of_where_the_normal_turns_away(model: str) -> None:
    """Finite differences at n.v from -0.3 to 0.3, and next to where it begins to be held."""
    stored, *_ = tensors(model, 1, 1, 6, torch.float64, smooth=True)
    cosines = torch.tensor([-0.3, -0.02, -1e-3, 5e-5, 3e-4, 0.3], dtype=torch.float64)
    normal = RECORDS[model].normal
    upright = stored.detach().clone()
    upright[..., normal] = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[: normal.stop - normal.start]
    view = torch.stack([(1 - cosines**2).sqrt(), 0 * cosines, cosines], -1)[None, None]
    light = torch.nn.functional.normalize(torch.tensor([0.1, 0.5, 0.9], dtype=torch.float64), dim=0).expand(1, 1, 6, 3)
    texels = upright.requires_grad_()
    assert torch.autograd.gradcheck(lambda m: shade(model, m, light, view), (texels,), eps=1e-7)
    assert (shade(model, texels, light, view) > 0).all()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-9), (torch.float32, 1e-3)])
def test_gradients_are_those_of_the_twin_in_float64(model: str, dtype: torch.dtype, tolerance: float) -> None:
    weights = torch.randn(2, 40, 70, 3, generator=torch.Generator().manual_seed(1))
    expected = gradient(reference.shade, model, tensors(model, 2, 40, 70, torch.float64), weights.double())
    got = gradient(shade, model, tensors(model, 2, 40, 70, dtype), weights)
    # Terms of both signs cancel in some sums: those are held to what gradients of other texels amount to.
    scale = expected.abs() + expected.abs().median(1, keepdim=True).values
    error = (got - expected).abs() / scale
    assert expected.abs().amax((0, 1)).all()
    assert error.max() < tolerance and error.flatten().quantile(0.99) < tolerance / 100


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_directions_of_each_texel_have_the_gradients_of_one_texel_at_a_time(model: str, dtype: torch.dtype) -> None:
    rng = np.random.default_rng(6)
    light, view = (torch.from_numpy(a).to(dtype) for a in pairs(rng, 2, 7, 35))
    stored, *_ = tensors(model, 2, 1, 35, dtype)
    weights = torch.randn(2, 7, 35, 3, generator=torch.Generator().manual_seed(1))
    got = gradient(shade, model, [stored, light, view], weights)
    for n in (0, 17, 34):
        one = stored[:, n : n + 1].detach().requires_grad_()
        expected = gradient(shade, model, [one, light[:, :, n], view[:, :, n]], weights[:, :, n : n + 1])
        assert torch.equal(got[:, n : n + 1], expected)
    assert (got != 0).any(-1).double().mean() > 0.5
    mixed = stored.detach()[0], light, view[:1, :, 4]
    of_arrays = torch.from_numpy(shade(model, *(each.numpy() for each in mixed)))
    assert torch.equal(shade(model, *mixed), of_arrays)


@pytest.mark.parametrize("rule", ["clamp", "black"])
@pytest.mark.parametrize("each_texel", [False, True])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-11), (torch.float32, 1e-3)])
def test_lights_and_views_have_the_gradients_of_the_twin(model, dtype, tolerance, each_texel, rule):
    rng = np.random.default_rng(8)
    stored = torch.from_numpy(material(rng, model, 2, 35).astype(np.float32))
    light, view = (torch.from_numpy(a).to(dtype) for a in pairs(rng, 2, 7, *([35] if each_texel else [])))
    weights = torch.randn(2, 7, 35, 3, generator=torch.Generator().manual_seed(1))

    def gradients(call: Any, dtype: torch.dtype) -> list[Tensor]:
        leaves = [each.to(dtype).requires_grad_() for each in (light, view)]
        result = call(model, stored.to(dtype), *leaves, turned_away=rule)
        return list(torch.autograd.grad(result, leaves, weights.to(dtype)))

    def unit(model: str, stored: Tensor, light: Tensor, view: Tensor, **rest: Any) -> Tensor:
        directions = (torch.nn.functional.normalize(each, dim=-1) for each in (light, view))
        return reference.shade(model, stored, *directions, **rest)

    for got, expected in zip(gradients(shade, dtype), gradients(unit, torch.float64), strict=True):
        scale = expected.norm(dim=-1, keepdim=True) + expected.norm(dim=-1).mean()
        error = (got - expected).abs() / scale
        assert expected.any() and error.max() < tolerance and error.flatten().quantile(0.99) < tolerance / 10


@pytest.mark.parametrize("model", MODELS)
def test_no_gradient_where_a_channel_has_no_effect(model: str) -> None:
    stored, light, view = tensors(model, 1, 30, 16, torch.float64)
    with torch.no_grad():
        for group in RECORDS[model].of(Kind.NORMAL_XY):
            stored[..., group] *= 1e-3
        for group in RECORDS[model].of(Kind.ROUGHNESS):
            stored[..., group] = 0.03
        for group in RECORDS[model].of(Kind.NORMAL):
            stored[..., group] = 1e-8
    grad = gradient(shade, model, [stored, light, view], torch.ones(1, 30, 16, 3))
    for group in RECORDS[model].of(Kind.ROUGHNESS, Kind.NORMAL):
        assert not grad[..., group].any()  # below the floor of roughness; a normal too short to be one
    below = gradient(shade, model, [stored, -light.abs(), view], torch.ones(1, 30, 16, 3))
    assert not below.any()


def test_strided_and_broadcast_arguments_get_their_gradients() -> None:
    stored, light, view = tensors("gltf", 2, 6, 20, torch.float64, smooth=True)
    weights = torch.randn(2, 6, 20, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def results(call: Any) -> list[Tensor]:
        one = stored.detach()[0].clone().requires_grad_()
        planar = stored.detach().permute(2, 0, 1).contiguous().permute(1, 2, 0).requires_grad_()
        assert not planar.is_contiguous()
        return [
            gradient(call, "gltf", [one, light, view], weights),
            gradient(call, "gltf", [planar, light[0], view[:1]], weights.mT.contiguous().mT),
            torch.autograd.grad(call("gltf", one, light, view).sum(), one)[0],
        ]

    for got, expected in zip(results(shade), results(reference.shade), strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-9, atol=1e-11)


def test_opcheck() -> None:
    model = "gltf-anisotropic"
    arguments = tensors(model, 2, 3, 5, torch.float64, smooth=True)
    torch.library.opcheck(torch.ops.mipbake.shade.default, (model, *arguments))
    grad = torch.rand(2, 3, 5, 3, dtype=torch.float64)
    plain = [a.detach() for a in arguments]
    torch.library.opcheck(torch.ops.mipbake.shade_backward.default, (model, *plain, grad), test_utils=QUICK)


def test_a_function_that_uses_it_compiles() -> None:
    stored, light, view = tensors("ggx", 2, 4, 20, torch.float32, smooth=True)

    def loss(material: Tensor) -> Tensor:
        return (shade("ggx", torch.sigmoid(material), light, view) ** 2).sum()

    (expected,) = torch.autograd.grad(loss(stored), stored)
    (got,) = torch.autograd.grad(torch.compile(loss, fullgraph=True, backend="aot_eager")(stored), stored)
    torch.testing.assert_close(got, expected)


def test_sizes_of_zero() -> None:
    stored, light, view = tensors("ggx", 2, 3, 4, torch.float32)
    assert shade("ggx", stored[:, :0], light, view).shape == (2, 3, 0, 3)
    nothing = shade("ggx", stored, light[:, :0], view[:, :0])
    assert nothing.shape == (2, 0, 4, 3)
    (grad,) = torch.autograd.grad(nothing.sum(), stored)
    assert not grad.any()


@needs_cuda
@pytest.mark.parametrize("model", MODELS)
def test_the_gpu_agrees_with_the_twin(model: str) -> None:
    arguments = tensors(model, 3, 150, 77, torch.float32)
    on_gpu = [a.detach().cuda().requires_grad_(a.requires_grad) for a in arguments]
    weights = torch.randn(3, 150, 77, 3, generator=torch.Generator().manual_seed(1))
    exact = [a.detach().double().requires_grad_(a.requires_grad) for a in arguments]
    torch.testing.assert_close(
        shade(model, *on_gpu).detach().cpu().double(), reference.shade(model, *exact).detach(), rtol=1e-5, atol=0
    )
    cpu = gradient(shade, model, arguments, weights)
    gpu = gradient(shade, model, on_gpu, weights.cuda()).cpu()
    assert ((cpu - gpu).abs() <= 1e-4 * (cpu.abs() + cpu.abs().mean((0, 1)))).all()
    assert torch.equal(gpu, gradient(shade, model, on_gpu, weights.cuda()).cpu())


@needs_cuda
def test_the_gpu_takes_float32_alone_and_uses_the_current_stream() -> None:
    arguments = [a.detach().cuda() for a in tensors("ggx", 1, 64, 5000, torch.float32)]
    with pytest.raises(UsageError, match="material is float64 on cuda:0: expected float32, or the CPU"):
        shade("ggx", *(a.double() for a in arguments))
    stream = torch.cuda.Stream()
    with torch.cuda.stream(stream):
        late = arguments[0] * 0 + arguments[0]
        result = shade("ggx", late, *arguments[1:])
    stream.synchronize()
    assert torch.equal(result, shade("ggx", *arguments))
