"""Parsing JSON that others wrote: what the standard allows, and nothing that Python adds to it."""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn


def parsed(text: str | bytes) -> Any:
    """What a JSON text in UTF-8 holds; every number is finite.

    Raises:
        ValueError: it is not JSON, as with NaN, Infinity and numbers beyond a float's range, or is nested too deeply.
    """

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not a number in JSON")

    def number_of(digits: str) -> float:
        if not math.isfinite(value := float(digits)):
            raise ValueError(f"the number {digits[:20]} is beyond what a float holds")
        return value

    text = text.decode("utf-8-sig") if isinstance(text, bytes) else text
    try:
        return json.loads(text, parse_constant=refuse, parse_float=number_of)
    except RecursionError:
        raise ValueError("its objects and arrays are nested too deeply") from None
