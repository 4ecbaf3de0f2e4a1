"""The native core as WebAssembly, under the names of `mipbake._native`: for systems that no core was compiled for.

The wheel for any system has it in place of the compiled core (.ci/wheels). Arguments are those of csrc/bind, for arrays
in the memory of the host. Stochastic gradients, splats and CUDA are missing.
"""

from __future__ import annotations

import os
from functools import cache
from typing import Any, NoReturn

from mipbake._wasm.images import decode_blocks, encode_blocks, resample
from mipbake._wasm.meshes import (
    antialias,
    antialias_backward,
    antialias_topology,
    check_mesh,
    interpolate,
    interpolate_backward,
    raster_scratch,
    raster_scratch_free,
    rasterize,
    rasterize_backward,
)
from mipbake._wasm.network import Network, NetworkBake, network_counts
from mipbake._wasm.shading import models, shade, shade_backward, shade_directions_backward, shade_lit
from mipbake._wasm.texture import (
    texture,
    texture_backward,
    texture_mip,
    texture_mip_backward,
    texture_quads,
    texture_taps,
)
from mipbake.base.errors import UsageError

__all__ = [
    "Network",
    "NetworkBake",
    "antialias",
    "antialias_backward",
    "antialias_topology",
    "check_mesh",
    "cuda_available",
    "cuda_compiled",
    "decode_blocks",
    "encode_blocks",
    "interpolate",
    "interpolate_backward",
    "isa",
    "models",
    "network_counts",
    "num_threads",
    "pages_supported",
    "raster_scratch",
    "raster_scratch_free",
    "rasterize",
    "rasterize_backward",
    "resample",
    "resident_bytes",
    "set_num_threads",
    "shade",
    "shade_backward",
    "shade_directions_backward",
    "shade_lit",
    "texture",
    "texture_backward",
    "texture_mip",
    "texture_mip_backward",
    "texture_quads",
    "texture_taps",
]


def isa() -> str:
    wish = os.environ.get("MIPBAKE_ISA", "")
    if wish not in ("", "baseline", "avx2", "avx512"):
        raise UsageError(
            f"the environment variable MIPBAKE_ISA is '{wish}': expected baseline, avx2 or avx512, or no such variable "
            "for the best that there is"
        )
    return "WebAssembly"


@cache
def _threads() -> list[int]:
    wish = os.environ.get("MIPBAKE_THREADS", "")
    if wish and not (wish.isascii() and wish.isdigit() and 1 <= int(wish) <= 1024):
        raise UsageError(
            f"the environment variable MIPBAKE_THREADS is '{wish}': expected a whole number from 1 to 1024, or no such "
            "variable for every core"
        )
    return [int(wish or os.cpu_count() or 1)]


def num_threads() -> int:
    """Each call runs on one thread; what calls several at once has as many machines."""
    return _threads()[0]


def set_num_threads(count: int) -> None:
    _threads()[0] = max(1, count)


def cuda_compiled() -> bool:
    return False


def cuda_available() -> bool:
    return False


def pages_supported() -> bool:
    return False


def resident_bytes() -> int:
    return 0


def __getattr__(name: str) -> Any:
    """What is missing says so where it is called."""
    if not name.startswith("stochastic_") and name not in ("Pages", "rasterize_workspace"):
        raise AttributeError(name)

    def missing(*_arguments: Any, **_named: Any) -> NoReturn:
        raise UsageError(
            f"{name} is missing in mipbake's core as WebAssembly, which is installed here: install mipbake where it "
            "has a compiled core (docs/installing.md)"
        )

    return missing
