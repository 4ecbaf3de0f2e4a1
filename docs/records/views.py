"""The texts of the blocks of pages, each made from one record or several."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from statistics import fmean
from typing import TYPE_CHECKING, Any

from records.known import KNOWN
from records.scripts import script
from records.views_films import FILM_VIEWS
from records.views_results import results_table, results_words
from records.views_scaling import SCALING_VIEWS
from records.wrapping import table, wrapped

if TYPE_CHECKING:
    from records.record import Records

PLAIN, BAKED = "linear", "mipbake"
_WHERE = {"near-mirror": "near the mirror", "hemisphere": "over the hemisphere"}


def scales_caption(records: Records) -> str:
    found = records["picture"]["scales"]
    means = {name: fmean(each["snr"][name] for each in found.values()) for name in (PLAIN, BAKED)}
    return wrapped(
        "*The same leather from four distances. Top row: plain MIP maps, which average the texels. The creases glitter "
        "from near, and the sphere is too glossy from far away. Middle row: the maps of mipbake in the same renderer. "
        "Bottom row: the reference, which takes many samples in every pixel. The figure below a sphere is its "
        "signal-to-noise ratio (SNR) against the reference; more is better. The mean of the four is "
        f"{means[PLAIN]:.1f} dB with plain MIP maps and {means[BAKED]:.1f} dB with mipbake. This example gains more "
        "than most sets do; [below](#how-good-is-it) are means over real sets.*"
    )


def shimmer_caption(records: Records) -> str:
    plain, baked = (records["animation"]["methods"][name] for name in (PLAIN, BAKED))
    return wrapped(
        f"*The same sphere in motion, under a lamp. From frame to frame, plain MIP maps change {plain['flicker']:.1f} "
        "times as much as the reference does (mean square). This is the shimmer. The maps of mipbake change "
        f"{baked['flicker']:.2f} times as much. The SNR is {plain['snr']:.1f} dB with plain MIP maps and "
        f"{baked['snr']:.1f} dB with mipbake.*"
    )


def fitting_table(records: Records) -> str:
    earth, cube, phong, pose = (records[f"fitting-{name}"]["figures"] for name in ("earth", "cube", "envphong", "pose"))
    colour, true = (", ".join(f"{each:.3g}" for each in phong[name]) for name in ("color", "true color"))
    rows = [
        ["earth, PSNR of the texture with mipmaps", f"{earth['psnr with mipmaps']:.1f} dB", "32.9 dB"],
        ["earth, without", f"{earth['psnr without mipmaps']:.1f} dB", "25.6 dB"],
    ]
    for name, each in cube.items():
        error = f"{each['mean error of the successful']:.2g} ({each['successful']} of {each['runs']})"
        rows.append([f"cube {name}", error, "about 75 % of runs" if name == "4 x 4, continuous" else "a curve"])
    rows += [
        ["envphong, PSNR of the environment", f"{phong['psnr']:.1f} dB", "not given"],
        [f"envphong, exponent (true {phong['true exponent']:g})", f"{phong['exponent']:.3f}", "converges"],
        [f"envphong, colour (true {true})", colour, "converges"],
    ]
    for name in ("noise", "two phases", "symmetry"):
        rows.append([f"pose, {name}", f"{pose[name]['mean error']:.1f} degrees", f"{pose[name]['paper']:.2f}"])
    return table(["figure", "here", "paper"], rows)


KEPT: Mapping[str, str] = {
    "timing-shading": r"(kernel, .* \| avx512|torch, .*) \| 1 \|",
    "timing-bake": r"--help|inspect, 1024|bake (lean|neural|auto), (1024|8192)",
    "timing-texture": r"^\| random, .*(\d\) \||aniso)",
    "timing-raster": r"all three|^\| (1|1024) ",
    "timing-stochastic": r"^\| \d+K? t.* s: ",
    "timing-card-texture": r"random, (forward|.*to texels) \| .*\(\d\.\d\) \|",
    "timing-card-raster": r"all three|^\| (1|1024) ",
}
"""Record of time to what rows of its tables a page shows: those that match."""


def _kept(part: str, kept: re.Pattern[str]) -> str:
    """A part of what was printed with the rows that are kept; empty where none of a table is."""
    head, separator, *rows = [*part.splitlines(), "", ""]
    if not head.startswith("|"):
        return part
    rows = [row for row in rows if row and kept.search(row)]
    return "\n".join([head, separator, *rows]) if rows else ""


def printed(name: str) -> Callable[[Records], str]:
    """What a benchmark of time printed, with the machine and the day: Markdown where it has tables, else as it is.

    Of the rows of tables only those stay that match KEPT.
    """
    kept = re.compile(KEPT.get(name, ""))

    def view(records: Records) -> str:
        record = records.record(name)
        parts = "\n".join(record.data["printed"]).split("\n\n")
        lines = "\n\n".join(filter(None, (_kept(part, kept) for part in parts))).splitlines()
        if any(line.startswith("|") for line in lines):
            lines = [line if line.startswith("|") else wrapped(line) for line in lines]
        else:
            lines = ["```", *lines, "```"]
        more = f"; the [record](records/{name}.json) has more" if name in KEPT else ""
        return "\n".join([*lines, "", wrapped(f"Measured {record.measured.on} on {record.measured.machine}{more}.")])

    return view


def ggx_to_beckmann(records: Records) -> str:
    """What the docstring of `mipbake.material.ggx_to_beckmann` says; a test compares them."""
    rule = records["beckmann"]["rule"]
    kept = [f"{rule[a][0]:.0f} and {rule[a][1]:.0f} at {a}" for a in ("0.01", "0.03", "0.1", "0.2", "0.5", "1")]
    return f"over views from everywhere: for alpha {', '.join(kept)}."


def beckmann_to_ggx(records: Records) -> str:
    """What the docstring of `mipbake.material.beckmann_to_ggx` says; a test compares them."""
    kept = {g: f"{records['beckmann']['narrow'][g][1]:.0f}" for g in ("-1.5", "-1", "-0.5", "0", "1", "1.5")}
    return (
        f"{kept['-1.5']} at g = -1.5, {kept['-1']} at -1, {kept['-0.5']} at -0.5, {kept['0']} at 0 (Beckmann), "
        f"{kept['1']} at 1 and {kept['1.5']} at 1.5."
    )


DOCSTRINGS: Mapping[str, Callable[[Any], str]] = {
    "mipbake.material.ggx_to_beckmann": ggx_to_beckmann,
    "mipbake.material.beckmann_to_ggx": beckmann_to_ggx,
}
"""Functions whose docstrings hold what was measured, to the words in them."""


def mipnet_words(records: Records) -> str:
    data = records["training-mipnet"]
    (name, paper), (first, *_, last) = next(iter(data["paper"].items())), data["validations"]

    def snr(row: Mapping[str, float], method: str) -> str:
        return " and ".join(f"{row[f'{method} {pairs}']:.2f} dB {where}" for pairs, where in _WHERE.items())

    lost = f"{data['not finite']} of its losses are not finite." if data["not finite"] else "All its losses are finite."
    return wrapped(
        f"It was trained for {data['steps']:,} steps at a rate of {data['learning rate']:g}. {lost} On held-out "
        f"patches it has {snr(last, 'network')}, and had {snr(first, 'network')} at first. Plain averages have "
        f"{snr(first, 'linear')}, and `{name}`, which has {paper['steps']:,} steps under the same loss, has "
        f"{snr(paper, 'network')}."
    )


def fit_words(records: Records) -> str:
    """At how many scales a fit is ahead, as displays show it and in linear radiance."""
    data, tables = records["fit"], script("benchmarks", "fit_tables")
    shown, linear = (tables.words(data, measure) for measure in ("snr-displayed", "snr"))
    return f"{wrapped(f'As displays show it: {shown}')}\n\n{wrapped(f'In linear radiance: {linear}')}"


def fit_pictures(records: Records) -> str:
    """The pictures of each set in each renderer, in the folder of the page."""
    names = [(renderer, name) for renderer, sets in records["fit"]["renderers"].items() for name in sets]
    return "\n\n".join(f"![{name} in {each}](fit-{each.replace(' ', '-')}-{name}.png)" for each, name in names)


def _of(folder: str, module: str, function: str, record: str) -> Callable[[Any], str]:
    """What a function of a script makes of a record."""
    return lambda records: str(getattr(script(folder, module), function)(records[record]))


_ENGINES = "benchmarks/engines"
VIEWS: Mapping[str, Callable[[Any], str]] = {
    "picture/caption": scales_caption,
    "animation/caption": shimmer_caption,
    "fitting/table": fitting_table,
    "results-whole/table": results_table,
    "results-whole/words": lambda records: wrapped(results_words(records)),
    "training-mipnet/words": mipnet_words,
    "fit/words": fit_words,
    "fit/pictures": fit_pictures,
    "fit/means": _of("benchmarks", "fit_tables", "means_table", "fit"),
    "fit/cost": _of("benchmarks", "fit_tables", "cost_table", "fit"),
    "delivered/table": _of("benchmarks", "delivered", "summarised", "delivered"),
    "engines-three/gains": _of(_ENGINES, "three_table", "gains", "engines-three"),
    "engines-three/containers": _of(_ENGINES, "three_table", "containers", "engines-three"),
    "engines-cycles/table": lambda records: table(
        ["set", *records["engines-cycles"]["columns"]],
        [[name, *(f"{each:.1f}" for each in row)] for name, row in records["engines-cycles"]["rows"].items()],
    ),
    **FILM_VIEWS,
    **SCALING_VIEWS,
    **{f"{name}/printed": printed(name) for name in KNOWN if name.startswith(("timing-", "weights"))},
}
"""Name of a block to what makes its text. The part before the slash is the record that it is about."""
