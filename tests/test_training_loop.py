"""Training: the loop, resuming, logs, export."""

from __future__ import annotations

import csv
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from mipbake.base.errors import InputError, UsageError
from mipbake.models.latent_inference import bake_levels
from mipbake.models.registry import WeightsInfo, default_weights, list_weights, load_network
from mipbake.training import data, loop
from mipbake.training.batches import draw_batch
from mipbake.training.config import read_config
from mipbake.training.export import card, export_weights
from mipbake.training.procedural import procedural_set
from mipbake.training.validation import Validator

from .moment_cases import bumpy
from .small_training import SMALL, tiny, train

ROOT = Path(__file__).resolve().parent.parent
CONFIGS = ROOT / "training" / "configs"
CARDS = ROOT / "benchmarks" / "records" / "cards.json"


# The loop


def weights(state: loop.TrainingState) -> list[torch.Tensor]:
    return [v.clone() for n in (state.network, state.average) for v in n.state_dict().values()]


@pytest.mark.long
@pytest.mark.parametrize("models", [["gltf"], ["ggx", "beckmann"]])
def test_resumed_equals_uninterrupted(tmp_path: Path, models: list[str]) -> None:
    config = tiny(network={"encoders": models, "decoders": models, "latent_channels": 32})
    whole = train(config, tmp_path / "whole", resume=False)
    short = dataclasses.replace(config, run=dataclasses.replace(config.run, steps=3))
    train(short, tmp_path / "parts", resume=False)
    resumed = train(config, tmp_path / "parts", resume=True)
    assert resumed.step == whole.step == 6
    assert all(torch.equal(a, b) for a, b in zip(weights(whole), weights(resumed), strict=True))
    rows = {name: [row[:2] for row in csv.reader((tmp_path / name / "log.csv").open())] for name in ("whole", "parts")}
    assert [row[0] for row in rows["whole"]] == ["step", "2", "4", "6"]
    assert rows["parts"][-1][0] == "6"


def test_training_writes_checkpoints_logs_and_pictures(tmp_path: Path) -> None:
    (tmp_path / "validation.csv").write_text("step,old\n0,1\n4,1")  # of a training without a checkpoint
    train(tiny(), tmp_path, resume=False)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"last.npz", "best.npz", "log.csv", "validation.csv", "validation-0000004.png"} <= names
    assert not any(name.endswith(".partial") for name in names)
    header, *rows = csv.reader((tmp_path / "validation.csv").open())
    assert header[0] == "step"
    assert [row[0] for row in rows] == ["0", "4", "6"]
    with pytest.raises(UsageError, match="--resume"):
        train(tiny(), tmp_path, resume=False)
    with (tmp_path / "validation.csv").open("a") as table:
        table.write("1")  # of a row that a crash cut short
    (tmp_path / "log.csv").write_text("")
    train(tiny(run={"steps": 7}), tmp_path, resume=True)
    for table, steps in (("validation", ["0", "4", "6", "7"]), ("log", ["7"])):
        header, *rows = csv.reader((tmp_path / f"{table}.csv").open())
        assert header[0] == "step" and [row[0] for row in rows] == steps


def test_resuming_refuses_another_configuration(tmp_path: Path) -> None:
    train(tiny(run={"steps": 1}), tmp_path, resume=False)
    with pytest.raises(UsageError, match=r"another \[loss\] section"):
        train(tiny(loss={"pairs": 2}), tmp_path, resume=True)
    with pytest.raises(UsageError, match="seed"):
        train(tiny(run={"seed": 5}), tmp_path, resume=True)
    (tmp_path / "last.npz").write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"cannot be read .*: train anew"):
        train(tiny(), tmp_path, resume=True)
    with pytest.raises(InputError, match="no such checkpoint"):
        train(tiny(), tmp_path / "none", resume=True)


def test_average_follows_the_weights() -> None:
    config = tiny(optimiser={"ema_decay": 0.5})
    materials, _ = data.load_materials(config)
    state = loop.new_state(config)
    before = [v.clone() for v in state.network.parameters()]
    state.advance(draw_batch(materials, config, 0))
    for start, value, mean in zip(before, state.network.parameters(), state.average.parameters(), strict=True):
        assert torch.allclose(mean, (start + value) / 2, atol=1e-7)


