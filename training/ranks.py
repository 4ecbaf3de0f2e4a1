"""Several processes, on one machine or on many, that train one network.

Each draws batches of its own. A step takes the mean of all their gradients, as one process would find it in all their
batches together. So the networks of all processes stay the same, and any one of them can go on alone.

`torchrun` begins the processes, and the environment says which one each is.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import torch
import torch.distributed as dist
from torch import Tensor

from mipbake.base.device import PROCESSOR
from mipbake.base.errors import UsageError

T = TypeVar("T")


@dataclass(frozen=True)
class Ranks:
    """One process of those that train.

    Args:
        rank: its number, from 0. count: how many there are. local: its number on its machine.
    """

    rank: int = 0
    count: int = 1
    local: int = 0

    @property
    def first(self) -> bool:
        """Whether it is the process that writes and speaks."""
        return self.rank == 0

    def device(self, name: str) -> str:
        """The device of this process, where a user named one: of a machine's graphics cards each gets its own."""
        return f"{name}:{self.local}" if name == "cuda" and self.count > 1 else name

    def average_(self, vectors: Iterable[Tensor]) -> None:
        """Makes vectors their means over all processes, in place."""
        if self.count == 1:
            return
        for vector in vectors:
            dist.all_reduce(vector)
            vector.div_(self.count)

    def of_first(self, value: T | None) -> T:
        """What the first process has, for all. The others give None."""
        if self.count > 1:
            shared = [value]
            dist.broadcast_object_list(shared)
            value = shared[0]
        if value is None:
            raise AssertionError("the first process gives a value")
        return value


@contextmanager
def ranks(device: str) -> Iterator[Ranks]:
    """The processes that `torchrun` has begun, or this one alone.

    Args:
        device: where all train: on graphics cards they talk by NCCL, else by Gloo.

    Raises:
        UsageError: torchrun begins several processes on one card.
    """
    count = int(os.environ.get("WORLD_SIZE", "1")) if dist.is_available() and dist.is_torchelastic_launched() else 1
    if count == 1:
        yield Ranks()
        return
    if device not in (PROCESSOR, "cuda"):
        raise UsageError(f"the device {device} is one, and {count} processes train: expected {PROCESSOR} or cuda")
    made = Ranks(int(os.environ["RANK"]), count, int(os.environ["LOCAL_RANK"]))
    if device == "cuda":
        torch.cuda.set_device(made.local)
    dist.init_process_group("nccl" if device == "cuda" else "gloo")
    try:
        yield made
    finally:
        dist.destroy_process_group()
