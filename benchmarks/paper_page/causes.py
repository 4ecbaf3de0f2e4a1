"""What explains that figures 5, 9, 10 and 11 come out otherwise: text and tables of the records `causes` and
`mipnet-losses`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from records.record import load
from records.wrapping import table
from results_page.files import LINEAR

from mipbake.quality.metrics import PAIR_SETS
from paper_page.cases import KINDS, LEAN, SCALES, Kind, shown

Row = Mapping[str, Any]

NAMES = {"real": "real sets", "lobes": "generated lobes", "sharp": "sharp lobes"}
MEASURES = {"snr": "SNR", "flip": "FLIP", "st-lpips": "ST-LPIPS"}

PAPERS: Mapping[str, Mapping[str, Sequence[Sequence[float]]]] = {
    "beckmann": {
        LINEAR: ((-2.68, -9.48, -8.80, 5.15, -2.88), (-5.10, -11.23, -10.39, 6.01, -2.12)),
        LEAN: ((2.39, 3.27, 2.71, 5.75, 8.50), (5.32, 6.38, 2.80, 8.60, 14.50)),
        "mipnet-beckmann": ((2.89, 1.01, 0.38, 6.15, 7.22), (6.49, 3.05, 3.06, 8.21, 13.68)),
        "paper-beckmann": ((2.75, 3.46, 2.59, 6.18, 6.89), (5.50, 6.27, 4.06, 8.80, 14.03)),
    },
    "ggx": {
        LINEAR: ((-3.77, 6.34, 12.29), (-4.29, 7.31, 13.06)),
        "mipnet-ggx": ((5.43, 15.79, 19.59), (9.00, 17.74, 22.87)),
        "paper-ggx": ((5.61, 14.93, 19.12), (12.10, 15.22, 22.49)),
    },
}
"""SNR in dB that the paper prints in its figures 9 and 10: model to method to the closer and the farther view of every
material."""


_SHARP = """\
**What explains it: {what}.** The paper's pictures print how far naive averaging is off, which says how sharp and
bumpy its materials are. Below is the same of real sets, of generated lobes and of *sharp lobes*: generated materials
with alpha from 0.03 to 0.1, strong anisotropy, and an albedo, an F0 and an anisotropy that follow the normals. All are
{texels} x {texels} texels. *Boosted* is as above, and again and again.
"""

_WHAT = {"beckmann": "the materials", "ggx": "in part the materials"}

_SHARP_WORDS = {
    "beckmann": """\
