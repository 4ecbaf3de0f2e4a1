"""Channels that have names: dataclasses whose fields are, in their order, the parts of a tensor's last axis.

Which fields have channels hangs on the material model: metallic is nothing where a model has no metallic. A field
without channels stands for a tensor of width 0, and what is calculated with one is of width 0 again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import cache
from typing import Any

from torch import Tensor

from mipbake.material import Kind, MaterialModel

Having = Callable[[MaterialModel], bool]


def every(model: MaterialModel) -> bool:  # noqa: ARG001
    """Every model has such channels."""
    return True


def has_metallic(model: MaterialModel) -> bool:
    """Models in which one colour serves diffuse light and highlights, and a share decides which."""
    return bool(model.of(Kind.SHARE))


def has_specular(model: MaterialModel) -> bool:
    """Models in which highlights have a reflectance of their own."""
    return not has_metallic(model)


def has_tensor(model: MaterialModel) -> bool:
    """Models that store a log-roughness tensor."""
    return bool(model.of(Kind.LOG_TENSOR))


def has_log_gamma(model: MaterialModel) -> bool:
    """Models that store ln gamma."""
    return bool(model.of(Kind.LOG_GAMMA))


def channels(width: int, having: Having = every, **about: Any) -> dict[str, Any]:
    """The metadata of a field that stands for so many channels of some models; `about` is kept beside them."""
    return {"width": width, "having": having, **about}


@cache
def places(kind: Any, model: MaterialModel) -> Any:
    """The dataclass with the slice of every field."""
    found, start = [], 0
    for each in fields(kind):
        found.append(slice(start, start + each.metadata["width"] * each.metadata["having"](model)))
        start = found[-1].stop
    return kind(*found)


def count(kind: Any, model: MaterialModel) -> int:
    """How many channels the fields have together."""
    return sum(each.metadata["width"] for each in fields(kind) if each.metadata["having"](model))


def parts(places: Any, tensor: Tensor) -> Any:
    """The dataclass with the part of (..., count) that each field stands for: (..., width)."""
    return type(places)(*(tensor[..., place] for place in vars(places).values()))
