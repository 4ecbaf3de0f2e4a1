"""Channels that have names: records whose fields are, in their order, the parts of a tensor's last axis."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from torch import Tensor


def channels(width: int, **about: Any) -> dict[str, Any]:
    """The metadata of a field that stands for so many channels; `about` is kept beside the width."""
    return {"width": width, **about}


def places(record: Any) -> Any:
    """The record with the slice of every field."""
    found, start = [], 0
    for each in fields(record):
        found.append(slice(start, start + each.metadata["width"]))
        start = found[-1].stop
    return record(*found)


def count(record: Any) -> int:
    """How many channels the fields have together."""
    return sum(each.metadata["width"] for each in fields(record))


def parts(places: Any, tensor: Tensor) -> Any:
    """The record with the part of (..., count) that each field stands for: (..., width)."""
    return type(places)(*(tensor[..., place] for place in vars(places).values()))
