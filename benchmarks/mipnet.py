"""MIPNet, re-implemented (mipnet_network.py), as a baseline: trains it, and makes weights that results.py measures.

    python benchmarks/mipnet.py train --target ggx --data SETS --out FOLDER [--resume] [--device cuda]
    python benchmarks/mipnet.py export FOLDER/best.npz NAME [--out benchmarks/baselines]
    python benchmarks/results.py SETS RESULTS --kinds models --weights benchmarks/baselines

`train` takes data and loss from the configuration of `mipbake-1`, or of its sister for the target, except for what
MIPNet does not know of: all steps are for the Gaussian pixel filter. `--like` names another configuration, such as
`paper-ggx.toml` with the paper's loss. It writes the files that `python -m mipbake.training` writes. With `--results
FILE` it writes its validations and losses as JSON, too. `export` takes the averaged weights and rounds them to 16 bits.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from mipnet_network import KINDS, TARGETS, MipnetNetwork, register
from safetensors.torch import save
from timing import BASELINES, CONFIGS, keep, number

from mipbake.base.allocator import keep_freed_memory
from mipbake.base.errors import InputError
from mipbake.material.pixel_filter import FILTERS
from mipbake.models.registry import WEIGHTS_LICENCE, WeightsInfo, list_weights, load_network
from mipbake.training.__main__ import exit_code
from mipbake.training.balanced_loss import BalancedLossConfig
from mipbake.training.config import TrainingConfig, read_config
from mipbake.training.data import load_materials
from mipbake.training.loop import LAST, TrainingState, load_state, threads_beside_batches, train
from mipbake.training.validation import Validator

OURS = {"gltf": "mipbake-1", "gltf-anisotropic": "mipbake-1", "ggx": "mipbake-1-ggx", "beckmann": "mipbake-1-beckmann"}
"""Target to the configuration whose data, loss and length are taken."""


def configured(ours: TrainingConfig, target: str, steps: int | None) -> TrainingConfig:
    """The training of a MIPNet with the data and the loss of ours, and its length unless there are `steps`.

    Layers four to eight times as wide take a fifth of the learning rate of `mipbake-1`. It falls to a hundredth until
    the end, from half of the way on: a budget that is known can be used up.
    """
    steps, loss = steps or ours.run.steps, ours.loss
    if isinstance(loss, BalancedLossConfig):
        loss = replace(loss, any_filter=0.0)
    return replace(
        ours,
        network=KINDS[loss.kind](target),
        loss=loss,
        optimiser=replace(ours.optimiser, learning_rate=3e-4, fall_from=steps // 2, fall_until=steps),
        run=replace(ours.run, steps=steps, validate_every=2000, checkpoint_every=500),
    )


def trained(options: argparse.Namespace) -> int:
    """The command `train`."""
    resume = options.resume and (options.out / LAST).exists()
    if resume:
        config = load_state(options.out / LAST).config
    else:
        like = options.like or CONFIGS / f"{OURS[options.target]}.toml"
        config = configured(read_config(like), options.target, options.steps)
    config = replace(config, data=replace(config.data, folder=options.data))
    keep_freed_memory()
    torch.set_num_threads(threads_beside_batches())
    state = train(config, options.out, resume, device=options.device)
    if options.results is not None:
        keep(told(state, options.out), options.results)
    return 0


def told(state: TrainingState, out: Path) -> dict[str, Any]:
    """What became of a training: SNR in dB at each validation, and the mean loss since the one before.

    Beside them stands the paper's network for the same model, where there is one, on the same patches.
    """
    validations, losses = (_rows(out / f"{table}.csv") for table in ("validation", "log"))
    before = -1.0
    for row in validations:
        since = [each["loss"] for each in losses if before < each["step"] <= row["step"]]
        row["loss"], before = float(np.mean(since or np.nan)), row["step"]
    config = state.config
    papers = [info for info in list_weights() if info.name == f"paper-{config.network.target}"]
    validator = Validator(load_materials(config)[1], config.network, config.loss.pixel_filter)
    return {
        "paper": {info.name: {"steps": info.steps} | validator.score(load_network(info)).columns() for info in papers},
        "commit": state.commit,
        "steps": config.run.steps,
        "learning rate": config.optimiser.learning_rate,
        "not finite": sum(not math.isfinite(each["loss"]) for each in losses),
        "validations": validations,
    }


def _rows(table: Path) -> list[dict[str, float]]:
    with table.open(encoding="utf-8") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def network_of(checkpoint: Path) -> MipnetNetwork:
    """The averaged weights of a checkpoint; InputError where it is of another network."""
    network = load_state(checkpoint).average
    if not isinstance(network, MipnetNetwork):
        raise InputError(f"{checkpoint}: a checkpoint of another architecture, expected one of this script's")
    return network


def exported(options: argparse.Namespace) -> int:
    """The command `export`."""
    state, network = load_state(options.checkpoint), network_of(options.checkpoint)
    content = save({name: value.half().contiguous() for name, value in network.state_dict().items()})
    data = state.config.data
    info = WeightsInfo(
        name=options.name,
        network=network.config,
        pixel_filters=tuple(FILTERS),
        default=False,
        steps=state.step,
        commit=state.commit,
        data=data.description,
        data_licence=data.licence,
        licence=WEIGHTS_LICENCE,
        sha256=hashlib.sha256(content).hexdigest(),
        folder=options.out,
    )
    options.out.mkdir(parents=True, exist_ok=True)
    info.tensors.write_bytes(content)
    (options.out / f"{options.name}.json").write_text(info.to_json())
    return 0


def main() -> int:
    """Runs one command; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    training = commands.add_parser("train", help="trains a MIPNet as mipbake-1 is trained")
    training.set_defaults(run=trained)
    training.add_argument("--data", required=True, metavar="SETS", help="folder of texture sets")
    training.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="for checkpoints and logs")
    training.add_argument("--target", choices=TARGETS, default=TARGETS[0], help="(default: %(default)s)")
    training.add_argument("--like", type=Path, metavar="CONFIG", help="(default: mipbake-1, or its sister)")
    training.add_argument("--steps", type=number(int, 1), help="(default: as many as CONFIG has)")
    training.add_argument("--resume", action="store_true", help="continue from FOLDER/last.npz where there is one")
    training.add_argument("--results", type=Path, metavar="FILE", help="for validations and losses, as JSON")
    training.add_argument("--device", default="cpu", help="cpu, or cuda for a graphics card (default: %(default)s)")
    export = commands.add_parser("export", help="makes weights of a checkpoint")
    export.set_defaults(run=exported)
    export.add_argument("checkpoint", type=Path)
    export.add_argument("name", help="of the weights")
    export.add_argument("--out", type=Path, default=BASELINES, metavar="FOLDER", help="(default: %(default)s)")
    options = parser.parse_args()
    register()
    return exit_code(lambda: options.run(options))


if __name__ == "__main__":
    sys.exit(main())
