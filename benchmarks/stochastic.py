"""Figures 3, 4 and 5 of Deliot, Heitz and Belcour 2024 at a CPU's size. Prints Markdown.

    python benchmarks/stochastic.py [--clock wall] [--seconds 10]

Figure 3: soups of triangles become a picture. Errors of pixels are credited to the triangles that the pixels show
(equation 8), or the error of the whole image is credited to all triangles (equation 4). Both ways take as many renders.
A soup of transparent triangles goes through a deep buffer of triangles (section 4.4).

Figures 4 and 5: a mesh and its albedo or normal map, from random views, by stochastic gradients and by exact gradients
of mipbake's own primitives. Both have the same time; then the stochastic ones have 2 and 4 times as much, and more
until they are as good within half a decibel. They perturb everything at once, as the paper does, or vertices and texels
in turns.

Everything is seeded, but steps that are counted by time differ with the machine. `--clock processor` counts the time of
all threads, which other processes on the machine do not disturb.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from typing import Any

import torch
from stochastic_meshes import (
    AS_THE_PAPER,
    CLOCKS,
    IN_TURNS,
    Scene,
    Setting,
    by_exact_gradients,
    by_stochastic_gradients,
    within,
)
from stochastic_soups import CREDITS, Fitted, Soup, fit
from timing import cpu_name

from mipbake import _native

SOUPS: Mapping[str, Soup] = {
    "1K triangles": Soup(1_000, 256, 150, 8),
    "10K triangles": Soup(10_000, 256, 100, 8),
    "100K triangles": Soup(100_000, 512, 25, 8),
    "500 transparent, 6 layers": Soup(500, 128, 60, 8, layers=6),
}
"""Numbers of steps are guesses, for some minutes in all. The paper has 128 estimates for each step."""

MESHES: Mapping[str, Setting] = {
    "figure 4, albedo map": Setting("albedo", texture=240, side=192),
    "figure 5, normal map": Setting("normal", texture=240, side=192),
}
EXACT_RATES = (0.0015, 0.02)
"""Adam's rates of vertices and texels: the best of a few that were tried for the albedo map."""

TIMES = (1, 2, 4)
"""How much time stochastic gradients have, in terms of what exact ones have."""

LONGER = (8, 16, 32)
"""How much more they have where they are still behind."""

AIM = 0.5
"""Decibels that stochastic gradients may be behind."""

PAPER: Mapping[str, Mapping[str, float]] = {
    "1K triangles": {"P": 12, "R": 28, "G": 13, "D": 21, "sum": 6800},
    "10K triangles": {"P": 14, "R": 38, "G": 14, "D": 21, "sum": 8400},
    "100K triangles": {"P": 54, "R": 126, "G": 35, "D": 105, "sum": 27000},
}
"""Table 3 of the paper: microseconds on an RTX 4090, of one estimate, of the one D of a step, and of a step."""


def soups() -> dict[str, Any]:
    """The figures of every soup."""
    out: dict[str, Any] = {}
    for name, soup in SOUPS.items():
        fitted = {credit: fit(soup, credit) for credit in CREDITS}
        equal = min(each.curve[-1][1] for each in fitted.values())
        out[name] = {
            **dataclasses.asdict(soup),
            "parameters": soup.parameters,
            "equal seconds": equal,
            "credits": {credit: _of_soup(each, equal, soup) for credit, each in fitted.items()},
        }
    return out


def _of_soup(fitted: Fitted, equal: float, soup: Soup) -> dict[str, Any]:
    estimates = soup.steps * soup.estimates
    return {
        "curve": fitted.curve,
        "psnr": fitted.curve[-1][2],
        "psnr after equal seconds": fitted.after(equal),
        "milliseconds": {
            stage: 1e3 * seconds / (soup.steps if stage == "D" else estimates)
            for stage, seconds in fitted.seconds.items()
        },
    }


