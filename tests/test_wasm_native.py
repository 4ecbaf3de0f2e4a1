"""The core as WebAssembly computes what the compiled core does. `python .ci/fallback_wheel.py` compiles it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake import _native
from mipbake.base.errors import UsageError
from mipbake.material.pixel_filter import resample_taps, resample_weights
from mipbake.models.registry import list_weights, load_baker

from .door_results import DOORS
from .moment_cases import bumpy

pytestmark = pytest.mark.independent


@pytest.fixture
def wasm() -> Any:
    pytest.importorskip("wasmtime", reason="wasmtime is not installed (the extra `checks`)")
    from mipbake import _wasm
    from mipbake._wasm.machine import CORE

    if not CORE.exists():
        pytest.skip("the core is not compiled to WebAssembly: run python .ci/fallback_wheel.py")
    return _wasm


@pytest.fixture
def by_both(wasm: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], tuple[Any, Any]]:
    """What a function gives with the core as WebAssembly, and with the compiled one."""

    def called(function: Callable[[], Any]) -> tuple[Any, Any]:
        with monkeypatch.context() as patch:
            patch.setattr(mipbake, "_native", wasm)
            found = function()
        return found, function()

    return called


@pytest.mark.parametrize("door", [name for name in DOORS if name not in ("stochastic", "splats")])
def test_doors_agree(by_both: Any, door: str) -> None:
    for index, ((found, error), (expected, _)) in enumerate(zip(*by_both(DOORS[door]), strict=True)):
        if error == 0 and door != "raster":
            assert found.tobytes() == expected.tobytes(), index
        else:
            assert np.linalg.norm(found - expected) <= max(error, 1e-6) * max(np.linalg.norm(expected), 1e-30), index


def test_resampling_has_the_same_bits_whatever_the_strides(by_both: Any) -> None:
    image = np.random.default_rng(0).random((40, 90, 6), np.float32)
    rows, columns = (resample_weights(n, 13, "mitchell", "wrap") for n in (20, 90))
    for view in (image[::2], image[::-2], np.broadcast_to(image[:1], image.shape)[::2]):
        found, expected = by_both(lambda view=view: resample_taps(view, rows, columns))
        assert found.tobytes() == expected.tobytes()


@pytest.mark.parametrize(("kind", "channels", "size"), [("bc1", 4, 8), ("bc4", 1, 8), ("bc5", 2, 16), ("bc7", 4, 16)])
def test_blocks_are_the_same(wasm: Any, kind: str, channels: int, size: int) -> None:
    values = np.random.default_rng(0).random((13, 22, channels), np.float32)
    blocks = [np.empty((24, size), np.uint8) for _ in range(2)]
    decoded = [np.empty_like(values) for _ in range(2)]
    for core, block, texels in zip((wasm, _native), blocks, decoded, strict=True):
        core.encode_blocks(kind, values, None, block)
        core.decode_blocks(kind, block, texels)
    assert blocks[0].tobytes() == blocks[1].tobytes()
    assert decoded[0].tobytes() == decoded[1].tobytes()


def test_networks_bake_the_same(wasm: Any, by_both: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from mipbake.models import native

    info = next(each for each in list_weights() if each.name == "mipbake-3")

    def levels() -> list[np.ndarray]:
        monkeypatch.setattr(native, "_native", mipbake._native)  # noqa: SLF001
        return load_baker(info).bake(bumpy(48, 40), "gltf", "gltf", "gaussian", ("clamp", "wrap"))

    for found, expected in zip(*by_both(levels), strict=True):
        assert np.abs(found - expected).max() < 3e-3
        assert np.quantile(np.abs(found - expected), 0.99) < 1e-4


def test_faults_are_errors_and_the_next_call_works(wasm: Any) -> None:
    tri = np.array([[0, 1, 9]], np.int32)
    with pytest.raises(ValueError) as expected:
        _native.check_mesh(None, tri, 3, None)
    with pytest.raises(ValueError) as found:
        wasm.check_mesh(None, tri, 3, None)
    assert str(found.value) == str(expected.value)
    wasm.check_mesh(None, tri, 10, None)
    with pytest.raises(ValueError, match="unexpected shape or dtype of blocks"):
        wasm.decode_blocks("bc1", np.empty((2, 8), np.uint8), np.empty((4, 4, 4), np.float32))


def test_what_does_not_fit_or_is_missing_is_a_sentence(wasm: Any) -> None:
    level = np.broadcast_to(np.float32(0), (1, 40000, 40000, 1))
    with pytest.raises(UsageError, match="does not fit into 4 GiB"):
        wasm.texture_mip(level, np.empty((1, 20000, 20000, 1), np.float32))
    with pytest.raises(UsageError, match="stochastic_adam is missing"):
        wasm.stochastic_adam()
