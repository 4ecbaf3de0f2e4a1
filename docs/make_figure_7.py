"""Makes the pictures and figures of docs/figure-7.md: one material read and made in every material model, after
figure 7 of Kemppinen et al. 2023.

    python docs/make_figure_7.py --figures FILE [PAGE] [--set FOLDER] [--side 112] [--passes 512] [--methods ...]

`python docs/remake.py --measure figure-7` runs it and writes the page from its figures; pictures are written beside
the page.

The material is converted to each model in turn (as `mipbake convert` does), and that is the input, whose supersampled
render is the reference. Stacks of every model are baked from it: by closed forms and by measurement, which convert
texel by texel, and by the networks among the released weights that make the model: the networks with a name that begins
with `paper-`, and the default networks. A network that is not there has no row.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pictures
from numpy.typing import NDArray
from PIL import Image
from records.wrapping import table

import mipbake
from mipbake.baking.bake import DEFAULT_FILTER
from mipbake.baking.methods import METHODS
from mipbake.base.errors import UsageError
from mipbake.comparing.pictures import RenderSettings, render_view
from mipbake.comparing.scenes import standard_views
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import level_sizes
from mipbake.models.registry import default_weights, list_weights, load_network
from mipbake.quality import environment
from mipbake.quality.figures import Candidate, Method
from mipbake.source.texture_set import TextureSet

PAGE = Path(__file__).resolve().parent / "figure-7.md"
SET = Path(__file__).resolve().parent.parent / "examples" / "brushed_steel"
MODELS = ("ggx", "beckmann", "gltf", "gltf-anisotropic")
SCALES = ("near", "middle", "far")
NEURAL, PAPER, CROSS = "neural", "paper-", "paper-cross"

GAP, LEFT, HEAD, LINE = 10, 66, 52, 18  # pixels

_TEXT = """\
# Figure 7: one material, every model

After figure 7 of [Kemppinen et al. 2023](method.md): a material is given in one material model, and stacks of all
models show it. The material is `{name}` of the [examples](../examples/README.md). It is converted to each model in
turn, and that is the input. The first column of a picture is the supersampled reference, shaded in the input's model.
The other columns are stacks by `{shown}` in the model that stands above them. Spheres are near, in the middle and far
away (levels of detail 0, 3 and 7). Under each stand its SNR and its FLIP, and the best of a row is green.
`docs/make_figure_7.py` makes this page.

The table has the SNR of `{method}` in dB, {scales}. A row is an input, and a column is the model of a stack. The
[record](../benchmarks/records/figure-7.json) has FLIP and the other methods.

{table}

What to look for is how far the other stacks are behind the stack in the input's own model:

- `gltf` has one roughness, so it shows brush marks as a round blur.
- The tails of GGX are longer than the tails of `beckmann`, and no stack can mend that.
- A matte dielectric differs between glTF and the other two models ([known limits](validation.md#known-limits)).
"""


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


def composed(
    source: str, method: str, found: Shown, references: Mapping[str, pictures.Picture], side: int
) -> Image.Image:
    """Reference and outputs of an input, a row for each scale."""
    outputs = [model for model in MODELS if (method, model, SCALES[0]) in found]
    row = side + 2 * LINE
    image, pen = pictures.panel(LEFT + (1 + len(outputs)) * (side + GAP), HEAD + len(SCALES) * row + GAP // 2)
    pen.text((GAP, 22), f"input {source}, {method}", pictures.BRIGHT, pictures.font(16), anchor="ls")
    for column, head in enumerate(("reference", *outputs)):
        middle = LEFT + column * (side + GAP) + side // 2
        pen.text((middle, 44), head, pictures.BRIGHT if head != source else pictures.GOOD, pictures.font(13), "ms")
    for index, scale in enumerate(SCALES):
        top = HEAD + index * row
        pen.text((GAP, top + side // 2), scale, pictures.BRIGHT, pictures.font(14), anchor="lm")
        image.paste(Image.fromarray(references[scale]), (LEFT, top))
        row_of = [found[method, output, scale] for output in outputs]
        for column, sphere in enumerate(row_of, 1):
            left = LEFT + column * (side + GAP)
            image.paste(Image.fromarray(sphere.picture), (left, top))
            figures = {
                f"{sphere.snr:.1f} dB": sphere.snr == max(each.snr for each in row_of),
                f"FLIP {sphere.flip:.3f}": sphere.flip == min(each.flip for each in row_of),
            }
            for line, (words, best) in enumerate(figures.items()):
                place = (left + side // 2, top + side + 13 + line * 15)
                pen.text(place, words, pictures.GOOD if best else pictures.DIM, pictures.font(12), anchor="ms")
    return image


def tabulated(found: Shown) -> dict[str, dict[str, list[list[float]]]]:
    """Output model to method to SNR and FLIP of every scale."""
    rows: dict[str, dict[str, list[list[float]]]] = {}
    for method, output in dict.fromkeys((method, output) for method, output, _ in found):
        spheres_of = [found[method, output, scale] for scale in SCALES]
        rows.setdefault(output, {})[method] = [[each.snr, each.flip] for each in spheres_of]
    return rows


def page_of(data: Mapping[str, Any], stem: str = PAGE.stem) -> str:
    """The Markdown page of what was measured; `stem` is what the names of its pictures begin with."""
    outputs = list(next(iter(data["inputs"].values())))
    method = [name for name in next(iter(data["inputs"].values()))[outputs[0]] if name in METHODS and name != NEURAL][
        -1
    ]
    rows = [
        [f"`{source}`", *(" / ".join(f"{snr:.1f}" for snr, _ in stacks[output][method]) for output in outputs)]
        for source, stacks in data["inputs"].items()
    ]
    made = table(["input", *(f"`{output}`" for output in outputs)], rows)
    scales = " / ".join(data["scales"])
    parts = [_TEXT.format(name=data["set"], shown=data["shown"], method=method, scales=scales, table=made)]
    for source in data["inputs"]:
        parts.append(f"![Spheres of every output model beside a reference in {source}]({stem}-{source}.webp)\n")
    return "\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description="the pictures and figures of figure 7")
    parser.add_argument("page", type=Path, nargs="?", default=PAGE)
    parser.add_argument("--figures", type=Path, required=True, help="a .json file of what was measured")
    parser.add_argument("--set", type=Path, default=SET, help="a texture set")
    parser.add_argument("--side", type=int, default=112, help="pixels of a sphere's picture")
    parser.add_argument("--passes", type=int, default=512, help="samples a pixel of a reference, at most")
    parser.add_argument("--methods", nargs="+", default=["linear", "lean", "auto"], choices=METHODS)
    options = parser.parse_args()
    texture_set = mipbake.load(options.set)
    trained = list(dict.fromkeys(name for source in MODELS for model in MODELS for name in networks(source, model)))
    method = CROSS if CROSS in trained else options.methods[-1]
    inputs = {}
    for source in MODELS:
        found, references = spheres(texture_set, source, options.methods, options.side, options.passes)
        picture = composed(source, method, found, references, options.side)
        picture.save(options.page.parent / f"{options.page.stem}-{source}.webp", quality=92, method=6)
        inputs[source] = tabulated(found)
    about = {"set": texture_set.name, "shown": method, "networks": trained, "scales": SCALES, "inputs": inputs}
    options.figures.write_text(json.dumps(about), encoding="utf-8")


if __name__ == "__main__":
    main()
