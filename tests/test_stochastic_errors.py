"""What stochastic gradients refuse, and in which words."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from mipbake import stochastic
from mipbake.base.errors import UsageError
from mipbake.stochastic import Channels, Contributions, Moments

CHANNELS = Channels((0.1, 0.0, 0.02, 0.3), (0.0, -1.0, -0.5, 0.0), (1.0, 1.0, 2.0, 0.75))
FREE = Channels((1.0,), (-math.inf,), (math.inf,))

V, G, CH1 = np.zeros((4, 1), np.float32), np.zeros((4, 1), np.float32), Channels((0.1,), (0.0,), (1.0,))
D, UV, LOD, DA = (np.zeros(shape, np.float32) for shape in (3, (3, 2), 3, (3, 4)))
MADE = stochastic.contributions(np.int32([[0], [1], [3]]))
IMAGE, SIZES, TRI = np.zeros((3, 2), np.float32), [(4, 4), (2, 2)], np.int32([[0, 1, 2]])
MOMENTS = Moments.of(V)
frozen = V.copy()
frozen.flags.writeable = False
strided = np.zeros((4, 2), np.float32)[:, :1]
double, integers = V.astype(np.float64), V.astype(np.int32)

REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: Channels((), (), ()), "channels have 0 magnitudes, 0 lower and 0 upper limits: expected 1 to 64"),
    (lambda: Channels((1.0,) * 65, (0.0,) * 65, (9.0,) * 65), "channels have 65 magnitudes"),
    (lambda: Channels((1.0,), (0.0, 0.0), (9.0,)), "1 magnitudes, 2 lower and 1 upper limits"),
    (lambda: Channels((-1.0,), (0.0,), (9.0,)), "magnitude holds -1.0: expected numbers, and magnitudes from 0 on"),
    (lambda: Channels((math.inf,), (0.0,), (9.0,)), "magnitude holds inf"),
    (lambda: Channels((math.nan,), (0.0,), (9.0,)), "magnitude holds nan"),
    (lambda: Channels((0.1,), (math.nan,), (9.0,)), "low holds nan"),
    (lambda: Channels((0.1,), (0.0,), (math.nan,)), "high holds nan"),
    (lambda: Channels((0.1,), (2.0,), (1.0,)), "a lower limit of channels lies above the upper one"),
    (lambda: Channels((0.6,), (0.0,), (1.0,)), "limits of a channel lie closer together than 2 magnitudes"),
    (lambda: Channels((0.1, 0.1, 0.1), (0.0,) * 3, (1.0,) * 3, 0), "lifted is 0: expected the first of three"),
    (lambda: Channels((0.1, 0.1, 0.0), (0.0,) * 3, (1.0,) * 3, 1), "lifted is 1: expected the first of three"),
    (lambda: Channels((0.1, 0.1, 0.0), (0.0,) * 3, (1.0,) * 3, -1), "lifted is -1: expected the first of three"),
    (lambda: stochastic.perturb([[1.0]], CH1, 0), "values is a list: expected a NumPy array or a torch tensor"),  # type: ignore[type-var]
    (lambda: stochastic.perturb(V[0], CH1, 0), r"values has shape \(1,\): expected \(any, 1\)"),
    (lambda: stochastic.perturb(V, FREE, -1), "a step or a seed is -1: expected 0 to 2\\^32 - 1"),
    (lambda: stochastic.perturb(V, FREE, 0, 2**32), "a step or a seed is 4294967296"),
    (lambda: stochastic.perturb(integers, CH1, 0), "values is int32: expected float32 or float64"),
    (lambda: stochastic.perturb(V, CHANNELS, 0), r"values has shape \(4, 1\): expected \(any, 4\)"),
    (lambda: stochastic.perturb(V, CH1, 0, 0, np.int64([0])), "elements is int64: expected int32"),
    (lambda: stochastic.perturb(V, CH1, 0, 0, torch.zeros(1).int()), "elements is a Tensor on cpu: expected a ndarray"),  # type: ignore[type-var]
    (lambda: stochastic.perturb(V, CH1, 0, 0, np.int32([4])), "elements reach from 4 to 4: expected 0 to 3"),
    (lambda: stochastic.perturb(V, CH1, 0, 0, np.int32([2, -1])), "elements reach from -1 to 2"),
    (lambda: stochastic.perturb(V, CH1, 0, out=(V, double)), r"out\[1\] is float64: expected float32"),
    (lambda: stochastic.perturb(V, CH1, 0, out=(frozen, G)), r"out\[0\] is not contiguous, or cannot be written to"),
    (lambda: stochastic.perturb(V, CH1, 0, out=(G, strided)), r"out\[1\] is not contiguous"),
    (lambda: stochastic.pixel_differences(IMAGE[:, 0], IMAGE, IMAGE), r"plus has shape \(3,\)"),
    (lambda: stochastic.pixel_differences(IMAGE, IMAGE[:2], IMAGE), r"minus has shape \(2, 2\): expected \(3, 2\)"),
    (lambda: stochastic.pixel_differences(IMAGE, IMAGE, IMAGE.astype(np.float64)), "reference is float64"),
    (lambda: stochastic.pixel_differences(IMAGE, IMAGE, IMAGE, D[:2]), r"weights has shape \(2,\): expected \(3\)"),
    (lambda: stochastic.contributions(np.zeros((2, 2))), "touched is float64: expected int32"),
    (lambda: stochastic.contributions(np.zeros(2, np.int32)), r"touched has shape \(2,\): expected \(any, any\)"),
    (lambda: stochastic.add_gradient(strided, D, MADE, CH1, 0), "gradient is not contiguous"),
    (lambda: stochastic.add_gradient(G, D, MADE, CHANNELS, 0), r"gradient has shape \(4, 1\): expected \(any, 4\)"),
    (lambda: stochastic.add_gradient(G, D.astype(np.float64), MADE, CH1, 0), "differences is float64"),
    (lambda: stochastic.add_gradient(G, D, MADE, CH1, 1 << 40), "a step or a seed is 1099511627776"),
    (
        lambda: stochastic.add_gradient(G, D, Contributions(MADE.elements, MADE.starts[:-1], MADE.pixels), CH1, 0),
        r"made_of\.starts has shape \(3,\): expected \(4\)",
    ),
    (
        lambda: stochastic.add_gradient(G, D, stochastic.contributions(torch.zeros((1, 1)).int()), CH1, 0),
        r"made_of\.elements is a Tensor on cpu: expected a ndarray",
    ),
    (lambda: stochastic.add_gradient(G, D[:2], MADE, CH1, 0), "differences has 2 pixels, and made_of names pixel 2:"),
    (lambda: stochastic.add_gradient(G[:3], D, MADE, CH1, 0), "gradient has 3 elements, and made_of names element 3:"),
    (lambda: stochastic.descend(frozen, G, MOMENTS, CH1), "values is not contiguous, or cannot be written to"),
    (lambda: stochastic.descend(V, double, MOMENTS, CH1), "gradient is float64: expected float32"),
    (lambda: stochastic.descend(V, G, Moments.of(double), CH1), r"moments\.first is float64"),
    (lambda: stochastic.descend(V, G, Moments.of(V[:2].copy()), CH1), r"moments\.first has shape \(2, 1\)"),
    (lambda: stochastic.descend(V, G, Moments(V, V, V), CH1), r"moments\.steps has shape \(4, 1\)"),
    (lambda: stochastic.descend(V, G, MOMENTS, CHANNELS), r"values has shape \(4, 1\): expected \(any, 4\)"),
    (lambda: stochastic.descend(V, G, MOMENTS, CH1, 1.0, np.zeros((1, 1), np.int32)), r"elements has shape \(1, 1\)"),
    (lambda: stochastic.descend(V, G, MOMENTS, CH1, 1.0, np.int32([7])), "elements reach from 7 to 7: expected 0 to 3"),
    (lambda: stochastic.descend(V, G, MOMENTS, CH1, math.nan), "rate is nan: expected a finite number, 0 or more"),
    (lambda: stochastic.descend(V, G, MOMENTS, CH1, -1.0), "rate is -1.0"),
    (lambda: stochastic.descend(V, G, MOMENTS, CH1, math.inf), "rate is inf"),
    (lambda: Moments.of(integers), "values is int32"),
    (lambda: stochastic.touched_texels(SIZES, UV, LOD, None, None, "linear"), "texels is 'linear': expected nearest"),
    (lambda: stochastic.touched_texels(SIZES, UV, LOD, boundary=("wrap", "cube")), "boundary is .*'cube'.*: expected"),
    (lambda: stochastic.touched_texels(SIZES, UV, LOD, boundary=("wrap",)), "boundary is"),  # type: ignore[arg-type]
    (lambda: stochastic.touched_texels(SIZES, UV), "lod and uv_da are both given, or both missing"),
    (lambda: stochastic.touched_texels(SIZES, UV, LOD, DA), "lod and uv_da are both given, or both missing"),
    (lambda: stochastic.touched_texels(SIZES, UV, LOD, texels="anisotropic"), "uv_da is missing"),
    (lambda: stochastic.touched_texels(SIZES, DA, LOD), r"uv has shape \(3, 4\): expected \(any, 2\)"),
    (lambda: stochastic.touched_texels(SIZES, UV.astype(np.float64), LOD), "uv is float64: expected float32"),
    (lambda: stochastic.touched_texels(SIZES, UV, LOD[:2]), r"lod has shape \(2,\): expected \(3\)"),
    (lambda: stochastic.touched_texels(SIZES, UV, None, UV), r"uv_da has shape \(3, 2\): expected \(3, 4\)"),
    (lambda: stochastic.touched_texels(SIZES, UV, LOD, seen=LOD), "seen is float32: expected uint8"),
    (lambda: stochastic.touched_texels([], UV, LOD), "sizes has 0 levels: expected 1 to 32"),
    (lambda: stochastic.touched_texels([(1, 1)] * 33, UV, LOD), "sizes has 33 levels"),
    (lambda: stochastic.touched_texels([(1 << 16, 1 << 16)], UV, LOD), "with less than 2\\^31 texels in all"),
    (lambda: stochastic.touched_texels([(4, 4), (0, 2)], UV, LOD), r"sizes holds \(0, 2\): expected heights"),
    (lambda: stochastic.touched_vertices(np.int32([[2]]), TRI), "ids reach from 2 to 2: expected 0 for none, up to 1"),
    (lambda: stochastic.touched_vertices(np.int32([[-1]]), TRI), "ids reach from -1 to -1"),
    (lambda: stochastic.touched_vertices(np.float32([[0.5]]), TRI), "ids holds numbers that are not whole: expected 0"),
    (lambda: stochastic.touched_vertices(np.float32([[np.nan]]), TRI), "ids holds numbers that are not whole"),
    (lambda: stochastic.touched_vertices(np.int32([1]), TRI), r"ids has shape \(1,\): expected \(any, any\)"),
    (lambda: stochastic.touched_vertices(np.uint8([[1]]), TRI), "ids is uint8: expected int32 or int64 or float32"),
    (lambda: stochastic.touched_vertices(np.int32([[1]]), TRI.astype(np.int64)), "triangles is int64: expected int32"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(REFUSED)))
def test_what_does_not_fit_is_refused(number: int) -> None:
    call, words = REFUSED[number]
    with pytest.raises(UsageError, match=words):
        call()


def test_nothing_is_no_error() -> None:
    none = np.zeros((0, 4), np.float32)
    plus, minus = stochastic.perturb(none, CHANNELS, 0)
    assert plus.shape == minus.shape == (0, 4)
    stochastic.descend(none, none.copy(), Moments.of(none), CHANNELS)
    assert stochastic.pixel_differences(none, none, none).shape == (0,)
    stochastic.add_gradient(V, D, stochastic.contributions(np.zeros((3, 0), np.int32)), CH1, 0)


def test_signs_that_torch_has_left_to_the_reader_are_read() -> None:
    values, elements = torch.rand(4, 1), torch.tensor([2, 0], dtype=torch.int32)
    wanted = stochastic.perturb(values, CH1, 0, elements=elements)
    # The imaginary part of a conjugate is such a view: torch keeps its sign as a flag.
    flagged = torch.complex(torch.zeros(4, 1), -values).conj().imag
    assert flagged.is_neg()
    found = stochastic.perturb(flagged, CH1, 0, elements=elements)
    assert all(torch.equal(a, b) for a, b in zip(found, wanted, strict=True))


@pytest.mark.parametrize("tensor", [torch.rand(4, 1).to_sparse(), torch.rand(4, 1, device="meta")])
def test_tensors_without_numbers_in_memory(tensor: torch.Tensor) -> None:
    with pytest.raises(UsageError, match=r"^values is .*expected"):
        stochastic.perturb(tensor, CH1, 0)
