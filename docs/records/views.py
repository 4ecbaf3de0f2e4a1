"""The texts of the blocks of pages, each made from one record or several."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Any

from records.known import KNOWN
from records.scripts import script
from records.views_films import FILM_VIEWS
from records.views_scaling import SCALING_VIEWS
from records.wrapping import table, wrapped, wrapped_page

if TYPE_CHECKING:
    from records.record import Records

PLAIN, BAKED = "plain MIP maps", "mipbake"
_WHERE = {"near-mirror": "near the mirror", "hemisphere": "over the hemisphere"}


def scales_caption(records: Records) -> str:
    more = {
        scale: 10 ** ((each["snr"][BAKED] - each["snr"][PLAIN]) / 10)
        for scale, each in records["picture"]["scales"].items()
    }
    return wrapped(
        "*The same leather from four distances. Plain MIP maps glitter in the creases from near, and are too glossy "
        "from far away. Truth takes many samples in every pixel. The error (mean square) of plain MIP maps is "
        f"{more['near']:.1f} times that of mipbake near, and {more['far']:.1f} times far. Most sets gain less.*"
    )


def shimmer_caption(records: Records) -> str:
    plain, baked = (records["animation"]["methods"][name]["flicker"] for name in (PLAIN, BAKED))
    return wrapped(
        f"*The same leather under a lamp. From frame to frame, plain MIP maps change {plain:.1f} times as much as the "
        f"truth does: this is the shimmer. mipbake changes {baked:.2f} times as much.*"
    )


def fitting_table(records: Records) -> str:
    experiments = ("earth", "cube", "envphong", "pose", "capture")
    earth, cube, phong, pose, capture = (records[f"fitting-{name}"]["figures"] for name in experiments)
    colour, true = (", ".join(f"{each:.3g}" for each in phong[name]) for name in ("color", "true color"))
    rows = [
        ["earth, PSNR of the texture with mipmaps", f"{earth['psnr with mipmaps']:.1f} dB", "32.9 dB"],
        ["earth, without", f"{earth['psnr without mipmaps']:.1f} dB", "25.6 dB"],
    ]
    paper = {
        "4 x 4, continuous": "about 75 % of runs",
        "2 x 2, continuous": "fails",
        "2 x 2, discontinuous": "not given",
    }
    for name, each in cube.items():
        error, runs = each["mean error of the successful"], f"({each['successful']} of {each['runs']})"
        found = f"{error:.2g} {runs}" if error is not None else f"fails {runs}"
        rows.append([f"cube {name}", found, paper.get(name, "a curve")])
    rows += [
        ["envphong, PSNR of the environment", f"{phong['psnr']:.1f} dB", "not given"],
        [f"envphong, exponent (true {phong['true exponent']:g})", f"{phong['exponent']:.3f}", "converges"],
        [f"envphong, colour (true {true})", colour, "converges"],
    ]
    for name in ("noise", "two phases", "symmetry"):
        rows.append([f"pose, {name}", f"{pose[name]['mean error']:.1f} degrees", f"{pose[name]['paper']:.2f}"])
    for name, each in capture.items():
        found = f"{each['mean distance']:.3f} of {each['of the base mesh']:.3f} at the start"
        rows.append([f"capture, {name}, mean distance of vertices", found, "pictures"])
    return table(["figure", "here", "paper"], rows)


def example_table(name: str) -> Callable[[Records], str]:
    """The table that an example printed."""

    def view(records: Records) -> str:
        heads, *rows = records[name]["figures"]["table"]
        return table(heads, rows)

    return view


_BAKES = re.compile(r"\| bake (\w+), (\d+) x \d+ \| ([\d.]+) \|")


def times(records: Records) -> str:
    """How long bakes of the README's two methods take, by size."""
    found: dict[str, list[tuple[str, float]]] = {}
    for method, side, seconds in _BAKES.findall("\n".join(records["timing-bake"]["printed"])):
        found.setdefault(method, []).append((side, float(seconds)))
    default, network = (
        ", ".join(f"{seconds:.0f} s at {side} x {side}" for side, seconds in found[name]) for name in ("auto", "neural")
    )
    where = records.record("timing-bake").measured.machine
    return wrapped(f"Bakes take {default}; with `--method neural` {network} ({where}).")


def sizes(records: Records) -> str:
    """How large the files of presets are."""
    found: dict[str, list[int]] = {}
    for each in records["delivered"]["whole"]:
        found.setdefault(each["preset"], []).append(each["bytes"])
    listed = ", ".join(f"{fmean(each) / 1e6:.1f} MB for `{name}`" for name, each in found.items()
                       if name in ("three", "unity", "unreal"))  # fmt: skip
    return wrapped(
        "Files are as large as those of plain MIP maps in the same format. Maps of 1024 x 1024 have, in the mean of "
        f"real sets, {listed}; Unreal compresses after import."
    )


