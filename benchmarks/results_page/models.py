"""The paper's comparisons on our sets: figures 5, 9, 10 and 11, and the anisotropic target."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mipbake.metrics import PAIR_SETS
from results_page.charts import gain_histograms
from results_page.files import FOUR, LINEAR, Results, read
from results_page.tables import PLACES, by_lod, described, lod_heads, table

MODELS = {
    "beckmann": ("Figure 9", (LINEAR, "lean (box)")),
    "ggx": ("Figure 10", (LINEAR, "lean (box)")),
}
"""Material model to the paper's figure about it, and the rivals shown. The paper leaves out LEAN for GGX."""

_INTRODUCTION = """\
Each set was converted, texel by texel, to the two material models of the paper. The reference uses the same model, so
differences between models do not count. Some things differ from the paper. The bumps of our sets are not boosted. FLIP
replaces LPIPS, because LPIPS is defined by trained weights that have to be downloaded. Pictures show spheres, on which
all angles are seen, and not planes. Far is level 7. `linear (box)` is what the paper calls naive linear filtering, and
`lean (box)` is LEAN mapping.
"""

_CORRELATED = """\
This is a generated material whose albedo, F0 and anisotropic roughness follow its normals. Slopes that face one way are
glossy; slopes that face the other way are rough and have another colour. A twin has the same channels, but its normals
are moved by half a period, so the values that meet in a texel meet by chance. The difference between the columns says
how a method takes channels that go together. The figures are means over {pairs} sets and their twins and over all
levels of detail, in dB, for `ggx`.
"""

_DIRECTIONAL = """\
These sets have an anisotropy map, or their slopes vary at least three times as much across their main direction as
along it in windows of 32 x 32 texels. {real} of them are real sets or examples. {generated} come from the project's
generator, and no training saw them. The reference is the same for both targets. `gltf` stores one roughness;
`gltf-anisotropic` stores a roughness, a strength and a direction of anisotropy.
"""


def paper(folder: Path, page: Path) -> list[str]:
    """Sections of figures 5, 9 and 10; empty where nothing was measured. Writes the histograms beside the page."""
    parts: list[str] = []
    for model, (figure, rivals) in MODELS.items():
        results = read(folder, "models", lambda file, model=model: file["model"] == model)  # type: ignore[misc]
        if results is None:
            continue
        names = [file["set"] for file in results.files]
        subjects = results.learned
        parts.append(f"### {figure}: `{model}`, from nearer and from farther away\n")
        parts += [_pictures(results, names, (*rivals, *subjects)), described(results)]
        parts += [f"Mean SNR by level of detail, `{model}`, dB:\n", *(by_lod(results, pairs) for pairs in PAIR_SETS)]
        for subject in subjects:
            words = f"{subject}, {model}: ahead of closed forms by"
            name = f"results-figure-5-{model}-{subject}.svg"
            (page.parent / name).write_text(gain_histograms(results, subject, FOUR, words), encoding="utf-8")
            parts.append(f"![Histograms of how far {subject} is ahead of closed forms]({name})\n")
    return ["## The paper's figures 5, 9 and 10, on these sets\n", _INTRODUCTION, *parts] if parts else []


def _pictures(results: Results, sets: Sequence[str], names: Sequence[str]) -> str:
    """SNR and FLIP of spheres, a row for each set and their mean; the best of each scale is bold."""
    scales = ("middle", "far")
    cells: dict[str, list[str]] = {name: [] for name in (*sets, "mean")}
    for scale in scales:
        snr, flip = (
            np.stack([results.figures[name, measure, "sphere", scale] for name in names], 1)
            for measure in ("snr", "flip")
        )
        snr, flip = (np.concatenate([values, np.nanmean(values, 0, keepdims=True)]) for values in (snr, flip))
        for row, own, seen in zip(cells.values(), snr, flip, strict=True):
            for index in range(len(names)):
                first = f"{own[index]:.1f}" if own[index] < own.max() else f"**{own[index]:.1f}**"
                second = f"{seen[index]:.3f}" if seen[index] > seen.min() else f"**{seen[index]:.3f}**"
                row.append(f"{first} / {second}")
    return table("SNR in dB / FLIP", [f"{scale}, {name}" for scale in scales for name in names], cells)


