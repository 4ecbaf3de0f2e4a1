"""The torch op of the texture lookups: gradients, torch.compile, determinism, layouts and storage types."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from mipbake import sampling
from mipbake.sampling import ops, reference, texture, texture_construct_mip

from .raster_scenes import needs_cuda
from .texture_cases import FILTERS, random_case

DOUBLE = torch.float64


def random(*shape: int, seed: int = 1, dtype: torch.dtype = DOUBLE) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=dtype).requires_grad_()


def lookups(*shape: int, axes: int = 2, spread: float = 2.0, dtype: torch.dtype = DOUBLE) -> list[Tensor]:
    """uv, uv_da and a bias."""
    generator = torch.Generator().manual_seed(2)
    uv = torch.randn(*shape, axes, generator=generator, dtype=dtype) * spread
    uv_da = torch.randn(*shape, 2 * axes, generator=generator, dtype=dtype) * 0.3
    bias = torch.randn(shape, generator=generator, dtype=dtype)
    return [uv.requires_grad_(), uv_da.requires_grad_(), bias.requires_grad_()]


@pytest.mark.long
@pytest.mark.parametrize("case", ["internal", "custom", "linear", "cube", "texels only", "anisotropic"])
def test_opcheck(case: str) -> None:
    cube = case == "cube"
    tex = random(1, 6, 4, 4, 2) if cube else random(2, 5, 4, 2)
    uv, uv_da, bias = lookups(2, 2, 3, axes=3 if cube else 2)
    mips = [level.detach() for level in ops.mips(tex.detach(), 2)]
    modes = ("cube", "cube") if cube else ("wrap", "mirror")
    arguments: tuple[Any, ...] = ([tex, *mips], uv, uv_da, bias, "linear-mipmap-linear", *modes, True)
    if case == "custom":
        mips = [level.requires_grad_() for level in mips]
        arguments = ([tex, *mips], uv, None, bias[:, :1, :1], "linear-mipmap-nearest", *modes, False)
    elif case == "linear":
        arguments = ([tex], uv, None, None, "linear", *modes, False)
    elif case == "texels only":
        arguments = ([tex, *mips], uv.detach(), uv_da.detach(), None, "linear-mipmap-linear", *modes, True)
    elif case == "anisotropic":
        arguments = ([tex, *mips], uv, uv_da, None, "anisotropic", *modes, True)
    torch.library.opcheck(ops.texture, arguments)
    torch.library.opcheck(ops.mips, (tex.detach(), 2))


def test_compiled_equals_eager() -> None:
    tex, level = random(2, 9, 8, 3, dtype=torch.float32), random(2, 3, 3, 3, dtype=torch.float32)
    uv, uv_da, bias = lookups(2, 5, 10, dtype=torch.float32)
    leaves = [tex, level, uv, uv_da, bias]

    def loss(tex: Tensor, level: Tensor, uv: Tensor, uv_da: Tensor, bias: Tensor) -> Tensor:
        out = texture(tex, uv, uv_da, bias, boundary_mode=("wrap", "mirror"))
        kept = texture(tex, uv, uv_da, mip=texture_construct_mip(tex), filter_mode="anisotropic")
        return (out**2).sum() + texture(tex, uv, None, bias, [level]).sum() + kept.sum()

    eager = torch.autograd.grad(loss(*leaves), leaves)
    # The backend without code generation still traces forward and backward through the fake implementations.
    compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
    for a, e in zip(torch.autograd.grad(compiled(*leaves), leaves), eager, strict=True):
        torch.testing.assert_close(a, e, rtol=1e-4, atol=1e-4)

    def kept(mip: Any) -> Tensor:
        return texture(tex, uv, uv_da, mip=mip)

    mip = texture_construct_mip(tex)
    assert torch.equal(torch.compile(kept, fullgraph=True, backend="aot_eager")(mip), kept(mip))


def test_only_the_gradients_that_are_needed() -> None:
    tex, levels = random(1, 5, 4, 3), [random(1, 2, 2, 3), random(1, 1, 1, 3)]
    uv, uv_da, bias = lookups(1, 3, 3)
    levels[0].requires_grad_(False)
    texture(tex, uv.detach(), uv_da.detach(), bias, levels).sum().backward()
    assert levels[0].grad is None and uv.grad is None and uv_da.grad is None
    assert all(t.grad is not None for t in (tex, levels[1], bias))
    assert not texture(tex.detach(), uv.detach(), mip_level_bias=bias.detach()).requires_grad
    texture(tex.detach(), uv, uv_da.detach()).sum().backward()
    assert uv.grad is not None and uv_da.grad is None
    # Filters without levels ignore what chooses one.
    tex.grad = None
    texture(tex, uv.detach(), uv_da, bias.detach(), filter_mode="linear").sum().backward()
    assert uv_da.grad is None and tex.grad is not None


def test_gradients_at_kinks_are_the_slopes_to_the_right() -> None:
    tex = torch.tensor([1.0, 4.0, 2.0, 8.0], dtype=DOUBLE).view(1, 1, 4, 1)

    def slopes(u: Tensor, boundary: str) -> list[float]:
        uv = torch.stack([u, torch.full_like(u, 0.5)], -1)[None, None].requires_grad_()
        (grad,) = torch.autograd.grad(texture(tex, uv, boundary_mode=(boundary, "wrap")).sum(), uv)
        assert torch.all(grad[..., 1] == 0)
        found: list[float] = grad[0, 0, :, 0].tolist()
        return found

    centres = (torch.arange(4, dtype=DOUBLE) + 0.5) / 4
    assert slopes(centres, "wrap") == [12, -8, 24, -28]
    assert slopes(centres, "clamp") == [12, -8, 24, 0]
    assert slopes(centres, "mirror") == [12, -8, 24, 0]
    assert slopes(centres, "zero") == [12, -8, 24, -32]
    assert slopes(centres + 1, "mirror") == [-24, 8, -12, 0]
    beyond = torch.tensor([-0.3, 0.1, 0.9, 7.0], dtype=DOUBLE)
    assert slopes(beyond, "clamp") == [0, 0, 0, 0]
    assert slopes(beyond, "zero") == [0, 4, -32, 0]

    levels = [torch.full((1, 2, 2, 1), value, dtype=DOUBLE) for value in (1.0, 3.0, 10.0)]
    lod = torch.tensor([-1.0, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0], dtype=DOUBLE).view(1, 1, 7).requires_grad_()
    uv = torch.zeros(1, 1, 7, 2, dtype=DOUBLE)
    (grad,) = torch.autograd.grad(texture(levels[0], uv, None, lod, levels[1:]).sum(), lod)
    assert grad.flatten().tolist() == [0, 2, 2, 7, 7, 0, 0]


@pytest.mark.parametrize("boundary", ["wrap", "clamp", "mirror", "zero"])
@pytest.mark.parametrize("size", [6, 300])
def test_undefined_lookups_leave_gradients_alone(size: int, boundary: str) -> None:
    tex = random(1, size, size - 1, 3)
    uv, uv_da, bias = (t.detach() for t in lookups(1, 1, 5000))
    bad = torch.zeros(5000, dtype=torch.bool)
    uv[..., ::7, 0], uv[..., 3::11, 1], bias[..., 5::13], uv_da[..., 2::17, 3] = (torch.nan,) * 4
    bad[::7] = bad[3::11] = bad[5::13] = bad[2::17] = True
    for filter_mode in ("linear-mipmap-linear", "anisotropic"):
        leaves = [t.clone().requires_grad_() for t in (uv, uv_da, bias)]
        tex.grad = None
        out = texture(tex, *leaves, filter_mode=filter_mode, boundary_mode=boundary)
        assert torch.equal(out[0, 0].isnan().all(-1), bad) and torch.equal(out[0, 0].isnan().any(-1), bad)
        out.backward(torch.ones_like(out))
        for leaf in leaves:
            assert torch.all(leaf.grad[0, 0, bad] == 0) and torch.all(leaf.grad.isfinite())
        again = tex.detach().clone().requires_grad_()
        defined = [t[:, :, ~bad] for t in (uv, uv_da, bias)]
        texture(again, *defined, filter_mode=filter_mode, boundary_mode=boundary).sum().backward()
        torch.testing.assert_close(tex.grad, again.grad, rtol=1e-10, atol=1e-12)


def test_large_textures_match_the_twin() -> None:
    uv, uv_da, bias = (t.detach() for t in lookups(3, 4, 1000))
    tex = random(3, 190, 211, 2)
    grad = torch.randn(3, 4, 1000, 2, generator=torch.Generator().manual_seed(6), dtype=DOUBLE)
    (actual,) = torch.autograd.grad(texture(tex, uv, uv_da * 0.1, bias), tex, grad)
    (expected,) = torch.autograd.grad(reference.texture(tex, uv, uv_da * 0.1, bias), tex, grad)
    torch.testing.assert_close(actual, expected, rtol=1e-9, atol=1e-10)


def test_layouts_and_dtypes() -> None:
    planar = random(2, 5, 9, 8)
    uv, _, bias = lookups(2, 3, 10)
    channel_last = planar.permute(0, 2, 3, 1)
    for detail in (None, bias):
        out = texture(channel_last, uv, None, detail)
        assert torch.equal(out, texture(channel_last.contiguous(), uv, None, detail))
    (grad,) = torch.autograd.grad(out.sum(), planar)
    assert grad.shape == planar.shape and float(grad.sum()) == pytest.approx(2 * 30 * 5)
    crop = planar.detach().contiguous(memory_format=torch.channels_last).permute(0, 2, 3, 1)[:, 2:7, 1:5]
    assert torch.equal(texture(crop, uv, None, bias), texture(crop.contiguous(), uv, None, bias))
    repeated = random(1, 4, 5, 3).expand(2, 4, 5, 3)
    assert torch.equal(texture(repeated, uv, None, bias), texture(repeated.contiguous(), uv, None, bias))
    (shared,) = torch.autograd.grad(texture(repeated, uv, None, bias).square().sum(), repeated)
    (apart,) = torch.autograd.grad(texture(leaf := repeated.contiguous(), uv, None, bias).square().sum(), leaf)
    assert torch.equal(shared, apart)
    wide = uv[:1].expand(2, 3, 10, 2)
    assert torch.equal(texture(repeated, wide), texture(repeated, wide.contiguous()))
    (summed,) = torch.autograd.grad(texture(repeated, wide).sum(), uv)
    assert float(summed[1].abs().sum()) == 0 and float(summed[0].abs().sum()) > 0

    single = random(2, 4, 4, 3).detach().float()
    out = texture(single, uv, None, bias.to(torch.bfloat16))
    assert out.dtype == torch.float32
    (grad_uv,) = torch.autograd.grad(out.sum(), uv)
    assert grad_uv.dtype == DOUBLE


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("boundary", ["wrap", "cube"])
@pytest.mark.parametrize("stack", ["internal", "constructed", "custom"])
def test_half_storage(stack: str, boundary: str, dtype: torch.dtype) -> None:
    cube = boundary == "cube"
    tex = random(1, 6, 9, 9, 5) if cube else random(2, 13, 9, 5)
    tex = tex.detach().to(dtype).requires_grad_()
    levels = texture_construct_mip(tex, cube_mode=cube).levels
    assert all(level.dtype == dtype for level in levels)
    for level, expected in zip(levels, reference.texture_construct_mip(tex, cube_mode=cube).levels, strict=True):
        torch.testing.assert_close(level.float(), expected.float(), rtol=2 * torch.finfo(dtype).eps, atol=1e-6)
    mip: Any = {"internal": None, "constructed": texture_construct_mip(tex, cube_mode=cube)}.get(
        stack, [level.detach().requires_grad_() for level in levels]
    )
    uv, uv_da, bias = lookups(2, 3, 10, axes=3 if cube else 2, dtype=torch.float32)
    leaves = [tex, uv, uv_da, bias, *(mip if stack == "custom" else ())]
    # The same stack as float32 numbers: the same result, and gradients that are then rounded once.
    same = [level.detach().float().requires_grad_() for level in (tex, *levels)]
    given = [same[0], uv, uv_da, bias, *(same[1:] if stack == "custom" else ())]
    out = texture(tex, uv, uv_da, bias, mip, boundary_mode=boundary)
    expected = texture(same[0], uv, uv_da, bias, same[1:], boundary_mode=boundary)
    assert out.dtype == torch.float32 and torch.equal(out, expected)
    grad = torch.randn(out.shape, generator=torch.Generator().manual_seed(4))
    actual = torch.autograd.grad(out, leaves, grad)
    if stack == "custom":
        wanted = torch.autograd.grad(expected, given, grad)
    else:
        chained = texture(same[0], uv, uv_da, bias, boundary_mode=boundary)
        wanted = torch.autograd.grad(chained, given, grad)
    for a, e, leaf in zip(actual, wanted, leaves, strict=True):
        assert a.dtype == leaf.dtype
        texels = leaf.dtype == dtype
        if texels:
            torch.testing.assert_close(a, e.to(dtype), rtol=0, atol=0)
        elif stack == "custom":
            # Each storage has its own kernel, and the compiler fuses multiply-adds in each as it likes.
            torch.testing.assert_close(a, e, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("cube", [False, True])
def test_a_batch_of_none_gives_empty_results_and_zero_gradients(cube: bool) -> None:
    tex = random(1, 6, 4, 4, 3) if cube else random(1, 5, 4, 3)
    axes = 3 if cube else 2
    uv, uv_da = torch.zeros(0, 2, 3, axes, dtype=tex.dtype), torch.zeros(1, 2, 3, 2 * axes, dtype=tex.dtype)
    bias = torch.zeros(1, 1, 1, dtype=tex.dtype).requires_grad_()
    boundary = "cube" if cube else "wrap"
    for texels in (tex, tex[:0]):
        for mip in (None, texture_construct_mip(texels, cube_mode=cube)):
            out = texture(texels, uv, uv_da, bias, mip, boundary_mode=boundary)
            assert out.shape == (0, 2, 3, 3)
            for leaf, gradient in zip((tex, bias), torch.autograd.grad(out.sum(), (tex, bias)), strict=True):
                assert gradient.shape == leaf.shape
                assert torch.all(gradient == 0)
    plain = texture(tex.detach().numpy(), uv.numpy(), uv_da.numpy(), boundary_mode=boundary)
    assert plain.shape == (0, 2, 3, 3)


def test_gradient_sums_are_the_serial_sums() -> None:
    """One texel that every lookup hits: the sum in float32 in the order of the lookups, and no other."""
    grad = torch.randn(20000, generator=torch.Generator().manual_seed(5)).view(1, 1, -1, 1)
    for size in (1, 512):
        tex = torch.zeros(1, size, size, 1, requires_grad=True)
        texture(tex, torch.full((1, 1, 20000, 2), 0.5 / size)).backward(grad)
        serial = torch.zeros(())
        for g in grad.flatten():
            serial = serial + g
        assert tex.grad is not None
        if size > 1:  # a 1 x 1 level adds each gradient in four parts
            assert torch.equal(tex.grad[0, 0, 0, 0], serial)
        torch.testing.assert_close(tex.grad.sum(), grad.double().sum().float(), rtol=1e-4, atol=1e-3)


@needs_cuda
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


@needs_cuda
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
        out = texture(leaf, uv.to(device), uv_da.to(device), boundary_mode=boundary)
        (grad,) = torch.autograd.grad(out.sum(), leaf)
        results.append([out.cpu(), grad.cpu()])
        assert out.dtype == torch.float32 and grad.dtype == dtype
    eps = torch.finfo(dtype).eps
    torch.testing.assert_close(results[1][0], results[0][0], rtol=0, atol=2 * eps)
    torch.testing.assert_close(results[1][1], results[0][1], rtol=4 * eps, atol=1e-3)
