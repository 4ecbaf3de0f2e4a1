"""Makes the pictures and figures of figure 7 in docs/paper-figures.md: one material read and made in every material
model, after figure 7 of Kemppinen et al. 2023.

    python docs/make_figure_7.py FOLDER [--results FILE] [--set SET] [--side 112] [--passes 512] [--methods ...]

The material is converted to each model in turn (as `mipbake convert` does), and that is the input, whose supersampled
render is the reference. Stacks of every model are baked from it: by closed forms and by measurement, which convert
texel by texel, and by the networks among the released weights that make the model: the networks with a name that begins
with `paper-`, and the default networks. A network that is not there has no row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pictures
from numpy.typing import NDArray
from PIL import Image
from records.scripts import script

import mipbake
from mipbake.baking.methods import METHODS
from mipbake.baking.pipeline import DEFAULT_FILTER
from mipbake.base.errors import UsageError
from mipbake.comparing.pictures import RenderSettings, render_view
from mipbake.comparing.scenes import standard_views
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import level_sizes
from mipbake.models.registry import default_weights, list_weights, load_network
from mipbake.quality import environment
from mipbake.quality.figures import Candidate, Method
from mipbake.source.texture_set import TextureSet

timing = script("benchmarks", "timing")

SET = Path(__file__).resolve().parent.parent / "examples" / "brushed_steel"
MODELS = ("ggx", "beckmann", "gltf", "gltf-anisotropic")
SCALES = ("near", "middle", "far")
NEURAL, PAPER, CROSS = "neural", "paper-", "paper-cross"


@dataclass(frozen=True, eq=False)
class Sphere:
    """A candidate's picture and its measures: SNR in dB, FLIP."""

    picture: pictures.Picture
    snr: float
    flip: float


Shown = Mapping[tuple[str, str, str], Sphere]
"""Method, output model and scale to the sphere."""


def networks(source: str, output: str) -> list[str]:
    """Names of the methods that are networks and make one model of another."""
    found = [
        info.name
        for info in list_weights()
        if info.name.startswith(PAPER) and output in info.targets and DEFAULT_FILTER in info.pixel_filters
    ]
    try:
        default_weights(output, DEFAULT_FILTER, source=source)
    except UsageError:
        return found
    return [NEURAL, *found]


def baked(
    stored: NDArray[np.float32], source: str, target: str, wrap: tuple[str, str], method: str
) -> list[NDArray[np.float32]]:
    """Levels of a model by a method, or by the weights of that name."""
    arguments = (stored, source, target, DEFAULT_FILTER, wrap, lambda _share: None)
    if method in METHODS:
        return METHODS[method](*arguments).levels
    (info,) = (info for info in list_weights() if info.name == method)
    return load_network(info).bake(*arguments)


def spheres(
    texture_set: TextureSet, source: str, methods: Sequence[str], side: int, passes: int
) -> tuple[Shown, Mapping[str, pictures.Picture]]:
    """Every stack of a material given in the model `source`, and the reference by scale."""
    stored = texture_set.material(source)
    filtered = FilteredSource(stored, source, texture_set.wrap, DEFAULT_FILTER)
    size = (texture_set.height, texture_set.width)
    candidates = []
    for output in MODELS:
        for method in (*methods, *networks(source, output)):
            levels = baked(stored, source, output, texture_set.wrap, method)
            candidates.append(Candidate(Method(f"{method}|{output}", method, DEFAULT_FILTER, output), levels))
    found, references = {}, {}
    for view in standard_views(size, environment.studio(), len(level_sizes(*size)) - 1, (side, side)):
        if view.view != "sphere" or view.scale not in SCALES:
            continue
        made = render_view(view, filtered, candidates, RenderSettings(max_passes=passes), flicker=False)
        references[view.scale] = pictures.shown(made.reference.image)
        values = {(figure.method, figure.measure): figure.value for figure in made.figures}
        for name, frame in made.frames.items():
            method, _, output = name.partition("|")
            picture = pictures.shown(frame.image)
            found[method, output, view.scale] = Sphere(picture, values[name, "snr"], values[name, "flip"])
        print(f"{source}, {view.title}: reference of {made.reference.passes} samples a pixel", flush=True)
    return found, references


def composed(source: str, method: str, found: Shown, references: Mapping[str, pictures.Picture]) -> Image.Image:
    """Reference and outputs of an input, a row for each scale."""
    outputs = [model for model in MODELS if (method, model, SCALES[0]) in found]
    rows = {}
    for scale in SCALES:
        row = [found[method, output, scale] for output in outputs]
        snr, flip = max(each.snr for each in row), min(each.flip for each in row)
        cells = (
            pictures.Cell(
                each.picture, [f"{each.snr:.1f} dB", f"FLIP {each.flip:.3f}"], [each.snr == snr, each.flip == flip]
            )
            for each in row
        )
        rows[f"{source}, {scale}"] = [pictures.Cell(references[scale]), *cells]
    return pictures.grid(["reference", *outputs], rows)


def tabulated(found: Shown) -> dict[str, dict[str, list[list[float]]]]:
    """Output model to method to SNR and FLIP of every scale."""
    rows: dict[str, dict[str, list[list[float]]]] = {}
    for method, output in dict.fromkeys((method, output) for method, output, _ in found):
        spheres_of = [found[method, output, scale] for scale in SCALES]
        rows.setdefault(output, {})[method] = [[each.snr, each.flip] for each in spheres_of]
    return rows


def main() -> None:
    options = timing.arguments(
        __doc__, "folder", results=None, set=SET, side=112, passes=512, methods=("linear", "lean", "auto")
    )
    texture_set = mipbake.load(options.set)
    trained = list(dict.fromkeys(name for source in MODELS for model in MODELS for name in networks(source, model)))
    method = CROSS if CROSS in trained else options.methods[-1]
    inputs = {}
    for source in MODELS:
        found, references = spheres(texture_set, source, options.methods, options.side, options.passes)
        picture = composed(source, method, found, references)
        picture.save(options.folder / f"figure-7-{source}.webp", quality=92, method=6)
        inputs[source] = tabulated(found)
    about = {"set": texture_set.name, "shown": method, "networks": trained, "scales": SCALES, "inputs": inputs}
    timing.keep(about, options.results)


if __name__ == "__main__":
    main()
