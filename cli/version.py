"""`mipbake --version`: the version, and what this installation can do."""

from __future__ import annotations

import mipbake
from mipbake import MipbakeError


def version_text() -> str:
    """Version, instruction set in use, CUDA or not, weights found; one line each."""
    from mipbake import _native
    from mipbake.models.registry import list_weights

    without_device = "compiled, but no device found" if _native.cuda_compiled() else "no"
    cuda = "yes" if _native.cuda_available() else without_device
    try:
        found = [f"{w.name} ({', '.join(w.targets)}; {', '.join(w.pixel_filters)})" for w in list_weights()]
    except MipbakeError as error:
        found = [f"unreadable ({error})"]
    return "\n".join(
        (
            f"mipbake {mipbake.__version__}",
            f"instruction set: {_native.isa()}",
            f"CUDA: {cuda}",
            f"weights: {', '.join(found) or 'none'}",
        )
    )
