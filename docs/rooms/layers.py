"""Drawing a graph without circles in layers: where its boxes lie, and the ways of its arrows (Sugiyama et al. 1981)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

Graph = Mapping[str, Sequence[str]]
"""Box to the boxes that it points at, each of which stands before it."""

_ROUNDS = 40


@dataclass(frozen=True)
class Layout:
    """Where boxes and arrows lie.

    Args:
        layers: the lowest first: boxes, and the places where arrows pass, from left to right.
        x: place of each box and of each passing, in pixels.
        ways: each arrow as what it passes, box to box.
    """

    layers: Sequence[Sequence[str]]
    x: Mapping[str, float]
    ways: Sequence[Sequence[str]]


def reduced(graph: Graph) -> dict[str, list[str]]:
    """The graph without arrows from which a longer way leads to the same box."""
    beyond: dict[str, set[str]] = {}
    found = {}
    for box, goals in graph.items():
        further = {each for goal in goals for each in beyond[goal]}
        found[box] = [goal for goal in goals if goal not in further]
        beyond[box] = {*goals, *further}
    return found


def laid_out(graph: Graph, widths: Mapping[str, float], gap: float) -> Layout:
    """Lays out boxes of these widths, `gap` apart; arrows that pass a layer take a place in it."""
    ranks = _ranks(graph)
    layers: list[list[str]] = [[] for _ in range(max(ranks.values()) + 1)]
    for box, rank in ranks.items():
        layers[rank].append(box)
    ways = []
    for box, goals in graph.items():
        for goal in goals:
            passed = [f"{box} {goal} {rank}" for rank in range(ranks[box] - 1, ranks[goal], -1)]
            for rank, each in zip(range(ranks[box] - 1, ranks[goal], -1), passed, strict=True):
                layers[rank].append(each)
            ways.append([box, *passed, goal])
    up: dict[str, list[str]] = {each: [] for layer in layers for each in layer}
    down: dict[str, list[str]] = {each: [] for layer in layers for each in layer}
    for way in ways:
        for above, below in pairwise(way):
            down[above].append(below)
            up[below].append(above)
    layers = _ordered(layers, up, down)
    return Layout(layers, _places(layers, up, down, widths, gap), ways)


def _ranks(graph: Graph) -> dict[str, int]:
    """A box lies above all that it points at, and right below what points at it where more does than it points at."""
    ranks: dict[str, int] = {}
    for box, goals in graph.items():
        ranks[box] = 1 + max((ranks[goal] for goal in goals), default=-1)
    for box in reversed(graph):
        above = [ranks[other] for other, goals in graph.items() if box in goals]
        if len(above) > len(graph[box]):
            ranks[box] = min(above) - 1
    return ranks


def _ordered(layers: list[list[str]], up: Graph, down: Graph) -> list[list[str]]:
    """Sorted by the mean place of neighbours, upwards and downwards in turn; the order with the fewest crossings."""
    best, fewest = layers, math.inf
    for turn in range(_ROUNDS):
        near, places = (down, range(1, len(layers))) if turn % 2 == 0 else (up, range(len(layers) - 2, -1, -1))
        for index in places:
            other = layers[index - 1 if turn % 2 == 0 else index + 1]
            at = {each: place for place, each in enumerate(other)}
            middle = {
                each: math.fsum(at[o] for o in near[each]) / len(near[each]) if near[each] else place
                for place, each in enumerate(layers[index])
            }
            layers = [*layers[:index], sorted(layers[index], key=middle.__getitem__), *layers[index + 1 :]]
        crossings = sum(_crossings(high, low, down) for low, high in pairwise(layers))
        if crossings < fewest:
            best, fewest = layers, crossings
    return best


def _crossings(high: Sequence[str], low: Sequence[str], down: Graph) -> int:
    at = {each: place for place, each in enumerate(low)}
    ends = [at[goal] for each in high for goal in sorted(down[each], key=at.__getitem__)]
    return sum(a > b for index, a in enumerate(ends) for b in ends[index + 1 :])


def _places(
    layers: Sequence[Sequence[str]], up: Graph, down: Graph, widths: Mapping[str, float], gap: float
) -> dict[str, float]:
    """Each as near to the mean of its neighbours as its layer has room; arrows that pass pull the most."""
    x = {each: float(index * gap) for layer in layers for index, each in enumerate(layer)}
    for turn in range(_ROUNDS):
        for layer in layers if turn % 2 == 0 else layers[::-1]:
            wanted = [
                math.fsum(x[other] for other in near) / len(near) if (near := [*up[each], *down[each]]) else x[each]
                for each in layer
            ]
            weights = [1.0 if each in widths else 4.0 for each in layer]
            half = [widths.get(each, 0.0) / 2 for each in layer]
            apart = [0.0, *(a + b + gap for a, b in pairwise(half))]
            x.update(zip(layer, _apart(wanted, weights, apart), strict=True))
    left = min(x[each] - widths.get(each, 0.0) / 2 for each in x)
    return {each: place - left for each, place in x.items()}


def _apart(wanted: Sequence[float], weights: Sequence[float], apart: Sequence[float]) -> list[float]:
    """The places nearest to what is wanted, least squares, each at least `apart` from the one before: neighbours that
    are too near are pooled (Ayer et al. 1955)."""
    start, pools = 0.0, list[tuple[float, float, int]]()
    offsets = []
    for place, weight, distance in zip(wanted, weights, apart, strict=True):
        start += distance
        offsets.append(start)
        mean, total, count = place - start, weight, 1
        while pools and pools[-1][0] > mean:
            before, heavy, several = pools.pop()
            mean = (mean * total + before * heavy) / (total + heavy)
            total, count = total + heavy, count + several
        pools.append((mean, total, count))
    means = [mean for mean, _, count in pools for _ in range(count)]
    return [mean + offset for mean, offset in zip(means, offsets, strict=True)]
