"""What is compared: stacks of every method, baked from one set or opened, each with the name that tables call it."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.methods import METHODS, OPTIONS
from mipbake.baking.neural import Neural
from mipbake.baking.pipeline import DEFAULT_METHOD, Recipe
from mipbake.base.device import checked_device
from mipbake.base.errors import OutputError, UsageError
from mipbake.base.names import known_name
from mipbake.base.publish import reason, temporary_folder
from mipbake.base.timings import PhaseProgress
from mipbake.material import model_named
from mipbake.material.aim import checked_aim
from mipbake.material.pixel_filter import FILTERS, level_sizes
from mipbake.quality.figures import Candidate, Method
from mipbake.source.texture_set import TextureSet
from mipbake.stack.stack import MipStack

ORIGIN_KERNEL = "box"
"""The averaging kernel that closed forms have where they come from: engines and their tools."""

MEMORY_LIMIT = 1 << 30
"""Bytes of levels that stay in memory; where all levels together need more, they are kept in files."""

_LEAST_FILE = 1 << 20  # bytes; smaller levels stay in memory


def closed_forms(pixel_filter: str) -> tuple[tuple[str, str], ...]:
    """Method and averaging kernel of every closed form: each with the box of its origin, and with the pixel filter."""
    kernels = tuple(dict.fromkeys((ORIGIN_KERNEL, pixel_filter)))
    return tuple((name, kernel) for name, method in METHODS.items() if method.averages for kernel in kernels)


def label(method: str, kernel: str) -> str:
    """What a method is called: `neural`; a closed form with its averaging kernel, `linear (box)`."""
    return f"{method} ({kernel})" if METHODS[method].averages else method


def chosen(names: Sequence[str], pixel_filter: str) -> dict[str, tuple[str, str]]:
    """Label to method and kernel of what is named, in that order, each once.

    Args:
        names: methods (`lean`), which stand for all of their forms, or labels: of a closed form with any kernel of
            `mipbake.material.pixel_filter.FILTERS` (`lean (box)`).
        pixel_filter: the filter that the stacks are for.

    Raises:
        UsageError: a name that is neither.
    """
    forms = closed_forms(pixel_filter)
    usual = {label(*each): each for each in forms}
    possible = {label(method, kernel): (method, kernel) for method, _ in forms for kernel in FILTERS}
    wanted: dict[str, tuple[str, str]] = {}
    for name in names:
        if (label_of := name.lower()) in possible:
            wanted[label_of] = possible[label_of]
            continue
        method = known_name("method", name, METHODS, f", or one with its kernel, such as {next(iter(usual))!r}")
        if METHODS[method].averages:
            wanted |= {key: form for key, form in usual.items() if form[0] == method}
        else:
            wanted[method] = (method, pixel_filter)
    return wanted


def default_names(
    source: str, model: str, pixel_filter: str, opened: bool = False
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What a comparison bakes when nobody names methods: what `bake` makes by default, unless a stack was opened,
    neural, where it has weights, and all closed forms.

    Returns:
        Labels, and notes: sentences that say what had to be left out.
    """
    notes: tuple[str, ...] = ()
    try:
        Neural().weights(model, pixel_filter, source)
    except UsageError as error:
        notes = (f"{Neural.name} was left out: {error}.",)
    learned = () if notes else (Neural.name,)
    default = () if opened else (DEFAULT_METHOD,)
    return (*default, *learned, *(label(*each) for each in closed_forms(pixel_filter))), notes


@contextmanager
def bake_all(
    texture_set: TextureSet,
    recipe: Recipe,
    names: Sequence[str],
    progress: PhaseProgress = lambda _phase, _share: None,
    memory_limit: int = MEMORY_LIMIT,
    folder: Path | None = None,
) -> Iterator[list[Candidate]]:
    """The stacks of many methods, each with how long its bake took: `with bake_all(...) as candidates`.

    Where the levels of all candidates together need more than `memory_limit` bytes, they lie in temporary files, mapped
    into memory and read as they are needed. The files are removed at the end: the candidates are of no use after it.

    Args:
        texture_set: the source.
        recipe: what the stacks are for. Each method takes of it what it can.
        names: labels or methods, as in `chosen`.
        memory_limit: in bytes.
        folder: where the temporary files go; None for the system's folder of such.

    Raises:
        UsageError: an unknown name, model or pixel filter, or a method that does not have them.
        OutputError: the temporary files cannot be written.
    """
    model = recipe.model(texture_set)
    wanted = chosen(names, recipe.pixel_filter)
    source = texture_set.source_model
    stored = texture_set.material(source)
    texels = sum(height * width for height, width in level_sizes(*stored.shape[:2]))
    needed = len(wanted) * texels * model_named(model).channels * np.dtype(np.float32).itemsize
    with temporary_folder(folder) if needed > memory_limit else nullcontext() as place:
        candidates = []
        for index, (name, (method, kernel)) in enumerate(wanted.items()):

            def tell(share: float, done: int = index) -> None:
                if done + share < len(wanted):
                    progress("bake", (done + share) / len(wanted))

            start = time.perf_counter()
            prefilter = recipe.by(method, kernel).prefilter()
            result = prefilter(stored, source, model, kernel, texture_set.wrap, tell)
            seconds = time.perf_counter() - start
            made = Method(name, method, kernel, model, seconds, sampler=result.sampler, aim=result.aim)
            levels = [_mapped(level, place) for level in result.levels] if place else result.levels
            candidates.append(Candidate(made, levels))
            del result
        progress("bake", 1.0)
        yield candidates


def _mapped(level: NDArray[np.float32], folder: Path) -> NDArray[np.float32]:
    """A level as it lies in a file, mapped into memory; small levels stay as they are."""
    if level.nbytes < _LEAST_FILE:
        return level
    path = folder / f"{len(list(folder.iterdir()))}.npy"
    level = np.ascontiguousarray(level)
    try:
        with path.open("wb") as file:  # np.save does not say why it could not write
            np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(level))
            file.write(level.data)
        mapped: NDArray[np.float32] = np.load(path, mmap_mode="r")
    except OSError as error:
        raise OutputError(
            f"{path}: {level.nbytes >> 20} MiB of temporary levels cannot be written ({reason(error)}); "
            "or set TMPDIR to a folder on a larger disk, or compare fewer methods"
        ) from error
    return mapped


def check_options(methods: Iterable[str], recipe: Recipe) -> None:
    """UsageError where a recipe has an aim or a device that is none, or that none of the methods takes."""
    if recipe.aim is not None:
        checked_aim(recipe.aim)
    if recipe.device is not None:
        checked_device(recipe.device)
    names = set(methods)
    for option, what, value in (("aim", "an aim", recipe.aim), ("device", "a device", recipe.device)):
        if value is not None and not names & set(OPTIONS[option]):
            raise UsageError(
                f"no method that is baked takes {what}: leave it out, or name one of {', '.join(OPTIONS[option])}"
            )


def mismatch(stack: MipStack, texture_set: TextureSet) -> str | None:
    """A sentence for readers where a stack was not baked from this texture set, else None."""
    if stack.provenance.source_hash == texture_set.source_hash:
        return None
    sentence = "the stack was not baked from this texture set (source hashes differ): its figures mean little"
    height, width = stack.size
    if (width, height) != (texture_set.width, texture_set.height):
        sentence += f"; it measures {width} x {height}, and the set measures {texture_set.width} x {texture_set.height}"
    return f"{sentence}."