KEPT: Mapping[str, str] = {
    "timing-shading": r"(kernel, .* \| avx512|torch, .*) \| 1 \|",
    "timing-bake": r"--help|inspect, 1024|bake (lean|neural|auto), (1024|8192)",
    "timing-texture": r"^\| random, .*(\d\) \||aniso)",
    "timing-raster": r"all three|^\| (1|1024) ",
    "timing-stochastic": r"^\| (\d+K? t|the paper)",
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


def stability_words(records: Records) -> str:
    """What came of averaged latents and of levels that are made one after the other, at either rate."""
    data, stability = records["stability"], script("benchmarks", "stability")

    def of(kind: str, rate: float, value: Callable[[Mapping[str, Any]], float]) -> list[float]:
        return [value(run) for run in data["runs"] if (run["kind"], run["rate"]) == (kind, rate)]

    lost = sum(run["not finite"] for run in data["runs"])
    words = [f"{lost} losses are not finite." if lost else "All losses are finite."]
    for rate in (stability.PAPERS_RATE, stability.HURRIED_RATE):
        snr, last = (
            {kind: of(kind, rate, value) for kind in ("linear", "autoregressive")}
            for value in (lambda run: run["snr"], lambda run: run["growth"][-1])
        )
        gain = fmean(snr["autoregressive"]) - fmean(snr["linear"])
        spread = {kind: stdev(each) for kind, each in snr.items()}
        size = {kind: fmean(each) for kind, each in last.items()}
        words.append(
            f"After {data['steps']} steps at a rate of {rate:g} the autoregressive network is {abs(gain):.1f} dB "
            f"{'ahead' if gain > 0 else 'behind'}. Its seeds spread by {spread['autoregressive']:.1f} dB, those of the "
            f"linear one by {spread['linear']:.1f} dB. At the last level it has {size['autoregressive']:.2f} of the "
            f"size of averages, and the linear one {size['linear']:.2f}."
        )
    words.append(f"Plain averages have {data['runs'][0]['averages']:.1f} dB on these held-out patches.")
    return wrapped(" ".join(words))


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


def web(records: Records) -> str:
    """What browsers load of the npm package, and how long it takes."""
    data = records["web"]
    names = ("core", "core without SIMD", "weights", "script")
    core, scalar, weights, code = (f"{data['bytes'][name] / 1000:.0f} KB" for name in names)
    node, native = (data["seconds"][name] for name in ("node", "native"))
    return wrapped(
        f"Gzipped: core (WebAssembly) {core}, or {scalar} where an engine has no SIMD, weights {weights}, script "
        f"{code} with its comments. Weights are loaded when a bake needs them. A set of {data['size']} x "
        f"{data['size']} texels takes {node:.1f} s of one thread in Node.js, {node / native:.1f} times what the Python "
        f"tool takes, and with two workers {data['two workers']:.2f} of the time "
        f"({records.record('web').measured.machine})."
    )


VIEWS: Mapping[str, Callable[[Any], str]] = {
    "picture/caption": scales_caption,
    "animation/caption": shimmer_caption,
    "fitting/table": fitting_table,
    **{f"{name}/table": example_table(name) for name in KNOWN if name.startswith("stochastic-")},
    "web/sizes": web,
    "training-mipnet/words": mipnet_words,
    "stability/words": stability_words,
    "stability/table": _of("benchmarks", "stability", "summary", "stability"),
    "fit/words": fit_words,
    "fit/pictures": fit_pictures,
    "fit/means": _of("benchmarks", "fit_tables", "means_table", "fit"),
    "fit/cost": _of("benchmarks", "fit_tables", "cost_table", "fit"),
    "fit-slow/gains": _of("benchmarks", "fit_tables", "slow_table", "fit-slow"),
    "fit-slow/words": lambda records: wrapped(script("benchmarks", "fit_tables").slow_words(records["fit-slow"])),
    "timing-bake/times": times,
    "delivered/sizes": sizes,
    "delivered/table": _of("benchmarks", "delivered", "summarised", "delivered"),
    "engines-three/gains": _of(_ENGINES, "three_table", "gains", "engines-three"),
    "engines-three/containers": _of(_ENGINES, "three_table", "containers", "engines-three"),
    "gallery/films": lambda records: wrapped_page(_of(_ENGINES, "three_table", "gallery", "gallery")(records)),
    "engines-cycles/table": lambda records: table(
        ["set", *records["engines-cycles"]["columns"]],
        [[name, *(f"{each:.1f}" for each in row)] for name, row in records["engines-cycles"]["rows"].items()],
    ),
    **FILM_VIEWS,
    **SCALING_VIEWS,
    **{f"{name}/printed": printed(name) for name in KNOWN if name.startswith(("timing-", "weights"))},
}
"""Name of a block to what makes its text. The part before the slash is the record that it is about."""
