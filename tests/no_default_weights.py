"""Weights of which none is a default: what bakes do where nothing was trained for a target."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from mipbake.models import registry


def hide_defaults(monkeypatch: pytest.MonkeyPatch) -> None:
    """No weights are the default of any target until the test ends; they may still be named."""
    every = registry.list_weights

    def others(folder: Path = registry.WEIGHTS_FOLDER) -> list[registry.WeightsInfo]:
        return [dataclasses.replace(info, default=False) for info in every(folder)]

    monkeypatch.setattr(registry, "list_weights", others)
