"""Generated sets in Beckmann lobes: valid, reproducible, with the tails and the directions that captures show."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.material import MAX_LOG_GAMMA, MODELS, regularise
from mipbake.training import data
from mipbake.training.captured import SUBSTANCES, captured, captured_set
from mipbake.training.config import read_config
from mipbake.training.loop import new_state
from mipbake.training.validation import Validator

from .small_training import SMALL, tiny

CONFIGS = Path(__file__).resolve().parent.parent / "training" / "configs"

Stored = np.ndarray[Any, np.dtype[np.float32]]


def axes(stored: Stored) -> tuple[Any, Any, Any]:
    """ln alpha of the wider and of the narrower axis of lobes, and the angle of the wider one."""
    a, b, c = np.moveaxis(stored[..., 8:11].astype(np.float64), -1, 0)
    radius = np.hypot((a - b) / 2, c)
    return ((a + b) / 2 + radius) / 2, ((a + b) / 2 - radius) / 2, np.arctan2(c, (a - b) / 2) / 2


@pytest.mark.parametrize("seed", range(8))
def test_sets_are_valid_periodic_and_reproducible(seed: int) -> None:
    stored = captured_set(seed, 64)
    assert stored.shape == (64, 64, 12)
    assert stored.dtype == np.float32
    assert np.isfinite(stored).all()
    low, high = np.array(MODELS["beckmann"].limits, np.float32).T
    assert ((stored >= low - 1e-6) & (stored <= high + 1e-6)).all()
    assert (np.linalg.norm(stored[..., 6:8], axis=-1) < 1).all()
    wide, narrow, _ = axes(stored)
    assert wide.max() <= 1e-6
    assert narrow.min() >= math.log(MODELS["beckmann"].least_alpha2) / 2 - 1e-6
    assert np.abs(stored[..., 11]).max() <= MAX_LOG_GAMMA
    np.testing.assert_allclose(regularise(stored, "beckmann"), stored, atol=1e-5)  # nothing has to be put right
    np.testing.assert_array_equal(stored, captured_set(seed, 64))
    inner, seam = np.diff(stored, axis=1), stored[:, :1] - stored[:, -1:]
    assert np.abs(seam).mean() < 2.5 * np.abs(inner).mean() + 1e-3


def test_tails_are_heavy_and_light_and_lobes_are_sharp() -> None:
    """What no converted set has: exponents from far below 1 to far above, and sharp peaks with the heaviest tails."""
    sets = np.stack([captured_set(seed, 32) for seed in range(64)])
    gamma = np.exp(sets[..., 11])
    assert np.mean(gamma < 0.5) > 0.15
    assert np.mean(gamma > 1.2) > 0.08
    assert np.mean((gamma > 0.5) & (gamma < 1)) > 0.3
    wide, narrow, _ = axes(sets)
    assert np.mean(narrow < math.log(0.06)) > 0.1
    assert np.mean(wide > math.log(0.4)) > 0.1
    assert np.mean(wide - narrow > math.log(2)) > 0.15
    own = [np.corrcoef(each[..., 11].ravel(), (each[..., 8] + each[..., 9]).ravel())[0, 1] for each in sets]
    assert np.mean(own) > 0.3  # within a set, glossier texels have heavier tails


def test_lobes_are_wide_across_brush_marks() -> None:
    """As scratches too fine for the normal map would have it."""
    for seed in range(6):
        kind = SUBSTANCES["brushed metal"]
        stored = captured(kind, np.random.default_rng(seed), 64)
        x, y = stored[..., 6], stored[..., 7]
        difference, product = np.mean(x * x - y * y), 2 * np.mean(x * y)
        if np.hypot(difference, product) < 0.6 * np.mean(x * x + y * y):
            continue  # scratched in all directions
        _, _, angle = axes(stored)
        lobes = np.angle(np.mean(np.exp(2j * angle))) / 2
        apart = abs((lobes - np.arctan2(product, difference) / 2 + math.pi / 2) % math.pi - math.pi / 2)
        assert apart < 0.3


def mixed(**network: Any) -> data.Materials:
    content = {"captured_sets": 3, "procedural_sets": 3, "held_out": 0, "procedural_size": 64}
    train, _ = data.load_materials(tiny(network=network, data=content))
    return train


def test_captured_sets_are_read_by_the_encoder_of_their_model_alone() -> None:
    """Half of its patches where there are as many of them; the other encoder has none."""
    materials = mixed(encoders=("ggx", "beckmann"), latent_channels=32)
    assert len(materials) == 6
    assert [name for _, name in materials.of("ggx")] == ["ggx"] * 3
    assert [name for _, name in materials.of("beckmann")] == ["ggx"] * 3 + ["beckmann"] * 3
    known = [image for image, name in materials.of("beckmann") if name == "beckmann"]
    crops = materials.crops(200, 16, "beckmann", np.random.default_rng(0))
    own = [bool(np.isin(crop[..., 11], [image[..., 11] for image in known]).all()) for crop in crops]
    assert 0.4 < np.mean(own) < 0.6


@pytest.mark.parametrize("encoders", [("beckmann",), ("ggx", "beckmann")])
def test_every_second_turn_of_a_validation_is_a_captured_set(encoders: tuple[str, ...]) -> None:
    content = {"captured_sets": 1, "procedural_sets": 1, "held_out": 0, "procedural_size": 64}
    config = tiny(network={"encoders": encoders, "latent_channels": 32}, data=content)
    _, held_out = data.load_materials(config)
    validator = Validator(held_out, config.network, "gaussian", SMALL)
    patches = [patch.stored for patch in validator.patches if patch.model == "beckmann"]
    middle = held_out.captured.images[SMALL.patches - 1][24:40, 24:40].astype(np.float32)
    if len(encoders) == 1:
        np.testing.assert_allclose(patches[1], middle, atol=2e-3)
    assert np.isfinite(validator.score(new_state(config).average).total)


def test_the_paper_s_beckmann_networks_are_trained_on_captured_sets() -> None:
    for name, count in {"paper-ggx": 0, "paper-beckmann": 104, "paper-cross": 104}.items():
        assert read_config(CONFIGS / f"{name}.toml").data.captured_sets == count
