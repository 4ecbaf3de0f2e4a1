"""nvdiffrast's rasteriser contexts: a device, and scratch memory of `mipbake.raster`."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any

from mipbake.base.device import PROCESSOR, checked_device
from mipbake.base.errors import UsageError
from mipbake.base.extras import extra
from mipbake.nvdiffrast.log import LOGGER
from mipbake.raster import RasterizeContext

if TYPE_CHECKING:
    import torch

__all__ = ["MODES", "RasterizeCudaContext", "RasterizeGLContext"]

MODES = ("automatic", "manual")

_warned: list[str] = []
"""The warning that there is no graphics card, once it has been given in this process."""


class RasterizeCudaContext:
    """A context for `rasterize` and `DepthPeeler` on one device: with CUDA, or on the processor.

    It holds the scratch memory of `mipbake.raster.RasterizeContext`, which is given back with the context. Several
    threads may use it at once. A copy, or a context that arrives in another process, has scratch of its own.

    Args:
        device: where positions and triangles will be: a torch.device, a name ("cuda:1", "cpu"), or the number of a
            graphics card. Default: the current device of CUDA, or the processor where torch finds no graphics card; a
            warning then says so, once in a process (see `set_log_level`).

    Attributes:
        device: torch.device, always with the number of the graphics card.

    Raises:
        UsageError: there is no such device.
    """

    device: torch.device
    scratch: RasterizeContext

    def __init__(self, device: torch.device | str | int | None = None) -> None:
        self.device = _found(device, type(self).__name__)
        self.scratch = RasterizeContext()

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self.device),)


class RasterizeGLContext(RasterizeCudaContext):
    """The same as `RasterizeCudaContext`, with the arguments that nvdiffrast has for OpenGL.

    No OpenGL is used: the rasteriser is the same, so both contexts give the same results, bit for bit.

    In manual mode `rasterize` and `DepthPeeler` want the context to be set in the thread that calls them, as nvdiffrast
    does. One thread at a time may have it set. In automatic mode several threads may use it at once.

    Args:
        output_db: whether `rasterize` gives the derivatives of barycentrics. Without them its second result has shape
            (B, H, W, 0), and its argument `grad_db` is ignored. They are computed all the same, so no time is saved.
        mode: "automatic", or "manual" for `set_context` and `release_context`.
        device: as for `RasterizeCudaContext`.

    Attributes:
        output_db: bool.
        mode: str.
        device: torch.device, always with the number of the graphics card.

    Raises:
        UsageError: there is no such device or mode, or output_db is not a bool.
    """

    def __init__(
        self, output_db: bool = True, mode: str = "automatic", device: torch.device | str | int | None = None
    ) -> None:
        if not isinstance(output_db, bool):
            raise UsageError(f"output_db is {output_db!r}: expected True or False")
        if mode not in MODES:
            raise UsageError(f"mode is {mode!r}: expected 'automatic' or 'manual'")
        super().__init__(device)
        self.output_db, self.mode = output_db, mode
        self._thread: int | None = None  # that has it set, in manual mode

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.output_db, self.mode, str(self.device))

    def set_context(self) -> None:
        """Sets the context in the current thread, in manual mode. Setting it twice there changes nothing.

        Raises:
            UsageError: the context is in automatic mode, or set in another thread that still runs.
        """
        self._check_manual("set_context")
        here, others = threading.get_ident(), {thread.ident for thread in threading.enumerate()}
        if self._thread not in (None, here) and self._thread in others:
            raise UsageError("glctx is set in another thread: expected that thread to call release_context() first")
        self._thread = here

    def release_context(self) -> None:
        """Releases the context where it is set in the current thread, in manual mode; else it changes nothing.

        Raises:
            UsageError: the context is in automatic mode.
        """
        self._check_manual("release_context")
        if self._thread == threading.get_ident():
            self._thread = None

    def check_set(self) -> None:
        """UsageError where the mode is manual and the context is not set in this thread."""
        if self.mode == "manual" and self._thread != threading.get_ident():
            raise UsageError(
                "glctx is in manual mode and not set in this thread: expected a call of set_context() before"
            )

    def _check_manual(self, method: str) -> None:
        if self.mode != "manual":
            raise UsageError(
                f"{method} was called on a context in automatic mode: expected RasterizeGLContext(mode='manual')"
            )


def _found(device: Any, name: str) -> torch.device:
    """The device of a context called `name`, with a message where to look for results."""
    with extra("train", name):
        import torch
    if device is None:
        found = torch.device("cuda", torch.cuda.current_device()) if torch.cuda.is_available() else None
        if found is None and not _warned and LOGGER.isEnabledFor(logging.WARNING):
            why = "torch finds no graphics card" if torch.version.cuda else "torch was built without CUDA"
            _warned.append(f"{why}, so {name} rasterises on the processor, with tensors there")
            LOGGER.warning(_warned[0])
        found = found or torch.device(PROCESSOR)
    else:
        found = torch.device(checked_device(_name(device, torch.device), "rasterise"))
        if found.type == "cuda" and found.index is None:
            found = torch.device("cuda", torch.cuda.current_device())
    LOGGER.info("%s rasterises on %s, without OpenGL", name, found)
    return found


def _name(device: Any, kind: type) -> str:
    if isinstance(device, (str, kind)):
        return str(device)
    if isinstance(device, int) and not isinstance(device, bool):
        return f"cuda:{device}"
    raise UsageError(f"device is {device!r}: expected a torch.device, a name such as 'cuda:1', or a number")
