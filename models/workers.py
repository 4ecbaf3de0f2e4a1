"""Where torch bakes: without gradients, and on a graphics card in float32 throughout."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from mipbake.base.device import too_small


@contextmanager
def baking_on(device: torch.device) -> Iterator[None]:
    """Inside, torch calculates without gradients, and on a graphics card in float32 throughout.

    Raises:
        UsageError: the memory of the graphics card is too small for what is done inside.
    """
    with torch.inference_mode():
        if device.type == "cpu":
            yield
            return
        try:
            # Convolutions there would round their factors to 10 bits, which is torch's default.
            with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True, allow_tf32=False):
                yield
        except torch.OutOfMemoryError as error:
            raise too_small(str(device)) from error
