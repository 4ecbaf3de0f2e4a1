"""How far a method is ahead in numbers, and the anisotropic target beside the isotropic one."""

from __future__ import annotations

import numpy as np

from mipbake.quality.metrics import PAIR_SETS
from results_page.files import Results
from results_page.tables import PLACES, by_lod, lod_heads, table

_DIRECTIONAL = """\
These sets have an anisotropy map, or their slopes vary at least three times as much across their main direction as
along it in windows of 32 x 32 texels. {real} of them are real sets or examples. {generated} come from the project's
generator, and no training saw them. The reference is the same for both targets. `gltf` stores one roughness;
`gltf-anisotropic` stores a roughness, a strength and a direction of anisotropy.
"""


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
