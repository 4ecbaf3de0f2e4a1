"""Words of the glossary that other things were called by, too: each stands only where the glossary's meaning is meant.

A program cannot read meanings. It can see where a word stands, what is named by it, and of which type that is: a place,
a name or a type that is new fails here, and whoever adds it to the list has looked the word up in docs/glossary.md.
"""

from __future__ import annotations

import ast
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = {"mipbake": "mipbake", "cli": "mipbake.cli", "models": "mipbake.models", "training": "mipbake.training"}

ARRAYS = r"(Array|Image|Tensor|Texels|Bytes|NDArray\[.+\])( \| None)?"
"""One array, as the package writes its types."""


@dataclass(frozen=True)
class Word:
    """Where a word of the glossary may stand.

    Args:
        places: files, and folders with a stroke at the end, in whose code, strings and comments it stands; None for
            everywhere.
        names: public modules, classes and functions that are named by it, below `mipbake`.
        types: what an argument or a field is that is called so, one or many: patterns of annotations.
        phrases: what it never stands in.
    """

    places: tuple[str, ...] | None
    names: tuple[str, ...]
    types: tuple[str, ...]
    phrases: str = "(?!)"


WORDS = {
    # Time that the user gives.
    "budget": Word(
        places=(
            *("mipbake/bake.py", "mipbake/baking/", "mipbake/content.py", "mipbake/prefilter/__init__.py"),
            *("mipbake/prefilter/promise.py", "mipbake/prefilter/search/methods.py", "cli/bake.py"),
            *("mipbake/prefilter/search/time_budget.py", "mipbake/prefilter/search/descent_effort.py"),
            *("mipbake/prefilter/search/forecast.py", "mipbake/prefilter/search/stages.py"),
            *("mipbake/fitting/fitting.py", "mipbake/fitting/loop.py", "mipbake/fitting/shared.py", "cli/fit.py"),
        ),
        names=("prefilter.search.time_budget",),
        types=(r"str( \| None)?", r"float \| None"),  # as users write it, and seconds
        phrases=r"budget of (rounds|pairs|samples|passes)",
    ),
    # Rounds, pairs, points and samples. Encoders of UASTC have an effort of their own, which is their option's name.
    "effort": Word(
        places=(
            *("mipbake/compare/", "mipbake/judging/", "mipbake/prefilter/search/", "mipbake/validate.py", "training/"),
            "mipbake/io/uastc.py",
        ),
        names=(
            *("compare.texture_space.MeasureEffort", "judging.probes.ProbeEffort", "prefilter.search.descent_effort"),
            *("prefilter.search.descent_effort.DescentEffort", "training.validation.ValidationEffort"),
        ),
        types=(r"(Measure|Probe|Descent|Validation)Effort( \| None)?",),
        phrases=r"effort of (time|seconds|minutes)",
    ),
    # What an engine shows of a stack.
    "candidate": Word(
        places=(
            *("mipbake/compare/", "mipbake/metrics/", "mipbake/render/", "mipbake/report/page/", "mipbake/validate.py"),
            *("cli/compare.py", "training/validation.py", "mipbake/fitting/kernels.py"),
        ),
        names=(
            *("compare.candidates", "compare.candidates.Candidate", "compare.turning.Turning.candidate"),
            *("render.film.film_candidate", "render.mesh_render.candidate", "render.texture_space.candidate"),
        ),
        types=(r"(Sequence\[)?(Candidate|Frame)\]?", "ImageArray", ARRAYS),
    ),
    # The material model of a stack. Documents and threads have targets of their own, which are other formats' names;
    # `target_samples` is a name in training configurations.
    "target": Word(
        places=(
            *("mipbake/bake.py", "mipbake/baking/", "mipbake/compare/", "mipbake/convert.py", "mipbake/output.py"),
            *("mipbake/presets.py", "mipbake/stack.py", "mipbake/material/models.py", "mipbake/judging/scores.py"),
            *("mipbake/prefilter/", "mipbake/reference/problem.py", "cli/", "models/"),
            *("mipbake/io/gltf/quad.py", "mipbake/io/gltf/uses.py", "mipbake/io/mtlx/document.py"),
            *("mipbake/render/mesh_gltf.py", "training/drawing.py", "training/loss.py"),
            "mipbake/fitting/three_page/",  # of a thread
        ),
        names=(
            *("bake.resolve_target", "presets.Preset.target", "models.architecture.Architecture.targets"),
            "models.registry.WeightsInfo.targets",
        ),
        types=(r"str( \| None)?",),
        phrases=r"(estimated|noisy|rendered) target|target (folder|file|path|render)",
    ),
    # What an ideal renderer shows of the source; and the plain twins, which are called `reference.py`.
    "reference": Word(
        places=(
            *("mipbake/compare/", "mipbake/judging/", "mipbake/metrics/", "mipbake/prefilter/", "mipbake/reference/"),
            *("mipbake/render/", "mipbake/report/", "mipbake/validate.py", "cli/compare.py", "cli/validate.py"),
            *("training/", "mipbake/raster/", "mipbake/sampling/", "mipbake/shading/"),
            *("mipbake/fitting/", "mipbake/stochastic/", "cli/fit.py"),
        ),
        names=(
            *("compare.turning.Turning.reference", "reference"),
            "render.small_pictures.SmallPictures.reference",
            *("reference.estimate.reference", "render.mesh_render.Reference", "render.mesh_render.reference"),
            *("training.loss.draw_noisy_reference", "raster.reference", "sampling.reference", "shading.reference"),
            "stochastic.reference",
            *("compare.film_figures.ShownReference", "render.film.FilmReference", "render.film.film_reference"),
            *("render.film.FilmSampling.reference", "render.mesh_render.reference_key"),
        ),
        types=("Reference", "FilmReference", r"References( \| None)?", "ImageArray", ARRAYS),
        phrases=r"references? (to|from) (a|an|the) (texture|image|buffer|file)",
    ),
    # One direction of light and one of view, never two of anything else.
    "pair": Word(
        places=(
            *("mipbake/compare/", "mipbake/judging/", "mipbake/metrics/", "mipbake/prefilter/", "mipbake/reference/"),
            *("mipbake/render/texture_space.py", "mipbake/report/page/"),
            *("mipbake/shading/", "mipbake/validate.py"),
            *("mipbake/material/beckmann.py", "cli/bake_output.py", "cli/compare.py", "cli/validate.py", "training/"),
        ),
        names=(
            *("judging.pairs", "judging.pairs.draw_pairs", "metrics.pairs", "metrics.pairs.LightViewPairs"),
            *("metrics.pairs.pair_set", "prefilter.search.pair_weights", "prefilter.search.pair_weights.PairWeights"),
            *("prefilter.search.pair_weights.PairWeights.pairs", "prefilter.search.pixel_samples.own_pairs"),
            *("prefilter.search.pixel_samples.common_pairs", "reference.lighting.GroupPairs"),
            *("reference.lighting.PixelPairs", "reference.lighting.common_pairs", "training.balanced_pairs"),
            *("training.balanced_pairs.Pairs", "training.balanced_pairs.draw_pairs"),
            *("training.balanced_loss.BalancedLossConfig.pairs", "training.base.Loss.pairs"),
            "training.loss.SingleLightsLossConfig.mirror_pairs",
        ),
        types=("LightViewPairs", "Pairs", "int"),
        phrases=r"\b(a|the same|each|every|this) pair of (?!directions\b)|pairs of (levels|corners|images|estimates)\b",
    ),
    # The images of one size in a stack: a number, an image, or the images of all sizes.
    "level": Word(
        places=None,
        names=(
            *("baking.options.Asked.level_count", "io.gpu_format.GpuFormat.level_size", "io.gpu_format.level_size"),
            *("io.map_files.quantised_levels", "io.oiio_levels", "judging.probes.Probe.levels"),
            *("judging.scores.between_levels", "models.latent_inference.bake_levels", "pixel_filter.level_sizes"),
            *("models.latent_baker.LatentBaker.levels", "models.level_filter", "models.lookup_kernel.periodic_levels"),
            *("models.moment_baker.MomentBaker.levels", "models.moment_inference.bake_levels"),
            *("pixel_filter.filtered_levels", "prefilter.promise.LevelPromise", "prefilter.search.level_fit"),
            *("prefilter.search.ingredients.Bench.levels", "prefilter.search.level_fit.fit_level"),
            *("prefilter.search.pixel_samples.levels_seen", "render.samplers.level_of_detail"),
            *("compare.file_levels", "compare.file_levels.WrittenLevels", "compare.file_levels.written_levels"),
            *("io.map_files.RoundedLevels", "io.map_files.StoredLevels", "io.read_back.whole_levels"),
            "training.picture_loss.plain_levels",
            *("fitting.renderer.Levels", "fitting.parameters.Parameters.levels", "fitting.loop.Loop.levels_of"),
            "fitting.loop.Loop.levels_with",
            *("fitting.prepared.Prepared.levels", "fitting.prepared.scores_of_levels", "fitting.starts.Starts.levels"),
            *("nvdiffrast.log.get_log_level", "nvdiffrast.log.set_log_level"),  # names that nvdiffrast chose
        ),
        types=(
            *(r"int( \| None)?", "range", ARRAYS, "Levels", rf"(Sequence|list)\[{ARRAYS}\]", r"tuple\[Any, \.\.\.\]"),
            *(r"tuple\[(bytes|LevelPromise|tuple\[int, int\]), \.\.\.\]",),
        ),
        phrases=r"level of (compression|effort|quality|verbosity|logging)",
    ),
}


