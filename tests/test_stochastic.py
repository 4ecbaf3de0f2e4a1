"""Stochastic gradients: the native kernels beside their plain twins, and what their estimates mean."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from mipbake import _native, stochastic
from mipbake.base.errors import UsageError
from mipbake.stochastic import Channels, Moments, reference

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


def test_signs_are_balanced_and_independent_in_pairs() -> None:
    """A mean of n independent signs has the standard error 1 / sqrt(n). 300 means all lie within 5 of them, but for a
    chance below 2e-4 if signs were drawn anew; here they are always the same ones."""
    n = 1 << 17
    bound = 5 / math.sqrt(n)
    base = signs(n, 0, 0)
    shifts = (*range(1, 65), 127, 128, 255, 256, 1000, 1024, 4096, 65536)
    means = [base.mean(), *((base[shift:] * base[:-shift]).mean() * math.sqrt(1 - shift / n) for shift in shifts)]
    for other in (*range(1, 33), 255, 256, 65536, 2**20, 2**32 - 1):
        for step, seed in ((other, 0), (0, other), (other, other)):
            drawn = signs(n, step, seed)
            means += [drawn.mean(), (drawn * base).mean(), (drawn[1:] * base[:-1]).mean()]
        means.append((signs(n, other, 3) * signs(n, 3, other)).mean() if other != 3 else 0.0)
    assert np.abs(means).max() < bound


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
    "many of one pixel, twice": np.int32([[*range(50_000), *range(50_000)], [7] * 100_000]),
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


@pytest.mark.long
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


def optimisers(rows: list[list[torch.Tensor]], rates: tuple[float, ...], **options: Any) -> list[torch.optim.Adam]:
    """torch's Adam of each element, with the rates of channels."""
    groups = [[{"params": [v], "lr": r} for v, r in zip(row, rates, strict=True)] for row in rows]
    return [torch.optim.Adam(group, **options) for group in groups]


@each_kind
@each_dtype
def test_descending_is_torchs_adam(kind: str, dtype: str) -> None:
    """Each element has an Adam of its own, which takes a step only when the element is listed."""
    free = Channels((0.1, 0.02, 0.3), (-math.inf,) * 3, (math.inf,) * 3)
    start = random(6, 3, dtype=dtype)
    values = KINDS[kind](start)
    moments = Moments.of(values)
    options: dict[str, Any] = {"betas": (0.8, 0.95), "eps": 1e-5}
    rows = [[torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in row.tolist()] for row in start]
    adams = optimisers(rows, tuple(0.5 * m for m in free.magnitude), **options)
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


def test_steps_are_bounded_however_small_gradients_are() -> None:
    """A step of Adam is at most the rate at first, also where the square of a gradient is no float32 any more."""
    values = np.zeros((1, 1), np.float32)
    for size in (1e-15, 1e-20, 1e-21, 8.4e-22, 8e-22, 1e-25, 1e-35, 0.0):
        values[...] = 0
        stochastic.descend(values, np.full((1, 1), size, np.float32), Moments.of(values), FREE, 0.25)
        assert abs(values[0, 0]) <= 0.25 * 1.001


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rate": math.nan}, "rate is nan: expected a finite number, 0 or more"),
        ({"betas": (0.9,)}, r"betas is \(0.9,\): expected two numbers from 0 to less than 1"),
        ({"betas": (0.9, 1.0)}, "expected two numbers from 0 to less than 1"),
        ({"epsilon": 0.0}, "epsilon is 0.0: expected a finite number above 0"),
    ],
)
def test_settings_of_a_step_outside_of_their_range_get_a_sentence(options: dict[str, Any], words: str) -> None:
    values = np.zeros((1, 1), np.float32)
    with pytest.raises(UsageError, match=words):
        stochastic.descend(values, np.zeros_like(values), Moments.of(values), FREE, **options)


# Threads and instruction sets


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
