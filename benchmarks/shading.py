"""Shading with its gradient: mipbake.shading against the plain torch twin, in one run; prints Markdown.

    python benchmarks/shading.py [--threads 1] [--rounds 7]

One evaluation is one texel of `ggx` under one light-view pair, 11 stored channels; the default size is the batch of
Kemppinen et al. 2023, 64 pairs x 5120 texels. Forward + gradient computes the radiance and, from a given gradient of
it, the gradient of the material. Times are medians over the rounds, which alternate between the candidates so that all
see the same machine; the spread is (largest - smallest) / median. The instruction sets are measured in processes of
their own, one after the other; the twin and its compiled form in the first.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable

from timing import cpu_name, measure

PAIRS, TEXELS, BATCH = 64, 1024, 5
EVALUATIONS = PAIRS * TEXELS * BATCH
ISAS = ("avx512", "avx2", "baseline")


def run(threads: int, rounds: int, with_torch: bool, repeats: int) -> dict[str, object]:
    """Measures this process's instruction set; `repeats` kernel calls count as one measurement, for a steady clock."""
    import numpy as np
    import torch

    from mipbake import _native
    from mipbake.shading import reference, shade

    torch.set_num_threads(threads)
    _native.set_num_threads(threads)
    rng = np.random.default_rng(0)

    def directions() -> torch.Tensor:
        d = rng.standard_normal((BATCH, PAIRS, 3))
        d[..., 2] = np.abs(d[..., 2]) + 0.2
        return torch.from_numpy(d / np.linalg.norm(d, axis=-1, keepdims=True)).float()

    def uniform(low: float, high: float, count: int) -> np.typing.NDArray[np.float64]:
        return rng.uniform(low, high, (BATCH, TEXELS, count))

    channels = [uniform(0, 1, 6), uniform(-0.4, 0.4, 2), uniform(-8, 0, 2), uniform(-1, 1, 1)]
    material = torch.from_numpy(np.concatenate(channels, -1)).float().requires_grad_()
    light, view = directions(), directions()
    weights = torch.from_numpy(rng.standard_normal((BATCH, PAIRS, TEXELS, 3))).float()

    def forward(shade: Callable[..., torch.Tensor], times: int = 1) -> Callable[[], None]:
        def call() -> None:
            with torch.no_grad():
                for _ in range(times):
                    shade("ggx", material, light, view)

        return call

    def both(shade: Callable[..., torch.Tensor], times: int = 1) -> Callable[[], None]:
        def call() -> None:
            for _ in range(times):
                torch.autograd.grad(shade("ggx", material, light, view), material, weights)

        return call

    kernel = {"kernel, forward": forward(shade, repeats), "kernel, forward + gradient": both(shade, repeats)}
    twins = {}
    if with_torch:
        compiled = torch.compile(reference.shade)
        twins = {
            "torch, forward": forward(reference.shade),
            "torch, forward + gradient": both(reference.shade),
            "torch.compile, forward": forward(compiled),
            "torch.compile, forward + gradient": both(compiled),
        }
    timings = {name: (timing.median, timing.spread) for name, timing in measure(kernel | twins, rounds).items()}
    for name in kernel:
        median, spread = timings[name]
        timings[name] = (median / repeats, spread)
    return {"isa": _native.isa(), "threads": threads, "timings": timings, "torch": torch.__version__}


def main() -> None:
    parser = argparse.ArgumentParser(description="benchmark of shading with its gradient")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--one-set", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--with-torch", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one_set:
        print(json.dumps(run(options.threads, options.rounds, options.with_torch, repeats=20)))
        return

    print(f"{EVALUATIONS:,} evaluations of `ggx`, 11 channels; {cpu_name()}\n")
    print("| what | instruction set | threads | ns per evaluation | spread | times faster than torch |")
    print("|---|---|---|---|---|---|")
    torch_seconds: dict[str, float] = {}
    measured = []
    for isa in ISAS:
        command = [sys.executable, __file__, "--one-set", f"--threads={options.threads}", f"--rounds={options.rounds}"]
        command += ["--with-torch"] if isa == ISAS[0] else []
        environment = {**os.environ, "MIPBAKE_ISA": isa}
        result = json.loads(subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE).stdout)
        if result["isa"] in measured:
            continue  # the processor lacks this one and took the next
        measured.append(result["isa"])
        timings = {tuple(name.split(", ")): timing for name, timing in result["timings"].items()}
        torch_seconds |= {what: median for (who, what), (median, _) in timings.items() if who == "torch"}
        for (who, what), (median, spread) in timings.items():
            label = result["isa"] if who == "kernel" else f"torch {result['torch']}"
            each = f"{median / EVALUATIONS * 1e9:.1f} | {spread:.0%} | {torch_seconds[what] / median:.1f}"
            print(f"| {who}, {what} | {label} | {options.threads} | {each} |")


if __name__ == "__main__":
    main()