def words(text: str) -> set[str]:
    """The words of a name or a text in small letters, without the s of many."""
    return {each.lower().removesuffix("s") for each in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", text)}


@cache
def files() -> dict[str, Path]:
    """Path from the root to every Python file of the package."""
    found = (path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py")))
    return {path.relative_to(ROOT).as_posix(): path for path in found}


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def said(path: Path) -> tuple[tuple[int, str], ...]:
    """Line and text of every name, string and comment, line breaks as blanks."""
    with path.open("rb") as file:
        return tuple(
            (token.start[0], " ".join(token.string.split()))
            for token in tokenize.tokenize(file.readline)
            if token.type in (tokenize.NAME, tokenize.COMMENT) or "STRING" in tokenize.tok_name[token.type]
        )


def module(name: str) -> str:
    """`prefilter.search.stages`: what a file is below `mipbake`."""
    folder, _, rest = name.removesuffix(".py").removesuffix("/__init__").partition("/")
    return ".".join(filter(None, (*FOLDERS[folder].split(".")[1:], *rest.split("/"))))


def definitions(body: list[ast.stmt], above: str) -> Iterator[str]:
    """Dotted names of public classes, functions and methods."""
    for node in body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            yield f"{above}.{node.name}"
            if isinstance(node, ast.ClassDef):
                yield from definitions(node.body, f"{above}.{node.name}")


def public_names() -> set[str]:
    out = set()
    for name, path in files().items():
        if not any(part.startswith("_") for part in module(name).split(".")):
            out |= {module(name), *definitions(tree(path).body, module(name))}
    return out


def annotations(path: Path) -> Iterator[tuple[int, str, str]]:
    """Line, name and type of every argument and field; of an option the type that it has in Python."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.arg) and node.annotation is not None:
            name, kind = node.arg, node.annotation
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            name, kind = node.target.id, node.annotation
        else:
            continue
        if isinstance(kind, ast.Subscript) and ast.unparse(kind.value) == "Annotated":
            assert isinstance(kind.slice, ast.Tuple)
            kind = kind.slice.elts[0]
        yield node.lineno, name, re.sub(r"Optional\[(.+)\]", r"\1 | None", ast.unparse(kind))


def test_the_glossary_has_them() -> None:
    terms = re.findall(r"^\| (\w+)", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(WORDS) <= set(terms)


@pytest.mark.parametrize("word", [word for word, each in WORDS.items() if each.places is not None])
def test_words_stand_only_where_their_meaning_is_needed(word: str) -> None:
    places = WORDS[word].places or ()
    found = {name for name, path in files().items() if any(word in words(text) for _, text in said(path))}
    assert {name for name in found if not name.startswith(places)} == set()
    assert {place for place in places if not any(name.startswith(place) for name in found)} == set()


@pytest.mark.parametrize("word", WORDS)
def test_what_is_named_by_a_word_has_its_meaning(word: str) -> None:
    assert {name for name in public_names() if word in words(name.rpartition(".")[2])} == set(WORDS[word].names)


@pytest.mark.parametrize("word", WORDS)
def test_what_is_called_by_a_word_has_the_type_of_its_meaning(word: str) -> None:
    allowed = re.compile("|".join(WORDS[word].types))
    other = [
        f"{name}:{line}: {called}: {kind}"
        for name, path in files().items()
        for line, called, kind in annotations(path)
        if called in (word, f"{word}s") and not allowed.fullmatch(kind)
    ]
    assert not other, "\n".join(other)


@pytest.mark.parametrize("word", WORDS)
def test_words_are_not_used_for_other_things(word: str) -> None:
    never = re.compile(WORDS[word].phrases)
    found = [
        f"{name}:{line}: {text}" for name, path in files().items() for line, text in said(path) if never.search(text)
    ]
    assert not found, "\n".join(found)
