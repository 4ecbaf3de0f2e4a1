"""Stochastic gradients: the native kernels beside their plain twins, and what their estimates mean."""

from __future__ import annotations

import io
import math
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from mipbake import _native, stochastic
from mipbake.errors import UsageError
from mipbake.stochastic import Channels, Contributions, Moments, reference

from .raster_scenes import threads

CHANNELS = Channels((0.1, 0.0, 0.02, 0.3), (0.0, -1.0, -0.5, 0.0), (1.0, 1.0, 2.0, 0.75))
FREE = Channels((1.0,), (-math.inf,), (math.inf,))
"""One channel without limits; its perturbed zeros are the signs."""

KINDS: dict[str, Callable[[NDArray[Any]], Any]] = {"numpy": np.array, "torch": torch.tensor}
DTYPES = ("float32", "float64")
each_kind = pytest.mark.parametrize("kind", KINDS)
each_dtype = pytest.mark.parametrize("dtype", DTYPES)


def random(*shape: int, seed: int = 0, dtype: str = "float64") -> NDArray[Any]:
    return np.random.default_rng(seed).uniform(-0.6, 1.6, shape).astype(dtype)


def close(actual: Any, expected: Any, dtype: str, scale: float = 1.0) -> None:
    """Equal but for some roundings of numbers of this size."""
    error = np.abs(np.asarray(actual, np.float64) - np.asarray(expected, np.float64))
    assert np.all(error <= 8 * scale * np.finfo(dtype).eps), float(error.max())


def signs(count: int, step: int, seed: int) -> NDArray[np.float64]:
    """The signs of parameters 0 to count - 1."""
    return stochastic.perturb(np.zeros((count, 1)), FREE, step, seed)[0][:, 0]


# Signs


@pytest.mark.parametrize("step, seed", [(0, 0), (1, 0), (0, 1), (77, 12345), (2**32 - 1, 2**32 - 1)])
def test_signs_are_the_twins(step: int, seed: int) -> None:
    assert np.array_equal(signs(5000, step, seed), reference.signs(5000, step, seed).numpy())


def test_signs_are_numbered_through_all_channels() -> None:
    channels = Channels((1.0,) * 7, (-math.inf,) * 7, (math.inf,) * 7)
    plus, _ = stochastic.perturb(np.zeros((300, 7)), channels, 5, 6)
    assert np.array_equal(plus.ravel(), signs(2100, 5, 6))


def test_signs_are_balanced_and_independent_in_pairs() -> None:
    """A mean of n independent signs has the standard error 1 / sqrt(n). 300 means all lie within 5 of them, but for a
    chance below 2e-4 if signs were drawn anew; here they are always the same ones."""
    n = 1 << 18
    bound = 5 / math.sqrt(n)
    base = signs(n, 0, 0)
    shifts = (*range(1, 65), 127, 128, 255, 256, 1000, 1024, 4096, 65536)
    means = [base.mean(), *((base[shift:] * base[:-shift]).mean() * math.sqrt(1 - shift / n) for shift in shifts)]
    for other in (*range(1, 33), 255, 256, 65536, 2**31, 2**32 - 1):
        for step, seed in ((other, 0), (0, other), (other, other)):
            drawn = signs(n, step, seed)
            means += [drawn.mean(), (drawn * base).mean(), (drawn[1:] * base[:-1]).mean()]
        means.append((signs(n, other, 3) * signs(n, 3, other)).mean() if other != 3 else 0.0)
    assert np.abs(means).max() < bound


def test_signs_of_a_parameter_are_balanced_over_steps() -> None:
    n = 4096
    drawn = np.stack([signs(64, step, 9) for step in range(n)])
    bound = 5 / math.sqrt(n)
    assert np.abs(drawn.mean(0)).max() < bound
    assert np.abs((drawn[1:] * drawn[:-1]).mean(0)).max() < bound * math.sqrt(n / (n - 1))
    products = drawn.T @ drawn / n
    assert np.abs(products - np.eye(64)).max() < bound * 1.1  # 2016 different products: 5.5 standard errors


# Perturbing


