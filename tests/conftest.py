"""What several files of tests share as fixtures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from .chromium import headless


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium, one for each file of tests."""
    with headless() as started:
        yield started
