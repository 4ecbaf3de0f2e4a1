"""The list of records: what each holds, and how it is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

MATERIALS, OUT, WORK = "{materials}", "{out}", "{work}"
"""Places in a command: the folder of real texture sets, the file that it writes, and a folder that a stopped run
goes on in."""

EXAMPLES = ("fitting", "stochastic")
"""Folders of examples whose scripts write a figure's JSON and picture; records are named after folder and JSON."""

FITTED = ("acg_metal007", "acg_diamondplate008c", "acg_fabric079", "acg_tiles136c", "acg_leather036b")
"""Sets that fits are measured on."""


@dataclass(frozen=True)
class Known:
    """A record that there is, or shall be.

    Args:
        about: what it holds.
        command: measures it, as arguments of the interpreter; it writes JSON to OUT, or prints Markdown where
            there is no OUT.
        golden: whether its figures are outputs of the code; not so for records of time, and of trainings.
        pictures: the folder that takes the pictures which the command leaves in WORK; none where it is empty.
    """

    about: str
    command: Sequence[str]
    golden: bool = True
    pictures: str = ""


def _measured(about: str, script: str, *arguments: str, golden: bool = True, pictures: str = "") -> Known:
    return Known(about, (script, *arguments, "--results", OUT), golden, pictures)


def _results(kind: str, about: str, *more: str) -> Known:
    return Known(about, ("benchmarks/results.py", MATERIALS, WORK, "--kinds", kind, *more))


def _example(folder: str, name: str, about: str, *options: str) -> Known:
    script = f"examples/{folder}/{name}.py"
    return Known(about, (script, "--output", WORK, *options), pictures=f"examples/{folder}/results")


def _timing(script: str, about: str, *options: str) -> Known:
    return Known(about, (f"benchmarks/{script}.py", *options), golden=False)


_BASELINES = ("--weights", "benchmarks/baselines", "--without", "paper-cross")

