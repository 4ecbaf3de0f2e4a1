"""Making one sentence of what a library says."""

from __future__ import annotations


def one_line(message: str, otherwise: str = "no reason given") -> str:
    """The first line of an error message, without the full stop; `otherwise` where there is none."""
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return lines[0].rstrip(".") if lines else otherwise
