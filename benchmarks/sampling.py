"""Texture lookups: mipbake.sampling against torch's grid_sample, in one run; prints Markdown.

    python benchmarks/sampling.py [--lookups 1000000] [--rounds 7]

Times are medians over the rounds, which alternate between the candidates so that both see the same machine; the spread
is (largest - smallest) / median. Forward + backward computes the gradients of the texels and of the coordinates.
"""

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from mipbake import _native
from mipbake.sampling import ops


@dataclass(frozen=True)
class Timing:
    """Seconds: the median, and the spread relative to it."""

    median: float
    spread: float

    def text(self, lookups: int) -> str:
        return f"{self.median * 1e3:.1f} ms ({self.median / lookups * 1e9:.1f} ns, spread {self.spread:.0%})"


def measure(candidates: dict[str, Callable[[], object]], rounds: int) -> dict[str, Timing]:
    """Times every candidate once a round, after one round that does not count."""
    seconds: dict[str, list[float]] = {name: [] for name in candidates}
    for index in range(rounds + 1):
        for name, call in candidates.items():
            start = time.perf_counter()
            call()
            if index > 0:
                seconds[name].append(time.perf_counter() - start)
    return {n: Timing(statistics.median(s), (max(s) - min(s)) / statistics.median(s)) for n, s in seconds.items()}


def cpu_name() -> str:
    info = Path("/proc/cpuinfo")
    names = [line for line in info.read_text().splitlines() if "model name" in line] if info.exists() else []
    return names[0].split(":", 1)[1].strip() if names else platform.processor()


def coordinates(kind: str, lookups: int, generator: torch.Generator) -> Tensor:
    """(P, 2): independent and uniform, or neighbours in scan order as a raster makes them."""
    if kind == "random":
        return torch.rand(lookups, 2, generator=generator)
    side = round(lookups**0.5)
    index = torch.arange(lookups)
    return torch.stack([index % side, index // side], -1) / side + 0.3 / side


def against_grid_sample(kind: str, lookups: int, rounds: int) -> list[str]:
    generator = torch.Generator().manual_seed(0)
    texture = torch.rand(2048, 2048, 4, generator=generator)
    planar = texture.permute(2, 0, 1)[None].contiguous()
    uv = coordinates(kind, lookups, generator)
    grid = (2 * uv - 1)[None, None]
    weight = torch.rand(lookups, 4, generator=generator)
    planar_weight = weight.T[None, :, None].contiguous()
    clamp = ("clamp", "clamp")

    def native() -> Tensor:
        return ops.sample([texture], uv, 0.0, clamp)

    def torch_op() -> Tensor:
        out: Tensor = grid_sample(planar, grid, mode="bilinear", padding_mode="border", align_corners=False)
        return out

    difference = float((native().T - torch_op()[0, :, 0]).abs().max())
    if difference > 1e-3:  # float32 resolves 2^-24 of the texture, which is 1e-4 of a texel
        raise SystemExit(f"the two disagree by {difference}: the comparison is void")

    def backward(door: Callable[[], Tensor], leaves: list[Tensor], grad: Tensor) -> Callable[[], object]:
        def call() -> object:
            for leaf in leaves:
                leaf.requires_grad_()
            gradients = torch.autograd.grad(door(), leaves, grad)
            for leaf in leaves:
                leaf.requires_grad_(False)
            return gradients

        return call

    rows = []
    for name, ours, theirs in (
        ("forward", native, torch_op),
        (
            "forward + backward, texels",
            backward(native, [texture], weight),
            backward(torch_op, [planar], planar_weight),
        ),
        (
            "forward + backward, texels and coordinates",
            backward(native, [texture, uv], weight),
            backward(torch_op, [planar, grid], planar_weight),
        ),
    ):
        times = measure({"mipbake": ours, "grid_sample": theirs}, rounds)
        ratio = times["grid_sample"].median / times["mipbake"].median
        cells = (times["mipbake"].text(lookups), times["grid_sample"].text(lookups), f"{ratio:.1f}")
        rows.append(f"| {name}, {kind} | {' | '.join(cells)} |")
    return rows


def own_cases(lookups: int, rounds: int) -> list[str]:
    """What the bake, the reference and the training do, without a counterpart in torch."""
    generator = torch.Generator().manual_seed(0)
    rows = []

    def row(name: str, count: int, call: Callable[[], object]) -> None:
        rows.append(f"| {name} | {measure({name: call}, rounds)[name].text(count)} |")

    source = torch.rand(1024, 1024, 8, generator=generator)
    uv = coordinates("random", lookups, generator)
    row("bilinear, 1024 x 1024 x 8, random", lookups, lambda: ops.sample([source], uv, 0.0))
    chain = [torch.rand(2048 >> level, 2048 >> level, 4, generator=generator) for level in range(12)]
    lod = torch.rand(lookups, generator=generator) * 11
    row("trilinear, 2048 x 2048 x 4 and its chain, random", lookups, lambda: ops.sample(chain, uv, lod))

    batch, points = 16, 5 * 4096
    levels = [torch.rand(batch, 32 >> level, 32 >> level, 8, generator=generator) for level in range(6)]
    views = torch.rand(batch, points, 2, generator=generator)
    lods = torch.rand(batch, points, generator=generator) * 6 - 0.5
    grad = torch.rand(batch, points, 8, generator=generator)
    training = f"training: {batch} stacks of 32 x 32 x 8, {batch * points:,} lookups"
    row(f"{training}, forward", batch * points, lambda: ops.sample(levels, views, lods))

    def step() -> object:
        leaves = [level.detach().requires_grad_() for level in levels]
        return torch.autograd.grad(ops.sample(leaves, views, lods), leaves, grad)

    row(f"{training}, forward + backward into the texels", batch * points, step)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lookups", type=int, default=1_000_000, help="lookups a call (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=7, help="timed rounds (default: %(default)s)")
    options = parser.parse_args()
    print(
        f"{cpu_name()}, {_native.num_threads()} threads ({torch.get_num_threads()} for torch), {_native.isa()}; "
        f"torch {torch.__version__}; {options.lookups:,} lookups; medians of {options.rounds} rounds\n"
    )
    print("Bilinear in 2048 x 2048 x 4, float32, clamped:\n")
    print("| lookups | mipbake | grid_sample | times faster |\n|---|---|---|---|")
    for kind in ("random", "coherent"):
        print("\n".join(against_grid_sample(kind, options.lookups, options.rounds)), flush=True)
    print("\n| lookups | mipbake |\n|---|---|")
    print("\n".join(own_cases(options.lookups, options.rounds)))


if __name__ == "__main__":
    main()
