"""What images of a fit are compared by, and that no part of it pays for another one."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mipbake.base.srgb import linear_to_srgb
from mipbake.fitting.comparisons import ERRORS, comparisons, joined
from mipbake.quality.metrics.images import film_exposure

from .fitting_small import fitted


def pixels(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).lognormal(0, 1.5, (40, 3)).astype(np.float32)


SHOWN = (np.arange(40) % 5 > 0).astype(np.float32)


@pytest.mark.parametrize("error", ERRORS)
def test_errors_are_shares_of_the_references_squares(error: str) -> None:
    reference, image = pixels(0), pixels(1)
    parts = comparisons(error, reference, SHOWN)
    assert [part.name for part in parts] == {"both": ["displayed", "linear"]}.get(error, [error])
    exposure = film_exposure(reference[SHOWN > 0])

    def display(x: np.ndarray) -> np.ndarray:
        return linear_to_srgb(x.astype(np.float64) * exposure / (1 + x * exposure))

    for part in parts:
        seen = display if part.name == "displayed" else np.asarray
        wanted, found = (seen(each)[SHOWN > 0].astype(np.float64) for each in (reference, image))
        assert part.error(image) == pytest.approx(np.square(found - wanted).sum() / np.square(wanted).sum(), rel=1e-5)
        assert part.error(reference) < 1e-12


def test_joined_parts_count_what_is_left_of_each() -> None:
    reference, first, image = pixels(0), pixels(2), pixels(1)
    parts = tuple(part.begun(first) for part in comparisons("both", reference, SHOWN))
    left = joined(parts, [part.compared(image) for part in parts]) - joined(parts, [part.reference for part in parts])
    found = float((np.square(left, dtype=np.float64) * SHOWN[:, None]).sum())
    assert found == pytest.approx(sum(part.error(image) / part.error(first) for part in parts), rel=1e-5)


def test_what_is_kept_gains_in_both_parts() -> None:
    """In the mean over views that are held out; a fit that looks at displays alone may lose in linear light."""
    told = fitted(steps=160).provenance.adjustments[-1]
    found = re.findall(r"level \d( \(linear\))? (-?[\d.]+) to (-?[\d.]+) dB", told)
    assert len(found) == 8
    for part in ("", " (linear)"):
        gains = [float(after) - float(before) for name, before, after in found if name == part]
        assert sum(gains) / len(gains) > 0.05
