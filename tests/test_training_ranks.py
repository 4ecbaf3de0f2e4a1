"""Several processes that train one network, as `torchrun` begins them."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from mipbake.base.errors import UsageError
from mipbake.training import loop
from mipbake.training.batches import draw_batch
from mipbake.training.data import load_materials
from mipbake.training.ranks import Ranks, ranks

from .small_training import tiny

HERE = Path(__file__).resolve().parent
LAUNCH = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]

pytestmark = pytest.mark.skipif(not torch.distributed.is_available(), reason="this torch has no torch.distributed")


def launch(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
    env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path}
    command = [*LAUNCH, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=env, timeout=600)


def joined(parts: list[Any]) -> Any:
    """One batch of several."""
    first = parts[0]
    if isinstance(first, Tensor):
        return torch.cat(parts)
    if is_dataclass(first):
        return type(first)(**{f.name: joined([getattr(part, f.name) for part in parts]) for f in fields(first)})
    assert all(part == first for part in parts)
    return first


@pytest.mark.long
def test_two_processes_have_the_gradient_of_one_with_the_joined_batch(tmp_path: Path) -> None:
    encoders = "gltf,ggx"
    run = launch(HERE / "training_ranks.py", tmp_path, "4", encoders)
    assert run.returncode == 0, run.stderr
    first, second = (torch.load(tmp_path / f"{rank}.pt") for rank in (0, 1))
    names = encoders.split(",")
    config = tiny(network={"encoders": names, "decoders": names, "latent_channels": 32}, run={"steps": 4})
    materials, _ = load_materials(config)
    state = loop.new_state(config)

    def both(step: int) -> Any:
        return joined([draw_batch(materials, config, step, Ranks(rank, 2)) for rank in (0, 1)])

    batch = both(0)
    assert len(batch.patches) == 2 * config.loss.crops
    assert not torch.equal(*batch.patches.chunk(2))
    state.optimiser.zero_grad()
    config.loss.value(state.network, batch).backward()
    for here, there in zip(state.optimiser.gradients(batch.source), first["first"], strict=True):
        torch.testing.assert_close(there, here, rtol=1e-4, atol=1e-6 * float(here.abs().max()))
        assert here.abs().max() > 0
    for step in range(4):
        state.advance(both(step))
    assert all(torch.equal(first["weights"][name], second["weights"][name]) for name in first["weights"])
    for name, value in state.network.state_dict().items():
        torch.testing.assert_close(first["weights"][name], value, rtol=1e-3, atol=1e-4)


@pytest.mark.long
def test_checkpoints_go_from_two_processes_to_one(tmp_path: Path) -> None:
    """A training by two processes goes on in one. Only one of them writes and speaks."""
    command = ["-m", "mipbake.training", "train"]
    config = tmp_path / "short.toml"
    text = (HERE.parent / "training" / "configs" / "smoke.toml").read_text()
    text = text.replace("procedural_size = 128", "procedural_size = 32").replace("pairs = 16\n", "pairs = 4\n")
    text = text.replace("target_samples = 16", "target_samples = 4")

    def write(steps: int) -> None:
        begun, _, _ = text.partition("[run]")
        config.write_text(f"{begun}[run]\nsteps = {steps}\nlog_every = 1\nvalidate_every = 9\ncheckpoint_every = 1\n")

    def weights() -> dict[str, Tensor]:
        state = loop.load_state(tmp_path / "run" / loop.LAST)
        assert state.step == int((tmp_path / "run" / "log.csv").read_text().splitlines()[-1].split(",")[0])
        return state.network.state_dict()

    where = ["--out", str(tmp_path / "run")]
    write(1)
    run = launch(*command, config, *where)
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("materials: ") == 1
    assert [line.split(",")[0] for line in (tmp_path / "run" / "log.csv").read_text().splitlines()[1:]] == ["1"]
    first = weights()
    write(2)
    alone = subprocess.run(
        [sys.executable, *command, str(config), *where, "--resume"], capture_output=True, text=True, check=False
    )
    assert alone.returncode == 0, alone.stderr
    second = weights()
    assert any(not torch.equal(first[name], second[name]) for name in first)


def test_one_process_is_alone() -> None:
    with ranks("cpu") as among:
        assert among == Ranks(0, 1)
    assert Ranks(1, 2, 1).device("cuda") == "cuda:1" and Ranks(1, 2, 1).device("cpu") == "cpu"


def test_one_card_for_several_processes_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("WORLD_SIZE", "2"), ("RANK", "0"), ("LOCAL_RANK", "0"), ("TORCHELASTIC_RUN_ID", "x")):
        monkeypatch.setenv(name, value)
    with pytest.raises(UsageError, match="the device cuda:1 is one, and 2 processes train"), ranks("cuda:1"):
        pass
