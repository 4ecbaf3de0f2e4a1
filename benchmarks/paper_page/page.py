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
from records.wrapping import table, wrapped_page
from results_page.files import LINEAR, read

from mipbake.quality.metrics import PAIR_SETS
from mipbake.quality.metrics.snr import MAX_SNR_DB
from paper_page.cases import KINDS, LEAN, ON, SCALES, Kind, Verdict, beats, kinds, shown
from paper_page.causes import ALIKE, causes
from paper_page.charts import gain_histograms

MODELS = ("ggx", "beckmann")

Section = tuple[str, str, "Verdict | None", list[str]]
"""Number of a figure, the heading, whether the claim came out again, and the parts of the text."""

_INTRODUCTION = """\
Figures 3 to 11 of Kemppinen, Aittala and Lehtinen 2023, made again with mipbake's re-implementation of the networks.
[Training](training.md#what-differs-from-the-paper) lists what differs in the networks, and [sources](sources.md) has
every other claim of the paper.

**The sets.** {sets} real texture sets that no training saw were converted, texel by texel, to the paper's two material
models. References use the same model. *Boosted* sets are a little glossier and bumpier, as the paper's are: alpha is
multiplied by 0.78, and slopes by 1.1. `beckmann` also has {captured} sets of
[generated lobes](training.md#generated-materials-in-beckmann-lobes), which stand for the captures that the paper tests
on. Their seeds were not trained on.

**The methods.** *Naive averaging* is `linear (box)`, and *LEAN* is `lean (box)`. *MIPNet* is written anew after its
abstract and its authors' scripts, and trained with the data and the loss of `mipbake-1`, for {steps} steps
([benchmarks](../benchmarks/README.md), `mipnet.py`). *Paper's network* is `paper-ggx` or `paper-beckmann`. The *default
network* is what was mipbake's own for the same model when a record was measured.

**The measures.** SNR and FLIP of spheres under the studio's lights at levels of detail 0 (near), 3 (middle) and 7
(far), beside references of up to {passes} samples a pixel. FLIP stands in for LPIPS, whose weights mipbake does not
bring.
"""

_CORRELATED = """\
A generated material has an albedo, an F0 and an anisotropic roughness that follow its normals. A twin has the same
channels, but its normals are moved by half a period, so the values that meet in a texel meet by chance. The table has
what a method gains over the twins where channels go together. Figures are means over {pairs} sets and all levels of
detail, in dB, for `ggx`.
"""