@each_kind
@each_dtype
def test_perturbed_values_are_the_twins(kind: str, dtype: str) -> None:
    values = random(3000, 4, dtype=dtype)
    plus, minus = stochastic.perturb(KINDS[kind](values), CHANNELS, 3, 4)
    assert type(plus) is type(KINDS[kind](values))
    numbers = [torch.tensor(n, dtype=torch.float64) for n in (CHANNELS.magnitude, CHANNELS.low, CHANNELS.high)]
    expected = reference.perturb(torch.tensor(values).double(), *numbers, 3, 4)
    close(plus, expected[0], dtype, 2)
    close(minus, expected[1], dtype, 2)
    assert np.array_equal(np.asarray(plus)[:, 1], values[:, 1])  # the magnitude 0: any value stays


@each_dtype
def test_perturbed_values_lie_within_limits_and_differ_by_two_magnitudes(dtype: str) -> None:
    generator = np.random.default_rng(1)
    for _ in range(300):
        low, high = np.sort(generator.normal(size=2).astype(dtype).astype(float))
        magnitude = float(np.dtype(dtype).type((high - low) / 2 * generator.random() * 0.999))
        values = generator.uniform(low - 1, high + 1, (16, 1)).astype(dtype)
        sides = stochastic.perturb(values, Channels((magnitude,), (low,), (high,)), 2)
        assert all(low <= side.min() and side.max() <= high for side in sides)
        close(np.abs(sides[0] - sides[1]), 2 * magnitude, dtype, max(abs(low), abs(high)))


@each_kind
def test_listed_elements_alone_are_perturbed(kind: str) -> None:
    make = KINDS[kind]
    values, listed = make(random(50, 4)), make(np.int32([7, 3, 49]))
    whole = stochastic.perturb(values, CHANNELS, 1, 2)
    some = stochastic.perturb(values, CHANNELS, 1, 2, listed)
    out = (make(np.full((50, 4), 9.0)), make(np.full((50, 4), 9.0)))
    given = stochastic.perturb(values, CHANNELS, 1, 2, listed, out)
    others = np.setdiff1d(np.arange(50), np.asarray(listed))
    for all_of_them, side, own, memory in zip(whole, some, given, out, strict=True):
        rows = [np.asarray(each) for each in (all_of_them, side, own, values, memory)]
        assert np.array_equal(rows[0][listed], rows[1][listed]) and np.array_equal(rows[0][listed], rows[2][listed])
        assert np.array_equal(rows[1][others], rows[3][others]) and np.all(rows[2][others] == 9)
        assert np.array_equal(rows[2], rows[4])


@each_dtype
def test_lifted_normals_are_unit_vectors(dtype: str) -> None:
    """Also where x and y reach beyond the unit disc, and after a step."""
    channels = Channels((0.1, 0.2, 0.2, 0.0), (0.0,) * 4, (1.0,) * 4, lifted=1)
    values = random(4000, 4, dtype=dtype)
    values[:4, 1:] = [[0.5, 0.5, 1], [1, 1, 0], [0, 0, 0.5], [0.5, 0, 0.5]]
    plus, minus = stochastic.perturb(values, channels, 1)
    stochastic.descend(values, random(4000, 4, seed=2, dtype=dtype), Moments.of(values), channels)
    for side in (plus, minus, values):
        normals = 2 * side[:, 1:].astype(np.float64) - 1
        close((normals**2).sum(-1), 1, dtype)
        assert normals[:, 2].min() >= 0


# Differences and gradients


@each_kind
@each_dtype
def test_differences_are_the_twins(kind: str, dtype: str) -> None:
    images, weights = [random(900, 3, seed=s, dtype=dtype) for s in range(3)], random(900, seed=3, dtype=dtype)
    made = [KINDS[kind](image) for image in images]
    expected = reference.differences(*(torch.tensor(image).double() for image in images)).numpy()
    close(stochastic.pixel_differences(*made), expected, dtype, 30)
    close(stochastic.pixel_differences(*made, KINDS[kind](weights)), expected * weights, dtype, 50)


def test_differences_of_almost_equal_images_do_not_cancel() -> None:
    plus, minus, wanted = np.float32([[1.0 + 2**-23]]), np.float32([[1.0]]), np.float32([[-999.0]])
    assert stochastic.pixel_differences(plus, minus, wanted)[0] == pytest.approx(2000 * 2**-23, rel=1e-6)


