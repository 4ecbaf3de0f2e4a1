"""Cases of the paper's comparisons: a method beside a rival, on every set of a kind, at every scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from results_page.files import LINEAR, Results, read

SCALES = ("near", "middle", "far")
LEAN = "lean (box)"
KINDS = {"plain": "as they are", "boosted": "boosted", "captured": "generated lobes"}
"""Kinds of sets, and what tables call them."""

ON = {"plain": "on sets as they are", "boosted": "on boosted sets", "captured": "on generated lobes"}
"""The same in sentences."""

NAMES = {"neural": "default network", LINEAR: "naive averaging", LEAN: "LEAN", "paper-cross": "cross-trained network"}
"""Names of methods in tables; names of networks that are for one model follow `shown`."""


def shown(name: str) -> str:
    """What tables call a method."""
    if name.startswith("mipnet-"):
        return "MIPNet"
    return NAMES.get(name, "paper's network" if name.startswith("paper-") else name)


@dataclass(frozen=True)
class Kind:
    """What was measured of one material model on one kind of sets.

    Args:
        model: `ggx` or `beckmann`. kind: of sets, in KINDS.
        results: of all methods.
    """

    model: str
    kind: str
    results: Results

    @property
    def network(self) -> str:
        """The paper's network of this model."""
        return f"paper-{self.model}"

    @property
    def rivals(self) -> list[str]:
        """What the paper compares with, as far as it was measured."""
        return [name for name in (LINEAR, LEAN, f"mipnet-{self.model}") if name in self.results.methods]

    @property
    def methods(self) -> list[str]:
        """The paper's rivals and network, and then the others."""
        first = [*self.rivals, self.network]
        return [*first, *(name for name in self.results.learned if name not in first)]

    def values(self, name: str, measure: str, scale: str) -> np.ndarray:
        """A figure a set, of spheres."""
        return self.results.figures[name, measure, "sphere", scale]

    def ahead(self, rival: str, measure: str, scale: str) -> np.ndarray:
        """How much better the network is than a rival, a figure a set: in dB, or in FLIP."""
        own, other = (self.values(name, measure, scale) for name in (self.network, rival))
        return np.asarray(own - other if measure == "snr" else other - own)


def kinds(folder: Path, model: str) -> Mapping[str, Kind]:
    """Kinds of sets that a record has of a model, by name."""
    found = {}
    for kind in KINDS:
        results = read(folder, "models", lambda file, kind=kind: (file["model"], file["kind"]) == (model, kind))  # type: ignore[misc]
        if results is not None and f"paper-{model}" in results.methods:
            found[kind] = Kind(model, kind, results)
    return found


@dataclass(frozen=True)
class Verdict:
    """Whether a claim of the paper came out again.

    Args:
        claim: the paper's, in our words.
        holds: whether it holds here.
        words: the figures that say so.
    """

    claim: str
    holds: bool
    words: str


def beats(claim: str, compared: Sequence[tuple[Kind, str]], measures: Sequence[str] = ("snr", "flip")) -> Verdict:
    """Whether the network is ahead of rivals in the mean at every scale and in every measure, and in how many cases."""
    won: dict[tuple[str, str], list[np.ndarray]] = {}
    holds = True
    for kind, rival in compared:
        for measure in measures:
            gains = [kind.ahead(rival, measure, scale) for scale in SCALES]
            holds = holds and all(gain.mean() > 0 for gain in gains)
            won.setdefault((shown(rival), measure), []).extend(gain > 0 for gain in gains)
    words = []
    for rival in dict.fromkeys(name for name, _ in won):
        shares = {measure: np.concatenate(won[rival, measure]) for measure in measures}
        found_words = " and ".join(
            f"{share.mean():.0%} of {share.size} cases in {m.upper()}" for m, share in shares.items()
        )
        words.append(f"It is ahead of {rival} in {found_words}.")
    return Verdict(claim, holds, " ".join(words))