_REASONS = """\
A material that is the same everywhere needs no filter: every level is the material itself. What a network makes of it
is off by what the network loses when it encodes and decodes. Below is the mean SNR of {texels} texels of every set,
each as a texture of its own. The default network changes averages alone, so it is exact. The paper's network has to
carry every channel through its latent code. That is the error near the viewer, where bumps are hardly averaged yet, and
on generated lobes. It is not all: on real sets MIPNet errs as much, and is ahead in the middle and far away; it was
trained with another loss ([research](research.md#mipnet-re-implemented)).
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
        _figure_7(load("figure-7", folder)),
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
    rows = [
        [f"[{number}](#{_anchor(title)})", verdict.claim, _state(verdict)]
        for number, title, verdict, _ in sections
        if verdict is not None
    ]
    parts = [
        "# The paper's figures, again\n",
        introduction,
        "## In short\n",
        table(["figure", "the paper's claim", "here"], rows) + "\n",
        *_reasons(load("constant-materials", folder)),
    ]
    explained = causes(folder, [kind for found in measured.values() for kind in found.values()])
    for number, title, verdict, body in sections:
        parts += [f"## {title}\n", *body]
        if verdict is not None:
            parts.append(f"**{_state(verdict).capitalize()}.** {verdict.words}\n")
        parts += explained.get(number, [])
    return wrapped_page("\n".join(parts))


def _reasons(record: Record | None) -> list[str]:
    """Why the network stays behind, with the experiment that shows it."""
    if record is None:
        return []
    found: dict[tuple[str, str, str], dict[str, list[float]]] = {}
    for row in record.data["rows"]:
        cell = found.setdefault((row["model"], row["kind"], row["network"]), {pairs: [] for pairs in PAIR_SETS})
        cell[row["pairs"]].append(row["snr"])
    rows = [
        [
            f"`{model}`, {KINDS[kind]}, {shown(network if network.startswith(('paper-', 'mipnet-')) else 'neural')}",
            *("exact" if min(snr) >= MAX_SNR_DB else f"{np.mean(snr):.1f} dB" for snr in cell.values()),
        ]
        for (model, kind, network), cell in found.items()
    ]
    return [
        "## Why the network stays behind\n",
        _REASONS.format(texels=record.data["texels"]),
        table(["SNR of materials that are constant", "near the mirror", "over the hemisphere"], rows) + "\n",
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
        f"Flicker: {', '.join(f'{shown(name)} {value:.2f}' for name, value in flicker.items())}. The claim holds where "
        f"the network is the nearest to 1, by its ratio, on this material. The network changes {way} than it should."
    )
    return Verdict(claim, min(off, key=lambda name: off[name]) == network, words)


def _figure_5(measured: Mapping[str, Mapping[str, Kind]], page: Path) -> Section:
    title = "Figure 5: how far ahead"
    every = [kind for found in measured.values() for kind in found.values()]
    if not every:
        return "5", title, None, [_MISSING]
    heads = [f"{measure}, {scale}" for measure in ("SNR", "FLIP") for scale in SCALES]
    parts = [
        "How far the paper's network is ahead in the mean over sets; better is positive in both measures. The claim "
        "holds where the network is ahead in every cell of naive averaging and of MIPNet.\n",
        table(["model, sets, rival", *heads], _gains(every)) + "\n",
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
    claim = "The network is ahead of naive averaging and of MIPNet at every scale, by both measures."
    rivals = [(kind, rival) for kind in every for rival in kind.rivals if rival != LEAN]
    return "5", title, beats(claim, rivals), parts


def _gains(every: Sequence[Kind]) -> list[list[str]]:
    """Of each kind of sets and each rival."""
    rows = []
    for kind in every:
        for rival in kind.rivals:
            gains = [
                f"{kind.ahead(rival, measure, scale).mean():+.{digits}f}"
                for measure, digits in (("snr", 1), ("flip", 3))
                for scale in SCALES
            ]
            rows.append([f"`{kind.model}`, {KINDS[kind.kind]}, {shown(rival)}", *gains])
    return rows


def _figure_6(measured: Mapping[str, Mapping[str, Kind]], seen: Mapping[str, Mapping[str, float]]) -> Section:
    parts = [
        _picture(6, "Change of a sphere under a shift by half a pixel"),
        "How much each pixel changes when the picture moves by half a pixel, near the viewer. Below stands the flicker "
        "of the sphere.\n",
    ]
    rows, keys = [], [("flicker", pairs, "near") for pairs in PAIR_SETS]
    for kind in (kind for found in measured.values() for kind in found.values()):
        figures = kind.results.figures
        names = (LINEAR, kind.network, "neural")
        if all((name, *key) in figures for name in names for key in keys):
            means = [[float(np.exp(np.nanmean(np.log(figures[(name, *key)])))) for key in keys] for name in names]
            cells = [" / ".join(f"{value:.2f}" for value in pair) for pair in means]
            rows.append([f"`{kind.model}`, {KINDS[kind.kind]}", *cells])
    if rows:
        words = (
            "Flicker under single lights at level of detail 0, near the mirror / over the hemisphere, over all sets. "
            "Above 1 a method changes more than it should. LEAN and MIPNet leave level 0 as naive averaging does.\n"
        )
        heads = ["sets", *(shown(name) for name in (LINEAR, "paper-ggx", "neural"))]
        parts += [words, table(heads, rows) + "\n"]
    verdict = None
    if "6" in seen:
        verdict = _steadiest(
            "Under a shift by half a pixel the other methods change noisily, and the network does not.", seen["6"]
        )
    return "6", "Figure 6: a shift by half a pixel", verdict, parts


_MODELS = """\
`{name}` of the [examples](../examples/README.md) is converted to each material model in turn, and that is the input.
The first column of a picture is the reference, shaded in the input's model. The other columns are stacks by `{shown}`
in the model that stands above them, with SNR and FLIP; the best of a row is green. The table has the SNR of `{method}`
in dB, {scales}, by input and by model of the stack.
"""

_MODELS_WHY = """\
`gltf` has one roughness, so it shows brush marks as a round blur. The tails of GGX are longer than the tails of
`beckmann`, and no stack can mend that. A matte dielectric differs between glTF and the other two models.
"""


def _figure_7(record: Record | None) -> Section:
    """One material, read and made in every model."""
    title = "Figure 7: one material, every model"
    if record is None:
        return "7", title, None, [_MISSING]
    data, method = record.data, "auto"
    outputs = list(next(iter(data["inputs"].values())))
    rows = [
        [f"`{source}`", *(" / ".join(f"{snr:.1f}" for snr, _ in stacks[output][method]) for output in outputs)]
        for source, stacks in data["inputs"].items()
    ]
    words = _MODELS.format(name=data["set"], shown=data["shown"], method=method, scales=" / ".join(data["scales"]))
    return "7", title, None, [
        words,
        table(["input", *(f"`{output}`" for output in outputs)], rows) + "\n",
        _MODELS_WHY,
        *(f"![Spheres of every output model beside a reference in {each}](figure-7-{each}.webp)\n" for each in outputs),
    ]  # fmt: skip


_STRUGGLES = 10.0
"""dB of a lobe beside the light that a pixel reflects, below which a method struggles."""


def _figure_8(seen: Mapping[str, Mapping[str, float]]) -> Section:
    verdict = None
    if "8" in seen:
        verdict = Verdict(
            "Where normals make several lobes, no lobe can match them, and all methods struggle.",
            max(seen["8"].values()) < _STRUGGLES,
            f"SNR of the lobe: {', '.join(f'{shown(name)} {snr:.1f} dB' for name, snr in seen['8'].items())}. A method "
            f"struggles below {_STRUGGLES:.0f} dB, a guess.",
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
    return number, title, _alike(claim, list(found.values()), peers), parts


def _alike(claim: str, found: Sequence[Kind], peers: Sequence[str]) -> Verdict:
    """Whether the network is ahead of naive averaging, and no peer ahead of the network by more than ALIKE, in the
    mean SNR of the middle and the far scale."""
    words, holds = [], True
    for name in (LINEAR, *peers):
        kinds_of_sets = [kind for kind in found if name in kind.methods]
        own = [float(kind.ahead(name, "snr", scale).mean()) for kind in kinds_of_sets for scale in ("middle", "far")]
        if own:
            holds = holds and min(own) > (0 if name == LINEAR else -ALIKE)
            words.append(f"{min(own):+.1f} to {max(own):+.1f} dB over {shown(name)}")
    return Verdict(
        claim,
        holds,
        f"The network gains {', '.join(words)}, in the middle and far away ([table](#figure-5-how-far-ahead)). The "
        "claim holds where it is ahead of naive averaging everywhere, and nowhere "
        f"{ALIKE:.0f} dB, a guess, behind another method of the claim. The paper compares pictures by eye.",
    )


def _figure_11(folder: Path) -> Section:
    title = "Figure 11: channels that go together"
    parts = [_picture(11, "A material whose channels go together")]
    together = read(folder, "correlated", lambda file: file["together"])
    apart = read(folder, "correlated", lambda file: not file["together"])
    if together is None or apart is None:
        return "11", title, None, [*parts, _MISSING]
    gained = {
        name: [
            float(np.mean([together.curve[name, pairs, lod] - apart.curve[name, pairs, lod] for lod in together.lods]))
            for pairs in PAIR_SETS
        ]
        for name in together.methods
    }
    rivals = [name for name in gained if name in (LINEAR, LEAN) or name.startswith("mipnet-")]
    holds = all(np.mean(gained["paper-ggx"]) > np.mean(gained[name]) for name in rivals)
    verdict = Verdict(
        "Where channels go together, the network alone takes this into account.",
        holds,
        "The claim holds where the network gains more than naive averaging, LEAN and MIPNet, in the mean of both "
        "columns.",
    )
    rows = [[shown(name), *(f"{gain:+.1f}" for gain in gains)] for name, gains in gained.items()]
    made = table(["gain where channels go together", "near the mirror", "over the hemisphere"], rows) + "\n"
    return "11", title, verdict, [*parts, _CORRELATED.format(pairs=len(together.sets)), made]