TOUCHED = {
    "some twice, some none": np.random.default_rng(0).integers(-6, 12, (200, 5)).astype(np.int32).clip(-1),
    "one element": np.zeros((7, 3), np.int32),
    "none at all": np.full((4, 2), -1, np.int32),
    "no pixels": np.zeros((0, 3), np.int32),
    "no places": np.zeros((3, 0), np.int32),
    "far numbers": np.int32([[900_000, 5], [5, -1], [-1, 900_000]]),
}


@each_kind
@pytest.mark.parametrize("case", TOUCHED)
def test_contributions_are_a_plain_loops(kind: str, case: str) -> None:
    pixels: dict[int, list[int]] = {}
    for pixel, named in enumerate(TOUCHED[case].tolist()):
        for element in {each for each in named if each >= 0}:
            pixels.setdefault(element, []).append(pixel)
    found = stochastic.contributions(KINDS[kind](TOUCHED[case]))
    assert str(found.elements.dtype).endswith("int32") and str(found.pixels.dtype).endswith("int32")
    assert str(found.starts.dtype).endswith("int64")
    elements, starts, listed = (each.tolist() for each in (found.elements, found.starts, found.pixels))
    assert elements == sorted(pixels)
    assert {e: listed[a:b] for e, a, b in zip(elements, starts, starts[1:], strict=False)} == pixels
    assert starts[0] == 0 and starts[-1] == len(listed)


@each_kind
@each_dtype
@pytest.mark.parametrize("case", TOUCHED)
def test_gradients_are_the_twins_and_are_added(kind: str, dtype: str, case: str) -> None:
    touched, count = TOUCHED[case], max(int(TOUCHED[case].max(initial=0)) + 1, 4)
    differences = random(len(touched), seed=4, dtype=dtype)
    gradient = KINDS[kind](np.ones((count, 4), dtype))
    made_of = stochastic.contributions(KINDS[kind](touched))
    for step in (8, 9):
        stochastic.add_gradient(gradient, KINDS[kind](differences), made_of, CHANNELS, step, 2)
    magnitude = torch.tensor(CHANNELS.magnitude, dtype=torch.float64)
    rows, named = np.unique(touched, return_inverse=True)  # the twin loops over all elements: few of them
    small = torch.tensor(differences).double()
    expected = np.ones((count, 4))
    for step in (8, 9):
        s = reference.signs(count * 4, step, 2).view(-1, 4)[torch.tensor(np.maximum(rows, 0)).long()]
        found = reference.gradient(
            small, torch.tensor(np.where(touched < 0, -1, named.reshape(touched.shape))), s, magnitude
        )
        expected[rows[rows >= 0]] += found.numpy()[rows >= 0]
    close(np.asarray(gradient), expected, dtype, 1 + np.abs(expected).max())


# Adam


def optimisers(rows: list[torch.Tensor], rates: tuple[float, ...], **options: Any) -> list[torch.optim.Adam]:
    """torch's Adam of each element, with the rates of channels."""
    return [torch.optim.Adam([{"params": [v], "lr": r} for v, r in zip(row, rates, strict=True)], **options) for row in rows]  # type: ignore[arg-type]  # fmt: skip


@each_kind
@each_dtype
def test_descending_is_torchs_adam(kind: str, dtype: str) -> None:
    """Each element has an Adam of its own, which takes a step only when the element is listed."""
    free = Channels((0.1, 0.02, 0.3), (-math.inf,) * 3, (math.inf,) * 3)
    start = random(6, 3, dtype=dtype)
    values, moments = KINDS[kind](start), None
    moments = Moments.of(values)
    options: dict[str, Any] = {"betas": (0.8, 0.95), "eps": 1e-5}
    rows = [[torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in row.tolist()] for row in start]
    adams = optimisers(rows, tuple(0.5 * m for m in free.magnitude), **options)  # type: ignore[arg-type]
    generator = np.random.default_rng(0)
    for step in range(60):
        listed = None if step % 7 == 0 else np.flatnonzero(generator.random(6) < 0.5).astype(np.int32)
        slope = generator.normal(size=(6, 3)).astype(dtype)
        gradient = KINDS[kind](slope)
        elements = None if listed is None else KINDS[kind](listed)
        stochastic.descend(values, gradient, moments, free, 0.5, elements, options["betas"], options["eps"])
        moved = np.arange(6) if listed is None else listed
        for element in moved:
            for leaf, g in zip(rows[element], slope[element].tolist(), strict=True):
                leaf.grad = torch.tensor(g, dtype=torch.float64)
            adams[element].step()
        kept = np.setdiff1d(np.arange(6), moved)
        assert np.all(np.asarray(gradient)[moved] == 0) and np.array_equal(np.asarray(gradient)[kept], slope[kept])
    close(values, [[x.item() for x in row] for row in rows], dtype, 60)