On real sets and on generated lobes naive averaging has more SNR than the paper prints, so there is little to gain. The
sharper the materials are, the nearer the order comes to the paper's: naive averaging falls far behind, and the network
catches up with MIPNet. What remains open is the lead of MIPNet on generated lobes and on sharp lobes that are less
sharp; there the network loses what its latent code loses ([above](#why-the-network-stays-behind)).
""",
    "ggx": """\
So the materials explain that naive averaging is no worse here. They do not explain the lead of MIPNet, which remains on
sharp lobes. A part of it may be its loss ([figure 5](#figure-5-how-far-ahead)), and the rest remains open. Which sets
are taken decides, too: on the real sets of this table, boosted at most once, the network is not behind MIPNet. The
paper shows three.
""",
}

_MEASURES = """\
**What explains it: the materials, the measure and the lights, and perhaps MIPNet's loss.** How far the network is ahead
on the spheres of [figure 9](#figure-9-the-generalised-beckmann-model) and [figure 10](#figure-10-ggx), boosted once;
better is positive. ST-LPIPS is shift-tolerant LPIPS (Ghildyal and Liu 2022), a relative of LPIPS whose backbone is to
be had.
"""

_AGREE = """\
The materials: on sharp lobes the network is far ahead of naive averaging in SNR at every scale, as in the paper. The
measure: near the viewer FLIP finds the network behind on real sets and generated lobes, and ST-LPIPS finds it ahead of
every rival there. Spearman's rank correlation of the two is {every:.2f} over all pictures, and {within:.2f} in the mean
over the methods of one sphere. FLIP compares colours pixel by pixel, so a tint that the latent code leaves counts. For
ST-LPIPS it hardly counts. MIPNet stays ahead in the middle and far away on sharp lobes.
"""

_LODS = (0.0, 3.0, 7.0)
"""Levels of detail of texture space that are shown as SCALES."""

_LIGHTS = """\
The network is trained under single lights over the hemisphere. Under these, how far it is ahead, in dB:
"""

_LIGHTS_WORDS = """\
So on real sets the network has learned what it was trained for: it is ahead of naive averaging at every scale. In the
studio, whose lights are large, it is even or behind near the viewer. So a part of the difference is the lights.
"""

_LOSS = """\
MIPNet's weights were trained here with the loss of `mipbake-1`, which weighs each level, pair set and patch by
its own error. Its authors compare tonemapped renders. Below is what {steps} steps with its authors' loss and with the
paper's make of it, all from plain averages with the same batches: SNR in dB on held-out patches of real sets. Noisy
references have one sample, and the others 16. Plain averages have {averages}.
"""

_LOSS_WORDS = """\
The paper's loss brings MIPNet {gain} dB more than its authors' loss. So a part of its lead here may be that it was
not trained as its authors trained it. Noisy references change its authors' loss by {noise} dB, and the paper's
loss by {paper_noise} dB. A whole training may leave less of these differences, or more.
"""

_TWINS = """\
The same with sharp lobes: alpha from 0.03 to 0.1 in place of 0.12 to 0.35, and more than twice the anisotropy. The
table has the SNR where channels go together, in dB, and the gain over the twins, over {count} sets.
"""

_TWINS_WORDS = """\
**What explains it.** Sharpness does not: on sharp lobes, too, the network gains hardly more than MIPNet where channels
go together, and naive averaging, which is far off, gains most. LEAN, MIPNet and the network are about alike on sharp
materials whose channels go together. MIPNet averages albedo and F0 by themselves, and still has what the network has,
because one lobe for all that a texel covers loses more than a colour that should go with it. Why MIPNet and LEAN fail
on the paper's material remains open; that material is not to be had.
"""


ALIKE = 1.0
"""dB within which methods count as about alike. A guess: the paper compares pictures by eye."""


def causes(folder: Path, every: Sequence[Kind]) -> Mapping[str, list[str]]:
    """Number of a figure to what its section says of causes; nothing where the record `causes` is missing.

    Args:
        folder: of records. every: what was measured of each model on each kind of sets.
    """
    record = load("causes", folder)
    if record is None:
        return {}
    spheres, losses = record.data["spheres"], load("mipnet-losses", folder)
    return {
        "5": [*_measures(spheres), *_lights(every), *(_loss(losses.data) if losses else [])],
        "9": _sharp(spheres, "beckmann", record.data["texels"]),
        "10": _sharp(spheres, "ggx", record.data["texels"]),
        "11": _twins(record.data["twins"]),
    }


def _mean(rows: Sequence[Row], method: str, **wanted: object) -> float:
    """The mean figure of a method over the rows whose fields are as wanted; NaN where there is none."""
    found = [row["values"][method] for row in rows if all(row[name] == each for name, each in wanted.items())]
    return fmean(found) if found else float("nan")


def _sharp(rows: Sequence[Row], model: str, texels: int) -> list[str]:
    """SNR of the paper's methods on ever sharper materials, beside what the paper prints."""
    papers = PAPERS[model]
    printed = (_pair(fmean(view) for view in papers.get(name, ())) for name in _methods(model))
    lines = [["the paper's, closer / farther", *printed]]
    own = [row for row in rows if row["model"] == model and row["measure"] == "snr"]
    for kind, boosts in dict.fromkeys((row["kind"], row["boosts"]) for row in own):
        cells = [
            _pair(_mean(own, name, kind=kind, boosts=boosts, scale=scale) for scale in ("middle", "far"))
            for name in _methods(model)
        ]
        lines.append([f"{NAMES[kind]}, {_boosted(boosts)}", *cells])
    heads = ["SNR of spheres, middle / far", *(shown(name) for name in _methods(model))]
    rivals = [index for index, name in enumerate(_methods(model)[:-1]) if name in papers]
    held = [_boosted(boosts) for boosts in dict.fromkeys(row["boosts"] for row in own) if _alike(own, boosts, rivals)]
    verdict = f"holds on sharp lobes {', and '.join(held)}" if held else "does not hold on sharp lobes, however boosted"
    words = f"By the rule above the claim {verdict}.\n"
    return [_SHARP.format(texels=texels, what=_WHAT[model]), table(heads, lines) + "\n", words, _SHARP_WORDS[model]]


def _alike(rows: Sequence[Row], boosts: int, rivals: Sequence[int]) -> bool:
    """Whether the claim of figures 9 and 10 holds on sharp lobes: ahead of naive averaging, not behind the others."""
    for rival, scale in product(rivals, ("middle", "far")):
        at = ("sharp", boosts, scale)
        gains = [_gain(row, rival) for row in rows if (row["kind"], row["boosts"], row["scale"]) == at]
        if not gains or fmean(gains) <= (0 if rival == 0 else -ALIKE):
            return False
    return True


def _methods(model: str) -> list[str]:
    return [LINEAR, LEAN, f"mipnet-{model}", f"paper-{model}"]


def _pair(values: Any) -> str:
    return " / ".join(f"{value:.1f}" for value in values) or "not printed"


def _boosted(boosts: int) -> str:
    return {0: "as they are", 1: "boosted"}.get(boosts, f"boosted {boosts} times")


def _measures(rows: Sequence[Row]) -> list[str]:
    """How far the network is ahead by three measures, and whether these agree."""
    lines = []
    for kind, index in product(NAMES, range(3)):
        cells = []
        for measure, scale in product(MEASURES, SCALES):
            gains = [
                _gain(row, index)
                for row in rows
                if (row["kind"], row["boosts"], row["measure"], row["scale"]) == (kind, 1, measure, scale)
            ]
            cells.append(f"{fmean(gains):+.{1 if measure == 'snr' else 3}f}")
        lines.append([f"{NAMES[kind]}, {shown(_methods('ggx')[index])}", *cells])
    heads = ["sets, rival", *(f"{MEASURES[measure]}, {scale}" for measure, scale in product(MEASURES, SCALES))]
    every, within = _agreement(rows)
    return [_MEASURES, table(heads, lines) + "\n", _AGREE.format(every=every, within=within)]


def _gain(row: Row, rival: int) -> float:
    """How far the network is ahead of a rival in a row; better is positive."""
    *rivals, network = (row["values"][name] for name in _methods(row["model"]))
    return float(network - rivals[rival]) if row["measure"] == "snr" else float(rivals[rival] - network)


def _agreement(rows: Sequence[Row]) -> tuple[float, float]:
    """Spearman's rank correlation of FLIP and ST-LPIPS over all pictures, and its mean over methods of one sphere."""
    pictures: dict[tuple[Any, ...], dict[str, Mapping[str, float]]] = {}
    for row in rows:
        sphere = tuple(row[name] for name in ("model", "kind", "boosts", "set", "scale"))
        pictures.setdefault(sphere, {})[row["measure"]] = row["values"]
    pairs = [
        np.array([[each["flip"][name], each["st-lpips"][name]] for name in each["flip"]]) for each in pictures.values()
    ]
    every = np.concatenate(pairs)
    return _by_rank(every), fmean(_by_rank(pair) for pair in pairs)


def _by_rank(pairs: np.ndarray) -> float:
    """Spearman's rank correlation of the two columns."""
    ranks = pairs.argsort(0).argsort(0)
    return float(np.corrcoef(ranks.T)[0, 1])


def _lights(every: Sequence[Kind]) -> list[str]:
    """How far the network is ahead under the lights that it was trained under."""
    lines = []
    for kind in every:
        curve = kind.results.curve
        for rival in kind.rivals:
            gains = (curve[kind.network, "hemisphere", lod] - curve[rival, "hemisphere", lod] for lod in _LODS)
            lines.append([f"`{kind.model}`, {KINDS[kind.kind]}, {shown(rival)}", *(f"{g.mean():+.1f}" for g in gains)])
    return (
        [_LIGHTS, table(["single lights over the hemisphere", *SCALES], lines) + "\n", _LIGHTS_WORDS] if lines else []
    )


def _loss(data: Mapping[str, Any]) -> list[str]:
    """What the losses make of MIPNet."""

    def snr(found: Mapping[str, float], method: str) -> list[str]:
        return [f"{found[f'{method} {pairs}']:.2f}" for pairs in PAIR_SETS]

    rows = [[name, *snr(found, "network")] for name, found in data["snr"].items()]
    averages = " / ".join(snr(next(iter(data["snr"].values())), "linear"))
    words = _LOSS.format(steps=data["steps"], averages=averages)

    def beyond(name: str, other: str, sign: str) -> str:
        own, less = (data["snr"][each] for each in (name, other))
        return " / ".join(f"{own[f'network {pairs}'] - less[f'network {pairs}']:{sign}.2f}" for pairs in PAIR_SETS)

    authors, papers = "its authors' loss", "the paper's loss"
    noise, paper_noise = (beyond(f"{name}, noisy references", name, "+") for name in (authors, papers))
    shown_rows = table(["MIPNet", "near the mirror", "over the hemisphere"], rows) + "\n"
    gains = _LOSS_WORDS.format(gain=beyond(papers, authors, ""), noise=noise, paper_noise=paper_noise)
    return [words, shown_rows, gains]


def _twins(rows: Sequence[Row]) -> list[str]:
    """Twins with the lobes that they have, and with sharp ones."""
    lines = []
    for name in rows[0]["values"]:
        cells = []
        for sharp, pairs in product((False, True), PAIR_SETS):
            together, apart = (_mean(rows, name, sharp=sharp, pairs=pairs, together=each) for each in (True, False))
            cells.append(f"{together:.1f} ({together - apart:+.1f})")
        lines.append([shown(name), *cells])
    where = ("near the mirror", "over the hemisphere")
    heads = ["SNR, dB (gain over twins)", *(f"{lobes}, {place}" for lobes in ("as above", "sharp") for place in where)]
    return [_TWINS.format(count=len({row["seed"] for row in rows})), table(heads, lines) + "\n", _TWINS_WORDS]
