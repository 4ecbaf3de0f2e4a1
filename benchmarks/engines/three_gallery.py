"""Films sets that shimmer in three.js as it comes: plain MIP maps, mipbake and the truth, beside each other.

    python benchmarks/engines/three_gallery.py FOLDER [--only wet_asphalt ocean] [--results FILE]

Leaves an animated picture of each set in FOLDER, and writes how ColorVideoVDP judges plain MIP maps and mipbake beside
the truth. The truth is three.js itself with level 0 of the source in float32, at many sub-pixel offsets. The sets are
those of examples/showcase.py, and the one of examples/ on which every method fails. A set that FOLDER has already is
not filmed again.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from browser import HERE
from engine_textures import engine_maps, stack_maps
from engine_views import described
from numpy.typing import NDArray
from PIL import Image
from scipy.stats import qmc
from three_page import opened_three
from three_table import BAKED, PLAIN_MAPS, arguments, expect, keep

import mipbake
from mipbake import TextureSet
from mipbake.comparing.filming import JUDGED_AT
from mipbake.comparing.films import FRAMES_PER_SECOND, films_of
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.material.pixel_filter import filter_named
from mipbake.quality import environment
from mipbake.quality.metrics import color_video_vdp, displayed, film_exposure, flicker_ratio

ROOT = HERE.parent.parent
sys.path += [str(ROOT / "examples"), str(ROOT / "docs")]
import generate  # noqa: E402
import pictures  # noqa: E402
import showcase  # noqa: E402

TRUTH = "truth"

STACKS: Mapping[str, Mapping[str, str]] = {
    PLAIN_MAPS: {"method": "linear", "pixel_filter": "box"},
    BAKED: {"method": "auto", "sampler": "trilinear"},
}
"""Name to how it is baked. `linear` with a box is what an engine makes from level 0."""

FLOOR = "film-floor"

SMALL = "knurled_plate"
"""The set of examples/, a quarter as large as the others, so that pixels hold whole pyramids."""

SETS = (*showcase.SHOWCASE, SMALL)

_REACH = 0.02  # of the ground of films, whose far end is at the horizon: float32 needs small coordinates
_QUALITY = 55  # of WebP, so that all films together load at once
_MILLISECONDS = 80  # a frame is shown: slower than it is judged, so that one can look

Film = NDArray[np.float32]
"""(T, H, W, 3), rows from the top: linear radiance, or what is displayed."""


class Filmed(NamedTuple):
    """The films by name as displayed, and the two halves of the truth."""

    films: Mapping[str, Film]
    halves: tuple[Film, Film]


def main() -> None:
    """Films what FOLDER lacks."""
    options = arguments(__doc__, "folder", only=(), size=1024, height=128, frames=8, samples=64, results=None)
    options.folder.mkdir(parents=True, exist_ok=True)
    expect("set", options.only, SETS)
    found = {}
    for name in options.only or SETS:
        file = options.folder / f"{name}.json"
        if not file.exists():
            size = options.size // 4 if name == SMALL else options.size
            made = filmed(_loaded(name, size), options.height, options.frames, options.samples)
            _save(made.films, options.folder / f"gallery-{name}.webp")
            keep(judged(made), file)
        found[name] = json.loads(file.read_text(encoding="utf-8"))
        print(name, found[name], flush=True)
    if options.results:
        effort = {key: getattr(options, key) for key in ("size", "height", "frames", "samples")}
        keep({"effort": effort, "sets": found}, options.results)


def _loaded(name: str, size: int) -> TextureSet:
    made = generate.SETS.get(name) or showcase.SHOWCASE[name]
    with tempfile.TemporaryDirectory() as scratch:
        generate.store(generate.quantised(made(size, size)), Path(scratch) / name)
        return mipbake.load(Path(scratch) / name)


def filmed(texture_set: TextureSet, height: int, frames: int, samples: int) -> Filmed:
    """The films of a floor by three.js; `samples` of each pixel in each half of the truth."""
    lights = environment.studio()  # three.js has its own
    [film] = (f for f in films_of((texture_set.height, texture_set.width), lights, 10, height=height, frames=frames)
              if f.name == FLOOR)  # fmt: skip
    kernel = filter_named("gaussian")
    offsets = [kernel.offsets(qmc.Sobol(2, seed=seed).random(samples))[0].reshape(-1).tolist() for seed in (1, 2)]
    with tempfile.TemporaryDirectory() as scratch, opened_three(Path(scratch)) as three:
        three.page.evaluate("() => proof.light(0)")  # the room alone: a lamp of no extent wants thousands of samples
        for which, how in STACKS.items():
            three.add_material(which, stack_maps(mipbake.bake(texture_set, **how)), "ktx2-rgba8")
        three.add_material(TRUTH, engine_maps([texture_set.material("gltf")]), "float")
        radiance: dict[str, list[NDArray[np.float64]]] = {each: [] for each in (*STACKS, "first", "second")}
        for shot in film.shots:
            three.add_view("view", described(_near(shot.mesh), shot.camera, shot.resolution))
            for which in STACKS:
                radiance[which].append(three.rendered("view", which, shot.resolution))
            for half, some in zip(("first", "second"), offsets, strict=True):
                radiance[half].append(three.rendered("view", TRUTH, shot.resolution, some) / samples)
    return _displayed({which: np.stack(images) for which, images in radiance.items()})


def _near(mesh: Mesh) -> Mesh:
    """The part of the ground that films show."""
    middle = mesh.uv.mean(0)
    return replace(mesh, positions=mesh.positions * _REACH, uv=middle + (mesh.uv - middle) * _REACH)


def _displayed(radiance: Mapping[str, NDArray[np.float64]]) -> Filmed:
    """Films as displays show them, at one exposure; pixels that hold an edge of the mesh are those of the truth."""
    mean = (radiance["first"] + radiance["second"]) / 2
    inside = mean[..., 3] > 1 - 1e-6
    exposure = film_exposure(mean[..., :3].astype(np.float32), inside)

    def shown(images: NDArray[np.float64]) -> Film:
        return np.asarray(displayed(images[..., :3] * exposure), np.float32)

    truth = shown(mean)
    films = {each: np.where(inside[..., None], shown(radiance[each]), truth) for each in STACKS}
    return Filmed({**films, TRUTH: truth}, (shown(radiance["first"]), shown(radiance["second"])))


def judged(made: Filmed) -> dict[str, dict[str, float | None]]:
    """JOD, and change from frame to frame over that of the truth, by name."""
    return {
        name: {
            "jod": color_video_vdp(made.films[name], made.films[TRUTH], JUDGED_AT[0], FRAMES_PER_SECOND),
            "flicker": flicker if math.isfinite(flicker) else None,
        }
        for name in STACKS
        for flicker in [flicker_ratio(made.films[name], *made.halves)]
    }


def _save(films: Mapping[str, Film], path: Path) -> None:
    """The films beside each other, forth and back."""
    frames: list[Image.Image] = []
    for index in range(len(films[TRUTH])):
        cells = [pictures.Cell(np.rint(255 * film[index]).astype(np.uint8)) for film in films.values()]
        frames.append(pictures.grid(list(films), {"": cells}))
    frames += frames[-2:0:-1]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=_MILLISECONDS, loop=0, quality=_QUALITY,
                   method=6)  # fmt: skip


if __name__ == "__main__":
    main()
