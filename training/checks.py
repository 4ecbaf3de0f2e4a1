"""Checks of settings."""

from __future__ import annotations

from mipbake.base.errors import UsageError


def require(condition: bool, name: str, expected: str, got: object) -> None:
    """UsageError about the setting of that name unless the condition holds."""
    if not condition:
        raise UsageError(f"{name} must be {expected}, got {got!r}")


def require_least(least: int, settings: object, section: str, *names: str) -> None:
    """UsageError unless the settings of those names are numbers of at least so much."""
    for name in names:
        value = getattr(settings, name)
        require(value >= least, f"{section}.{name}", f"at least {least}", value)


def require_shares(settings: object, section: str, *names: str) -> None:
    """UsageError unless the settings of those names are shares."""
    for name in names:
        value = getattr(settings, name)
        require(0 <= value <= 1, f"{section}.{name}", "between 0 and 1", value)


def require_power_of_two(name: str, value: int) -> None:
    """UsageError unless the value is a power of two of at least 4."""
    require(value >= 4 and value & (value - 1) == 0, name, "a power of two of at least 4", value)
