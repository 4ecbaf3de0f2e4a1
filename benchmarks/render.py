"""Renders of a mesh: nanoseconds per shaded sample, of candidate and reference and of their parts; prints Markdown.

    python benchmarks/render.py [--size 256] [--threads 2] [--rounds 5]

A shaded sample is one covered pixel under one light. The material ball under the studio's lights, `gltf` in a texture
of 512 x 512. Times are medians over the rounds, which alternate; the spread is (largest - smallest) / median.
"""

from __future__ import annotations

import argparse
import os

import numpy as np
from timing import cpu_name, measure


def main() -> None:
    parser = argparse.ArgumentParser(description="benchmark of mesh renders")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()

    from mipbake import _native, shading
    from mipbake.prefilter.pixel_filter import filtered_levels
    from mipbake.render import environment, mesh_render, shapes
    from mipbake.render.camera import orbit

    _native.set_num_threads(options.threads)
    rng = np.random.default_rng(0)
    level = rng.random((512, 512, 8), np.float32)
    level[..., 5:7] = (level[..., 5:7] - 0.5) * 0.6
    level[..., 7] = 1
    wrap = ("wrap", "wrap")
    levels = filtered_levels(level, "gaussian", wrap)
    lighting = environment.studio()
    view = (shapes.material_ball(), orbit(3.6, 25, 18), lighting)
    resolution = (options.size, options.size)
    frame = mesh_render.candidate(*view, levels, "gltf", wrap, resolution)
    covered, lights = int(frame.coverage.sum()), len(lighting.direction)
    passes = 8

    def candidate() -> None:
        mesh_render.candidate(*view, levels, "gltf", wrap, resolution)

    def reference() -> None:
        mesh_render.reference(
            *view, level, "gltf", wrap, resolution, "gaussian", 0, [frame],
            min_passes=passes, max_passes=passes,
        )  # fmt: skip

    texels = np.ascontiguousarray(level.reshape(-1, 8)[:covered])
    up = np.array([[0.0, 0.6, 0.8]], np.float32)
    shared = np.repeat(up[None], lights, 1)
    own = np.ascontiguousarray(np.broadcast_to(up, (1, lights, covered, 3)))
    calls = {
        "shading, directions that all pixels share": (lambda: shading.shade("gltf", texels, shared, shared), 1),
        "shading, directions of each pixel's own": (lambda: shading.shade("gltf", texels, own, own), 1),
        "candidate": (candidate, 1),
        f"reference, {passes} passes": (reference, passes),
    }
    timings = measure({name: call for name, (call, _) in calls.items()}, options.rounds)
    print(f"{covered:,} covered pixels of {options.size} x {options.size}, {lights} lights, {options.threads} threads;")
    print(f"{_native.isa()}, {cpu_name()}\n")
    print("| what | ms | ns per shaded sample | spread |")
    print("|---|---|---|---|")
    for name, (_, count) in calls.items():
        timing = timings[name]
        each = timing.median / (covered * lights * count) * 1e9
        print(f"| {name} | {timing.median * 1e3:.1f} | {each:.1f} | {timing.spread:.0%} |")


if __name__ == "__main__":
    main()
