"""A graphics card beside the processor of its machine: shading, the network of a bake, steps of a training.

    python benchmarks/card.py [--device cuda] [--rounds 5] [--steps 300]

Shading is the batch of Kemppinen et al. 2023: 64 light-view pairs x 5120 texels of `ggx`, and the gradient of the
material. The network is that of the default method; an image goes to the card and its levels come back, which is part
of the time. Training steps are those of the paper's configurations, with batches that are drawn meanwhile on the
processor. Medians over the rounds, which alternate between the two; of steps the mean over all, the last one ended.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable

import numpy as np
import torch
from network import stored_of
from timing import Timing, cpu_name, measure
from training_step import PAPER

from mipbake import _native
from mipbake.models.registry import find_weights, load_baker
from mipbake.shading import shade
from mipbake.training import loop
from mipbake.training.batches import batches
from mipbake.training.config import DataConfig, read_config
from mipbake.training.data import load_materials

PAIRS, TEXELS, BATCH = 64, 1024, 5
SIZES = 1024, 4096
CONFIGS = "paper-ggx", "paper-beckmann", "paper-cross", "mipbake-1"
_WARM = 30  # steps that are not counted
_CAPTURED = 8  # sets of lobes for the configurations that read them


def shading(device: torch.device) -> dict[str, Callable[[], object]]:
    """Forward, and forward with the gradient, on a device."""
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((2, BATCH, PAIRS, 3))
    directions[..., 2] = np.abs(directions[..., 2]) + 0.2
    light, view = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    low, high = np.array([[0, 1]] * 6 + [[-0.4, 0.4]] * 2 + [[-8, 0]] * 2 + [[-1, 1]]).T
    material = rng.uniform(low, high, (BATCH, TEXELS, 11))
    weights = rng.standard_normal((BATCH, PAIRS, TEXELS, 3))
    stored, light, view, weights = (torch.from_numpy(a).float().to(device) for a in (material, light, view, weights))
    wanted = stored.clone().requires_grad_()
    return {
        "shading, forward": lambda: shade("ggx", stored, light, view),
        "shading, forward + gradient": lambda: torch.autograd.grad(shade("ggx", wanted, light, view), wanted, weights),
    }


def baking(device: torch.device) -> dict[str, Callable[[], object]]:
    """The network of a bake on a device, for every size."""
    baker = load_baker(find_weights("mipbake-3"), str(device))

    def of(size: int) -> Callable[[], object]:
        stored = stored_of(size)
        return lambda: baker.bake(stored, "gltf", "gltf", "gaussian", ("wrap", "wrap"))

    return {f"network of a bake, {size} x {size}": of(size) for size in SIZES}


def step_seconds(name: str, steps: int, device: torch.device) -> float:
    """Seconds of a step of a configuration, with materials of the project's own generator."""
    config = read_config(PAPER.with_name(f"{name}.toml"))
    captured = min(config.data.captured_sets, _CAPTURED)
    data = DataConfig(procedural_sets=16, captured_sets=captured)
    config = dataclasses.replace(config, data=dataclasses.replace(data, mixed=config.data.mixed))
    materials, _ = load_materials(config)
    state = loop.new_state(config, device)
    loop.fit_whitening(state.network, materials, config)
    began = 0.0
    for step, batch in enumerate(batches(materials, config, 0, ahead=loop.batches_ahead(device))):
        state.advance(batch)
        if step in (_WARM, _WARM + steps):
            torch.cuda.synchronize()
            if step > _WARM:
                break
            began = time.perf_counter()
    return (time.perf_counter() - began) / steps


def row(name: str, timings: dict[str, Timing], unit: float) -> str:
    """A line of the table: both medians, their spreads, and how many times faster the card is."""
    card, processor = (timings[f"{name} on the {where}"] for where in ("card", "processor"))
    cells = [f"{each.median * unit:.3g} ms ({each.spread:.0%})" for each in (card, processor)]
    return f"| {name} | {' | '.join(cells)} | {processor.median / card.median:.1f} |"


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description="Times a graphics card beside the processor of its machine.")
    parser.add_argument("--device", default="cuda", help="cuda, or cuda:1 (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=5, help="times that each is measured (default: %(default)s)")
    parser.add_argument("--steps", type=int, default=300, help="measured steps of trainings (default: %(default)s)")
    options = parser.parse_args()
    card = loop.device_named(options.device)
    places = {"card": card, "processor": torch.device("cpu")}
    print(
        f"{torch.cuda.get_device_name(card)}, torch {torch.__version__}; {cpu_name()}, {_native.isa()}, "
        f"{_native.num_threads()} threads\n"
    )
    print("| what | card | processor | times faster |\n|---|---|---|---|")
    for made in (shading, baking):
        both = {where: made(device) for where, device in places.items()}
        for name in both["card"]:
            candidates = {f"{name} on the {where}": calls[name] for where, calls in both.items()}
            print(row(name, measure(candidates, options.rounds, torch.cuda.synchronize), 1e3), flush=True)
    print("\n| a step of | card | hours of 310,000 steps |\n|---|---|---|")
    for name in CONFIGS:
        seconds = step_seconds(name, options.steps, card)
        print(f"| {name} | {seconds * 1e3:.2f} ms | {seconds * 310_000 / 3600:.2f} |", flush=True)


if __name__ == "__main__":
    main()
