"""Makes the pictures of docs/paper-figures.md, and the figures below them: figures 3, 4, 6, 8, 9, 10 and 11 of
Kemppinen et al. 2023, with materials of this project.

    python docs/make_paper_pictures.py FOLDER [--results FILE] [--side 128] [--passes 256]

`python docs/remake.py --measure paper-pictures` runs it. The materials are the examples, converted to the paper's
material models and boosted (a little glossier and bumpier, section 4 of the paper), and generated ones. Columns are
the methods that the paper compares: naive averaging, LEAN mapping, MIPNet, the paper's network, and the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pictures
from numpy.typing import NDArray
from PIL import Image
from records.record import ROOT
from records.scripts import script

import mipbake
from mipbake.baking.methods import METHODS
from mipbake.baking.pipeline import DEFAULT_FILTER
from mipbake.comparing import plots
from mipbake.comparing.pictures import RenderSettings, render_view
from mipbake.comparing.result import Plot
from mipbake.comparing.scenes import View, standard_views
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import level_sizes
from mipbake.models.registry import WEIGHTS_FOLDER, find_weights, list_weights, load_network
from mipbake.quality import environment
from mipbake.quality.figures import Candidate, Method
from mipbake.quality.metrics.images import displayed
from mipbake.shading import shade
from mipbake.training.augmentation import augment, mix

mipnet_network, results_sets, cases, timing = (
    script("benchmarks", name) for name in ("mipnet_network", "results_sets", "paper_page.cases", "timing")
)

BASELINES = ROOT / "benchmarks" / "baselines"
EXAMPLES = ("lacquered_leather", "hammered_copper", "brushed_steel")
MANY_LOBES = "knurled_plate"
SCALES = ("middle", "far")

Array = NDArray[np.float32]


def methods(model: str) -> list[str]:
    """What the paper compares, as far as there are weights."""
    names = {info.name for folder in (WEIGHTS_FOLDER, BASELINES) for info in list_weights(folder)}
    return [cases.LINEAR, cases.LEAN, *(name for name in (f"mipnet-{model}", f"paper-{model}") if name in names)]


def stacks(source: Any) -> list[Candidate]:
    """The stacks of a set in its own model."""
    found = []
    for name in methods(source.model):
        method, _, kernel = name.partition(" (")
        if kernel:
            kernel = kernel.rstrip(")")
            levels = METHODS[method](
                source.stored, source.model, source.model, kernel, source.wrap, lambda _share: None
            ).levels
        else:
            folder = BASELINES if name.startswith("mipnet-") else WEIGHTS_FOLDER
            kernel = DEFAULT_FILTER
            arguments = (source.stored, source.model, source.model, kernel, source.wrap, lambda _share: None)
            levels = load_network(find_weights(name, folder)).bake(*arguments)
        found.append(Candidate(Method(name, method, kernel, source.model), levels))
    return found


def example(name: str, model: str) -> Any:
    """An example in a material model, boosted."""
    return results_sets.boosted(results_sets.in_model(mipbake.load(ROOT / "examples" / name), model))


def filtered(source: Any) -> FilteredSource:
    return FilteredSource(source.stored, source.model, source.wrap, DEFAULT_FILTER)


def bytes_of(radiance: Array) -> pictures.Picture:
    return np.round(displayed(radiance.astype(np.float64)) * 255).astype(np.uint8)


def augmentations(model: str = "ggx", side: int = 64, count: int = 8) -> Image.Image:
    """Figure 3: a patch and random augmentations of it, lit from the upper right and from the mirror direction."""
    (name, *_) = EXAMPLES
    patch = example(name, model).stored[None, :side, :side]
    rng = np.random.default_rng(3)
    several = np.repeat(patch, count - 1, 0)
    changed = mix(*(augment(several, model, rng, False, True) for _ in range(2)), rng, True)

    def lit(texels: Array) -> pictures.Picture:
        light = np.array([[0.5, 0.5, 0.7], [-0.05, 0.02, 1]], np.float32)
        view = np.array([[0, 0, 1], [0.1, -0.05, 1]], np.float32)
        light, view = (each / np.linalg.norm(each, axis=-1, keepdims=True) for each in (light, view))
        radiance = np.asarray(shade(model, texels.reshape(-1, texels.shape[-1]), light, view))
        image = bytes_of(np.array([3.0, 0.3]) @ radiance.reshape(2, -1)).reshape(side, side, 3)
        return image.repeat(2, 0).repeat(2, 1)

    patches = [lit(each) for each in (patch[0], *changed)]
    half = count // 2
    columns = [np.concatenate([above, below]) for above, below in zip(patches[:half], patches[half:], strict=True)]
    return pictures.grid([shown_name(name), *[""] * (half - 1)], {"": [pictures.Cell(each) for each in columns]})


def shown_name(name: str) -> str:
    return name.replace("_", " ")


def of_plot(plot: Plot, words: Mapping[str, str]) -> Image.Image:
    """A plot of every method, with words below, the reference last."""
    heads = [*(cases.shown(name) for name in plot.images), "reference"]
    cells = [pictures.Cell(bytes_of(image), [words[name]]) for name, image in plot.images.items()]
    return pictures.grid(heads, {"": [*cells, pictures.Cell(bytes_of(plot.reference))]})


def temporal(source: Any, side: int, passes: int) -> tuple[Image.Image, dict[str, float]]:
    """Figure 4, and flicker."""
    plot, figures = plots.temporal_slice(
        filtered(source), stacks(source), environment.studio(), size=(side, side * 4 // 3), passes=passes
    )
    flicker = {figure.method: figure.value for figure in figures if figure.measure == "flicker"}
    return of_plot(plot, {name: f"flicker {value:.2f}" for name, value in flicker.items()}), flicker


def moved(source: Any, side: int, passes: int) -> tuple[Image.Image, dict[str, float]]:
    """Figure 6: how much a sphere near the viewer changes when the picture moves by half a pixel."""
    view = next(each for each in views(source, side) if (each.view, each.scale) == ("sphere", "near"))
    made = render_view(view, filtered(source), stacks(source), RenderSettings(max_passes=passes), flicker=True)
    assert made.change is not None
    flicker = {figure.method: figure.value for figure in made.figures if figure.measure == "flicker"}
    return of_plot(made.change, {name: f"flicker {value:.2f}" for name, value in flicker.items()}), flicker


def apparent(source: Any, side: int) -> tuple[Image.Image, dict[str, float]]:
    """Figure 8, and the SNR in dB of each lobe over the directions of the light that are shown."""
    plot = plots.apparent_brdf(filtered(source), stacks(source), 0, size=side)
    energy = np.square(plot.reference, dtype=np.float64).sum()
    snr = {
        name: float(10 * np.log10(energy / np.square(image - plot.reference, dtype=np.float64).sum()))
        for name, image in plot.images.items()
    }
    return of_plot(plot, {name: f"{value:.1f} dB" for name, value in snr.items()}), snr


def views(source: Any, side: int) -> Sequence[View]:
    size = (source.height, source.width)
    return standard_views(size, environment.studio(), len(level_sizes(*size)) - 1, (side, side), (side, side * 7 // 4))


def overview(sources: Mapping[str, Any], side: int, passes: int) -> tuple[Image.Image, dict[str, dict[str, float]]]:
    """Figures 9, 10 and 11: spheres of materials from two distances, and their SNR."""
    rows: dict[str, list[pictures.Cell]] = {}
    heads: list[str] = []
    found: dict[str, dict[str, float]] = {}
    for name, source in sources.items():
        candidates = stacks(source)
        for view in (each for each in views(source, side) if each.view == "sphere" and each.scale in SCALES):
            made = render_view(view, filtered(source), candidates, RenderSettings(max_passes=passes), flicker=False)
            snr = {figure.method: figure.value for figure in made.figures if figure.measure == "snr"}
            cells = [
                pictures.Cell(pictures.shown(frame.image), [f"{snr[each]:.1f} dB"])
                for each, frame in made.frames.items()
            ]
            rows[f"{shown_name(name)}, {view.scale}"] = [*cells, pictures.Cell(pictures.shown(made.reference.image))]
            heads = [*(cases.shown(each) for each in made.frames), "reference"]
            found[f"{name}, {view.scale}"] = snr
    return pictures.grid(heads, rows), found


def main() -> None:
    options = timing.arguments(__doc__, "folder", side=128, passes=256, results=None)
    mipnet_network.register()
    side, passes = options.side, options.passes
    leather = example(EXAMPLES[0], "ggx")
    lobes = {f"generated lobes {seed}": results_sets.captured(seed, 256) for seed in range(2)}
    beckmann = {name: example(name, "beckmann") for name in EXAMPLES[:1]} | lobes
    makers: Mapping[int, Callable[[], tuple[Image.Image, object]]] = {
        3: lambda: (augmentations(), None),
        4: lambda: temporal(leather, side, passes),
        6: lambda: moved(leather, side, passes),
        8: lambda: apparent(example(MANY_LOBES, "ggx"), side),
        9: lambda: overview(beckmann, side, passes),
        10: lambda: overview({name: example(name, "ggx") for name in EXAMPLES}, side, passes),
        11: lambda: overview({"together": results_sets.correlated(0, 256, True)}, side, passes),
    }
    found = {}
    for figure, make in makers.items():
        image, figures = make()
        image.save(options.folder / f"paper-figure-{figure}.webp", quality=90, method=6)
        if figures is not None:
            found[str(figure)] = figures
        print(f"figure {figure}", flush=True)
    timing.keep(found, options.results)


if __name__ == "__main__":
    main()
