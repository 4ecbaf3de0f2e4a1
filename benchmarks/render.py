"""Renders of a mesh: nanoseconds per shaded sample, of candidate and reference; prints Markdown.

    python benchmarks/render.py [--size 256] [--threads 2] [--rounds 9]

A shaded sample is one covered pixel under one light. The material ball under the studio's lights, `gltf` in a texture
of 512 x 512. Rounds alternate between the rows. Wall time is the shortest round and the median; the shortest is what a
machine takes that does nothing else. Processor time, of all threads together, is the shortest round too.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable

import numpy as np
from timing import cpu_name


def main() -> None:
    parser = argparse.ArgumentParser(description="benchmark of mesh renders")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()

    from mipbake import _native
    from mipbake.comparing.meshes import mesh_render, shapes
    from mipbake.comparing.meshes.camera import orbit
    from mipbake.material.filtered_source import FilteredSource
    from mipbake.material.pixel_filter import filtered_levels
    from mipbake.quality import environment

    _native.set_num_threads(options.threads)
    rng = np.random.default_rng(0)
    level = rng.random((512, 512, 8), np.float32)
    level[..., 5:7] = (level[..., 5:7] - 0.5) * 0.6
    level[..., 7] = 1
    wrap = ("wrap", "wrap")
    levels = filtered_levels(level, "gaussian", wrap)
    lighting = environment.studio()
    resolution = (options.size, options.size)
    shot = mesh_render.Shot(shapes.material_ball(), orbit(3.6, 25, 18), lighting, resolution)
    source = FilteredSource(level, "gltf", wrap, "gaussian")
    frame = mesh_render.candidate(shot, levels, "gltf", wrap)
    covered, lights = int(frame.coverage.sum()), len(lighting.direction)
    passes = 8

    def candidate() -> None:
        mesh_render.candidate(shot, levels, "gltf", wrap)

    def reference() -> None:
        mesh_render.reference(shot, source, 0, [frame], mesh_render.Passes(least=passes, most=passes))

    calls: dict[str, tuple[Callable[[], object], int]] = {
        "candidate": (candidate, 1),
        f"reference, {passes} passes": (reference, passes),
    }
    print(f"{covered:,} covered pixels of {options.size} x {options.size}, {lights} lights, {options.threads} threads;")
    print(f"{_native.isa()}, {cpu_name()}\n")
    report(calls, covered * lights, options.rounds)


def report(calls: dict[str, tuple[Callable[[], object], int]], samples: int, rounds: int) -> None:
    """Times every call once a round, and prints a table; each shades `samples` times the number beside it."""
    wall: dict[str, list[float]] = {name: [] for name in calls}
    processor: dict[str, list[float]] = {name: [] for name in calls}
    for index in range(rounds + 1):
        for name, (call, _) in calls.items():
            start, spent = time.perf_counter(), time.process_time()
            call()
            if index > 0:  # the first round does not count
                wall[name].append(time.perf_counter() - start)
                processor[name].append(time.process_time() - spent)
    print("| what | ms | ns per shaded sample, shortest | median | processor ns |")
    print("|---|---|---|---|---|")
    for name, (_, count) in calls.items():
        each = 1e9 / (samples * count)
        shortest, median, spent = min(wall[name]), statistics.median(wall[name]), min(processor[name])
        numbers = f"{shortest * 1e3:.1f} | {shortest * each:.2f} | {median * each:.2f} | {spent * each:.2f}"
        print(f"| {name} | {numbers} |")


if __name__ == "__main__":
    main()
