"""The text of docs/paper-figures.md, from the records `results-models`, `results-correlated` and `paper-pictures`.

`python docs/remake.py` writes it, and the histograms of figure 5 beside it. Figures of networks that were not measured
have no rows; figures without a record say that they were not measured.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from records.record import Record, load
from records.wrapping import wrapped_page
from results_page.charts import gain_histograms
from results_page.files import LINEAR, read
from results_page.tables import table

from mipbake.quality.metrics import PAIR_SETS
from mipbake.quality.metrics.snr import MAX_SNR_DB
from paper_page.cases import KINDS, LEAN, ON, SCALES, Kind, Verdict, beats, kinds, shown

MODELS = ("ggx", "beckmann")

Section = tuple[str, str, "Verdict | None", list[str]]
"""Number of a figure, the heading, whether the claim came out again, and the parts of the text."""

_INTRODUCTION = """\
Kemppinen, Aittala and Lehtinen 2023 show what their networks do in figures 3 to 11. This page makes these figures
again, with mipbake's re-implementation of the networks, and says for each whether the paper's claim came out again.
[Training](training.md#what-differs-from-the-paper) lists what differs in the networks. The [glossary](glossary.md)
explains the terms, and [sources](sources.md) has every other claim of the paper. `python docs/remake.py` makes this
page from records.

**The sets.** {sets} real texture sets that no training saw were converted, texel by texel, to the paper's two material
models. References use the same model, so differences between models do not count. *Boosted* sets are a little glossier
and bumpier, as the paper's are: alpha is multiplied by 0.78, and slopes by 1.1. `beckmann` also has {captured} sets of
[generated lobes](training.md#generated-materials-in-beckmann-lobes), which stand for the captures that the paper tests
on. Their seeds were not trained on.

**The methods.** *Naive averaging* is `linear (box)`, and *LEAN* is `lean (box)`. *MIPNet* is made from its description
and trained with the data and the loss of mipbake's default network, to the end of a schedule of {steps} steps
([benchmarks](../benchmarks/README.md), `mipnet.py`). *Paper's network* is `paper-ggx` or `paper-beckmann`. The *default
network* is mipbake's own for the same model.

**The measures.** Spheres under the studio's lights at levels of detail 0 (near), 3 (middle) and 7 (far), beside
supersampled references of up to {passes} samples a pixel, by SNR and FLIP. FLIP stands in for LPIPS, because LPIPS is
defined by trained weights that have to be downloaded.
"""

_CORRELATED = """\
A generated material has an albedo, an F0 and an anisotropic roughness that follow its normals. Slopes that face one way
are glossy; slopes that face the other way are rough and have another colour. A twin has the same channels, but its
normals are moved by half a period, so the values that meet in a texel meet by chance. The difference between the
columns says how a method takes channels that go together. The table has means over {pairs} sets and their twins and
over all levels of detail, in dB, for `ggx`.
"""

_REASONS = """\
A material that is the same everywhere needs no filter: every level is the material itself. What a network makes of it
is off by what the network loses when it encodes and decodes. Below are {texels} texels of every set, each as a texture
of its own, and the mean over sets of the SNR of what comes out. Averages are exact there, and so is a network that
changes averages alone, as the default one does. The paper's network has to carry every channel through its latent code,
and is off even where there is nothing to filter. That is what is seen near, where bumps are hardly averaged yet, and on
generated lobes. It is not all: on real sets MIPNet errs as much, in the lobes of coarser levels, and is ahead in the
middle and far away. It was trained with another loss. In an experiment
[under the paper's loss](research.md#under-the-papers-loss), a MIPNet of as many steps as these ends about level with
`paper-ggx` near the mirror, and behind it over the hemisphere, on held-out patches.
"""

_MISSING = "This was not measured with this version.\n"


def text(folder: Path, page: Path) -> str:
    """The page; its histograms are written beside it.

    Args:
        folder: of records. page: the file that it will be.
    """
    measured = {model: kinds(folder, model) for model in MODELS}
    pictures = load("paper-pictures", folder)
    seen: Mapping[str, Mapping[str, float]] = pictures.data if pictures else {}
    sections: list[Section] = [
        _figure_3(),
        _figure_4(seen),
        _figure_5(measured, page),
        _figure_6(measured, seen),
        _figure_8(seen),
        _figure_9(measured["beckmann"]),
        _figure_10(measured["ggx"]),
        _figure_11(folder),
    ]
    first = next((kind for each in measured.values() for kind in each.values()), None)
    captured = measured["beckmann"].get("captured")
    introduction = _INTRODUCTION.format(
        sets=len(first.results.sets) if first else 0,
        captured=len(captured.results.sets) if captured else 0,
        passes=first.results.files[0]["key"]["effort"]["passes"] if first else 0,
        steps=" and ".join(f"{steps:,}" for steps in _baseline_steps()),
    )
    rows = {
        f"[{number}](#{_anchor(title)})": [verdict.claim, _state(verdict)]
        for number, title, verdict, _ in sections
        if verdict is not None
    }
    parts = [
        "# The paper's figures, again\n",
        introduction,
        "## In short\n",
        table("figure", ["the paper's claim", "here"], rows),
        "Figure 7 has [a page of its own](figure-7.md).\n",
        *_reasons(load("constant-materials", folder)),
    ]
    for _, title, verdict, body in sections:
        parts += [f"## {title}\n", *body]
        if verdict is not None:
            parts.append(f"**The paper:** {verdict.claim} **Here:** {_state(verdict)}. {verdict.words}\n")
    return wrapped_page("\n".join(parts))


def _reasons(record: Record | None) -> list[str]:
    """Why the network stays behind, with the experiment that shows it."""
    if record is None:
        return []
    found: dict[tuple[str, str, str], dict[str, list[float]]] = {}
    for row in record.data["rows"]:
        cell = found.setdefault((row["model"], row["kind"], row["network"]), {pairs: [] for pairs in PAIR_SETS})
        cell[row["pairs"]].append(row["snr"])
    rows = {
        f"`{model}`, {KINDS[kind]}, {shown(network if network.startswith(('paper-', 'mipnet-')) else 'neural')}": [
            "exact" if min(snr) >= MAX_SNR_DB else f"{np.mean(snr):.1f} dB" for snr in cell.values()
        ]
        for (model, kind, network), cell in found.items()
    }
    return [
        "## Why the network stays behind\n",
        _REASONS.format(texels=record.data["texels"]),
        table("SNR of materials that are constant", ["near the mirror", "over the hemisphere"], rows),
    ]


def _baseline_steps() -> list[int]:
    """How many steps the weights of MIPNet have; one number where all have the same."""
    files = (Path(__file__).resolve().parent.parent / "baselines").glob("mipnet-*.json")
    return sorted({json.loads(file.read_text(encoding="utf-8"))["steps"] for file in files})


def _state(verdict: Verdict) -> str:
    return "reproduced" if verdict.holds else "not reproduced"


def _anchor(title: str) -> str:
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c == "-")


def _picture(figure: int, words: str) -> str:
    return f"![{words}](paper-figure-{figure}.webp)\n"


def _figure_3() -> Section:
    words = (
        "The first patch is a part of an example, boosted. The others are random augmentations of it, each a mixture "
        "of two, as trainings of `paper-ggx` see them.\n"
    )
    return "3", "Figure 3: augmentations", None, [_picture(3, "A patch and augmentations of it"), words]


def _figure_4(seen: Mapping[str, Mapping[str, float]]) -> Section:
    words = (
        "One column of pixels of a plane that turns by 0.1 degrees a frame, side by side, at levels of detail from 0 "
        "to 1. Below stands the flicker: how much pixels change from frame to frame, over how much they should.\n"
    )
    verdict = None
    if "4" in seen:
        verdict = _steadiest(
            "In motion its result changes as smoothly as the reference, and the others shimmer.", seen["4"]
        )
    return "4", "Figure 4: a slow rotation", verdict, [_picture(4, "Temporal slices of a slow rotation"), words]


def _steadiest(claim: str, flicker: Mapping[str, float]) -> Verdict:
    """Whether the flicker of the paper's network is nearest to 1."""
    off = {name: abs(np.log(value)) for name, value in flicker.items()}
    network = next(name for name in flicker if name.startswith("paper-"))
    way = "less" if flicker[network] < 1 else "more"
    words = (
        f"Flicker: {', '.join(f'{shown(name)} {value:.2f}' for name, value in flicker.items())}. This claim counts as "
        "reproduced where the flicker of the network is the nearest to 1 of these methods, by its ratio, on the one "
        f"material of the picture. The network changes {way} than it should."
    )
    return Verdict(claim, min(off, key=lambda name: off[name]) == network, words)


def _figure_5(measured: Mapping[str, Mapping[str, Kind]], page: Path) -> Section:
    title = "Figure 5: how far ahead"
    every = [kind for found in measured.values() for kind in found.values()]
    if not every:
        return "5", title, None, [_MISSING]
    parts = [
        "Each cell says how far the paper's network is ahead in the mean over sets, and in how many of them it is "
        "ahead. Better is positive in both measures.\n",
        table("model, sets, rival", [f"{measure}, {s}" for measure in ("SNR", "FLIP") for s in SCALES], _gains(every)),
    ]
    for kind in every:
        if kind.kind == "captured":
            continue
        words = f"{kind.network} {ON[kind.kind]}: ahead by"
        name = f"paper-figure-5-{kind.model}-{kind.kind}.svg"
        (page.parent / name).write_text(
            gain_histograms(kind.results, kind.network, kind.rivals, words), encoding="utf-8"
        )
        parts.append(f"![Histograms of how far {words}]({name})\n")
    parts.append(
        "The claim counts as reproduced where the network is ahead in the mean in every cell of naive averaging and of "
        "MIPNet.\n"
    )
    claim = "The network is ahead of naive averaging and of MIPNet at every scale, by both measures."
    rivals = [(kind, rival) for kind in every for rival in kind.rivals if rival != LEAN]
    return "5", title, beats(claim, rivals), parts


def _gains(every: Sequence[Kind]) -> dict[str, list[str]]:
    rows = {}
    for kind in every:
        for rival in kind.rivals:
            cells = []
            for measure in ("snr", "flip"):
                for scale in SCALES:
                    gain = kind.ahead(rival, measure, scale)
                    mean = f"{gain.mean():+.1f}" if measure == "snr" else f"{gain.mean():+.3f}"
                    cells.append(f"{mean}, {(gain > 0).sum()} of {gain.size}")
            rows[f"`{kind.model}`, {KINDS[kind.kind]}, {shown(rival)}"] = cells
    return rows


def _figure_6(measured: Mapping[str, Mapping[str, Kind]], seen: Mapping[str, Mapping[str, float]]) -> Section:
    parts = [
        _picture(6, "Change of a sphere under a shift by half a pixel"),
        "How much each pixel changes when the picture moves by half a pixel, near the viewer. Below stands the flicker "
        "of the sphere.\n",
    ]
    rows = {}
    for kind in (kind for found in measured.values() for kind in found.values()):
        for name in kind.methods:
            key = ("flicker", "near-mirror", "near"), ("flicker", "hemisphere", "near")
            if all((name, *each) in kind.results.figures for each in key):
                means = [float(np.exp(np.nanmean(np.log(kind.results.figures[(name, *each)])))) for each in key]
                rows[f"`{kind.model}`, {KINDS[kind.kind]}, {shown(name)}"] = [f"{mean:.2f}" for mean in means]
    if rows:
        heads = ["near the mirror", "over the hemisphere"]
        words = (
            "Over all sets, flicker under single lights at level of detail 0, where naive averaging, LEAN and MIPNet "
            "leave the source as it is. Above 1 a method changes more than it should:\n"
        )
        parts += [words, table("", heads, rows)]
    verdict = None
    if "6" in seen:
        verdict = _steadiest(
            "Under a shift by half a pixel the other methods change noisily, and the network does not.", seen["6"]
        )
    return "6", "Figure 6: a shift by half a pixel", verdict, parts


_STRUGGLES = 10.0
"""dB of a lobe beside the light that a pixel reflects, below which a method struggles."""


def _figure_8(seen: Mapping[str, Mapping[str, float]]) -> Section:
    verdict = None
    if "8" in seen:
        verdict = Verdict(
            "Where normals make several lobes, no lobe can match them, and all methods struggle.",
            max(seen["8"].values()) < _STRUGGLES,
            f"SNR of the lobe: {', '.join(f'{shown(name)} {snr:.1f} dB' for name, snr in seen['8'].items())}. A method "
            f"counts as struggling here where it has less than {_STRUGGLES:.0f} dB. This limit is a guess.",
        )
    words = "What one pixel of a knurled plate reflects, for every direction of the light, seen from above.\n"
    return "8", "Figure 8: several lobes in a pixel", verdict, [_picture(8, "Apparent BRDF of a pixel"), words]


def _figure_9(found: Mapping[str, Kind]) -> Section:
    claim = "LEAN, MIPNet and the network are about alike from two distances, ahead of naive averaging."
    return _overview("9", "Figure 9: the generalised Beckmann model", claim, found, [LEAN, "mipnet-beckmann"])


def _figure_10(found: Mapping[str, Kind]) -> Section:
    claim = "MIPNet and the network are about alike from far away, ahead of naive averaging."
    return _overview("10", "Figure 10: GGX", claim, found, ["mipnet-ggx"])


def _overview(number: str, title: str, claim: str, found: Mapping[str, Kind], peers: Sequence[str]) -> Section:
    """Materials of a model from two distances, and whether the network is alike to its peers."""
    parts = [_picture(int(number), "Materials from two distances")]
    if not found:
        return number, title, None, [*parts, _MISSING]
    means = [_means(kind) for kind in found.values()]
    return number, title, _alike(claim, list(found.values()), peers), [*parts, *means]


_ALIKE = 1.0
"""dB within which methods count as about alike. A guess: the paper compares pictures by eye."""


def _alike(claim: str, found: Sequence[Kind], peers: Sequence[str]) -> Verdict:
    """Whether the network is ahead of naive averaging, and no peer ahead of the network by more than `_ALIKE`, in the
    mean SNR of the middle and the far scale."""
    words, holds = [], True
    for kind in found:
        parts = []
        for scale in ("middle", "far"):
            naive = float(kind.ahead(LINEAR, "snr", scale).mean())
            others = {
                name: float(kind.ahead(name, "snr", scale).mean()) for name in peers if name in kind.results.methods
            }
            holds = holds and naive > 0 and all(gain > -_ALIKE for gain in others.values())
            gains = [f"{naive:+.1f} dB over {shown(LINEAR)}"]
            gains += [f"{gain:+.1f} dB over {shown(name)}" for name, gain in others.items()]
            parts.append(f"{scale}: {', '.join(gains)}")
        words.append(f"{ON[kind.kind]}, {'; '.join(parts)}")
    rule = (
        "This claim counts as reproduced where the network is ahead of naive averaging, and is behind none of the "
        f"other methods of the claim by {_ALIKE:.0f} dB or more, in the mean SNR of each kind of sets at both scales. "
        "This limit is a guess: the paper compares pictures by eye."
    )
    return Verdict(claim, holds, f"The network {'; '.join(words)}. {rule}")


def _means(kind: Kind) -> str:
    """Mean SNR and FLIP of every method; the best of a column is bold."""
    scales = ("middle", "far")
    snr, flip = (
        np.array([[float(np.nanmean(kind.values(name, measure, s))) for s in scales] for name in kind.methods])
        for measure in ("snr", "flip")
    )
    rows = {}
    for index, name in enumerate(kind.methods):
        cells = []
        for column in range(len(scales)):
            first, second = f"{snr[index, column]:.1f} dB", f"{flip[index, column]:.3f}"
            first = f"**{first}**" if snr[index, column] == snr[:, column].max() else first
            second = f"**{second}**" if flip[index, column] == flip[:, column].min() else second
            cells.append(f"{first} / {second}")
        rows[shown(name)] = cells
    return table(f"SNR / FLIP, {KINDS[kind.kind]}", scales, rows)


def _figure_11(folder: Path) -> Section:
    title = "Figure 11: channels that go together"
    parts = [_picture(11, "A material whose channels go together")]
    together = read(folder, "correlated", lambda file: file["together"])
    apart = read(folder, "correlated", lambda file: not file["together"])
    if together is None or apart is None:
        return "11", title, None, [*parts, _MISSING]
    rows, gained = {}, {}
    for name in together.methods:
        cells, differences = [], []
        for pairs in PAIR_SETS:
            first, second = (
                float(np.mean([each.curve[name, pairs, lod] for lod in each.lods])) for each in (together, apart)
            )
            differences.append(first - second)
            cells += [f"{first:.1f}", f"{second:.1f}", f"{first - second:+.1f}"]
        gained[name] = float(np.mean(differences))
        rows[shown(name)] = cells
    places = ("near the mirror", "over the hemisphere")
    heads = [f"{place}: {one}" for place in places for one in ("correlated", "twin", "difference")]
    rivals = [name for name in gained if name in (LINEAR, LEAN) or name.startswith("mipnet-")]
    network = gained["paper-ggx"]
    holds = all(network > gained[name] for name in rivals)
    words = ", ".join(f"{shown(name)} {gained[name]:+.1f} dB" for name in (*rivals, "paper-ggx"))
    verdict = Verdict(
        "Where channels go together, the network alone takes this into account.",
        holds,
        f"What a method gains where channels go together, over the twins: {words}. This claim counts as reproduced "
        "where the network gains more than each of the others.",
    )
    return "11", title, verdict, [*parts, _CORRELATED.format(pairs=len(together.sets)), table("", heads, rows)]