KNOWN: Mapping[str, Known] = {
    "results-whole": _results("whole", "every method on whole test sets, every measure"),
    "results-crop": _results("crop", "the middle of test sets beside its optimum"),
    "results-directional": _results("directional", "the anisotropic target on sets with directional bumps"),
    "results-models": _results("models", "the paper's material models and networks", *_BASELINES),
    "results-correlated": _results("correlated", "channels that go together, and twins", *_BASELINES),
    "films": _measured(
        "what people see: films of test sets, every method, two samplers, with accumulation and without",
        "benchmarks/films.py", MATERIALS, WORK,
    ),
    "aims": _measured(
        "what --aim moves, and how far the limit of the visible error is, on small parts of test sets",
        "benchmarks/aims.py", MATERIALS,
    ),
    "picture": _measured("SNR of the spheres in docs/scales.png", "docs/make_picture.py", WORK, pictures="docs"),
    "animation": _measured("flicker and SNR of docs/shimmer.webp", "docs/make_animation.py", WORK, pictures="docs"),
    "figure-7": _measured(
        "one material in every model, with its pictures", "docs/make_figure_7.py", WORK, pictures="docs"
    ),
    "paper-pictures": _measured(
        "the pictures of the paper's figures, with their figures", "docs/make_paper_pictures.py", WORK, pictures="docs"
    ),
    "constant-materials": _measured(
        "what networks make of materials that are the same everywhere", "benchmarks/constant_materials.py", MATERIALS
    ),
    "cards": _measured("released networks beside averages, on held-out patches", "benchmarks/cards.py", MATERIALS),
    "beckmann": _measured("what conversions between ggx and beckmann keep", "docs/fit_beckmann.py"),
    "fitting-earth": _example("fitting", "earth", "a planet's texture from views"),
    "fitting-cube": _example("fitting", "cube", "corners and colours of a cube"),
    "fitting-envphong": _example("fitting", "envphong", "an environment and a highlight"),
    "fitting-capture": _example("fitting", "capture", "a surface that moves, and its texture"),
    "fitting-pose": _example("fitting", "pose", "the pose of a cube"),
    "stochastic-surface": _example("stochastic", "surface", "a subdivision surface and its maps"),
    "stochastic-surface-physical": _example(
        "stochastic", "surface", "the same with maps of albedo, metallic and roughness", "--physical"
    ),
    "stochastic-mesh": _example("stochastic", "mesh", "a mesh and a map, beside exact gradients"),
    "stochastic-pose": _example("stochastic", "pose", "poses of an object and of a camera"),
    "stochastic-splats": _example("stochastic", "splats", "splats that are split where pictures are wrong"),
    "stochastic-volume": _example("stochastic", "volume", "a volume of smoke, beside exact gradients"),
    "fit": _measured(
        "stacks that were fitted in renderers, beside bakes",
        "benchmarks/fit.py", MATERIALS, WORK, "--sets", *FITTED, pictures="docs",
    ),
    "fit-slow": _measured(
        "what a fit gains in a renderer of 50 ms a frame, by the minutes that it has taken",
        "benchmarks/fit_slow.py", MATERIALS, "--measured", "6", "--passes", "24", golden=False,
    ),
    "delivered": _measured("what the files of presets cost", "benchmarks/delivered.py", MATERIALS),
    "engines-three": _measured(
        "levels in three.js, supersampled by itself", "benchmarks/engines/three_proof.py", MATERIALS
    ),
    "gallery": _measured(
        "sets that shimmer, filmed in three.js", "benchmarks/engines/three_gallery.py", WORK, pictures="docs"
    ),
    "engines-cycles": _measured("level 0 in Cycles", "benchmarks/engines/cycles_proof.py", MATERIALS),
    "weights": Known("what each weight of the judge does, halved and doubled", ("benchmarks/weights.py", MATERIALS)),
    "training-mipnet": _measured(
        "what becomes of MIPNet under the paper's loss",
        "benchmarks/mipnet.py", "train", "--target", "ggx", "--like", "training/configs/paper-ggx.toml",
        "--steps", "12000", "--data", MATERIALS, "--out", WORK, "--resume", golden=False,
    ),
    "stability": _measured(
        "levels of an averaged latent beside levels that are made one after the other, five seeds",
        "benchmarks/stability.py", golden=False,
    ),
    "causes": _measured(
        "sharp materials, shift-tolerant LPIPS and twins with sharp lobes: why the paper's figures come out otherwise",
        "benchmarks/causes.py", MATERIALS,
    ),
    "mipnet-losses": _measured(
        "MIPNet trained with its authors' loss and the paper's, clean and noisy references",
        "benchmarks/mipnet_losses.py", MATERIALS, golden=False,
    ),
    "web": _measured("the npm package beside the native core", "benchmarks/web.py", golden=False),
    "library": _measured(
        "a library that is baked, killed again and again, and gone on with", "benchmarks/library.py", golden=False
    ),
    "throughput": _measured(
        "sets an hour by size, method, format and processes, beside maketx", "benchmarks/throughput.py", golden=False
    ),
    "throughput-large": _measured(
        "the same of large sets", "benchmarks/throughput.py", "--sizes", "4096", golden=False
    ),
    "timing-shading": _timing("shading", "the shading kernel beside torch"),
    "timing-training-step": _timing("training_step", "one step at the paper's settings"),
    "timing-bake": _timing("bake", "whole processes"),
    "timing-texture": _timing("texture", "texture lookups beside torch's"),
    "timing-raster": _timing("raster", "rasterize, interpolate, antialias"),
    "timing-card": _timing("card", "a graphics card beside the processor of its machine"),
    "timing-card-texture": _timing("texture", "texture lookups on a graphics card", "--device", "cuda"),
    "timing-card-raster": _timing("raster", "rasterize, interpolate, antialias on a graphics card", "--device", "cuda"),
    "timing-stochastic": _timing("stochastic", "soups by stochastic gradients"),
    "timing-stochastic-many": _timing(
        "stochastic", "a soup of the paper's size, by estimates for each step", "--many", "10240"
    ),
}  # fmt: skip
"""Name to what it is. Those that nobody has measured yet have no file."""
