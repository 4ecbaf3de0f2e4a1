"""The devices that networks work on: the processor, and graphics cards that torch reaches with CUDA."""

from __future__ import annotations

import re

from mipbake.base.errors import UsageError
from mipbake.base.extras import extra

PROCESSOR = "cpu"
"""The default device. Networks bake there without torch."""

_CARD = re.compile(r"cuda(?::(0|[1-9][0-9]*))?")


def checked_device(name: str, work: str = "bake") -> str:
    """The name of a device, as it was given. It loads torch for a graphics card only, and tries the card.

    Args:
        name: `cpu`, `cuda`, or `cuda:1` for the second graphics card.
        work: what is to be done there, as a verb, for the sentence of an error.

    Raises:
        UsageError: an unknown name, torch is not installed, or it reaches no such graphics card.
    """
    if name == PROCESSOR:
        return name
    card = _CARD.fullmatch(name)
    if not card:
        raise UsageError(f"unknown device {name!r}: expected cpu, cuda, or cuda:1 for the second graphics card")
    with extra("train", f"the device {name}"):
        import torch
    if not torch.cuda.is_available():
        without = "the torch that is installed was built without CUDA"
        raise _unusable(name, "torch finds no graphics card" if torch.version.cuda else without, work)
    count = torch.cuda.device_count()
    if card_of(name) >= count:
        expected = "cuda" if count == 1 else f"cuda:0 to cuda:{count - 1}"
        raise UsageError(f"there is no device {name}: expected {expected}")
    try:
        float(torch.ones(1, device=name) + 1)  # a card may be too old for this torch, or taken by others
    except RuntimeError as error:
        raise _unusable(name, str(error).partition("\n")[0], work) from error
    return name


def card_of(name: str) -> int:
    """The number of a graphics card, by its name."""
    return int(name.partition(":")[2] or 0)


def too_small(name: str) -> UsageError:
    """What a bake raises where the memory of a graphics card does not suffice."""
    return UsageError(
        f"the memory of the device {name} is too small to bake this set: leave the device out to bake on the processor"
    )


def _unusable(name: str, why: str, work: str) -> UsageError:
    return UsageError(
        f"the device {name} cannot be used ({why}): expected a graphics card that torch reaches with CUDA; leave the "
        f"device out to {work} on the processor"
    )
