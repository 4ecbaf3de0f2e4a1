"""What can be chosen for a method beside its name: trained weights, and the time it may take."""

from __future__ import annotations

import time

import numpy as np
import pytest

from mipbake.errors import UsageError
from mipbake.models import list_weights
from mipbake.prefilter import METHODS, OPTIONS, method_named
from mipbake.prefilter.time_budget import seconds_of


def test_budgets_are_seconds_minutes_or_best() -> None:
    assert [seconds_of(text) for text in ("30s", "2m", " 1.5 m ", "0.5s", "90S")] == [30, 120, 90, 0.5, 90]
    assert seconds_of("best") is None


@pytest.mark.parametrize("text", ["", "30", "0s", "-1m", "2h", "soon", "s", "nan s", "1e3s"])
def test_other_budgets_say_what_is_expected(text: str) -> None:
    with pytest.raises(
        UsageError, match=r"expected a time above 0 in seconds or minutes, for example 30s or 2m, or best"
    ):
        seconds_of(text)


@pytest.mark.parametrize("option", OPTIONS)
def test_methods_without_an_option_refuse_it(option: str) -> None:
    value = {"weights": "residual-gltf", "budget": "1s"}[option]
    for name in METHODS:
        if name in OPTIONS[option]:
            assert method_named(name, **{option: value}).name == name
        else:
            with pytest.raises(UsageError, match=rf"method {name} takes no {option}: .*{'.*'.join(OPTIONS[option])}"):
                method_named(name, **{option: value})


def test_weights_are_found_before_anything_is_baked() -> None:
    with pytest.raises(UsageError, match="unknown weights 'none-such': expected one of"):
        method_named("neural", weights="none-such")


def test_weights_of_another_model_are_refused() -> None:
    info = next(info for info in list_weights() if "ggx" in info.targets)
    stored = np.full((4, 4, 8), 0.5, np.float32)
    with pytest.raises(UsageError, match=rf"weights {info.name} are for material model ggx .* expected some for gltf"):
        method_named("neural", weights=info.name)(stored, "gltf", "gltf", "gaussian", ("wrap", "wrap"), lambda _: None)


def test_named_weights_are_used() -> None:
    info = next(info for info in list_weights() if info.targets == ("gltf",))
    stored = np.full((4, 4, 8), 0.5, np.float32)
    stored[..., 5:] = 0, 0, 1
    result = method_named("neural", weights=info.name)(
        stored, "gltf", "gltf", info.pixel_filter, ("wrap", "wrap"), lambda _: None
    )
    assert (result.weights, result.weights_sha256) == (info.name, info.sha256)


def test_a_budget_of_time_ends_the_optimum() -> None:
    rng = np.random.default_rng(0)
    normal = np.concatenate([0.3 * rng.standard_normal((32, 32, 2)), np.ones((32, 32, 1))], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    stored = np.concatenate([np.full((32, 32, 5), 0.4), normal], -1).astype(np.float32)
    method = method_named("optimum", budget="0.1s")
    began = time.monotonic()
    method(stored, "gltf", "gltf", "gaussian", ("wrap", "wrap"), lambda _: None)
    assert time.monotonic() - began < 30  # forty rounds take several times as long
