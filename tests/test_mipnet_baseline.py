"""The re-implemented MIPNet: what it makes before training, exactly; that it trains, resumes and is not released."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mipbake import material
from mipbake.material.pixel_filter import FILTERS
from mipbake.models.architectures import ARCHITECTURES
from mipbake.models.registry import find_weights, load_network
from mipbake.training import loop
from mipbake.training.config import TrainingConfig, config_from, plain, read_config

from .moment_cases import TORUS, bumpy
from .small_training import train

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
GLTF = ("gltf", "gltf-anisotropic")
AXIS = np.array([1, 0, 0], np.float32)


def module(name: str) -> ModuleType:
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
        assert spec is not None and spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


module("timing")
mipnet_network = module("mipnet_network")
mipnet = module("mipnet")


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Configurations may name it, in these tests alone."""
    for kind in mipnet_network.KINDS.values():
        monkeypatch.setitem(ARCHITECTURES, kind.architecture, kind)
    yield


def small(target: str) -> mipnet_network.MipnetConfig:
    return mipnet_network.MipnetConfig(target, single_layers=2, single_width=12, multi_layers=2, multi_width=16)


def tiny(target: str) -> TrainingConfig:
    return config_from(
        {
            "network": {
                "architecture": "mipnet", "target": target,
                "single_layers": 2, "single_width": 12, "multi_layers": 2, "multi_width": 16,
            },
            "data": {"held_out": 0, "procedural_sets": 2, "procedural_size": 64, "plain": 0.5, "strided": 0.5},
            "loss": {"kind": "balanced", "crops": 2, "crop_size": 16, "any_filter": 0.0},
            "optimiser": {"learning_rate": 2e-3, "ramp": 2, "ema_decay": 0.9, "clip": 5.0},
            "run": {"steps": 6, "log_every": 2, "validate_every": 4, "checkpoint_every": 3, "uses": 2},
        }
    )  # fmt: skip


def boxed(image: np.ndarray) -> np.ndarray:
    """Averages of 2 x 2, or of what there is along an axis of one texel."""
    rows = image if image.shape[0] == 1 else (image[::2] + image[1::2]) / 2
    return rows if rows.shape[1] == 1 else (rows[:, ::2] + rows[:, 1::2]) / 2


def stretched(height: int, width: int, seed: int) -> np.ndarray:
    """Valid stored channels of `beckmann` with turned lobes from sharp to wide."""
    rng = np.random.default_rng(seed)
    stored = material.convert(bumpy(height, width, seed), "gltf", "beckmann")
    mean, (d, c) = rng.uniform(-8, -1, (height, width)), rng.uniform(-1, 1, (2, height, width))
    stored[..., 8:] = np.stack([mean + d, mean - d, c, rng.uniform(-1, 1, (height, width))], -1)
    return material.regularise(stored, "beckmann")


def lobes(level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., 2) alpha along and across, and the direction of the first, of `gltf-anisotropic`."""
    across = np.square(level[..., 4])
    return np.stack([across + (1 - across) * np.square(level[..., 10]), across], -1), level[..., 8:10]


@pytest.mark.parametrize("size", [(16, 16), (8, 32), (16, 2), (1, 8)])
@pytest.mark.parametrize("target", GLTF)
def test_untrained_it_makes_box_averages(target: str, size: tuple[int, int]) -> None:
    stored = bumpy(*size, 3)
    levels = small(target).build().bake(stored, "gltf", target, "box", TORUS)
    kept = np.concatenate([stored, np.broadcast_to(AXIS, (*size, 3))], -1) if len(target) > 4 else stored
    np.testing.assert_array_equal(levels[0][..., :5], kept[..., :5])
    np.testing.assert_allclose(levels[0][..., 5:], kept[..., 5:], atol=1e-6)
    colours, xy = stored[..., :4].astype(float), stored[..., 5:7].astype(float)
    alpha = np.square(np.maximum(stored[..., 4:5].astype(float), material.MIN_ROUGHNESS))
    assert levels[-1].shape[:2] == (1, 1)
    for level in levels[1:]:
        colours, xy, alpha = boxed(colours), boxed(xy), boxed(alpha)
        np.testing.assert_allclose(level[..., :4], colours, atol=1e-6)
        np.testing.assert_allclose(level[..., 4:5], np.sqrt(alpha), rtol=1e-5 if target == "gltf" else 1e-3)
        np.testing.assert_allclose(level[..., 5:7], xy, atol=1e-5)
        np.testing.assert_allclose(np.square(level[..., 5:8]).sum(-1), 1, atol=1e-5)
        if target == "gltf-anisotropic":
            axes, direction = lobes(level)
            np.testing.assert_allclose(axes[..., 0] / axes[..., 1], 1, atol=3e-3)
            np.testing.assert_allclose(direction, np.broadcast_to(AXIS[:2], direction.shape), atol=1e-4)


def test_exported_weights_make_what_the_checkpoint_makes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To 16 bits, for every pixel filter, and never by default."""
    train(tiny("beckmann"), tmp_path / "run", False)
    arguments = ["mipnet.py", "export", str(tmp_path / "run" / loop.LAST), "mine", "--out", str(tmp_path / "weights")]
    monkeypatch.setattr("sys.argv", arguments)
    assert mipnet.main() == 0
    info = find_weights("mine", tmp_path / "weights")
    assert not info.default and info.pixel_filters == tuple(FILTERS) and info.targets == ("beckmann",)
    stored = stretched(16, 16, 1)
    theirs = mipnet.network_of(tmp_path / "run" / loop.LAST).bake(stored, "beckmann", "beckmann", "box", TORUS)
    ours = load_network(info).bake(stored, "beckmann", "beckmann", "box", TORUS)
    for level, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(level, other, atol=0.01)


def test_it_is_trained_as_mipbake_1_is() -> None:
    """Data, loss and length are equal, except for the filters that it does not know of; no other loss is taken."""
    ours = read_config(mipnet.CONFIGS / "mipbake-1.toml")
    config = mipnet.configured(ours, "gltf-anisotropic", None)
    assert config.network == mipnet_network.MipnetConfig("gltf-anisotropic")
    found, expected = plain(config), plain(ours)
    assert found["data"] == expected["data"] and found["loss"] == expected["loss"] | {"any_filter": 0.0}
    assert all(found["run"][name] == expected["run"][name] for name in ("steps", "uses", "seed"))
    assert config_from(found) == config
    assert mipnet.configured(ours, "gltf", 40).optimiser.rate(39) < 0.02 * 3e-4
    paper = mipnet.configured(read_config(mipnet.CONFIGS / "paper-ggx.toml"), "ggx", 100)
    assert paper.network == mipnet_network.SingleLightsConfig("ggx") and paper.loss.kind == "single-lights"
