"""MIPNet, re-implemented (mipnet_network.py), as a baseline: trains it, and measures it beside `mipbake-1`.

    python benchmarks/mipnet.py train --data SETS --out FOLDER [--target gltf-anisotropic] [--resume]
    python benchmarks/mipnet.py evaluate SETS RESULTS_FOLDER CHECKPOINT [CHECKPOINT ...]

`train` takes data, loss and length from the configuration of `mipbake-1`, except for what MIPNet does not know of: all
steps are for the Gaussian pixel filter. It writes the files that `python -m mipbake.training` writes. `evaluate`
measures the SNR of `texture_space.measure` on every set of a folder, a JSON file a set, and prints tables in Markdown.
Sets whose file says that it was measured with the same checkpoints, methods and settings are left alone. Checkpoints
are `best.pt` or `last.pt` of trainings, whose averaged weights are taken. All other methods are baked for isotropic
`gltf`. Beside a checkpoint for `gltf-anisotropic`, `lean` is baked for that target as well.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from mipnet_network import TARGETS, MipnetConfig, MipnetNetwork

import mipbake
from mipbake import TextureSet
from mipbake._allocator import keep_freed_memory
from mipbake.bake import DEFAULT_FILTER
from mipbake.compare import texture_space
from mipbake.compare.candidates import Candidate, bake_all
from mipbake.compare.result import Comparison, Method
from mipbake.errors import InputError, UsageError
from mipbake.metrics import PAIR_SETS
from mipbake.models import default_weights
from mipbake.models.architectures import ARCHITECTURES
from mipbake.training.__main__ import exit_code
from mipbake.training.balanced_loss import BalancedLossConfig
from mipbake.training.config import TrainingConfig, read_config
from mipbake.training.loop import LAST, load_state, threads_beside_batches, train
from mipbake.validate import DEFAULT_LODS

OURS = Path(__file__).resolve().parent.parent / "training" / "configs" / "mipbake-1.toml"

LABELS = {"gltf": "MIPNet, re-implemented", "gltf-anisotropic": "MIPNet, re-implemented, anisotropic"}

FOUR = ("linear (box)", "linear (gaussian)", "lean (box)", "lean (gaussian)")
BEST = "best of these four, for every set and lod"
METHODS = ("neural", *FOUR, "unreal (box)", "unreal (gaussian)")
ANISOTROPIC = ("lean (box)", "lean (gaussian)")

Curve = Mapping[tuple[str, str, float], np.ndarray]
"""Method, pair set and lod to the SNR of every set, in dB."""


def configured(ours: TrainingConfig, target: str, steps: int | None) -> TrainingConfig:
    """The training of a MIPNet with the data and the loss of ours, and its length unless there are `steps`.

    Layers four to eight times as wide take a fifth of the learning rate. It falls to a hundredth until the end, from
    half of the way on: a budget that is known can be used up.
    """
    if not isinstance(ours.loss, BalancedLossConfig):
        raise UsageError('MIPNet is trained with the loss "balanced": expected a configuration with that')
    steps = steps or ours.run.steps
    return replace(
        ours,
        network=MipnetConfig(target),
        loss=replace(ours.loss, any_filter=0.0),
        optimiser=replace(ours.optimiser, learning_rate=3e-4, fall_from=steps // 2, fall_until=steps),
        run=replace(ours.run, steps=steps, validate_every=2000, checkpoint_every=500),
    )


def trained(arguments: Sequence[str]) -> int:
    """The command `train`."""
    parser = argparse.ArgumentParser(prog="mipnet.py train", description="Trains a MIPNet as mipbake-1 is trained.")
    parser.add_argument("--data", required=True, metavar="SETS", help="folder of texture sets")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="for checkpoints and logs")
    parser.add_argument("--target", choices=TARGETS, default=TARGETS[0], help="(default: %(default)s)")
    parser.add_argument("--like", type=Path, default=OURS, metavar="CONFIG", help="(default: as mipbake-1)")
    parser.add_argument("--steps", type=int, help="(default: as many as CONFIG has)")
    parser.add_argument("--resume", action="store_true", help="continue from FOLDER/last.pt, with its configuration")
    options = parser.parse_args(arguments)
    if options.resume:
        config = load_state(options.out / LAST).config
    else:
        config = configured(read_config(options.like), options.target, options.steps)
    config = replace(config, data=replace(config.data, folder=options.data))
    keep_freed_memory()
    torch.set_num_threads(threads_beside_batches())
    train(config, options.out, options.resume)
    return 0


def network_of(checkpoint: Path) -> MipnetNetwork:
    """The averaged weights of a checkpoint; InputError where it is of another network."""
    network = load_state(checkpoint).average
    if not isinstance(network, MipnetNetwork):
        raise InputError(f"{checkpoint}: a checkpoint of another architecture, expected one of this script's")
    return network


def baked(network: MipnetNetwork, texture_set: TextureSet) -> Candidate:
    """Its stack of a set."""
    start, source = time.perf_counter(), texture_set.source_model
    levels = network.bake(texture_set.material(source), source, network.target)
    label = LABELS[network.target]
    return Candidate(Method(label, "mipnet", "box", network.target, time.perf_counter() - start), levels)


def measured(
    texture_set: TextureSet, networks: Sequence[MipnetNetwork], methods: Sequence[str], points: int, samples: int
) -> Comparison:
    """The SNR by level of detail of the networks and of other methods, all against the same reference."""
    with ExitStack() as stack:
        candidates = [baked(network, texture_set) for network in networks]
        candidates += stack.enter_context(bake_all(texture_set, "gltf", DEFAULT_FILTER, methods))
        if any(network.target == "gltf-anisotropic" for network in networks):
            others = stack.enter_context(bake_all(texture_set, "gltf-anisotropic", DEFAULT_FILTER, ANISOTROPIC))
            candidates += [replace(c, method=replace(c.method, name=f"{c.name}, anisotropic")) for c in others]
        effort = texture_space.MeasureEffort(points=points, samples=samples)
        found = texture_space.measure(texture_set, candidates, DEFAULT_FILTER, DEFAULT_LODS, (), effort)
        made = tuple(candidate.method for candidate in candidates)
    return Comparison(
        texture_set.name, made[0].name, "gltf", DEFAULT_FILTER, made, found.curve, found.figures, notes=found.notes
    )


def read(files: Sequence[Path]) -> tuple[list[str], Curve]:
    """Methods, and their SNR on the sets that all lods were measured on."""
    contents = [json.loads(file.read_text()) for file in files]
    curve: dict[tuple[str, str, float], list[float]] = {}
    for content in contents:
        for figure in content["curve"]:
            curve.setdefault((figure["method"], figure["view"], figure["lod"]), []).append(figure["value"])
    full = {key: np.array(values) for key, values in curve.items() if len(values) == len(files)}
    return [method["name"] for method in contents[0]["methods"]], full


def tables(methods: Sequence[str], curve: Curve) -> str:
    """Mean SNR by lod of each pair set, and how each method stands against the best of four closed forms."""
    lods = sorted({lod for _, _, lod in curve})
    known, rows = dict(curve), list(methods)
    if set(FOUR) <= set(methods):
        rows.append(BEST)
        for view in PAIR_SETS:
            for lod in lods:
                known[BEST, view, lod] = np.max([curve[method, view, lod] for method in FOUR], 0)
    lines = []
    for view in PAIR_SETS:
        head = ["SNR in dB, " + view, *(f"lod {lod:g}" for lod in lods), "mean"]
        if BEST in rows:
            head += ["against best", "cells below -1 dB", "worst cell"]
        lines += ["", "| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
        for method in rows:
            cells = np.array([known[method, view, lod] for lod in lods])  # (lods, sets)
            row = [*(f"{mean:.2f}" for mean in cells.mean(1)), f"{cells.mean():.2f}"]
            if BEST in rows:
                gain = cells - np.array([known[BEST, view, lod] for lod in lods])
                row += [f"{gain.mean():+.2f}", f"{(gain < -1).sum()} of {gain.size}", f"{gain.min():+.1f}"]
            lines.append(f"| {method} | " + " | ".join(row) + " |")
    return "\n".join(lines)


def evaluate(arguments: Sequence[str]) -> int:
    """The command `evaluate`."""
    parser = argparse.ArgumentParser(prog="mipnet.py evaluate", description="Measures trained MIPNets.")
    parser.add_argument("sets", type=Path, help="folder with a texture set in each sub-folder")
    parser.add_argument("results", type=Path, help="folder for a JSON file a set")
    parser.add_argument("checkpoints", type=Path, nargs="+", help="of trainings, at most one for each target")
    parser.add_argument("--methods", nargs="*", default=METHODS, help="to compare with (default: %(default)s)")
    parser.add_argument("--points", type=int, default=texture_space.DEFAULT_POINTS, help="pixels a level of detail")
    parser.add_argument("--samples", type=int, default=texture_space.DEFAULT_SAMPLES, help="of the reference a pixel")
    options = parser.parse_args(arguments)
    networks = [network_of(checkpoint) for checkpoint in options.checkpoints]
    if len({network.target for network in networks}) < len(networks):
        parser.error("two checkpoints for the same target: measure them one after the other, into different folders")
    options.results.mkdir(parents=True, exist_ok=True)
    files, key = (
        [],
        {
            "checkpoints": [hashlib.sha256(checkpoint.read_bytes()).hexdigest() for checkpoint in options.checkpoints],
            "weights": default_weights("gltf").sha256 if "neural" in options.methods else None,
            "methods": list(options.methods),
            "effort": [options.points, options.samples],
        },
    )
    for folder in sorted(path for path in options.sets.iterdir() if path.is_dir()):
        file = options.results / f"{folder.name}.json"
        files.append(file)
        if file.exists() and json.loads(file.read_text()).get("key") == key:
            continue
        start = time.perf_counter()
        found = measured(mipbake.load(folder), networks, options.methods, options.points, options.samples)
        partial = file.with_suffix(".part")
        partial.write_text(json.dumps(found.to_dict() | {"key": key}, indent=1, default=str))
        partial.rename(file)
        print(f"{folder.name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    if not files:
        parser.error(f"{options.sets} holds no folder with a texture set")
    print(f"Means over {len(files)} sets.\n{tables(*read(files))}")
    return 0


COMMANDS = {"train": trained, "evaluate": evaluate}


def main() -> int:
    """Runs one command; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=COMMANDS)
    command = COMMANDS[parser.parse_args(sys.argv[1:2]).command]
    ARCHITECTURES[MipnetConfig.architecture] = MipnetConfig
    return exit_code(lambda: command(sys.argv[2:]))


if __name__ == "__main__":
    sys.exit(main())
