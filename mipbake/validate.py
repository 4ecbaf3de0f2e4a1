"""Validation: a stack and the closed forms against the supersampled, pixel-filtered reference of their source."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mipbake.errors import UsageError
from mipbake.metrics import PAIR_SETS, Interval, LightViewPairs, pair_set, snr_interval, snr_sums
from mipbake.prefilter import METHODS
from mipbake.prefilter.pixel_filter import level_sizes
from mipbake.render import candidate, random_points, reference
from mipbake.stack import MipStack
from mipbake.texture_set import TextureSet

DEFAULT_LODS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0)
DEFAULT_SEED = 0
DEFAULT_POINTS = 8192
DEFAULT_SAMPLES = 64

CLOSED_FORMS = (("linear", "box"), ("linear", None), ("lean", "box"), ("lean", None))
"""Method and averaging kernel of each baseline; None stands for the pixel filter of the stack under test."""

BAKED = "baked"
"""Name of the rows that belong to the stack under test."""


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
        pixel_filter: the reference's filter.
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

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the measured methods, the stack under test first."""
        return tuple(dict.fromkeys(row.method for row in self.rows))

    @property
    def lods(self) -> tuple[float, ...]:
        """Measured levels of detail."""
        return tuple(dict.fromkeys(row.lod for row in self.rows))

    def snr(self, method: str, pairs: str, lod: float) -> float:
        """The figure of one method, pair set and lod; KeyError where it was not measured."""
        for row in self.rows:
            if (row.method, row.pair_set, row.lod) == (method, pairs, lod):
                return row.snr
        raise KeyError((method, pairs, lod))

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON."""
        return asdict(self)


def validate(
    texture_set: TextureSet,
    stack: MipStack,
    lods: Sequence[float] = DEFAULT_LODS,
    seed: int = DEFAULT_SEED,
    points: int = DEFAULT_POINTS,
    samples: int = DEFAULT_SAMPLES,
    progress: Callable[[str, float], None] = lambda _stage, _share: None,
    baselines: Sequence[tuple[str, str | None]] = CLOSED_FORMS,
) -> Validation:
    """Measures a stack, and the closed forms baked from the same set, against the reference.

    The reference renders level 0 of the source, every stored channel interpolated bilinearly, under the pixel filter
    that the stack declares; candidates look their stack up once, trilinearly. All are compared at the same random
    sub-texel offsets. The reference is estimated twice, independently, so that its noise biases no figure (snr_db).

    Args:
        texture_set: the source.
        stack: what was baked from it.
        lods: levels of detail; those beyond the last level are measured at the last level, once.
        seed: fixes points, light-view pairs and samples.
        points: random pixels per lod. samples: reference samples per pixel in each estimate.
        progress: told "validate" and the finished share.
        baselines: methods to bake beside the stack, each with its averaging kernel, or None for the stack's filter.

    Raises:
        UsageError: a negative lod, or fewer than one point or sample.
    """
    if not lods or not all(0 <= lod < float("inf") for lod in lods):
        raise UsageError(f"lods must be one or more numbers from 0 up, got {list(lods)}")
    if points < 1 or samples < 1:
        raise UsageError(f"points and samples must be at least 1, got {points} and {samples}")
    source = texture_set.source_model
    stored = texture_set.material(source)
    last = len(level_sizes(*stored.shape[:2])) - 1
    measured = tuple(dict.fromkeys(min(float(lod), float(last)) for lod in lods))
    notes = []
    if measured != tuple(float(lod) for lod in lods):
        notes.append(f"lods beyond the last level were measured there, at lod {last}.")
    if stack.provenance.source_hash != texture_set.source_hash:
        notes.append("the stack was not baked from this texture set (source hashes differ): its figures mean little.")
    kernel = stack.provenance.pixel_filter

    candidates = {BAKED: stack.levels}
    for method, averaging in baselines:
        filtered = averaging or kernel
        label = f"{method} ({filtered})"
        if label not in candidates:
            bake = METHODS[method]
            result = bake(stored, source, stack.model, filtered, texture_set.wrap, lambda _: None)
            candidates[label] = result.levels

    sets = {name: pair_set(name, seed) for name in PAIR_SETS}
    every = LightViewPairs(*(np.concatenate([getattr(p, a) for p in sets.values()]) for a in ("light", "view")))
    figures: dict[tuple[str, str, float], Interval] = {}
    for index, lod in enumerate(measured):
        rng = np.random.default_rng([seed, index])
        uv = random_points(rng, points)
        first, second = (
            reference(stored, source, texture_set.wrap, uv, lod, kernel, every, samples, rng) for _ in range(2)
        )
        for label, levels in candidates.items():
            shaded = candidate(levels, stack.model, texture_set.wrap, uv, lod, every)
            for name, part in _parts(sets).items():
                figures[label, name, lod] = snr_interval(snr_sums(shaded[part], first[part], second[part]))
        progress("validate", (index + 1) / len(measured))
    return Validation(
        name=texture_set.name,
        method=stack.provenance.method,
        model=stack.model,
        pixel_filter=kernel,
        rows=tuple(
            Row(*key, figures[key].estimate, figures[key].low, figures[key].high)
            for key in itertools.product(candidates, sets, measured)
        ),
        notes=tuple(notes),
        points=points,
        samples=samples,
        seed=seed,
    )


def _parts(sets: dict[str, LightViewPairs]) -> dict[str, slice]:
    parts, start = {}, 0
    for name, pairs in sets.items():
        parts[name] = slice(start, start + len(pairs.light))
        start += len(pairs.light)
    return parts
