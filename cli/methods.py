"""What help texts say of methods. Apart from the other options, because to know the methods is to load them all."""

from __future__ import annotations

from mipbake.baking.methods import OPTIONS


def some_of(option: str) -> str:
    """The methods that have an option, as a sentence lists them."""
    *others, last = OPTIONS[option]
    return f"{', '.join(others)} or {last}" if others else last