@each_kind
@each_dtype
def test_what_is_not_listed_keeps_its_bits(kind: str, dtype: str) -> None:
    make = KINDS[kind]
    values = make(random(40, 4, dtype=dtype))
    moments = Moments(make(random(40, 4, seed=1, dtype=dtype)), make(random(40, 4, seed=2, dtype=dtype) + 1), make(np.full(40, 3, np.int32)))  # fmt: skip
    gradient, listed = make(random(40, 4, seed=3, dtype=dtype)), np.int32([0, 39, 11])
    arrays = (values, gradient, moments.first, moments.second, moments.steps)
    before = [np.array(each) for each in arrays]
    stochastic.descend(values, gradient, moments, CHANNELS, 1.0, make(listed))
    others = np.setdiff1d(np.arange(40), listed)
    for now, then in zip(arrays, before, strict=True):
        assert np.array_equal(np.asarray(now)[others], then[others])
    assert np.array_equal(np.asarray(moments.steps)[listed], [4, 4, 4])
    assert np.array_equal(np.asarray(values)[listed, 1], before[0][listed, 1])  # the channel without a magnitude
    moving = np.asarray(values)[listed][:, [0, 2, 3]]
    assert np.all(moving >= [0, -0.5, 0]) and np.all(moving <= np.array([1, 2, 0.75]))


def test_steps_are_bounded_however_small_gradients_are() -> None:
    """A step of Adam is at most the rate at first, also where the square of a gradient is no float32 any more."""
    values = np.zeros((1, 1), np.float32)
    for size in (1e-15, 1e-20, 1e-25, 1e-35, 0.0):
        values[...] = 0
        stochastic.descend(values, np.full((1, 1), size, np.float32), Moments.of(values), FREE, 0.25)
        assert abs(values[0, 0]) <= 0.25 * 1.001


# Threads and instruction sets

