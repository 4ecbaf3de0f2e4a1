"""Parsing TOML that others wrote, with one kind of error for all that may be wrong with it."""

from __future__ import annotations

import sys
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_MOST = 1 << 63
"""TOML promises whole numbers of 64 bits with a sign. What lies beyond is a typing error, which few can convert."""


def parsed(text: str) -> dict[str, Any]:
    """What a TOML text holds; whole numbers have at most 64 bits.

    Raises:
        ValueError: it is not TOML, is nested too deeply, or holds a larger number.
    """
    try:
        content: dict[str, Any] = tomllib.loads(text)
        _check(content)
    except RecursionError:
        raise ValueError("its tables and arrays are nested too deeply") from None
    except ValueError as error:
        # Python refuses to read integers of thousands of digits, in words of its own.
        raise ValueError(_TOO_LARGE if "integer string conversion" in str(error) else str(error)) from error
    return content


_TOO_LARGE = "it holds a whole number of more than 64 bits"


def _check(node: Any) -> None:
    if isinstance(node, dict):
        node = list(node.values())
    if isinstance(node, list):
        for each in node:
            _check(each)
    elif isinstance(node, int) and not -_MOST <= node < _MOST:
        raise ValueError(_TOO_LARGE)
