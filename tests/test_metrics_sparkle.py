"""False sparkle: bright spots that the reference does not have."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake.quality.metrics import false_sparkle


def test_false_sparkle_by_hand() -> None:
    """What is 0.1 above the reference or less counts nothing, and nothing darker does; channels count by themselves."""
    reference = np.full((1, 2, 2, 3), 0.3)
    candidate = reference.copy()
    candidate[0, 0, 0] = [0.9, 0.35, 0.1]  # 0.5 too much, forgiven, darker
    candidate[0, 1, 1] = [0.4, 0.5, 0.0]  # just forgiven, 0.1 too much, darker
    measured = false_sparkle(candidate, reference)
    assert measured.per_pixel == pytest.approx(np.array([[[0.5 / 3, 0], [0, 0.1 / 3]]]), abs=1e-7)
    assert measured.mean == pytest.approx(0.6 / 12)
    assert false_sparkle(reference, candidate).mean == pytest.approx((0.1 + 0.2) / 12)


def test_false_sparkle_ends_at_nine_tenths() -> None:
    white, black = np.ones((16, 20, 3)), np.zeros((16, 20, 3))
    assert false_sparkle(white, black).mean == pytest.approx(0.9)
    assert false_sparkle(black, white).mean == 0
