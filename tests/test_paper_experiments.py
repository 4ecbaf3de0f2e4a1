"""Experiments on the paper's claims: networks that differ in how levels come about, a perceptual measure, losses, and
the text that says what explains a figure."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from mipbake import material
from mipbake.training import loop
from mipbake.training.batches import draw_batch
from mipbake.training.config import DataConfig
from mipbake.training.data import load_materials
from mipbake.training.procedural import MODEL, procedural_set

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module


def test_networks_start_as_averages_and_differ_after_a_step(module: Callable[[str], ModuleType]) -> None:
    stability, networks = module("stability"), module("stability_networks")
    stored = torch.from_numpy(material.convert(procedural_set(3, 16), MODEL, "ggx")[None].astype(np.float32))
    made = {}
    for kind in networks.KINDS:
        config = stability.configured(kind, 1e-2, 0, 2)
        config = loop.dataclasses.replace(config, data=DataConfig(procedural_sets=1, procedural_size=32))
        materials, _ = load_materials(config)
        state = loop.new_state(config)
        loop.fit_whitening(state.network, materials, config)
        assert networks.growth(state.network, stored, "ggx") == pytest.approx([1.0] * 5, abs=1e-4)
        state.advance(draw_batch(materials, config, 0))
        made[kind] = networks.growth(state.network, stored, "ggx")
        levels = state.network(stored, "ggx", "gaussian")["ggx"]
        assert [level.shape[1] for level in levels] == [16, 8, 4, 2, 1]
    # Level 0 is made alike; what is made of what was made is not.
    assert made["linear"][0] == pytest.approx(made["autoregressive"][0], rel=1e-4)
    assert made["linear"][4] != pytest.approx(made["autoregressive"][4], rel=1e-4)


def test_shift_tolerant_lpips_sees_changes(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    """With made-up weights of the released shapes."""
    torch.manual_seed(0)
    shapes = {"slice1.0": (64, 3, 11), "slice2.5": (192, 64, 5), "slice3.9": (384, 192, 3), "slice4.11": (256, 384, 3)}
    parts: dict[str, torch.Tensor] = {}
    for index, (layer, (out, read, side)) in enumerate((shapes | {"slice5.13": (256, 256, 3)}).items()):
        parts[f"net.{layer}.weight"] = torch.randn(out, read, side, side) / side / read**0.5
        parts[f"net.{layer}.bias"] = torch.zeros(out)
        parts[f"lin{index}.model.1.weight"] = torch.rand(1, out, 1, 1)
    for name in ("shift", "scale"):
        parts[f"scaling_layer.{name}"] = torch.ones(1, 3, 1, 1)
    torch.save(parts, tmp_path / "weights.pth")
    measure = module("st_lpips").ShiftTolerantLpips(tmp_path / "weights.pth")
    picture = np.random.default_rng(0).random((48, 48, 3))
    little, much = (np.clip(picture + noise, 0, 1) for noise in (0.02, 0.3))
    assert measure(picture, picture) == 0
    assert 0 < measure(little, picture) < measure(much, picture)
    assert measure(much, picture) == pytest.approx(measure(picture, much))


def test_the_authors_loss_of_mipnet_is_zero_where_renders_agree(module: Callable[[str], ModuleType]) -> None:
    losses, stability = module("mipnet_losses"), module("stability")
    config = stability.configured("linear", 1e-3, 0, 1)
    config = loop.dataclasses.replace(config, data=DataConfig(procedural_sets=1, procedural_size=32))
    materials, _ = load_materials(config)
    state = loop.new_state(config)
    loop.fit_whitening(state.network, materials, config)
    batch = draw_batch(materials, config, 0)
    before = losses.authors(config.loss, state.network, batch)
    levels = state.network(batch.patches, "ggx", "gaussian")["ggx"]
    texels, views = losses.trilinear(levels, batch.views), batch.views
    render = losses.shade("ggx", texels.flatten(1, 2), views.light, views.view)
    own = render.detach().reshape(*render.shape[:2], *texels.shape[1:3], 3).movedim(2, 1)
    same = loop.dataclasses.replace(batch, noisy_reference=own)
    assert losses.authors(config.loss, state.network, same).item() == pytest.approx(0, abs=1e-7)
    before.backward()
    assert before.item() > 0
    assert all(float(each.norm()) > 0 for each in state.optimiser.gradients("ggx"))
