"""The native core (csrc/bind). Arguments are checked by the modules that call it; see csrc/ops.h for the kernels."""

from collections.abc import Sequence
from typing import Any

# Arrays: NumPy arrays or torch tensors, exchanged without a copy.
Array = Any

def isa() -> str: ...
def num_threads() -> int: ...
def set_num_threads(count: int) -> None: ...
def cuda_compiled() -> bool: ...
def cuda_available() -> bool: ...
def models() -> list[tuple[str, int]]: ...
def shade(model: str, material: Array, light: Array, view: Array, radiance: Array, stream: int = 0) -> None: ...
def shade_backward(
    model: str,
    material: Array,
    light: Array,
    view: Array,
    grad_radiance: Array,
    grad_material: Array,
    stream: int = 0,
    duals: bool = False,
) -> None: ...
def sample(
    levels: Sequence[Array], uv: Array, lod: Array, wrap_u: bool, wrap_v: bool, out: Array, stream: int = 0
) -> None: ...
def sample_backward(
    grad: Array,
    levels: Sequence[Array],
    uv: Array,
    lod: Array,
    wrap_u: bool,
    wrap_v: bool,
    level_grads: Sequence[Array],
    uv_grad: Array | None,
    lod_grad: Array | None,
    stream: int = 0,
) -> None: ...
