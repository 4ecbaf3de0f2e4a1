"""What a report calls methods and distances."""

from __future__ import annotations

from collections.abc import Mapping

from mipbake.baking.methods import METHODS
from mipbake.comparing.result import LINEAR, Comparison
from mipbake.stack.verdict import distance_of

PLAIN, OURS = "plain MIP maps", "mipbake"

DISTANCES: Mapping[str, str] = {"near": "Near", "middle": "Middle distance", "far": "Far"}
"""What a reader is shown as a distance, by the name of a scale."""


def called(comparison: Comparison, name: str) -> str:
    """What a reader is shown as the name of a method: `linear (box)` is plain MIP maps, and a subject that is no closed
    form, nor an opened stack of one, is mipbake."""
    if name == LINEAR:
        return PLAIN
    methods = [each.method for each in comparison.methods if each.name == name == comparison.subject]
    return OURS if methods and not (methods[0] in METHODS and METHODS[methods[0]].averages) else name


def distance(lod: float) -> str:
    """What a reader is shown as the distance of a surface whose median level of detail is `lod`."""
    return DISTANCES[distance_of(lod)]
