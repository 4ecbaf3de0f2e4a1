"""The texts of the blocks of pages, each made from one record or several."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from mipbake.quality.metrics import PAIR_SETS
from records.known import KNOWN
from records.views_cards import CARD_VIEWS
from records.views_films import FILM_VIEWS
from records.views_fit import FIT_VIEWS
from records.views_results import in_three, results_table, results_words
from records.views_scaling import SCALING_VIEWS
from records.wrapping import table, wrapped

if TYPE_CHECKING:
    from records.record import Records

PLAIN, BAKED = "linear", "mipbake"
_SPELLED = {"snr:": "SNR of linear radiance:", "snr-displayed:": "SNR of what a display shows:"}
_WHERE = {"near-mirror": "near the mirror", "hemisphere": "over the hemisphere"}


def scales_caption(records: Records) -> str:
    found = records["picture"]["scales"]
    means = {name: sum(each["snr"][name] for each in found.values()) / len(found) for name in (PLAIN, BAKED)}
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
    calm = " This is calmer than it should be." if baked["flicker"] < 0.85 else ""
    return wrapped(
        f"*The same sphere in motion, under a lamp. From frame to frame, plain MIP maps change {plain['flicker']:.1f} "
        "times as much as the reference does (mean square). This is the shimmer. The maps of mipbake change "
        f"{baked['flicker']:.2f} times as much.{calm} The SNR is {plain['snr']:.1f} dB with plain MIP maps and "
        f"{baked['snr']:.1f} dB with mipbake. [docs/validation.md](docs/validation.md) explains the figures.*"
    )


def failure_table(records: Records) -> str:
    data = records["failure"]
    columns = [(pairs, scale) for pairs, row in next(iter(data["methods"].values())).items() for scale in row]
    rows = [[name, *(f"{row[pairs][scale]:.1f}" for pairs, scale in columns)] for name, row in data["methods"].items()]
    return "\n" + table(["", *(f"{pairs}, {scale}" for pairs, scale in columns)], rows) + "\n"


def _far(records: Records) -> tuple[dict[str, float], int, int]:
    """Best of all methods far away, by pair set; at how many of the scales the network is behind the best, and of
    how many."""
    methods: Mapping[str, Any] = records["failure"]["methods"]
    pairs = list(next(iter(methods.values())))
    best = {each: max(row[each]["far"] for row in methods.values()) for each in pairs}
    scales = [(each, scale) for each in pairs for scale in methods["neural"][each]]
    behind = sum(
        methods["neural"][each][scale] < max(row[each][scale] for row in methods.values()) for each, scale in scales
    )
    return best, behind, len(scales)


def failure_words(records: Records) -> str:
    best, behind, of = _far(records)
    data = records["failure"]
    scales = ", ".join(f"{lod:g} ({scale})" for scale, lod in data["lods"].items())
    below = sum(value < 0 for value in data["methods"]["linear (box)"]["near-mirror"].values())
    return wrapped(
        f"SNR in dB against the reference, as `mipbake.validate` measures it, at the lods {scales}. Far away no "
        f"method is above {best['near-mirror']:.1f} dB near the mirror or {best['hemisphere']:.1f} dB over the "
        f"hemisphere. Averaging with the box is below 0 dB, where a black picture would be closer, at {below} of "
        f"{len(data['lods'])} scales near the mirror. The network is behind the best closed form in {behind} of the "
        f"{of} columns of the table."
    )


def fitting_table(records: Records) -> str:
    earth, cube, phong, pose = (records[f"fitting-{name}"] for name in ("earth", "cube", "envphong", "pose"))

    def time(data: Any, what: str) -> str:
        return f"{data['seconds']:.0f} s, {data['processor seconds']:.0f} s{what}"

    s, figures = earth["settings"], earth["figures"]
    faces = f"faces of {s['texture_size']} x {s['texture_size']}, images of {s['resolution']} x {s['resolution']}"
    rows = [
        ["earth, PSNR of the texture with mipmaps", f"{figures['psnr with mipmaps']:.1f} dB", "32.9 dB",
         f"{faces}, {s['iterations']:,} iterations", time(earth, " for both")],
        ["earth, without", f"{figures['psnr without mipmaps']:.1f} dB", "25.6 dB", "the same views", ""],
    ]  # fmt: skip
    s = cube["settings"]
    about = [f"{s['runs']} runs of {s['iterations']:,} iterations", time(cube, " for all six")]
    for name, each in cube["figures"].items():
        ended = f"{each['mean error of the successful']:.2g} ({each['successful']} of {each['runs']})"
        curve = "curve, about 75 % of runs" if name == "4 x 4, continuous" else "curve"
        what = ", mean distance of a corner" if about[0] else ""
        rows.append([f"cube {name}{what}", ended, curve, *about])
        about = ["", ""]
    s, figures = phong["settings"], phong["figures"]
    faces = f"faces of {s['texture_size']} x {s['texture_size']}, images of {s['resolution']} x {s['resolution']}"
    settings = f"{faces}, {s['iterations']:,} iterations"
    colour, true = (", ".join(f"{each:.3g}" for each in figures[name]) for name in ("color", "true color"))
    rows += [
        ["envphong, PSNR of the environment", f"{figures['psnr']:.1f} dB", "not given", settings, time(phong, "")],
        [f"envphong, exponent (true {figures['true exponent']:g})", f"{figures['exponent']:.3f}", "converges", "", ""],
        [f"envphong, colour (true {true})", colour, "converges", "", ""],
    ]
    s = pose["settings"]
    about = [
        f"{s['trials']} trials, {s['resolution']} x {s['resolution']} pixels, {s['iterations']:,} iterations",
        time(pose, " for all three"),
    ]
    for name in POSE:
        each = pose["figures"][name]
        rows.append([f"pose, {name}", f"{each['mean error']:.1f} degrees", f"{each['paper']:.2f}", *about])
        about = ["", ""]
    return table(["figure", "here", "paper", "settings here", "time, processor's time"], rows)


def _kept(part: str, kept: re.Pattern[str]) -> str:
    """A part of what was printed with the rows that are kept; empty where none of a table is."""
    head, separator, *rows = [*part.splitlines(), "", ""]
    if not head.startswith("|"):
        return part
    rows = [row for row in rows if row and kept.search(row)]
    return "\n".join([head, separator, *rows]) if rows else ""


KEPT: Mapping[str, str] = {
    "timing-shading": r"\| 1 \|",
    "timing-bake": r"--help|inspect, 1024|bake (lean|neural|auto)",
    "timing-texture": r"\d\) \||^\| random, (anis|cube)",
    "timing-raster": r"all three|^\| (1|1024) ",
    "timing-render": r"candidate|reference",
    "timing-stochastic": r"^\| (\d+K? t.* s: |figure \d, \w+ map \| \d)",
    "timing-card-texture": r"(, forward|to texels) \| .*\(\d\.\d\) \|",
    "timing-card-raster": r"all three|^\| (1|1024) ",
}
"""Record of time to what rows of its tables a page shows: those that match."""

POSE = ("noise", "two phases", "symmetry")


def printed(name: str) -> Callable[[Records], str]:
    """What a benchmark of time printed, with the machine and the day: Markdown where it has tables, else as it is.

    Names of measures are spelled out. Of the rows of tables only those stay that KEPT asks for.
    """
    kept = re.compile(KEPT.get(name, ""))

    def view(records: Records) -> str:
        record = records.record(name)
        parts = "\n".join(record.data["printed"]).split("\n\n")
        lines = "\n\n".join(filter(None, (_kept(part, kept) for part in parts))).splitlines()
        if any(line.startswith("|") for line in lines):
            lines = [line if line.startswith("|") else wrapped(_SPELLED.get(line, line)) for line in lines]
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


def mipnet_table(records: Records) -> str:
    rows = [
        [f"{row['step']:,.0f}", *(f"{row[f'network {pairs}']:.2f}" for pairs in PAIR_SETS), _loss(row)]
        for row in records["training-mipnet"]["validations"]
    ]
    return (
        "\n" + table(["steps", *(f"SNR in dB {_WHERE[pairs]}" for pairs in PAIR_SETS), "mean loss since"], rows) + "\n"
    )


def _loss(row: Mapping[str, float | None]) -> str:
    return "" if row["loss"] is None else f"{row['loss']:.3f}"


def mipnet_words(records: Records) -> str:
    data = records["training-mipnet"]
    (name, paper), first = next(iter(data["paper"].items())), data["validations"][0]
    lost = f"{data['not finite']} of its losses are not finite." if data["not finite"] else "All its losses are finite."
    text = (
        f"It was trained for {data['steps']:,} steps at a rate of {data['learning rate']:g}, by revision "
        f"`{data['commit'][:7]}`. {lost} The table has SNR on held-out patches. On the same patches plain averages "
        f"have {_places(first, 'linear')}, and `{name}`, which has {paper['steps']:,} steps under the same loss, has "
        f"{_places(paper, 'network')}."
    )
    return "\n" + wrapped(text) + "\n"


def _places(row: Mapping[str, float], method: str) -> str:
    return " and ".join(f"{row[f'{method} {pairs}']:.2f} dB {where}" for pairs, where in _WHERE.items())


DOCSTRINGS: Mapping[str, Callable[[Any], str]] = {
    "mipbake.material.ggx_to_beckmann": ggx_to_beckmann,
    "mipbake.material.beckmann_to_ggx": beckmann_to_ggx,
}
"""Functions whose docstrings hold what was measured, to the words in them."""


VIEWS: Mapping[str, Callable[[Any], str]] = {
    "picture/caption": scales_caption,
    "animation/caption": shimmer_caption,
    "failure/table": failure_table,
    "failure/words": failure_words,
    "fitting/table": fitting_table,
    "results-whole/table": results_table,
    "results-whole/words": lambda records: wrapped(results_words(records)),
    "training-mipnet/words": mipnet_words,
    "training-mipnet/table": mipnet_table,
    "engines-three/summary": lambda records: wrapped(in_three(records)),
    **{f"films/{name}": view for name, view in FILM_VIEWS.items()},
    **FIT_VIEWS,
    **CARD_VIEWS,
    **SCALING_VIEWS,
    **{f"{name}/printed": printed(name) for name in KNOWN if name.startswith(("timing-", "weights"))},
}
"""Name of a block to what makes its text. The part before the slash is the record that it is about."""
