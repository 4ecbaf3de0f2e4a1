"""Stacks that are fitted in the renderer that will show them, beside stacks that are baked without it.

    python benchmarks/fit.py MATERIALS PICTURES --sets SET SET --results RESULTS

MATERIALS is a folder of texture sets, and SET names some of them. Each set is baked by `linear`, `lean` and `auto`, and
fitted in each renderer as `mipbake fit` does, from `auto` and `linear`. That renderer then shows all four stacks in
views that the fit has not seen, and its own supersampled pictures of the source are the references. PICTURES is a
folder for a picture of each set in each renderer. RESULTS is a JSON file. It takes the figures of a set in a renderer
as soon as they are there, and a run that was stopped goes on from it. New code is not noticed: it wants a new file.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from operator import sub
from pathlib import Path
from typing import Any

import numpy as np
from fit_tables import FITTED, METHODS, OTHERS, START
from numpy.typing import NDArray
from PIL import Image
from results_sets import folder_sets, middle
from timing import arguments, effort_of, expect, keep

import mipbake
from mipbake import MipStack, TextureSet
from mipbake.fitting import Levels, View, standard_views
from mipbake.fitting.named import RendererChoice
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.process import ProcessRenderer as Renderer
from mipbake.fitting.references import Supersampled
from mipbake.fitting.views import scale_of
from mipbake.material.pixel_filter import filter_named, level_sizes
from mipbake.quality.metrics import displayed, snr_sums

FILTER = "gaussian"

LODS = (0.0, 0.5, 3.0, 7.0)
"""Levels of detail that are measured: one for each scale of docs/validation.md. A small set has its last one in place
of 7."""

LEARNED, HELD_OUT, PICTURED = 0, 71, 72
"""Seeds of cameras and lights: of the views that a fit learns from and checks with, of those that measure, and of the
one that is pictured."""

ESTIMATES = (81, 82)
"""Seeds of both estimates of a reference."""

PICTURED_LOD, PICTURED_SIDE = 4.0, 144
"""Pixels see so many texels that methods differ. The picture is enlarged to about so many pixels a side."""

Image3 = NDArray[np.float32]


RENDERERS: Mapping[str, Callable[[], Any]] = {
    f"{name} {shader}": RendererChoice(name, shader).made
    for name, shader in (("gl", "clearcoat"), ("gl", "ramp"), ("three", "physical"))
}


@dataclass(frozen=True)
class Effort:
    """How thoroughly.

    Args:
        size: texels a side of the middle of each set, which repeats without end, seams included.
        steps: of each fit at most, so that figures do not depend on how busy the machine is.
        each: views at each level of detail to fit to. As many more as the command line takes are held out.
        measured: views at each scale to measure in.
        passes: renders of each of both estimates of a reference at level of detail 0; twice as many at each level
            more, up to four times as many.
    """

    size: int = 256
    steps: int = 4000
    each: int = 8
    measured: int = 8
    passes: int = 64


def texture_set_of(load: Callable[[], TextureSet], effort: Effort) -> TextureSet:
    """The middle of a set."""
    return replace(middle(load(), effort.size), wrap=("wrap", "wrap"))


def levels_of(stored: Sequence[Image3], model: str, wrap: tuple[str, str]) -> Levels:
    """Stored channels of levels, as a renderer gets them."""
    height, width = stored[0].shape[:2]
    parameters = Parameters.of(model, height, width, len(stored))
    return parameters.levels(parameters.values(list(stored)), wrap)


def reference(renderer: Renderer, source: Levels, view: View, lod: float, effort: Effort, seed: int) -> Image3:
    """What the renderer shows of the source, supersampled: one estimate."""
    found = Supersampled(renderer, source, view, filter_named(FILTER), seed)
    found.refine(max(2, round(effort.passes * 2 ** min(max(lod, 0.0), 2.0))))  # a render in each half at least
    return np.asarray(found.halves().mean(0))


def measured(
    renderer: Renderer, stacks: Mapping[str, MipStack], texture_set: TextureSet, effort: Effort
) -> dict[str, list[dict[str, Any]]]:
    """Scale to its views, each with the sums of `snr_sums` (signal, error, noise) by measure and method."""
    source = levels_of([texture_set.material(texture_set.source_model)], texture_set.source_model, texture_set.wrap)
    levels = {name: levels_of(stack.levels, stack.model, stack.wrap) for name, stack in stacks.items()}
    size = texture_set.height, texture_set.width
    last = len(level_sizes(*size)) - 1
    found: dict[str, list[dict[str, Any]]] = {}
    for lod in sorted({min(each, float(last)) for each in LODS}):
        for view in standard_views(size, texture_set.wrap, effort.measured, HELD_OUT, [lod]):
            pixels = np.asarray(renderer.render(levels[START], view).id) > 0  # those that show the maps
            if not pixels.any():
                continue
            first, second = (reference(renderer, source, view, lod, effort, seed)[pixels][None] for seed in ESTIMATES)
            exposure = exposed((first + second) / 2)
            shown = {name: renderer.render(each, view).image[pixels][None] for name, each in levels.items()}
            sums = {
                measure: {
                    name: snr_sums(seen(image), seen(first), seen(second))[0].tolist() for name, image in shown.items()
                }
                for measure, seen in (("snr", np.asarray), ("snr-displayed", lambda x, e=exposure: displayed(x * e)))
            }
            found.setdefault(scale_of(lod), []).append({"view": view.name, "sums": sums})
    return found


def exposed(right: NDArray[np.floating]) -> float:
    """What radiance is multiplied by before it is displayed: the median of the reference is shown at 0.375."""
    lit = right[right > 0]
    return 0.6 / float(np.median(lit)) if lit.size else 1.0


def strip(renderer: Renderer, stacks: Mapping[str, MipStack], texture_set: TextureSet, effort: Effort) -> Image.Image:
    """One view of the bakes, the fit and the reference, side by side, as a display shows them at one exposure."""
    size, wrap = (texture_set.height, texture_set.width), texture_set.wrap
    lod = min(PICTURED_LOD, float(len(level_sizes(*size)) - 1))
    [view] = standard_views(size, wrap, 1, PICTURED, [lod])
    source = levels_of([texture_set.material(texture_set.source_model)], texture_set.source_model, wrap)
    right = reference(renderer, source, view, lod, effort, ESTIMATES[0])
    every = [stacks[name] for name in (*METHODS, FITTED)]
    shown = [renderer.render(levels_of(stack.levels, stack.model, wrap), view).image for stack in every]
    picture = displayed(np.concatenate([*shown, right], 1) * exposed(right))
    larger = max(1, PICTURED_SIDE // view.size[0])
    return Image.fromarray(np.rint(255 * picture).astype(np.uint8).repeat(larger, 0).repeat(larger, 1))


def fitted(
    stacks: Mapping[str, MipStack], renderer: Renderer, texture_set: TextureSet, effort: Effort
) -> tuple[MipStack, dict[str, Any]]:
    """The fitted stack; and how many views and steps there were."""
    size, wrap = (texture_set.height, texture_set.width), texture_set.wrap
    learned, checked, apart = RendererChoice("gl").views_of(size, wrap, effort.each, LEARNED)  # as on a command line
    progress: list[mipbake.fitting.Progress] = []
    found = mipbake.fitting.fit(
        stacks[START],
        renderer,
        learned,
        others=[stacks[name] for name in OTHERS],
        source=texture_set,
        held_out=checked,
        apart=apart,
        steps=effort.steps,
        progress=progress.append,
    )
    return found, {"views": len(learned) + len(checked or ()), "steps": progress[-1].step}


def one(name: str, renderer: Renderer, texture_set: TextureSet, effort: Effort, pictures: Path) -> dict[str, Any]:
    """All figures of a set in a renderer."""
    clock = [time.monotonic()]
    stacks = {method: mipbake.bake(texture_set, method, pixel_filter=FILTER) for method in METHODS}
    clock.append(time.monotonic())
    stacks[FITTED], about = fitted(stacks, renderer, texture_set, effort)
    clock.append(time.monotonic())
    scales = measured(renderer, stacks, texture_set, effort)
    clock.append(time.monotonic())
    pictures.mkdir(parents=True, exist_ok=True)
    image = strip(renderer, stacks, texture_set, effort)
    image.save(pictures / f"fit-{name.replace(' ', '-')}-{texture_set.name}.png")
    seconds = dict(zip(("baking", "fit", "measuring"), map(sub, clock[1:], clock[:-1]), strict=True))
    return {"size": [texture_set.height, texture_set.width], **about, "seconds": seconds, "scales": scales}


def main() -> None:
    """Measures what RESULTS does not hold yet."""
    more = asdict(Effort())
    options = arguments(__doc__, "materials", "pictures", results=None, sets=(), renderers=tuple(RENDERERS), **more)
    folder, pictures = options.materials.resolve(), options.pictures.resolve()
    results = options.results and options.results.resolve()
    os.environ.setdefault("NODE_PATH", str(Path(__file__).parent / "engines/node_modules"))  # has three.js
    effort, known = effort_of(Effort, options), folder_sets(folder)
    expect("set", options.sets or ["is named"], known)
    expect("renderer", options.renderers, RENDERERS)
    data: dict[str, Any] = {"effort": asdict(effort), "renderers": {}}
    if results and results.exists():
        data = json.loads(results.read_text(encoding="utf-8"))
        if data["effort"] != asdict(effort):
            raise SystemExit(f"{results} was measured with {data['effort']}: give the same options, or another file")
    for renderer_name in options.renderers:
        found = data["renderers"].setdefault(renderer_name, {})
        missing = [name for name in options.sets if name not in found]
        if not missing:
            continue
        with closing(RENDERERS[renderer_name]()) as renderer:
            for name in missing:
                texture_set = texture_set_of(known[name], effort)
                found[name] = one(renderer_name, renderer, texture_set, effort, pictures)
                keep(data, results)
                print(f"{renderer_name}, {name}: {found[name]['seconds']}", flush=True)


if __name__ == "__main__":
    main()
