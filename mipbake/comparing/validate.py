"""Validation: a stack and the closed forms against the supersampled, pixel-filtered reference of their source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from mipbake.baking.pipeline import Recipe
from mipbake.base.timings import PhaseProgress
from mipbake.comparing.candidates import bake_all, label, mismatch
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.quality.texture_space import (
    DEFAULT_POINTS,
    DEFAULT_SAMPLES,
    DEFAULT_SEED,
    MeasureEffort,
    check_settings,
    measure,
)
from mipbake.source.loading import PathLike, as_texture_set
from mipbake.source.texture_set import TextureSet
from mipbake.stack.saving import as_stack
from mipbake.stack.stack import MipStack
from mipbake.stack.written import BAKED, opened

__all__ = ["BAKED", "CLOSED_FORMS", "DEFAULT_LODS", "DEFAULT_SEED", "Row", "Validation", "validate"]

DEFAULT_LODS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0)

CLOSED_FORMS = (("linear", "box"), ("linear", None), ("lean", "box"), ("lean", None))
"""Method and averaging kernel of each baseline; None stands for the pixel filter of the stack under test."""


@dataclass(frozen=True)
class Row:
    """One figure: SNR in dB of a method, on a pair set, at a level of detail.

    `low` and `high` bound its 95 % confidence interval over light-view pairs; nan where it has none.
    """

    method: str
    pair_set: str
    lod: float
    snr: float
    low: float
    high: float


@dataclass(frozen=True)
class Validation:
    """What `validate` measured.

    Args:
        name: the texture set's name.
        method: how the stack under test was baked (its rows are called "baked").
        model: material model of the stack.
        pixel_filter: the filter of the reference.
        rows: all figures.
        notes: what a reader must know, in plain sentences.
        points, samples, seed: pixels per lod, reference samples per pixel in each of two estimates, random seed.
    """

    name: str
    method: str
    model: str
    pixel_filter: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    points: int
    samples: int
    seed: int

    def __repr__(self) -> str:
        """A description in one line: the figures of the stack under test at the finest level of detail."""
        at = min(self.lods, default=0.0)
        found = [f"{r.pair_set} {r.snr:.1f} dB" for r in self.rows if (r.method, r.lod) == (BAKED, at)]
        return f"Validation({self.name!r}, {self.method}, {self.model}, at lod {at:g}: {', '.join(found)})"

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the measured methods, the stack under test first."""
        return tuple(dict.fromkeys(row.method for row in self.rows))

    @property
    def lods(self) -> tuple[float, ...]:
        """Measured levels of detail."""
        return tuple(dict.fromkeys(row.lod for row in self.rows))

    def snr(self, method: str, pair_set: str, lod: float) -> float:
        """The figure of one method, pair set and lod; KeyError where it was not measured."""
        for row in self.rows:
            if (row.method, row.pair_set, row.lod) == (method, pair_set, lod):
                return row.snr
        raise KeyError((method, pair_set, lod))

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON."""
        return asdict(self)


def validate(
    texture_set: TextureSet | PathLike | Sequence[PathLike],
    stack: MipStack | PathLike,
    lods: Sequence[float] = DEFAULT_LODS,
    seed: int = DEFAULT_SEED,
    points: int = DEFAULT_POINTS,
    samples: int = DEFAULT_SAMPLES,
    progress: PhaseProgress = lambda _phase, _share: None,
    baselines: Sequence[tuple[str, str | None]] = CLOSED_FORMS,
) -> Validation:
    """Measures a stack, and the closed forms baked from the same set, against the reference.

    The reference has the pixel filter that the stack declares; candidates are looked up by the sampler that the stack
    was made for. All are compared at the same random sub-texel offsets (mipbake.quality.texture_space.measure).

    Args:
        texture_set: the source, or what `mipbake.load` takes, such as its folder.
        stack: what was baked from it, or the folder that it was saved in.
        lods: levels of detail; those beyond the last level are measured at the last level, once.
        seed: fixes points, light-view pairs and samples.
        points: random pixels per lod. samples: reference samples per pixel in each estimate.
        baselines: methods to bake beside the stack, each with its averaging kernel, or None for the stack's filter; for
            the stack's sampler and with its aim, where they take them.

    Raises:
        UsageError: a negative lod, or fewer than one point or sample.
        InputError, OutputError: as `mipbake.load` and `mipbake.open_stack`, where paths are given.
    """
    check_settings(lods, points, samples)
    texture_set, stack = as_texture_set(texture_set), as_stack(stack)
    made = stack.provenance
    kernel = made.pixel_filter
    names = dict.fromkeys(label(method, averaging or kernel) for method, averaging in baselines)
    wrong = mismatch(stack, texture_set)
    recipe = Recipe(target=stack.model, pixel_filter=kernel, sampler=made.sampler, aim=made.aim)
    with bake_all(texture_set, recipe, tuple(names)) as baked:
        measured = measure(
            texture_set.filtered(kernel),
            [opened(stack), *baked],
            lods,
            (),
            MeasureEffort(seed, points, samples),
            lambda _phase, share: progress("validate", share),
            made.sampler or DEFAULT_SAMPLER,
        )
    return Validation(
        name=texture_set.name,
        method=made.method,
        model=stack.model,
        pixel_filter=kernel,
        rows=tuple(Row(f.method, f.view, f.lod, f.value, f.low, f.high) for f in measured.curve),
        notes=(
            f"all stacks are looked up by the sampler {made.sampler or DEFAULT_SAMPLER}, which this stack was made for",
            *measured.notes,
            *([wrong] if wrong else ()),
        ),
        points=points,
        samples=samples,
        seed=seed,
    )
