"""Cross-training: several encoders and decoders on one latent (section 3.5 of Kemppinen et al. 2023)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from mipbake.base.errors import UsageError
from mipbake.material import MODELS, convert
from mipbake.models.latent_config import LatentConfig
from mipbake.models.parameters import to_parameters
from mipbake.models.registry import default_weights, load_network
from mipbake.training import data, loop
from mipbake.training.batches import batches, draw_batch
from mipbake.training.config import TrainingConfig
from mipbake.training.export import export_weights
from mipbake.training.loss import render_loss, trilinear
from mipbake.training.procedural import procedural_set

from .small_training import tiny, train

ENCODERS, DECODERS = ("ggx", "beckmann"), ("ggx", "beckmann", "gltf", "gltf-anisotropic")


def crossed(**sections: dict[str, object]) -> TrainingConfig:
    network = {"encoders": list(ENCODERS), "decoders": list(DECODERS), "latent_channels": 32}
    return tiny(network=network, **sections)


def started(config: TrainingConfig) -> tuple[loop.TrainingState, data.Materials]:
    materials, _ = data.load_materials(config)
    state = loop.new_state(config)
    loop.fit_whitening(state.network, materials, config)
    return state, materials


def test_encoders_take_turns_and_targets_are_rendered_in_what_is_read() -> None:
    config = crossed()
    materials, _ = data.load_materials(config)
    drawn = [draw_batch(materials, config, step) for step in range(3)]
    assert [batch.source for batch in drawn] == ["ggx", "beckmann", "ggx"]
    for batch in drawn:
        assert batch.patches.shape[-1] == MODELS[batch.source].channels
    assert drawn[1].patches[..., 11].std() > 0.01


def test_a_step_trains_its_encoder_and_every_decoder() -> None:
    config = crossed(optimiser={"ramp": 1, "ema_decay": 0.0})
    state, materials = started(config)
    for step in range(4):
        before = {name: value.clone() for name, value in state.network.named_parameters()}
        state.advance(draw_batch(materials, config, step))
        moved = {
            ".".join(name.split(".")[:2])
            for name, value in state.network.named_parameters()
            if not torch.equal(value, before[name])
        }
        assert moved == {f"encoders.{ENCODERS[step % 2]}", *(f"decoders.{model}" for model in DECODERS)}


@pytest.mark.parametrize("source", ENCODERS)
def test_decoders_start_as_linear_maps_of_what_is_read(source: str) -> None:
    """Level 0 of an untrained network is the material itself, as near as a linear map between parameters comes."""
    state, materials = started(crossed())
    patches = data.draw_crops(materials, 16, 16, source, np.random.default_rng(0))
    with torch.no_grad():
        stacks = state.network.stacks(torch.from_numpy(patches), ("wrap", "wrap"), source)
    for model in DECODERS:
        found = to_parameters(stacks[model][0], model).flatten(0, 2)
        wanted = to_parameters(torch.from_numpy(convert(patches, source, model)), model).flatten(0, 2)
        error = (found - wanted).square().sum() / (wanted - wanted.mean(0)).square().sum()
        assert error < (1e-6 if model == source else 0.25), model


@pytest.mark.long
def test_cross_training_lowers_the_loss_of_every_decoder() -> None:
    config = crossed(
        loss={"pairs": 16, "target_samples": 16, "near_mirror_fraction": 1.0, "lods": 3, "crops": 4},
        optimiser={"learning_rate": 3e-3, "ema_decay": 0.0, "ramp": 5},
        run={"steps": 40},
    )
    state, materials = started(config)
    held = [draw_batch(materials, config, 1000 + i) for i in range(6)]

    def losses() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        out = np.zeros(len(DECODERS))
        with torch.no_grad():
            for batch in held:
                stacks = state.network.stacks(batch.patches, ("wrap", "wrap"), batch.source)
                out += [
                    float(render_loss(trilinear(levels, batch.views), model, batch.views, batch.noisy_reference))
                    for model, levels in stacks.items()
                ]
        return out

    before = losses()
    for batch in batches(materials, config, 0):
        state.advance(batch)
    assert (losses() < 0.95 * before).all()


def test_exported_and_baked(tmp_path: Path) -> None:
    whole = train(crossed(run={"steps": 2}), tmp_path / "whole", resume=False)
    header = (tmp_path / "whole" / "validation.csv").read_text().splitlines()[0]
    assert all(f"{model} near-mirror" in header for model in DECODERS)

    info = export_weights(tmp_path / "whole" / "last.npz", "tiny-cross", tmp_path / "weights", default=True)
    assert info.targets == DECODERS
    assert info.pixel_filters == ("gaussian",)
    assert json.loads((tmp_path / "weights" / "tiny-cross.json").read_text())["network"]["encoders"] == list(ENCODERS)
    assert (
        "| Makes | `ggx`, `beckmann`, `gltf` and `gltf-anisotropic` |"
        in (tmp_path / "weights/tiny-cross.md").read_text()
    )
    network, stored, wrap = load_network(info), procedural_set(7, 32), ("wrap", "wrap")
    for target in DECODERS:
        assert default_weights(target, folder=tmp_path / "weights") == info
        levels = network.bake(stored, "gltf", target, "gaussian", wrap)
        assert [level.shape for level in levels] == [(32 >> i, 32 >> i, MODELS[target].channels) for i in range(6)]
        ggx = torch.from_numpy(convert(stored, "gltf", "ggx"))[None]
        with torch.no_grad():
            expected = [level[0].numpy() for level in whole.average.stacks(ggx, wrap, "ggx")[target]]
        for level, other in zip(levels, expected, strict=True):
            np.testing.assert_allclose(level, other, atol=2e-4)
    with pytest.raises(UsageError, match="pixel filter gaussian, not for 'box'"):
        network.bake(stored, "gltf", "gltf", "box", wrap)


def test_what_networks_read_and_make() -> None:
    ggx = LatentConfig(("ggx",), ("ggx",))
    assert ggx.targets == ("ggx", "gltf-anisotropic")
    assert ggx.read_as("beckmann") == ggx.read_as("gltf") == "ggx"
    assert ggx.made_from("gltf-anisotropic") == "ggx"
    with pytest.raises(UsageError, match="make ggx, gltf-anisotropic, not 'gltf'"):
        ggx.made_from("gltf")
    cross = LatentConfig(ENCODERS, DECODERS)
    assert cross.targets == DECODERS
    assert [cross.read_as(model) for model in MODELS] == ["ggx", "ggx", "ggx", "beckmann"]
    assert cross.made_from("gltf-anisotropic") == "gltf-anisotropic"
    for model in MODELS:
        assert LatentConfig((model,), (model,)).read_as(model) == model
