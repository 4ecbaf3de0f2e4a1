"""Blocks of the cards of released weights: what was measured under each pixel filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from mipbake.models.registry import list_weights
from mipbake.quality.metrics import PAIR_SETS
from records.record import Missing
from records.results import File, unpack
from records.wrapping import table, wrapped

if TYPE_CHECKING:
    from records.record import Records


def by_filter(weights: str) -> Callable[[Records], str]:
    """What a card says of default weights: mean SNR under every pixel filter that they are for."""

    def view(records: Records) -> str:
        files = [
            file
            for file in unpack(records["results-filters"])
            if any(m["name"] == "neural" and m["weights"] == weights for m in file["methods"])
        ]
        if not files:
            raise Missing(weights)
        sets, side = sorted({file["set"] for file in files}), files[0]["crop"]
        parts = [
            wrapped(
                f"The middle {side} x {side} texels of {len(sets)} test sets were measured under every pixel filter. "
                "Figures are mean SNR in dB over sets and levels of detail. The best of four is an oracle: for every "
                "set and level it is the best of `linear` and `lean`, each with the box and with the pixel filter."
            )
        ]
        for target in dict.fromkeys(file["model"] for file in files):
            rows = [
                [name, *_means([file for file in files if (file["model"], file["kind"]) == (target, name)])]
                for name in dict.fromkeys(file["kind"] for file in files)
            ]
            heads = [f"{who}, {_PLACES[pairs]}" for pairs in PAIR_SETS for who in ("network", "best of four")]
            parts.append(table([f"target `{target}`, pixel filter", *heads], rows))
        return "\n\n".join(parts)

    return view


_PLACES = {"near-mirror": "near the mirror", "hemisphere": "over the hemisphere"}


def _means(files: Sequence[File]) -> list[str]:
    """Mean SNR of the network and of the best of the others, for each pair set."""
    cells = []
    for pairs in PAIR_SETS:
        own, best = [], []
        for file in files:
            found: dict[float, dict[str, float]] = {}
            for figure in file["curve"]:
                if figure["view"] == pairs and figure["value"] is not None:
                    found.setdefault(figure["lod"], {})[figure["method"]] = figure["value"]
            own += [each["neural"] for each in found.values()]
            best += [max(value for name, value in each.items() if name != "neural") for each in found.values()]
        cells += [f"{sum(each) / len(each):.1f}" for each in (own, best)]
    return cells


CARD_VIEWS: Mapping[str, Callable[[Records], str]] = {
    f"results-filters/{info.name}": by_filter(info.name) for info in list_weights() if info.default
}
