"""Checks of settings."""

from __future__ import annotations

from mipbake.base.errors import UsageError


def require(condition: bool, name: str, expected: str, got: object) -> None:
    """UsageError about the setting of that name unless the condition holds."""
    if not condition:
        raise UsageError(f"{name} must be {expected}, got {got!r}")


def require_share(name: str, value: float) -> None:
    """UsageError unless the value is a share."""
    require(0 <= value <= 1, name, "between 0 and 1", value)


def require_power_of_two(name: str, value: int) -> None:
    """UsageError unless the value is a power of two of at least 4."""
    require(value >= 4 and value & (value - 1) == 0, name, "a power of two of at least 4", value)
