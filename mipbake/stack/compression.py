"""What files cost: the error of rounding and compression, in every map and in what is shaded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError
from mipbake.base.timings import Progress
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.quality.figures import Candidate
from mipbake.quality.metrics import PAIR_SETS
from mipbake.quality.texture_space import MeasureEffort, measure
from mipbake.source.layout import to_file
from mipbake.source.opacity import coverage
from mipbake.source.texture_set import TextureSet
from mipbake.stack.containers import FORMATS
from mipbake.stack.costs import Cost, Coverage
from mipbake.stack.file_levels import written_levels
from mipbake.stack.gltf.ranges import Ranges
from mipbake.stack.gpu_files import GpuFile
from mipbake.stack.map_files import GivenBack, MapFile, row_blocks
from mipbake.stack.output import Output
from mipbake.stack.stack import MipStack
from mipbake.stack.written import measure_written, opened

LODS: tuple[float, ...] = (0.0, 1.0, 3.0)
"""Levels of detail that the loss is measured at; the loss is the fall of their mean SNR."""

_COVERAGE_SIDE = 8
"""Texels along a side of a level; in smaller levels every texel is a great share."""

_FEW, _POINTS, _SAMPLES, _SEED = 1024, 8192, 16, 11
"""Losses hang on the few points that shine; but half floats lose nothing that more points would find. So most points
are measured where few show a loss of _SMALL. The last number is the seed."""

_SMALL = 0.1  # dB


def part_of(progress: Progress, index: int, count: int) -> Progress:
    """Progress of one of several pieces of work that are as long as each other."""
    return lambda share: progress((index + share) / count)


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
        gpu_bytes=_gpu_bytes(written),
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


def _gpu_bytes(files: Sequence[MapFile]) -> dict[str, int]:
    """What files take of a graphics card's memory, with the texels that they have and with others of their format."""
    container = files[0].container
    if not isinstance(container, GpuFile):
        return {}
    sizes = [[(level.shape[0], level.shape[1]) for level in file.levels] for file in files]
    kinds = {name: each for name, each in FORMATS[container.name].items() if isinstance(each, GpuFile)}
    return {
        name: sum(kind.gpu_bytes(file.layout, each) for file, each in zip(files, sizes, strict=True))
        for name, kind in kinds.items()
    }


def _called(files: Sequence[MapFile]) -> str:
    """Format and texels of an output: the texels of most of its files that shade, or of the first where as many have
    others."""
    texels = [file.container.texels for file in files if file.layout.shades]
    return f"{files[0].container.name}:{max(dict.fromkeys(texels), key=texels.count)}"


def losses(
    texture_set: TextureSet,
    baked: Candidate,
    variants: Mapping[str, Sequence[NDArray[np.float32]]],
    progress: Progress = lambda _share: None,
) -> dict[str, dict[str, float]]:
    """Variant and pair set to the fall of the SNR below the SNR of what was baked, in dB. `baked`: of `opened`, or
    fewer levels of it, as many as `LODS` reach. `variants`: name to levels of the same stored channels."""
    found: dict[str, dict[str, float]] = {}
    for turn, points in enumerate((_FEW, _POINTS)):
        found = _losses(texture_set, baked, variants, points, part_of(progress, turn, 2))
        if all(abs(value) < _SMALL for loss in found.values() for value in loss.values()):
            break
    progress(1.0)
    return found


def _losses(
    texture_set: TextureSet,
    baked: Candidate,
    variants: Mapping[str, Sequence[NDArray[np.float32]]],
    points: int,
    progress: Progress,
) -> dict[str, dict[str, float]]:
    others = [Candidate(replace(baked.method, name=name), levels) for name, levels in variants.items()]
    measured = measure(
        texture_set.filtered(baked.method.kernel),
        [baked, *others],
        LODS,
        (),
        MeasureEffort(_SEED, points, _SAMPLES, intervals=False),
        lambda _phase, share: progress(share),
        baked.method.sampler or DEFAULT_SAMPLER,
    )
    snr: dict[tuple[str, str], list[float]] = {}
    for figure in measured.curve:
        snr.setdefault((figure.method, figure.view), []).append(figure.value)
    return {
        name: {view: float(np.mean(snr[baked.name, view]) - np.mean(snr[name, view])) for view in PAIR_SETS}
        for name in variants
    }


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
