"""What a stack holds, and how it was made: what writers of files are given."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.material import MODELS
from mipbake.material.aim import Sampler, checked_aim
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.layout import LAYOUTS, MapLayout, extra_layout
from mipbake.stack.map_files import Levels, row_blocks
from mipbake.stack.packing import PackedFile

if TYPE_CHECKING:
    from mipbake.stack.promise import Promise

Recipe: TypeAlias = Mapping[str, str]
"""Hashes of what a result is made from: its "sources" and how they are read, the "options" and the "weights". What
`mipbake bake` finds unchanged it need not bake again."""


@dataclass(frozen=True)
class Provenance:
    """How a stack was made. It holds no times and no machine, so that the same bake gives the same files.

    Args:
        method: a name in `mipbake.baking.methods.METHODS`.
        pixel_filter: the pixel filter that the levels are made for.
        weights, weights_sha256: trained weights and their hash; None for closed forms.
        budget: time that the method was given to optimise, as it was asked for; None where it set its own.
        sampler: that the levels are made for. aim: what the method aimed at, from 0, SNR under single lights, to 1,
            what people see. None for methods that take none, and in files of versions that knew none.
        tool_version: version of mipbake.
        sources: source file name to SHA-256 of its bytes.
        source_hash: one hash of everything that level 0 was made from.
        warnings: what a user should know, in sentences.
        promise: how every level measured beside the best closed form, by methods that measure; None for others.
        adjustments: what was changed after the bake, in sentences.
        alpha_cutoff: what opacity is tested against, and keeps its coverage for; None where it is blended.
        recipe: see `Recipe`; empty for stacks that were not baked from files.

    Raises:
        UsageError: stacks are made for no such aim.
    """

    method: str
    pixel_filter: str
    weights: str | None = None
    weights_sha256: str | None = None
    budget: str | None = None
    sampler: Sampler | None = None
    aim: float | None = None
    tool_version: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    source_hash: str = ""
    warnings: tuple[str, ...] = ()
    promise: Promise | None = None
    adjustments: tuple[str, ...] = ()
    alpha_cutoff: float | None = None
    recipe: Recipe = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Checks what may come from files."""
        if self.aim is not None:
            checked_aim(self.aim)


@dataclass(frozen=True, eq=False)
class Content:
    """What a stack holds. `mipbake.MipStack` adds how it is saved, and says what the fields are."""

    name: str
    model: str
    levels: Levels
    extra: Mapping[str, Levels]
    wrap: tuple[str, str]
    provenance: Provenance
    source_files: tuple[PackedFile, ...] = ()
    tile: int = 0

    def __post_init__(self) -> None:
        """Checks the shapes."""
        if self.model not in MODELS:
            raise UsageError(f"unknown material model {self.model!r}: expected one of {', '.join(MODELS)}")
        _check_chain("the material", self.levels, MODELS[self.model].channels)
        for role, chain in self.extra.items():
            if any(layout.name == role for layout in LAYOUTS[self.model]):
                raise UsageError(f"the map {role} belongs to the model {self.model}: pass it in levels, not in extra")
            _check_chain(f"the map {role}", chain, None)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of level 0."""
        height, width = self.levels[0].shape[:2]
        return height, width

    def maps(self) -> list[tuple[MapLayout, Levels]]:
        """Every map that is written, with its levels: (H_L, W_L, channels of the map), views where possible."""
        shading = [(m, [level[..., m.channels] for level in self.levels]) for m in LAYOUTS[self.model]]
        plain = [(extra_layout(role, chain[0].shape[-1]), list(chain)) for role, chain in self.extra.items()]
        return shading + plain

    def about(self) -> str:
        """How the stack was made, as JSON for the files themselves."""
        made = self.provenance
        return json.dumps(
            {
                "set": self.name,
                "model": self.model,
                "method": made.method,
                "pixel_filter": made.pixel_filter,
                "weights": made.weights,
                "sampler": None if made.sampler is None else str(made.sampler),
                "aim": made.aim,
                "source_hash": made.source_hash,
                "version": made.tool_version,
                "wrap": list(self.wrap),
            }
        )


def _check_chain(what: str, chain: Sequence[NDArray[np.float32]], channels: int | None) -> None:
    if not chain or any(level.ndim != 3 or level.dtype != np.float32 or not level.size for level in chain):
        raise UsageError(f"{what} is not a chain of levels: expected float32 arrays (height, width, channels)")
    channels = chain[0].shape[-1] if channels is None else channels
    expected = [(*size, channels) for size in level_sizes(*chain[0].shape[:2])[: len(chain)]]
    if [level.shape for level in chain] != expected or not 1 <= channels <= max(m.channels for m in MODELS.values()):
        raise UsageError(f"{what} has levels of {[level.shape for level in chain]}: expected {expected}")
    for index, level in enumerate(chain):
        bad = not_finite(level)
        if bad:
            raise UsageError(f"{what} has {bad} values that are not finite at level {index}: expected none")


def not_finite(level: NDArray[np.float32]) -> int:
    """How many values of a level are NaN or infinite; row by row, because marks for all are a quarter of a level."""
    return sum(int(rows.size - np.count_nonzero(np.isfinite(rows))) for rows in row_blocks(level))
