"""Whether a latent that is averaged trains more stably than an encoder that makes one level after the other.

    python benchmarks/stability.py [--results FILE] [--steps 200] [--seeds 5]

Section 1 of Kemppinen et al. 2023 says so. Both are trained from several seeds, and so is a network of residual layers
(benchmarks/stability_networks.py), with the loss and the data of the paper's configuration but fewer light-view pairs,
on sets of the project's own generator. A seed gives all of them the same batches. Rates are the paper's and, for what
the claim is about, twenty times as much. `python docs/remake.py --measure stability` runs it, and docs/research.md
shows what came out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from statistics import fmean, median, stdev
from typing import Any

import numpy as np
import torch
from stability_networks import LinearNetwork, StabilityConfig, growth
from timing import CONFIGS, arguments, keep, table

from mipbake import material
from mipbake.training import loop
from mipbake.training.batches import draw_batch
from mipbake.training.config import DataConfig, TrainingConfig, read_config
from mipbake.training.data import Materials, load_materials
from mipbake.training.procedural import MODEL, procedural_set
from mipbake.training.validation import ValidationEffort, Validator

PAPER = CONFIGS / "paper-ggx.toml"
PAPERS_RATE, HURRIED_RATE = 5e-5, 1e-3
TRAININGS = (
    ("linear", PAPERS_RATE),
    ("autoregressive", PAPERS_RATE),
    ("linear", HURRIED_RATE),
    ("autoregressive", HURRIED_RATE),
    ("residual", PAPERS_RATE),
)
"""Network and rate of each training."""

EFFORT = ValidationEffort(patches=4, points=96, samples=32)
SETS, DEEP = 16, 256
"""Sets to train on, and the side in texels of an image with levels deeper than those that are trained."""

_UNSEEN = 3_000_000  # seed of that image
_WINDOW = 20  # steps that a point of a loss curve is the mean of


def configured(kind: str, rate: float, seed: int, steps: int) -> TrainingConfig:
    """The paper's training, with fewer pairs and levels of detail a step."""
    paper = read_config(PAPER)
    data = DataConfig(procedural_sets=SETS, procedural_size=128, mixed="itself", turned=False, boosted=True)
    network = StabilityConfig(kind=kind, encoders=("ggx",), decoders=("ggx",), latent_filter="box")
    return replace(
        paper,
        network=network,
        data=data,
        loss=replace(paper.loss, pairs=16, lods=3),
        optimiser=replace(paper.optimiser, learning_rate=rate),
        run=replace(paper.run, steps=steps, seed=seed),
    )


def trained(config: TrainingConfig, materials: Materials, validator: Validator) -> dict[str, Any]:
    """What became of one training."""
    state, losses, gradients = loop.new_state(config), [], []
    loop.fit_whitening(state.network, materials, config)
    for step in range(config.run.steps):
        losses.append(float(state.advance(draw_batch(materials, config, step))))
        gradients.append(float(torch.linalg.vector_norm(torch.cat(state.optimiser.gradients("ggx")))))
    network = state.network
    assert isinstance(network, LinearNetwork)
    deep = material.convert(procedural_set(_UNSEEN, DEEP), MODEL, "ggx")
    score = validator.score(network)
    whole = len(losses) // _WINDOW * _WINDOW
    return {
        "parameters": sum(value.numel() for value in network.parameters()),
        "not finite": sum(not math.isfinite(each) for each in losses),
        "largest loss": max(losses),
        "end": median(losses[-len(losses) // 4 :]),
        "gradient": median(gradients),
        "largest gradient": max(gradients),
        "snr": score.total,
        "averages": float(score.baselines["linear"].mean()),
        "growth": growth(network, torch.from_numpy(deep[None].astype(np.float32)), "ggx"),
        "curve": [fmean(losses[at : at + _WINDOW]) for at in range(0, whole, _WINDOW)],
    }


def _spread(values: Iterable[float], digits: int = 2) -> str:
    known = [*values]
    return f"{fmean(known):.{digits}f} ± {stdev(known):.{digits}f}"


def summary(record: Mapping[str, Any]) -> str:
    """The table that docs/research.md shows: means over seeds, with their standard deviations."""
    heads = [
        "levels", "rate", "loss at the end", "largest loss", "largest gradient over the median", "SNR, dB",
        "growth at level 5", "growth at the last level",
    ]  # fmt: skip
    rows = []
    for kind, rate in TRAININGS:
        runs = [run for run in record["runs"] if (run["kind"], run["rate"]) == (kind, rate)]
        rows.append([
            kind,
            f"{rate:g}",
            _spread(run["end"] for run in runs),
            f"{max(run['largest loss'] for run in runs):.3g}",
            f"{max(run['largest gradient'] / run['gradient'] for run in runs):.0f}",
            _spread(run["snr"] for run in runs),
            _spread(run["growth"][5] for run in runs),
            _spread(run["growth"][-1] for run in runs),
        ])  # fmt: skip
    return table(heads, rows)


def main() -> None:
    options = arguments(__doc__, results=None, steps=200, seeds=5)
    torch.set_num_threads(1)
    config = configured("linear", PAPERS_RATE, 0, options.steps)
    materials, held_out = load_materials(config)
    validator = Validator(held_out, config.network, config.loss.pixel_filter, EFFORT)
    runs: list[dict[str, Any]] = []
    for seed in range(options.seeds):
        for kind, rate in TRAININGS:
            found = trained(configured(kind, rate, seed, options.steps), materials, validator)
            runs.append({"kind": kind, "rate": rate, "seed": seed} | found)
            print(f"{kind} at {rate:g}, seed {seed}: SNR {found['snr']:.2f} dB", flush=True)
        keep({"steps": options.steps, "seeds": seed + 1, "runs": runs}, options.results)


if __name__ == "__main__":
    main()