def meshes(seconds: float, clock: str) -> dict[str, Any]:
    """The figures of every mesh."""
    out: dict[str, Any] = {}
    for name, setting in MESHES.items():
        scene = Scene(setting)
        exact = by_exact_gradients(scene, seconds, clock, *EXACT_RATES)
        paper = by_stochastic_gradients(scene, seconds, clock, AS_THE_PAPER)
        longer = {times: by_stochastic_gradients(scene, seconds * times, clock, IN_TURNS) for times in TIMES}
        wanted = exact.curve[-1][1] - AIM
        for times in LONGER:
            if all(each.curve[-1][1] < wanted for each in longer.values()):
                longer[times] = by_stochastic_gradients(scene, seconds * times, clock, IN_TURNS)
        out[name] = {
            "parameters": scene.base.numel() + setting.texture**2 * (3 if setting.kind == "albedo" else 2),
            "runs": [(run.curve[-1][1], run.steps) for run in (exact, paper, *(longer[times] for times in TIMES))],
            "longest": (max(longer), longer[max(longer)].curve[-1][1]),
            "exact reaches the stochastic end": within(exact.curve, longer[1].curve[-1][1]),
            "within the aim": next((t for t, each in longer.items() if each.curve[-1][1] >= wanted), None),
        }
    return out


def soup_tables(found: Mapping[str, Any]) -> str:
    """Table of figure 3, and table 3."""
    lines = [
        "| soup | parameters | renders | at first | per pixel | full image | both after as many seconds |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, each in found.items():
        own, whole = (each["credits"][credit] for credit in CREDITS)
        lines.append(
            f"| {name} | {each['parameters']:,} | {own['curve'][-1][0]:,} | {own['curve'][0][2]:.1f} dB "
            f"| {own['psnr']:.1f} dB | {whole['psnr']:.1f} dB "
            f"| {each['equal seconds']:.0f} s: {own['psnr after equal seconds']:.1f} dB, "
            f"{whole['psnr after equal seconds']:.1f} dB |"
        )
    lines += ["", "| per pixel, for each step | P | R | G | D | sum |", "|---|---|---|---|---|---|"]
    for name, each in found.items():
        spent, count = each["credits"][CREDITS[0]]["milliseconds"], each["estimates"]
        total = sum(spent[s] for s in "PRG") * count + spent["D"]
        cells = [f"{spent[s]:.2f} ms (x {count})" for s in "PRG"]
        lines.append(f"| {name} | {' | '.join(cells)} | {spent['D']:.2f} ms | {total:.0f} ms |")
        if name in PAPER:
            paper = PAPER[name]
            cells = [f"{paper[s] / 1e3:.3f} ms (x 128)" for s in "PRG"]
            lines.append(
                f"| the paper, RTX 4090 | {' | '.join(cells)} | {paper['D'] / 1e3:.3f} ms | {paper['sum'] / 1e3:g} ms |"
            )
    return "\n".join(lines)


def mesh_table(found: Mapping[str, Any], seconds: float) -> str:
    """PSNR over held-out views."""
    ways = [f"exact, {seconds:g} s", f"all at once, {seconds:g} s", *(f"in turns, {t * seconds:g} s" for t in TIMES)]
    lines = [
        f"| mesh | parameters | {' | '.join(ways)} | exact is as far as {ways[2]}, after "
        f"| in turns within {AIM:g} dB of exact, after |",
        "|---|---|---|---|---|---|" + "---|" * len(TIMES),
    ]
    for name, each in found.items():
        earlier, within_aim = each["exact reaches the stochastic end"], each["within the aim"]
        longest, psnr = each["longest"]
        reached = f"not in {longest * seconds:g} s" if within_aim is None else f"{within_aim * seconds:g} s"
        if longest not in TIMES:
            reached += f" ({psnr:.1f} dB)"
        lines.append(
            f"| {name} | {each['parameters']:,} | "
            + " | ".join(f"{value:.1f} dB, {steps:,} steps" for value, steps in each["runs"])
            + f" | {'not' if earlier is None else f'{earlier:.1f} s'} | {reached} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clock", choices=tuple(CLOCKS), default="wall", help="of meshes (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of exact gradients (default: %(default)s)")
    options = parser.parse_args()
    # Images are small: torch's own threads would wait for each other. The native core has threads of its own.
    torch.set_num_threads(1)
    machine = f"{cpu_name()}, {_native.isa()}; {_native.num_threads()} threads; torch {torch.__version__}"
    print(f"{machine}\n", flush=True)
    print(soup_tables(soups()), flush=True)
    print("\n" + mesh_table(meshes(options.seconds, options.clock), options.seconds))


if __name__ == "__main__":
    main()
