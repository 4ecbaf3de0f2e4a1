"""What the record of benchmarks/fit.py says: stacks in renderers, set by set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from records.record import Difference
from records.scripts import script

DECIBELS = 0.1
"""By which figures of a sample may be off."""


def sets(data: Mapping[str, Any]) -> list[str]:
    """The sets that every renderer showed."""
    return list(next(iter(data["renderers"].values())))


def differences(record: Mapping[str, Any], sample: Mapping[str, Any]) -> list[Difference]:
    """All figures of a sample beside the record's."""
    have, found = _figures(record), _figures(sample)
    return [
        Difference(", ".join(name), have[name], value, abs(value - have[name]) / DECIBELS)
        for name, value in found.items()
        if name in have
    ]


def _figures(data: Mapping[str, Any]) -> dict[tuple[str, ...], float]:
    """Renderer, set, measure, scale and method to SNR in dB."""
    tables = script("benchmarks", "fit_tables")
    return {
        (renderer, name, measure, scale, method): value
        for renderer, named in data["renderers"].items()
        for name in named
        for measure in tables.MEASURES
        for scale, row in tables.snr(data, renderer, name, measure).items()
        for method, value in row.items()
    }
