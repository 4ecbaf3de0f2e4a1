"""The list of records: what each holds, and how it is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

MATERIALS, OUT, WORK = "{materials}", "{out}", "{work}"
"""Places in a command: the folder of real texture sets, the file that it writes, and a folder that a stopped run
goes on in."""

FITTED = ("acg_metal007", "acg_diamondplate008c", "acg_fabric079", "acg_tiles136c", "acg_leather036b")
"""Sets that fits are measured on."""

FIT_OPTIONS = (
    *("--renderers", "gl clearcoat", "gl ramp", "three physical"),
    *("--size", "256", "--repeat", "1"),
    *("--steps", "4000", "--each", "8", "--witnesses", "8", "--passes", "64"),
)
"""What can be measured in an hour."""


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


def _results(kind: str, about: str, baselines: bool = False) -> Known:
    more = ("--weights", "benchmarks/baselines", "--without", "paper-cross") if baselines else ()
    return Known(about, ("benchmarks/results.py", MATERIALS, WORK, "--kinds", kind, *more))


def _fitting(name: str, about: str) -> Known:
    script = f"examples/fitting/{name}.py"
    return Known(about, (script, "--output", WORK), pictures="examples/fitting/results")


def _timing(script: str, about: str, *options: str) -> Known:
    return Known(about, (f"benchmarks/{script}.py", *options), golden=False)


def _measured(script: str, about: str, *options: str) -> Known:
    return Known(about, (f"benchmarks/{script}.py", "--results", OUT, *options), golden=False)


KNOWN: Mapping[str, Known] = {
    "results-whole": _results("whole", "every method on whole test sets, every measure"),
    "results-crop": _results("crop", "the middle of test sets beside its optimum"),
    "results-directional": _results("directional", "the anisotropic target on sets with directional bumps"),
    "results-filters": _results("filters", "default networks of all targets under all pixel filters"),
    "results-models": _results("models", "the paper's material models and networks", True),
    "results-correlated": _results("correlated", "channels that go together, and twins", True),
    "films": Known(
        "what people see: films of test sets, every method, two samplers, with accumulation and without",
        ("benchmarks/films.py", MATERIALS, WORK, "--results", OUT),
    ),
    "aims": Known(
        "what --aim moves, and how far the limit of what is seen is, on small parts of test sets",
        ("benchmarks/aims.py", MATERIALS, OUT),
    ),
    "picture": Known(
        "SNR of the spheres in docs/scales.png",
        ("docs/make_picture.py", f"{WORK}/scales.png", "--figures", OUT),
        pictures="docs",
    ),
    "animation": Known(
        "flicker and SNR of docs/shimmer.webp",
        ("docs/make_animation.py", f"{WORK}/shimmer.webp", "--figures", OUT),
        pictures="docs",
    ),
    "failure": Known(
        "SNR of every method on examples/knurled_plate",
        ("docs/make_failure_table.py", OUT),
    ),
    "figure-7": Known(
        "one material in every model, with its pictures",
        ("docs/make_figure_7.py", f"{WORK}/figure-7.md", "--figures", OUT),
        pictures="docs",
    ),
    "paper-pictures": Known(
        "the pictures of the paper's figures, with their figures",
        ("docs/make_paper_pictures.py", WORK, "--figures", OUT),
        pictures="docs",
    ),
    "constant-materials": Known(
        "what networks make of materials that are the same everywhere",
        ("benchmarks/constant_materials.py", MATERIALS, "--results", OUT),
    ),
    "beckmann": Known(
        "what conversions between ggx and beckmann keep",
        ("docs/fit_beckmann.py", OUT),
    ),
    "fitting-earth": _fitting("earth", "a planet's texture from views"),
    "fitting-cube": _fitting("cube", "corners and colours of a cube"),
    "fitting-envphong": _fitting("envphong", "an environment and a highlight"),
    "fitting-pose": _fitting("pose", "the pose of a cube"),
    "fit": Known(
        "stacks that were fitted in renderers, beside bakes",
        ("benchmarks/fit.py", "--materials", MATERIALS, *FITTED, "--results", OUT, "--pictures", WORK, *FIT_OPTIONS),
        pictures="docs",
    ),
    "commands": Known(
        "every command on every set: exit codes, time, memory, what files cost",
        ("benchmarks/commands.py", MATERIALS, "--results", OUT),
        golden=False,
    ),
    "uastc": Known(
        "what the textures of GLB files cost",
        ("benchmarks/uastc.py", MATERIALS, WORK, "--results", OUT),
    ),
    "engines-three": Known(
        "levels in three.js, supersampled by itself",
        ("benchmarks/engines/three_proof.py", MATERIALS, "--results", OUT),
    ),
    "engines-cycles": Known(
        "level 0 in Cycles",
        ("benchmarks/engines/cycles_proof.py", MATERIALS, "--results", OUT),
    ),
    "weights": Known(
        "what each weight of the judge does, halved and doubled",
        ("benchmarks/weights.py", MATERIALS),
    ),
    "training-mipnet": Known(
        "what becomes of MIPNet under the paper's loss",
        (
            *("benchmarks/mipnet.py", "train", "--target", "ggx", "--like", "training/configs/paper-ggx.toml"),
            *("--steps", "12000", "--data", MATERIALS, "--out", WORK, "--resume", "--results", OUT),
        ),
        golden=False,
    ),
    "timing-fit-whole": Known(
        "a fit of 512 x 512 texels, with the preparation of its views",
        (
            *("benchmarks/fit.py", "--materials", MATERIALS, FITTED[0], "--results", f"{WORK}/fit.json"),
            *("--renderers", "gl clearcoat", "--size", "512", "--repeat", "1", "--steps", "8000"),
        ),
        golden=False,
    ),
    "library": _measured("library", "a library that is baked, killed again and again, and gone on with"),
    "throughput": _measured("throughput", "sets an hour by size, method, format and processes, beside maketx"),
    "throughput-large": _measured(
        "throughput", "the same of large sets, and what one takes, part by part", "--sizes", "4096", "--parts"
    ),
    "soak": _measured("soak", "many small sets in one process: memory, open files, threads, time"),
    "timing-fit": _timing("fit_cost", "what a step of a fit costs, by its parts"),
    "timing-shading": _timing("shading", "the shading kernel beside torch"),
    "timing-training-step": _timing("training_step", "one step at the paper's settings"),
    "timing-bake": _timing("bake", "whole processes"),
    "timing-network": _timing("network", "the network of a bake in the native core"),
    "timing-texture": _timing("texture", "texture lookups beside torch's"),
    "timing-raster": _timing("raster", "rasterize, interpolate, antialias"),
    "timing-card": _timing("card", "a graphics card beside the processor of its machine"),
    "timing-card-texture": _timing("texture", "texture lookups on a graphics card", "--device", "cuda"),
    "timing-card-raster": _timing("raster", "rasterize, interpolate, antialias on a graphics card", "--device", "cuda"),
    "timing-render": _timing("render", "renders of meshes"),
    "timing-stochastic": _timing("stochastic", "soups and meshes by stochastic gradients", "--clock", "processor"),
}
"""Name to what it is. Those that nobody has measured yet have no file."""
