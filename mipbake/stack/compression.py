"""What files cost: the error of rounding and compression, in every map and in what is shaded, and the texels that keep
it small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import ceil
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.quality.figures import Candidate
from mipbake.quality.metrics import PAIR_SETS
from mipbake.quality.texture_space import MeasureEffort, measure
from mipbake.source.layout import ENCODINGS, to_file
from mipbake.source.opacity import coverage
from mipbake.source.texture_set import TextureSet
from mipbake.stack.containers import FORMATS, Container
from mipbake.stack.costs import LIMIT, Cost, Coverage
from mipbake.stack.file_levels import stored_channels, written_levels
from mipbake.stack.gltf.ranges import Ranges
from mipbake.stack.map_files import GivenBack, MadeLevels, MapFile, quantised_levels, row_blocks, stood_for
from mipbake.stack.output import Output
from mipbake.stack.stack import MipStack
from mipbake.stack.written import measure_written, opened

Progress: TypeAlias = Callable[[float], None]
"""Gets the finished share, from 0 to 1."""

LODS: tuple[float, ...] = (0.0, 1.0, 3.0)
"""Levels of detail that the loss is measured at; the loss is the fall of their mean SNR."""

_COVERAGE_SIDE = 8
"""Texels along a side of a level; in smaller levels every texel is a great share."""

_POINTS, _SAMPLES, _SEED = 8192, 16, 11
"""Losses hang on the few points that shine. From 1,024 points, the order of variants changed from draw to draw on
polished tiles; from 8,192 it stays, for little more time. That was measured, and no record holds it. The samples are
a guess, and the last number is the seed."""


def part_of(progress: Progress, index: int, count: int) -> Progress:
    """Progress of one of several pieces of work that are as long as each other."""
    return lambda share: progress((index + share) / count)


def chosen_all(
    texture_set: TextureSet, stack: MipStack, outputs: Sequence[Output], progress: Progress = lambda _share: None
) -> tuple[Output, ...]:
    """`chosen` for several outputs; `ktx2` and `dds` of the same packing hold the same blocks, and choose once."""
    made: list[Output] = []
    for index, output in enumerate(outputs):
        alike = [
            (given, choice)
            for given, choice in zip(outputs, made, strict=False)
            if len(_ladder(output)) > 1
            and _ladder(given) == _ladder(output)
            and replace(given, format=output.format) == output
        ]
        here = part_of(progress, index, len(outputs))
        choice = replace(alike[0][1], format=output.format) if alike else chosen(texture_set, stack, output, here)
        made.append(choice)
    progress(1.0)
    return tuple(made)


def chosen(
    texture_set: TextureSet,
    stack: MipStack,
    output: Output,
    progress: Progress = lambda _share: None,
    ranges: Ranges = Ranges(),  # noqa: B008
) -> Output:
    """An output with texels for every file, as small as the loss allows: of `ktx2` or `dds`, or with `finer` texels.

    Every file is compressed alone to see how much error it brings. Beginning with the smallest everywhere, the file
    that brings the most gets better texels until the sum is below `LIMIT`. Other outputs are given back as they are.

    Args:
        texture_set: that the stack was baked from, nothing in it hidden (`mipbake.source.opacity.shown`).
        ranges: what a material multiplies the values in the files by.
    """
    ladder = _ladder(output)
    if len(ladder) < 2:
        return output
    kinds = FORMATS[output.container.name]
    files = [file for file in stack.files(output) if file.layout.shades and file.container.texels in ladder]
    first = [ladder.index(file.container.texels) for file in files]  # sides or values may want better texels
    variants = {}
    for index, file in enumerate(files):
        for step, texels in list(enumerate(ladder))[first[index] :]:
            variants[f"{texels} {index}"] = Decoded(file, kinds[texels], stack, ranges)
            progress((index + (step + 1) / len(ladder)) / len(files) / 2)
    # Engines decode colours by the slot of the material: what stands there stays sRGB-encoded.
    srgb = output.format != output.container.name and kinds[ladder[-1]].encodings == ENCODINGS
    steps = [len(ladder) - (srgb and file.layout.is_colour) for file in files]
    found = losses(texture_set, opened(stack), variants, part_of(progress, 1, 2))
    added = {name: _added(loss) for name, loss in found.items()}
    choice = dict(enumerate(first))
    allowed = _added(dict.fromkeys(PAIR_SETS, LIMIT))

    def brought(index: int, step: int) -> NDArray[np.float64]:
        return added[f"{ladder[step]} {index}"]

    while (np.sum([brought(i, step) for i, step in choice.items()], 0) > allowed).any():
        open_ends = [i for i, step in choice.items() if step + 1 < steps[i]]
        if not open_ends:
            break
        gains = {i: float((brought(i, choice[i]) - brought(i, choice[i] + 1)).max()) for i in open_ends}
        choice[max(gains, key=gains.__getitem__)] += 1
    names = _plain_names(stack, output)
    return replace(output, texels={names[files[i].layout.name]: ladder[step] for i, step in choice.items() if step})


def _ladder(output: Output) -> tuple[str, ...]:
    """Texels that files of an output may have, from the smallest to the most precise."""
    container = output.container
    plain = output.format == container.name  # without texels
    return container.ladder if plain else (container.texels, *output.finer)


def cost(
    texture_set: TextureSet,
    stack: MipStack,
    output: Output,
    written: Sequence[MapFile],
    called: str | None = None,
    progress: Progress = lambda _share: None,
    ranges: Ranges = Ranges(),  # noqa: B008
) -> Cost:
    """What an output cost, from its files as they were read back.

    Args:
        texture_set: that the stack was baked from, nothing in it hidden (`mipbake.source.opacity.shown`).
        written: its files, with the levels that came back.
        called: what the output is called; None for its format and texels.
        ranges: what a material multiplies the values in the files by.
    """
    planned = {file.layout.name: file for file in stack.files(output)}
    psnr = {}
    for index, file in enumerate(written):
        psnr[file.layout.name] = _psnr(planned[file.layout.name], ranges.meant(file))
        progress((index + 1) / len(written) / 2)
    covered = _coverage(planned, written, texture_set.alpha_cutoff)
    del planned  # as large as the stack, where channels were packed
    levels = written_levels([ranges.shown(file) for file in written], stack)
    stack = replace(stack, levels=stack.levels[: len(levels)])
    between = measure_written(texture_set, stack, levels, part_of(progress, 2, 4))
    return Cost(
        format=called or _called(written),
        psnr=psnr,
        loss=losses(texture_set, opened(stack), {"written": levels}, part_of(progress, 3, 4))["written"],
        texels={file.layout.name: file.container.precision(file.layout) for file in written},
        coverage=covered,
        written=between,
    )


def _coverage(planned: Mapping[str, MapFile], written: Sequence[MapFile], cutoff: float | None) -> Coverage | None:
    """What files make of an opacity that is tested against a cutoff."""
    if cutoff is None:
        return None
    found = [
        Coverage(
            level,
            coverage(before[..., place], cutoff),
            coverage(after[..., place], cutoff),
            file.container.texels,
            len(file.layout.channels) == 1,
        )
        for file in written
        for place, channel in enumerate(file.layout.channels)
        if channel.map == "opacity"
        for level, (before, after) in enumerate(zip(planned[file.layout.name].levels, file.levels, strict=False))
        if min(before.shape[:2]) >= _COVERAGE_SIDE
    ]
    return max(found, key=lambda each: each.change, default=None)


def _called(files: Sequence[MapFile]) -> str:
    """Format and texels of an output: the texels of most of its files that shade, or of the first where as many have
    others."""
    texels = [file.container.texels for file in files if file.layout.shades]
    return f"{files[0].container.name}:{max(dict.fromkeys(texels), key=texels.count)}"


def _plain_names(stack: MipStack, output: Output) -> dict[str, str]:
    """File names of an output to those that its packing has."""
    plain = replace(output, naming="{file}", names={})
    return {
        named.layout.name: file.layout.name for named, file in zip(stack.files(output), stack.files(plain), strict=True)
    }


class Decoded(MadeLevels):
    """Levels of a stack with the maps of one file as its texels would give them back."""

    def __init__(self, file: MapFile, container: Container, stack: MipStack, ranges: Ranges) -> None:
        self._file, self._container, self._stack, self._ranges = file, container, stack, ranges
        stored = ranges.stored(replace(file, container=container, levels=file.levels[: _reached(stack)]))
        self._texels = container.decoded(file.layout, quantised_levels(stored))

    def __len__(self) -> int:
        return len(self._texels)

    def _level(self, index: int) -> NDArray[np.float32]:
        level = stood_for(self._texels[index], self._container, self._file.layout)
        stack = replace(self._stack, levels=[self._stack.levels[index]])
        return stored_channels([self._ranges.shown(replace(self._file, levels=[level]))], stack)[0]


def _reached(stack: MipStack) -> int:
    """How many levels lookups at LODS read."""
    sampler = stack.provenance.sampler or DEFAULT_SAMPLER
    return 1 + max(0, ceil(max(LODS) + sampler.bias))


def losses(
    texture_set: TextureSet,
    baked: Candidate,
    variants: Mapping[str, Sequence[NDArray[np.float32]]],
    progress: Progress = lambda _share: None,
) -> dict[str, dict[str, float]]:
    """Variant and pair set to the fall of the SNR below the SNR of what was baked, in dB.

    Args:
        baked: of `opened`, or fewer levels of it, as many as `LODS` reach.
        variants: name to levels of the same stored channels.
    """
    others = [Candidate(replace(baked.method, name=name), levels) for name, levels in variants.items()]
    effort = MeasureEffort(_SEED, _POINTS, _SAMPLES, intervals=False)
    sampler = baked.method.sampler or DEFAULT_SAMPLER
    measured = measure(
        texture_set.filtered(baked.method.kernel),
        [baked, *others],
        LODS,
        (),
        effort,
        lambda _phase, share: progress(share),
        sampler,
    )
    snr: dict[tuple[str, str], list[float]] = {}
    for figure in measured.curve:
        snr.setdefault((figure.method, figure.view), []).append(figure.value)
    return {
        name: {view: float(np.mean(snr[baked.name, view]) - np.mean(snr[name, view])) for view in PAIR_SETS}
        for name in variants
    }


def _added(loss: Mapping[str, float]) -> NDArray[np.float64]:
    """Squared error that a loss stands for, in units of the error that was there, for every pair set."""
    return np.maximum(10 ** (np.array([loss[view] for view in PAIR_SETS]) / 10) - 1, 0)


def _psnr(planned: MapFile, written: MapFile) -> float:
    if len(planned.levels) < len(written.levels):
        raise InputError(f"{written.layout.name} came back with more levels than were written: bake it again")
    if isinstance(written.levels, GivenBack) and written.levels.squares is not None:
        squares, count = written.levels.squares, sum(level.size for level in planned.levels[: len(written.levels)])
    else:
        squares, count = 0.0, 0
        srgb = written.container.srgb(written.layout)
        for wanted, found in zip(planned.levels, written.levels, strict=False):
            for both in zip(row_blocks(found), row_blocks(wanted), strict=True):
                error = np.subtract(*(to_file(block, written.layout.encodings, srgb) for block in both))
                squares += float(np.square(error).sum())
                count += error.size
    return float("inf") if squares == 0 else float(-10 * np.log10(squares / count))
