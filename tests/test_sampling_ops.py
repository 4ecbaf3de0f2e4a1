"""The torch op of the texture lookups: gradients, torch.compile, determinism and what it refuses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

from mipbake import _native
from mipbake._stream import current_stream
from mipbake.errors import UsageError
from mipbake.sampling import ops, reference

NO_CUDA = "no CUDA device and CUDA kernels here: the GPU kernels of the sampler are not tested"
needs_cuda = pytest.mark.skipif(not (torch.cuda.is_available() and _native.cuda_compiled()), reason=NO_CUDA)


def stack(*sizes: tuple[int, ...], channels: int = 3, dtype: torch.dtype = torch.float64) -> list[Tensor]:
    generator = torch.Generator().manual_seed(1)
    return [torch.rand(*s, channels, generator=generator, dtype=dtype).requires_grad_() for s in sizes]


def lookups(*shape: int, spread: float = 2.0, levels: int = 3, dtype: torch.dtype = torch.float64) -> list[Tensor]:
    generator = torch.Generator().manual_seed(2)
    uv = torch.randn(*shape, 2, generator=generator, dtype=dtype) * spread
    lod = torch.rand(*shape, generator=generator, dtype=dtype) * (levels + 1) - 1
    return [uv.requires_grad_(), lod.requires_grad_()]


@pytest.fixture
def thread_counts() -> Iterator[Any]:
    default = _native.num_threads()
    yield _native.set_num_threads
    _native.set_num_threads(default)


@pytest.mark.parametrize("wrap", [("wrap", "clamp"), ("clamp", "wrap")])
@pytest.mark.parametrize("channels", [1, 3, 4, 6, 8])
def test_gradcheck(channels: int, wrap: tuple[str, str]) -> None:
    levels = stack((5, 4), (2, 3), (1, 1), channels=channels)
    uv, lod = lookups(7)

    def call(*arguments: Tensor) -> Tensor:
        return ops.sample(arguments[2:], arguments[0], arguments[1], wrap)

    assert torch.autograd.gradcheck(call, (uv, lod, *levels), fast_mode=False)


def test_gradcheck_of_repeated_arguments() -> None:
    uv, lod = lookups(2, 5)
    shared = stack((4, 3), (2, 1))
    assert torch.autograd.gradcheck(lambda u, d, *ls: ops.sample(ls, u, d), (uv, lod[0].detach(), *shared))
    batched = stack((2, 4, 3), (2, 2, 1))
    scalar = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    one = uv[0].detach().requires_grad_()
    assert torch.autograd.gradcheck(lambda u, d, *ls: ops.sample(ls, u, d), (one, scalar, *batched))


@pytest.mark.parametrize("case", ["trilinear", "bilinear", "batched", "texels only"])
def test_opcheck(case: str) -> None:
    uv, lod = lookups(2, 6)
    levels = stack((5, 4), (2, 2))
    arguments: tuple[Any, ...] = (levels, uv, lod, True, False)
    if case == "bilinear":
        arguments = (levels[:1], uv[0].detach().requires_grad_(), torch.zeros((), dtype=torch.float64), False, False)
    elif case == "batched":
        arguments = (stack((2, 5, 4), (2, 1, 7)), uv, lod, False, True)
    elif case == "texels only":
        arguments = (levels, uv.detach(), lod.detach(), True, True)
    torch.library.opcheck(ops._sample, arguments)


def test_compiled_equals_eager() -> None:
    levels = stack((2, 9, 8), (2, 4, 4), dtype=torch.float32)
    uv, lod = lookups(2, 50, dtype=torch.float32)

    def loss(*arguments: Tensor) -> Tensor:
        out = ops.sample(arguments[2:], arguments[0], arguments[1], ("wrap", "clamp"))
        return (out**2).sum() + ops.sample(arguments[2:3], arguments[0], 0.0).sum()

    eager = torch.autograd.grad(loss(uv, lod, *levels), (uv, lod, *levels))
    # The backend without code generation still traces forward and backward through the fake implementations.
    compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
    for a, e in zip(torch.autograd.grad(compiled(uv, lod, *levels), (uv, lod, *levels)), eager, strict=True):
        torch.testing.assert_close(a, e, rtol=1e-5, atol=1e-5)


def test_only_the_gradients_that_are_needed() -> None:
    levels = stack((5, 4), (2, 2), (1, 1))
    uv, lod = lookups(9)
    levels[1].requires_grad_(False)
    ops.sample(levels, uv.detach(), lod, ("wrap", "wrap")).sum().backward()
    assert levels[1].grad is None and uv.grad is None
    assert all(t.grad is not None for t in (levels[0], levels[2], lod))
    assert not ops.sample([level.detach() for level in levels], uv.detach(), 0.5).requires_grad


def test_gradients_at_kinks_are_the_slopes_to_the_right() -> None:
    texels = torch.tensor([1.0, 4.0, 2.0, 8.0], dtype=torch.float64).view(1, 4, 1)
    u = (torch.arange(4, dtype=torch.float64) + 0.5) / 4
    uv = torch.stack([u, torch.full_like(u, 0.5)], -1).requires_grad_()
    for wrap, slopes in (("wrap", [12, -8, 24, -28]), ("clamp", [12, -8, 24, 0])):
        (du,) = torch.autograd.grad(ops.sample([texels], uv, 0.0, (wrap, wrap)).sum(), uv)
        torch.testing.assert_close(du, torch.tensor([[s, 0.0] for s in slopes], dtype=torch.float64))
    beyond = torch.tensor([[-0.3, 0.5], [0.1, 0.5], [0.9, 0.5], [7.0, 0.5]], dtype=torch.float64, requires_grad=True)
    (du,) = torch.autograd.grad(ops.sample([texels], beyond, 0.0, ("clamp", "clamp")).sum(), beyond)
    assert torch.all(du == 0)

    levels = [torch.full((2, 2, 1), value, dtype=torch.float64) for value in (1.0, 3.0, 10.0)]
    lod = torch.tensor([-1.0, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0], dtype=torch.float64, requires_grad=True)
    out = ops.sample(levels, torch.zeros(7, 2, dtype=torch.float64), lod)
    (dlod,) = torch.autograd.grad(out.sum(), lod)
    torch.testing.assert_close(dlod, torch.tensor([0.0, 2, 2, 7, 7, 0, 0], dtype=torch.float64))


@pytest.mark.parametrize("wrap", ["wrap", "clamp"])
@pytest.mark.parametrize("sizes", [[(6, 5), (3, 2)], [(300, 300), (150, 150)]])
def test_undefined_lookups_leave_gradients_alone(sizes: list[tuple[int, int]], wrap: str) -> None:
    levels = stack(*sizes)
    uv, lod = (t.detach() for t in lookups(5000, levels=2))
    bad = torch.zeros(5000, dtype=torch.bool)
    uv[::7, 0], uv[3::11, 1], lod[5::13] = torch.nan, torch.nan, torch.nan
    bad[::7] = bad[3::11] = bad[5::13] = True
    uv.requires_grad_()
    lod.requires_grad_()
    out = ops.sample(levels, uv, lod, (wrap, wrap))
    assert torch.equal(out.isnan().all(-1), bad) and torch.equal(out.isnan().any(-1), bad)
    out.backward(torch.ones_like(out))
    with_bad = [level.grad for level in levels]
    assert torch.all(uv.grad[bad] == 0) and torch.all(lod.grad[bad] == 0)
    again = [level.detach().clone().requires_grad_() for level in levels]
    ops.sample(again, uv.detach()[~bad], lod.detach()[~bad], (wrap, wrap)).sum().backward()
    assert all(torch.equal(a, level.grad) for a, level in zip(with_bad, again, strict=True))


# Small stacks are summed an item at a time, large ones sorted into bins of rows; both in the order of the lookups.
@pytest.mark.parametrize("wrap", [("wrap", "wrap"), ("clamp", "wrap")])
@pytest.mark.parametrize(
    ("batch", "sizes"),
    [
        ((1,), [(40, 30), (20, 15), (10, 7), (1, 1)]),
        ((5,), [(16, 16), (8, 8)]),
        ((2,), [(257, 301), (128, 150)]),
        ((1,), [(1, 5000), (5000, 1)]),
    ],
)
def test_gradients_do_not_depend_on_the_number_of_threads(
    batch: tuple[int], sizes: list[tuple[int, int]], wrap: tuple[str, str], thread_counts: Any
) -> None:
    levels = stack(*((*batch, *s) for s in sizes), channels=4, dtype=torch.float32)
    uv, lod = (t.detach() for t in lookups(5, 6000, levels=len(sizes), dtype=torch.float32))
    uv = (uv[: batch[0]] if batch[0] > 1 else uv).requires_grad_()
    scalar = torch.tensor(0.4, requires_grad=True)
    lod = lod[: uv.shape[0]].requires_grad_()
    leaves = [*levels, uv]
    results = []
    for threads in (1, 2, 3, 8):
        thread_counts(threads)
        for detail in (lod, scalar):
            out = ops.sample(levels, uv, detail, wrap)
            grad = torch.randn(out.shape, generator=torch.Generator().manual_seed(4))
            results.append([out.detach(), *torch.autograd.grad(out, (*leaves, detail), grad)])
    for index, result in enumerate(results[2:]):
        assert all(torch.equal(a, b) for a, b in zip(result, results[index % 2], strict=True))


def test_gradient_sums_are_the_serial_sums() -> None:
    """One texel that every lookup hits: the sum in float32 in the order of the lookups, and no other."""
    generator = torch.Generator().manual_seed(5)
    grad = torch.randn(20000, 1, generator=generator)
    for size in (1, 512):
        level = torch.zeros(size, size, 1, requires_grad=True)
        centre = torch.full((20000, 2), 0.5 / size)
        ops.sample([level], centre, 0.0).backward(grad)
        serial = torch.zeros(())
        for g in grad[:, 0]:
            serial = serial + g
        assert level.grad is not None
        if size > 1:  # a 1 x 1 level adds each gradient in four parts
            assert torch.equal(level.grad[0, 0, 0], serial)
        torch.testing.assert_close(level.grad.sum(), grad.double().sum().float(), rtol=1e-4, atol=1e-3)


def test_large_textures_match_the_twin() -> None:
    uv, lod = (t.detach() for t in lookups(3, 4000, levels=2))
    for batch in ((), (3,)):
        levels = stack((*batch, 190, 210), (*batch, 95, 105), channels=2)
        grad = torch.randn(3, 4000, 2, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
        actual = torch.autograd.grad(ops.sample(levels, uv, lod), levels, grad)
        expected = torch.autograd.grad(reference.sample(levels, uv, lod), levels, grad)
        for a, e in zip(actual, expected, strict=True):
            torch.testing.assert_close(a, e, rtol=1e-10, atol=1e-11)


def test_layouts_and_dtypes() -> None:
    planar = torch.rand(2, 5, 9, 8, dtype=torch.float64, requires_grad=True)
    uv, lod = lookups(2, 30)
    channel_last = planar.permute(0, 2, 3, 1)
    out = ops.sample([channel_last], uv, 0)
    assert torch.equal(out, ops.sample([channel_last.contiguous()], uv, 0))
    (grad,) = torch.autograd.grad(out.sum(), planar)
    assert grad.shape == planar.shape and float(grad.sum()) == pytest.approx(2 * 30 * 5)
    crop = planar.detach().contiguous(memory_format=torch.channels_last).permute(0, 2, 3, 1)[:, 2:7, 1:5]
    assert torch.equal(ops.sample([crop], uv, 0), ops.sample([crop.contiguous()], uv, 0))

    single = [level.detach().float() for level in stack((4, 4))]
    out = ops.sample(single, uv, lod.to(torch.bfloat16))
    assert out.dtype == torch.float32
    (grad_uv,) = torch.autograd.grad(out.sum(), uv)
    assert grad_uv.dtype == torch.float64
    assert ops.sample(single, uv, 1).shape == (2, 30, 3)


def test_no_lookups_give_empty_results_and_zero_gradients() -> None:
    levels = stack((4, 4), (2, 2))
    uv = torch.zeros(0, 2, dtype=torch.float64, requires_grad=True)
    out = ops.sample(levels, uv, 0.5)
    assert out.shape == (0, 3)
    out.sum().backward()
    assert all(level.grad is not None and torch.all(level.grad == 0) for level in levels)


LEVEL, UV = torch.ones(4, 4, 3), torch.zeros(5, 2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((LEVEL, UV, 0), "levels is a Tensor: expected a list of tensors"),
        (([], UV, 0), "levels has 0 items: expected 1 to 32"),
        (([LEVEL.numpy()], UV, 0), r"levels\[0\] is a ndarray: expected a torch tensor"),
        (([LEVEL.half()], UV, 0), r"levels\[0\] is torch.float16: expected float32 or float64"),
        (([LEVEL, LEVEL.double()], UV, 0), r"levels\[1\] is torch.float64: expected"),
        (([LEVEL, LEVEL.to("meta")], UV, 0), r"levels\[1\] is on meta: expected cpu"),
        (([LEVEL], UV.to("meta"), 0), "uv is on meta: expected cpu"),
        (([LEVEL], UV, torch.zeros(5, device="meta")), "lod is on meta: expected cpu"),
        (([LEVEL[0]], UV, 0), r"levels\[0\] has shape \(4, 3\): expected \(H, W, C\)"),
        (([LEVEL, LEVEL[:, :0]], UV, 0), r"levels\[1\] has shape \(4, 0, 3\): expected"),
        (([LEVEL, LEVEL[..., :2]], UV, 0), r"levels\[1\] has shape .* expected the same batch and the same channels"),
        (([LEVEL], [[0, 0]], 0), "uv is a list: expected a torch tensor"),
        (([LEVEL], UV[:, :1], 0), r"uv has shape \(5, 1\): expected"),
        (([LEVEL], UV.to(torch.complex64), 0), "uv is torch.complex64: expected real numbers"),
        (([LEVEL], UV, [0.0] * 5), "lod is a list: expected a number or a torch tensor"),
        (([LEVEL], UV, torch.zeros(4)), r"lod has shape \(4,\): expected a scalar"),
        (([LEVEL], UV, torch.zeros(5, dtype=torch.bool)), "lod is torch.bool: expected real numbers"),
        (([torch.ones(2, 4, 4, 3)], torch.zeros(3, 5, 2), 0), "batch sizes do not fit: levels has 2, uv has 3"),
        (([LEVEL], UV, 0, ("wrap", "repeat")), "wrap is .*: expected a pair of 'wrap' or 'clamp'"),
    ],
)
def test_wrong_arguments_are_named(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        ops.sample(*arguments)


@pytest.mark.skipif(_native.cuda_compiled(), reason="this build has CUDA kernels")
def test_a_build_without_cuda_says_so() -> None:
    with pytest.raises(UsageError, match="has no CUDA kernels"), current_stream(_OnCuda(), "uv"):
        pass


class _OnCuda:
    """Stands for a tensor on a GPU, which a machine without one cannot make."""

    device = torch.device("cuda", 0)


@needs_cuda
@pytest.mark.parametrize("batch", [(), (1,), (3,)])
def test_cuda_equals_the_cpu(batch: tuple[int, ...]) -> None:
    levels = [level.detach() for level in stack((*batch, 33, 20), (*batch, 16, 10), channels=5, dtype=torch.float32)]
    uv, lod = (t.detach() for t in lookups(3, 999, dtype=torch.float32))
    grad = torch.randn(3, 999, 5)
    results = []
    for device in ("cpu", "cuda"):
        leaves = [t.to(device).requires_grad_() for t in (*levels, uv, lod)]
        out = ops.sample(leaves[:2], leaves[2], leaves[3], ("wrap", "clamp"))
        results.append([out, *torch.autograd.grad(out, leaves, grad.to(device))])
    for cpu, cuda in zip(*results, strict=True):
        torch.testing.assert_close(cuda.cpu(), cpu, rtol=1e-4, atol=1e-4)


@needs_cuda
def test_cuda_refuses_double() -> None:
    with pytest.raises(UsageError, match=r"levels are torch\.float64 on cuda:0: expected float32"):
        ops.sample([LEVEL.double().cuda()], UV.cuda(), 0)
