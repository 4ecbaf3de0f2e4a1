"""Renders of a mesh: nanoseconds per shaded sample, of candidate and reference and of their parts; prints Markdown.

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

    from mipbake import _native, raster, sampling, shading
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

    mesh, camera, surface = shot.mesh, shot.camera, shot.surface
    clip = camera.to_clip(mesh.positions, resolution)[None]
    points = surface.seen()
    texels = sampling.texture(level[None], points.uv[None, None], filter_mode="linear", boundary_mode=wrap)[0, 0]
    up = np.array([[0.0, 0.6, 0.8]], np.float32)
    shared = np.repeat(up[None], lights, 1)
    own = np.ascontiguousarray(np.broadcast_to(up, (1, lights, covered, 3)))
    calls: dict[str, tuple[Callable[[], object], int]] = {
        "candidate": (candidate, 1),
        f"reference, {passes} passes": (reference, passes),
        "of a pass: rasterising": (lambda: raster.rasterize(None, clip, mesh.triangles, resolution), 1),
        "of a pass: that, interpolation and tangent frames": (lambda: list(surface.bands((0.0, 0.0))), 1),
        "of a pass: lookups": (
            lambda: sampling.texture(level[None], points.uv[None, None], filter_mode="linear", boundary_mode=wrap),
            1,
        ),
        "of a pass: shading, all lights of a point at once": (
            lambda: shading.shade_lit("gltf", texels, points.frame, points.view, lighting.direction, lighting.radiance),
            1,
        ),
        "`shade`, directions that all pixels share": (lambda: shading.shade("gltf", texels, shared, shared), 1),
        "`shade`, directions of each pixel's own": (lambda: shading.shade("gltf", texels, own, own), 1),
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
