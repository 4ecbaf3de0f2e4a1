"""A device that every machine has, in place of a graphics card: torch's `meta`, whose tensors have no values."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from mipbake.models.base import Network

META = torch.device("meta")

_MOVES = "aten.to", "aten._to_copy"

_Some = TypeVar("_Some", bound=Network)


class Watched(TorchDispatchMode):
    """Counts what is sent to `meta` and what comes back, which is zeros; tensors of two devices in one call raise.

    Calls of torch on the CPU are allowed, because tiles are cut out there.

    Attributes:
        sent, fetched: shapes of the tensors that changed their device.
    """

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[tuple[int, ...]] = []
        self.fetched: list[tuple[int, ...]] = []

    def __torch_dispatch__(
        self, func: Any, types: Sequence[Any], args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        given = dict(kwargs or {})
        leaves = tree_leaves((args, given))
        tensors = [each for each in leaves if isinstance(each, torch.Tensor)]
        devices = {each.device for each in tensors}
        assert len(devices) < 2, f"{func} is given tensors of {devices}"
        asked = {each for each in leaves if isinstance(each, torch.device)}
        if str(func.overloadpacket) not in _MOVES or not asked - devices:
            return func(*args, **given)
        (tensor,) = tensors
        if tensor.device != META:
            self.sent.append(tuple(tensor.shape))
            return func(*args, **given)
        self.fetched.append(tuple(tensor.shape))
        return torch.zeros(tensor.shape, dtype=tensor.dtype)


def moved(network: _Some) -> _Some:
    """A copy of a network there."""
    return copy.deepcopy(network).to(META)
