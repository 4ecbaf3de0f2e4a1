"""`nvdiffrast.torch` as its documentation describes it: the restrictions are checked, and mipbake computes.

A program that runs on this module uses no name, no argument and no freedom that nvdiffrast's documentation lacks. The
documentation has tensors in GPU memory alone. That is not checked, since tests run without a GPU.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

import mipbake.nvdiffrast as dr

FILTERS = "auto", "nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear"
BOUNDARIES = "wrap", "clamp", "zero", "cube"
INTEGERS = "tri", "ranges"


def _check_tensors(given: Mapping[str, Any]) -> None:
    """Contiguous, of the documented types, and on one device."""
    tensors = {name: value for name, value in given.items() if isinstance(value, Tensor)}
    for name, tensor in tensors.items():
        assert tensor.is_contiguous(), f"{name} is not contiguous"
        assert tensor.dtype == (torch.int32 if name in INTEGERS else torch.float32), f"{name} is {tensor.dtype}"
    assert len({tensor.device for name, tensor in tensors.items() if name != "ranges"}) <= 1


def _check_rasterize(given: Mapping[str, Any]) -> None:
    assert type(given["glctx"]) in (dr.RasterizeCudaContext, dr.RasterizeGLContext)
    height, width = given["resolution"]
    assert isinstance(height, int) and isinstance(width, int)
    assert isinstance(given["pos"], Tensor) and isinstance(given["tri"], Tensor)
    assert given["pos"].ndim == 3 or given["ranges"] is not None


def _check_texture(given: Mapping[str, Any]) -> None:
    """Halved sizes are whole, down to 1 x 1 or to the level that is the last; and lookups have one minibatch."""
    tex, uv, filter_mode = given["tex"], given["uv"], given["filter_mode"]
    assert filter_mode in FILTERS and given["boundary_mode"] in BOUNDARIES
    assert tex.shape[0] in (1, uv.shape[0])
    derivatives, bias = given["uv_da"], given["mip_level_bias"]
    assert derivatives is None or derivatives.shape == (*uv.shape[:3], 2 * uv.shape[3])
    assert bias is None or bias.shape == uv.shape[:3]
    looked_up = derivatives is not None or bias is not None
    if given["mip"] is None and ("mipmap" in filter_mode or (filter_mode == "auto" and looked_up)):
        _check_halving(given)


def _check_halving(given: Mapping[str, Any]) -> None:
    sides, last = list(given["tex"].shape[-3:-1]), given["max_mip_level"]
    level = 0
    while sides != [1, 1] and (last is None or level < last):
        assert all(side == 1 or side % 2 == 0 for side in sides), f"level {level} of {sides} cannot be halved"
        sides, level = [max(1, side // 2) for side in sides], level + 1


CHECKS: dict[str, Callable[[Mapping[str, Any]], None]] = {
    "rasterize": _check_rasterize,
    "DepthPeeler": _check_rasterize,
    "texture": _check_texture,
    "texture_construct_mip": _check_halving,
}


def _checked(name: str) -> Callable[..., Any]:
    function = getattr(dr, name)
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        _check_tensors(bound.arguments)
        CHECKS.get(name, lambda _: None)(bound.arguments)
        called.append(name)
        return function(*args, **kwargs)

    return call


called: list[str] = []
"""Names of the functions that programs have called."""


def as_documented() -> ModuleType:
    """The module, for `sys.modules`. Contexts are mipbake's own classes, because programs name them as types."""
    module = ModuleType("nvdiffrast.torch")
    called.clear()
    for name in dr.__all__:
        found = getattr(dr, name)
        setattr(module, name, found if name.endswith("Context") else _checked(name))
    return module
