"""Forward-mode derivatives, which the torch ops do not have: an error in place of tangents that are silently lost."""

from __future__ import annotations

from typing import Any

from mipbake.base.errors import UsageError

__all__ = ["refuse_tangents"]


def refuse_tangents(**arguments: Any) -> None:
    """UsageError where an argument is a dual tensor of torch.autograd.forward_ad or torch.func.jvp.

    torch calls an op that has no formula for tangents as if there were none, unless an argument requires a gradient.
    """
    import torch
    from torch.autograd.forward_ad import unpack_dual

    if torch.compiler.is_compiling():
        return
    for name, tensor in arguments.items():
        if isinstance(tensor, torch.Tensor) and unpack_dual(tensor).tangent is not None:  # type: ignore[no-untyped-call]
            raise UsageError(
                f"{name} has a forward-mode tangent: expected none, because this op has reverse-mode derivatives "
                "only; use torch.autograd.grad or backward()"
            )