SCRIPT = """
import math
import numpy as np
from mipbake import _native, stochastic
from mipbake.stochastic import Channels, Moments


def results():
    generator = np.random.default_rng(0)
    found = []
    for dtype in (np.float32, np.float64):
        channels = Channels((0.1, 0.0, 0.02, 0.3), (0.0,) * 4, (1.0,) * 4, 0 if False else None)
        lifted = Channels((0.1, 0.1, 0.0, 0.3), (0.0,) * 4, (1.0,) * 4, 0)
        values = generator.uniform(-0.2, 1.2, (9001, 4)).astype(dtype)
        images = [generator.uniform(0, 1, (20011, 3)).astype(dtype) for _ in range(3)]
        made_of = stochastic.contributions(generator.integers(-1, 9001, (20011, 4)).astype(np.int32))
        for each in (channels, lifted):
            sides = stochastic.perturb(values, each, 5, 6)
            differences = stochastic.pixel_differences(*images, images[0][:, 0].copy())
            gradient = np.zeros_like(values)
            stochastic.add_gradient(gradient, differences, made_of, each, 5, 6)
            found += [*sides, differences, gradient.copy()]
            moments = Moments.of(values)
            for _ in range(3):
                slope = gradient.copy()
                stochastic.descend(values, slope, moments, each)
            found += [values.copy(), moments.first, moments.second]
    uv = generator.uniform(-2, 3, (20011, 2)).astype(np.float32)
    uv_da = (generator.normal(size=(20011, 4)) * 0.1).astype(np.float32)
    for texels in ("nearest", "trilinear", "anisotropic"):
        found.append(stochastic.touched_texels([(33, 17), (16, 8), (8, 4)], uv, None, uv_da, None, texels))
    return found
"""


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    here: dict[str, Any] = {}
    exec(SCRIPT, here)
    with threads(1):
        expected = here["results"]()
    for count in (2, 3, 7):
        with threads(count):
            found = here["results"]()
        assert all(a.tobytes() == b.tobytes() for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_every_instruction_set_agrees(isa: str) -> None:
    """Perturbed values have the same bits, so that renders of them do, and the rest is equal to rounding."""
    if isa == _native.isa():
        pytest.skip(f"{isa} is what the other tests use")
    script = f"import sys\n{SCRIPT}\nnp.savez(sys.stdout.buffer, *results(), isa=_native.isa())"
    run = subprocess.run(
        [sys.executable, "-c", script], env={**os.environ, "MIPBAKE_ISA": isa}, capture_output=True, check=True
    )
    loaded = np.load(io.BytesIO(run.stdout))
    if str(loaded["isa"]) != isa:
        pytest.skip(f"this processor or build has no {isa}")
    here: dict[str, Any] = {}
    exec(SCRIPT, here)
    expected = here["results"]()
    found = [loaded[f"arr_{i}"] for i in range(len(expected))]
    assert len(loaded.files) == len(expected) + 1
    bad = [i for i, (a, b) in enumerate(zip(found, expected, strict=True)) if a.tobytes() != b.tobytes()]
    assert bad == []


# What is refused

V, G, CH1 = np.zeros((4, 1), np.float32), np.zeros((4, 1), np.float32), Channels((0.1,), (0.0,), (1.0,))
D, UV, LOD, DA = np.zeros(3, np.float32), np.zeros((3, 2), np.float32), np.zeros(3, np.float32), np.zeros((3, 4), np.float32)  # fmt: skip
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
    (lambda: stochastic.descend(frozen, G, MOMENTS, CH1), "values is not contiguous, or cannot be written to"),
    (lambda: stochastic.descend(V, double, MOMENTS, CH1), "gradient is float64: expected float32"),
    (lambda: stochastic.descend(V, G, Moments.of(double), CH1), r"moments\.first is float64"),
    (lambda: stochastic.descend(V, G, Moments.of(V[:2].copy()), CH1), r"moments\.first has shape \(2, 1\)"),
    (lambda: stochastic.descend(V, G, Moments(V, V, V), CH1), r"moments\.steps has shape \(4, 1\)"),
    (lambda: stochastic.descend(V, G, MOMENTS, CHANNELS), r"values has shape \(4, 1\): expected \(any, 4\)"),
    (lambda: stochastic.descend(V, G, MOMENTS, CH1, 1.0, np.zeros((1, 1), np.int32)), r"elements has shape \(1, 1\)"),
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


# CUDA


@pytest.mark.skipif(
    not (torch.cuda.is_available() and _native.cuda_compiled()),
    reason="no CUDA device and CUDA kernels here: the GPU kernels of stochastic gradients are not tested",
)
def test_cuda_equals_the_cpu() -> None:
    generator = torch.Generator().manual_seed(0)
    lifted = Channels((0.1, 0.1, 0.0, 0.3), (0.0,) * 4, (1.0,) * 4, 0)
    found = []
    start = torch.rand(9001, 4, generator=generator)
    images = [torch.rand(20011, 3, generator=generator) for _ in range(3)]
    touched = torch.randint(-1, 9001, (20011, 4), generator=generator, dtype=torch.int32)
    listed = torch.randperm(9001, generator=generator)[:5000].int()
    for device in ("cpu", "cuda"):
        for channels in (CHANNELS, lifted):
            values = start.to(device, copy=True)
            sides = stochastic.perturb(values, channels, 3, 4, listed.to(device))
            made_of = stochastic.contributions(touched.to(device))
            differences = stochastic.pixel_differences(*(image.to(device) for image in images))
            gradient = torch.zeros_like(values)
            stochastic.add_gradient(gradient, differences, made_of, channels, 3, 4)
            slope, moments = gradient.clone(), Moments.of(values)
            stochastic.descend(values, slope, moments, channels, 1.0, listed.to(device))
            found.append(
                [*sides, differences, gradient, slope, values, made_of.elements, made_of.pixels, moments.steps]
            )
    for cpu, cuda in zip(found[:2], found[2:], strict=True):
        for expected, actual in zip(cpu, cuda, strict=True):
            torch.testing.assert_close(actual.cpu(), expected, rtol=1e-5, atol=1e-5)
    with pytest.raises(UsageError, match="values is float64 on cuda:0: expected float32, or the CPU"):
        stochastic.perturb(start.double().cuda(), lifted, 0)
