"""What a search goes on from, as arrays and as what JSON holds: its start, and a region that is not done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.search.blending import Blend, judging_renders
from mipbake.baking.search.ingredients import Rival
from mipbake.baking.search.texel_descent import RegionState, TexelState
from mipbake.quality.judging.judge import Asked, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.weights import Weights
from mipbake.quality.reference.problem import Image, Problem

Arrays = dict[str, NDArray[Any]]

_ASKED = ("log_errors", "pooled", "seen")


@dataclass(frozen=True, eq=False)
class Parts:
    """Something as arrays by name, and the rest of it as JSON holds it."""

    arrays: Mapping[str, NDArray[Any]]
    about: Mapping[str, Any]

    @property
    def bytes(self) -> int:
        """Size of the arrays."""
        return sum(array.nbytes for array in self.arrays.values())


@dataclass(frozen=True, eq=False)
class Come:
    """How far a descent has come.

    Args:
        done: indices of the regions that are done.
        at: index of the region that is at work. state: how far it is; None where it has not begun.
    """

    done: tuple[int, ...]
    at: int
    state: RegionState | None = None


def name_of(level: int) -> str:
    """What the array of a level is called."""
    return f"level {level}"


def start_parts(start: Blend) -> Parts:
    """All of a start that its problem and its seed do not say."""
    arrays: Arrays = {name_of(index): level for index, level in enumerate(start.levels)}
    for index, asked in enumerate(start.judge.asked):
        arrays |= {f"asked {index} {name}": getattr(asked, name) for name in _ASKED}
        if asked.plain is not None:
            arrays[f"asked {index} plain"] = asked.plain
    for index, rivals in enumerate(start.witnessed):
        arrays |= {f"witnessed {index} {number}": each.log_errors for number, each in enumerate(rivals)}
    arrays["plain"] = start.plain
    if start.typical is not None:
        arrays["typical"] = start.typical
    about = {
        "sources": start.sources,
        "left_out": start.left_out,
        "witnessed": [[each.name for each in rivals] for rivals in start.witnessed],
    }
    return Parts(arrays, about)


def start_of(parts: Parts, problem: Problem, effort: ProbeEffort, judged_by: Weights, seed: int) -> Blend:
    """The start of `start_parts`. KeyError where something is missing."""
    arrays, about = parts.arrays, parts.about
    check, witness = judging_renders(problem, effort, seed)
    asked = [
        Asked(
            arrays[f"asked {index} log_errors"],
            arrays[f"asked {index} pooled"],
            arrays[f"asked {index} seen"],
            arrays.get(f"asked {index} plain"),
        )
        for index in range(len(check.lods))
    ]
    witnessed = [
        [Rival(name, arrays[f"witnessed {index} {number}"]) for number, name in enumerate(names)]
        for index, names in enumerate(about["witnessed"])
    ]
    levels: list[Image] = [arrays[name_of(index)] for index in range(len(problem.sizes))]
    sources = [tuple(names) for names in about["sources"]]
    judge = Judge(asked, judged_by)
    left_out = tuple(about["left_out"])
    renders = judge, check, witness
    return Blend(levels, sources, *renders, witnessed, arrays["plain"], left_out, arrays.get("typical"))


def state_parts(state: RegionState) -> Parts:
    """A region that is not done."""
    arrays = {
        f"{level} {each.name}": getattr(texels, each.name)
        for level, texels in state.texels.items()
        for each in fields(TexelState)
    }
    about = {
        "rounds": state.rounds,
        "still": state.still,
        "least": state.least,
        "rng": state.rng,
        "seconds": state.seconds,
        "texels": list(state.texels),
    }
    return Parts(arrays, about)


def state_of(parts: Parts) -> RegionState:
    """The region of `state_parts`. KeyError or TypeError where something is missing."""
    about = parts.about
    texels = {
        int(level): TexelState(**{each.name: parts.arrays[f"{level} {each.name}"] for each in fields(TexelState)})
        for level in about["texels"]
    }
    np.random.default_rng().bit_generator.state = about["rng"]  # raises where it is no state of a generator
    return RegionState(
        int(about["rounds"]), int(about["still"]), float(about["least"]), about["rng"], float(about["seconds"]), texels
    )
