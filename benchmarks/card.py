"""A graphics card beside the processor of its machine: shading, the network of a bake, steps of a training.

    python benchmarks/card.py [--device cuda] [--rounds 5] [--steps 300]

Shading is the batch of Kemppinen et al. 2023: 64 light-view pairs x 5120 texels of `ggx`, and the gradient of the
material. The network is that of the default method; an image goes to the card and its levels come back, which is part
of the time. Training steps are those of the paper's configurations, with batches that are drawn meanwhile on the
processor. Medians over the rounds, which alternate between the two; of steps the mean over all, the last one ended.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from shading import calls
from timing import CONFIGS, arguments, cpu_name, measure, show

from mipbake import _native
from mipbake.models.registry import find_weights, load_baker
from mipbake.shading import shade
from mipbake.training import loop
from mipbake.training.batches import batches
from mipbake.training.config import DataConfig, read_config
from mipbake.training.data import load_materials

SIZES = 1024, 4096
TRAININGS = "paper-ggx", "paper-beckmann", "paper-cross", "mipbake-1"
_WARM = 30  # steps that are not counted
_CAPTURED = 8  # sets of lobes for the configurations that read them


def shading(device: torch.device) -> dict[str, Callable[[], object]]:
    """Forward, and forward with the gradient, on a device."""
    return {f"shading, {name}": call for name, call in calls(shade, device).items()}


def stored_of(size: int) -> NDArray[np.float32]:
    """(size, size, 8) stored channels of `gltf`: bumps of two sizes, and spots of metal."""
    v, u = np.meshgrid(*(np.arange(size, dtype=np.float32) * (2 * np.pi / 64),) * 2, indexing="ij")
    x, y = 0.4 * np.sin(3 * u) * np.cos(v), 0.3 * np.sin(5 * v + u)
    length = np.sqrt(1 + x * x + y * y)
    metal = (np.sin(u) * np.sin(2 * v) > 0).astype(np.float32)
    rough = 0.4 + 0.3 * np.sin(u + 2 * v)
    colours = [0.5 + 0.4 * np.sin(u + each) for each in (0, 1, 2)]
    return np.stack([*colours, metal, rough, x / length, y / length, 1 / length], -1).astype(np.float32)


def baking(device: torch.device) -> dict[str, Callable[[], object]]:
    """The network of a bake on a device, for every size."""
    baker = load_baker(find_weights("mipbake-3"), str(device))

    def of(size: int) -> Callable[[], object]:
        stored = stored_of(size)
        return lambda: baker.bake(stored, "gltf", "gltf", "gaussian", ("wrap", "wrap"))

    return {f"network of a bake, {size} x {size}": of(size) for size in SIZES}


def step_seconds(name: str, steps: int, device: torch.device) -> float:
    """Seconds of a step of a configuration, with materials of the project's own generator."""
    config = read_config(CONFIGS / f"{name}.toml")
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


def rows(card: torch.device, rounds: int) -> Iterator[list[str]]:
    """What is timed: both medians, their spreads, and how many times faster the card is."""
    places = {"card": card, "processor": torch.device("cpu")}
    for made in (shading, baking):
        both = {where: made(device) for where, device in places.items()}
        for name in both["card"]:
            found = measure({where: both[where][name] for where in places}, rounds, torch.cuda.synchronize)
            cells = [f"{each.median * 1e3:.3g} ms ({each.spread:.0%})" for each in found.values()]
            yield [name, *cells, f"{found['processor'].median / found['card'].median:.1f}"]


def steps(card: torch.device, count: int) -> Iterator[list[str]]:
    """How long a step of each training takes."""
    for name in TRAININGS:
        seconds = step_seconds(name, count, card)
        yield [name, f"{seconds * 1e3:.2f} ms", f"{seconds * 310_000 / 3600:.2f}"]


def main() -> None:
    """Prints the tables."""
    options = arguments(__doc__, device="cuda", rounds=5, steps=300)
    card = loop.device_named(options.device)
    print(
        f"{torch.cuda.get_device_name(card)}, torch {torch.__version__}; {cpu_name()}, {_native.isa()}, "
        f"{_native.num_threads()} threads\n"
    )
    show(["what", "card", "processor", "times faster"], rows(card, options.rounds))
    print()
    show(["a step of", "card", "hours of 310,000 steps"], steps(card, options.steps))


if __name__ == "__main__":
    main()