def test_an_untrained_network_scores_like_averaging() -> None:
    config = tiny()
    materials, held_out = data.load_materials(config)
    state = loop.new_state(config)
    loop.fit_whitening(state.network, materials, config)
    score = Validator(held_out, config.network, "gaussian", SMALL).score(state.network)
    assert score.network.shape == score.baselines["lean"].shape
    # Level 0 is the input in both.
    np.testing.assert_allclose(score.network[..., 0], score.baselines["linear"][..., 0], atol=0.5)
    methods = ("network", "linear", "lean")
    assert score.columns().keys() == {f"{m} {s}" for m in methods for s in ("near-mirror", "hemisphere")}


def test_of_a_set_that_is_smaller_than_a_patch_a_smaller_square_is_validated() -> None:
    image = bumpy(12, 40)
    validator = Validator(data.Materials([image.astype(np.float16)], "gltf"), tiny().network, "gaussian", SMALL)
    np.testing.assert_allclose(validator.patches[0].stored, image[2:10, 16:24], atol=1e-3)


def test_tensorboard_gets_the_same_figures(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    config = tiny(run={"steps": 2, "tensorboard": True, "validate_every": 2})
    train(config, tmp_path, resume=False)
    events = EventAccumulator(str(tmp_path)).Reload()
    _, *rows = csv.reader((tmp_path / "validation.csv").open())
    logged = [event.value for event in events.Scalars("validation/network near-mirror")]
    assert logged == pytest.approx([float(row[1]) for row in rows], rel=1e-4)


# Export


def test_exported_weights_bake_like_the_training(tmp_path: Path) -> None:
    state = train(tiny(), tmp_path / "run", resume=False)
    info = export_weights(tmp_path / "run" / "last.npz", "tiny-1", tmp_path / "weights", default=True)
    last = (tmp_path / "run" / "validation.csv").read_text(encoding="utf-8").splitlines()[-1].split(",")
    written = (tmp_path / "weights" / "tiny-1.md").read_text(encoding="utf-8")
    cells = [f"{float(last[at]):.2f} / {float(last[at + 1]):.2f}" for at in (1, 3, 5)]
    assert f"| `gltf` | {' | '.join(cells)} |" in written  # the network, plain averages, LEAN
    assert default_weights("gltf", folder=tmp_path / "weights") == info
    assert info.steps == 6
    stored = procedural_set(7, 32)
    wrap = ("wrap", "clamp")
    for left, right in zip(
        bake_levels(load_network(info), stored, wrap), bake_levels(state.average, stored, wrap), strict=True
    ):
        np.testing.assert_allclose(left, right, atol=1e-6)
    assert info.sha256 in written
    assert "CC0-1.0" in written
    with pytest.raises(UsageError, match=r"tiny-1 are the default weights for material model 'gltf'"):
        export_weights(tmp_path / "run" / "last.npz", "tiny-2", tmp_path / "weights", default=True)
    assert sorted(path.name for path in (tmp_path / "weights").iterdir()) == [
        "tiny-1.json",
        "tiny-1.md",
        "tiny-1.safetensors",
    ]
    with pytest.raises(UsageError, match="name"):
        export_weights(tmp_path / "run" / "last.npz", "../evil", tmp_path / "weights", default=False)
    with pytest.raises(InputError, match="no such checkpoint"):
        export_weights(tmp_path / "none.npz", "tiny-2", tmp_path / "weights", default=False)


@pytest.mark.parametrize("info", list_weights(), ids=lambda info: info.name)
def test_released_cards_say_what_an_export_says(info: WeightsInfo) -> None:
    """With the validation of the record `cards`, which is of these weights; none lacks its averages."""
    config = read_config(CONFIGS / f"{info.name}.toml")
    assert config.network == info.network
    measured = json.loads(CARDS.read_text(encoding="utf-8"))["data"][info.name]
    assert measured["sha256"] == info.sha256, "python docs/remake.py --measure cards measures the weights of today"
    parameters = sum(value.numel() for value in load_network(info).parameters())
    described = info.network.describe()
    text = info.tensors.with_suffix(".md").read_text(encoding="utf-8")
    exported, _, _ = text.partition("\n## ")  # what was added later has headings
    assert exported == card(info, described, config, parameters, measured["figures"])
    assert "plain averages by" in exported and "LEAN by" in exported


@pytest.mark.long
def test_command_line_reports_errors_in_one_sentence(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mipbake.training", "train", str(tmp_path / "none.toml")]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert run.stderr.startswith("error: ")
    assert "Traceback" not in run.stderr


@pytest.mark.long
def test_a_number_of_steps_is_enough_to_train(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "mipbake.training", "--steps", "3"], cwd=tmp_path, check=True)
    assert loop.load_state(tmp_path / "runs/smoke" / loop.BEST).step in (0, 3)
    assert (tmp_path / "runs/smoke/log.csv").read_text().splitlines()[-1].startswith("3,")
