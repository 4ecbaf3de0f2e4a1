"""Time of one training step at the paper's settings, and where it goes.

    python benchmarks/training_step.py [--config CONFIG] [--threads N] [--steps N]

Prints the median over steps of each part, run one after the other, and of the whole loop, in which the next batch is
drawn in a second thread while a step is under way.
"""

from __future__ import annotations

import dataclasses
import platform
import statistics
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping

import torch
from timing import CONFIGS, arguments

from mipbake.base.allocator import keep_freed_memory
from mipbake.training import loop, loss
from mipbake.training.batches import batches
from mipbake.training.config import DataConfig, TrainingConfig, read_config
from mipbake.training.data import Materials, draw_crops, load_materials, step_generator

PAPER = CONFIGS / "paper-ggx.toml"


def one_step(state: loop.TrainingState, materials: Materials, step: int) -> Iterator[str]:
    """What batches.draw_batch and TrainingState.advance do; gives the name of each part after it."""
    config, (model,) = state.config, state.config.network.encoders
    settings, rng = config.loss, step_generator(config.run.seed, step)
    patches = torch.from_numpy(draw_crops(materials, settings.crops, settings.crop_size, model, rng, config.data))
    yield "patches and augmentation"
    views = loss.draw_views(settings, rng)
    yield "views"
    target = loss.draw_noisy_reference(patches, views, model, settings.pixel_filter, settings.target_samples, rng)
    yield "target: lookups and shading"
    state.optimiser.zero_grad()
    levels = state.network(patches, model, settings.pixel_filter)[model]
    yield "network forward"
    texels = loss.trilinear(levels, views)
    yield "prediction: lookups"
    value = loss.render_loss(texels, model, views, target)
    yield "shading, loss, their gradient"
    (gradient,) = torch.autograd.grad(value, texels, retain_graph=True)
    gradients = torch.autograd.grad(texels, levels, gradient, retain_graph=True)
    yield "lookups backward"
    torch.autograd.backward(levels, gradients)
    yield "network backward"
    state.optimiser.step(step, model)
    yield "optimiser"


def parts(state: loop.TrainingState, materials: Materials, steps: int) -> Mapping[str, list[float]]:
    """Seconds of each part of the steps."""
    found: dict[str, list[float]] = defaultdict(list)
    for step in range(steps):
        last = time.perf_counter()
        for part in one_step(state, materials, step):
            now = time.perf_counter()
            found[part].append(now - last)
            last = now
    return found


def whole_loop(config: TrainingConfig, materials: Materials, steps: int) -> list[float]:
    """Seconds of each step of the real loop."""
    state, times = loop.new_state(config), []
    loop.fit_whitening(state.network, materials, config)
    last = time.perf_counter()
    for step, batch in enumerate(batches(materials, config, 0)):
        state.advance(batch)
        now = time.perf_counter()
        times.append(now - last)
        last = now
        if step == steps:
            break
    return times[1:]


def main() -> None:
    options = arguments(__doc__, config=None, threads=loop.threads_beside_batches(), steps=100)
    torch.set_num_threads(options.threads)
    keep_freed_memory()
    path = options.config or PAPER
    config = read_config(path)
    config = dataclasses.replace(config, data=DataConfig(procedural_sets=16))
    materials, _ = load_materials(config)
    state = loop.new_state(config)
    loop.fit_whitening(state.network, materials, config)
    parts(state, materials, 10)
    measured = parts(state, materials, options.steps)
    loss_config = config.loss
    evaluations = loss_config.crops * loss_config.pairs * loss_config.lods * loss_config.crop_size**2
    print(f"{platform.processor() or platform.machine()}, {torch.get_num_threads()} threads, torch {torch.__version__}")
    print(
        f"{path.name}: {evaluations} predicted evaluations with gradients, "
        f"{evaluations * loss_config.target_samples} of targets"
    )
    total = 0.0
    for part, times in measured.items():
        total += statistics.median(times)
        print(f"{part:28} {1e3 * statistics.median(times):8.2f} ms")
    print(f"{'sum':28} {1e3 * total:8.2f} ms")
    times = sorted(whole_loop(config, materials, options.steps))
    low, middle, high = times[len(times) // 10], times[len(times) // 2], times[9 * len(times) // 10]
    print(f"{'whole loop, median':28} {1e3 * middle:8.2f} ms (10 % to 90 %: {1e3 * low:.2f} to {1e3 * high:.2f})")


if __name__ == "__main__":
    main()
