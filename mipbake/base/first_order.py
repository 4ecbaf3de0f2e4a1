"""Derivatives that the torch ops do not have: an error in place of tangents that are silently lost, and a sentence for
derivatives of derivatives."""

from __future__ import annotations

from typing import Any

from mipbake.base.errors import UsageError

__all__ = ["refuse_second_derivatives", "refuse_tangents"]


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


def refuse_second_derivatives(backward: Any, op: str) -> None:
    """Makes a backward op raise UsageError where its own gradient is wanted.

    Args:
        backward: of `torch.library.custom_op`. op: what users call the op that it is the gradient of.
    """

    def refuse(*_: Any) -> Any:
        raise UsageError(
            f"{op} has first derivatives only, and a derivative of its gradient is wanted: expected a loss without "
            "gradients of gradients; leave create_graph out, or detach() the gradient"
        )

    backward.register_autograd(refuse)