def gains_over(results: Results, subject: str) -> str:
    """How far a method is ahead of every closed form over all sets and levels: the paper's figure 5 in numbers."""
    rows = {}
    for rival in results.closed_forms:
        cells = []
        for pairs in PAIR_SETS:
            gains = results.gains(subject, pairs, (rival,))
            cells += [f"{gains.mean():+.2f}", f"{np.median(gains):+.2f}", f"{(gains > 0).mean():.0%}"]
        rows[rival] = cells
    heads = [f"{PLACES[pairs]}: {what}" for pairs in PAIR_SETS for what in ("mean", "median", "ahead")]
    return table(f"{subject} over, dB", heads, rows)


def correlated(folder: Path) -> list[str]:
    """The section of figure 11."""
    together = read(folder, "correlated", lambda file: file["together"])
    apart = read(folder, "correlated", lambda file: not file["together"])
    if together is None or apart is None:
        return []
    rows = {}
    for name in together.methods:
        cells = []
        for pairs in PAIR_SETS:
            first, second = (
                float(np.mean([each.curve[name, pairs, lod] for lod in each.lods])) for each in (together, apart)
            )
            cells += [f"{first:.1f}", f"{second:.1f}", f"{first - second:+.1f}"]
        flip = [float(each.figures[name, "flip", "sphere", "middle"].mean()) for each in (together, apart)]
        rows[name] = [*cells, *(f"{value:.3f}" for value in flip)]
    what = ("correlated", "twin", "difference")
    heads = [*(f"{PLACES[pairs]}: {one}" for pairs in PAIR_SETS for one in what), "FLIP, middle", "FLIP, twin"]
    return [
        "## Figure 11: channels that go together\n",
        _CORRELATED.format(pairs=len(together.sets)),
        table("", heads, rows),
    ]


def targets(results: Results) -> list[tuple[str, str, str]]:
    """Methods that were baked to both targets: name, and what files call it for `gltf` and `gltf-anisotropic`."""
    ends = (" as gltf", " as gltf-anisotropic")
    names = [name.removesuffix(ends[0]) for name in results.methods if name.endswith(ends[0])]
    return [(name, *(name + end for end in ends)) for name in names if name + ends[1] in results.methods]  # type: ignore[misc]


def anisotropy_gain(results: Results, pairs: str = "near-mirror") -> float:
    """Mean dB of the best method of the anisotropic target over the best of the isotropic one, both by their means."""
    best = []
    for which in (1, 2):
        means = [np.mean([results.curve[each[which], pairs, lod] for lod in results.lods]) for each in targets(results)]
        best.append(max(means))
    return float(best[1] - best[0])


def directional(results: Results | None) -> list[str]:
    """The section of the anisotropic target."""
    if results is None or not targets(results):
        return []
    generated = sum(name.startswith("procedural-") for name in results.sets)
    parts = [
        "## Directional bumps: the anisotropic target\n",
        _DIRECTIONAL.format(real=len(results.sets) - generated, generated=generated),
        *(by_lod(results, pairs) for pairs in PAIR_SETS),
        "What the anisotropic target gains over the isotropic one with the same method, means over sets, dB:\n",
    ]
    for pairs in PAIR_SETS:
        rows = {}
        for name, plain, rich in targets(results):
            gains = np.stack(
                [results.curve[rich, pairs, lod] - results.curve[plain, pairs, lod] for lod in results.lods]
            )
            rows[name] = [*(f"{gain:+.1f}" for gain in gains.mean(1)), f"{gains.mean():+.2f}"]
        parts.append(table(pairs, [*lod_heads(results), "mean"], rows))
    heads = ["directionality", "slope, rms", *(name for name, _, _ in targets(results))]
    rows = {}
    for index, file in enumerate(results.files):
        gains = [
            np.mean(
                [
                    results.curve[rich, "near-mirror", lod][index] - results.curve[plain, "near-mirror", lod][index]
                    for lod in results.lods
                ]
            )
            for _, plain, rich in targets(results)
        ]
        rows[file["name"]] = [f"{file['directionality']:.2f}", f"{file['slope']:.2f}", *(f"{g:+.1f}" for g in gains)]
    return [*parts, "The same for each set, near the mirror, means over levels:\n", table("", heads, rows)]
