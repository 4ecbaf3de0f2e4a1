"""Blocks of docs/scaling.md and docs/pipeline.md: how fast libraries are baked, here and by arithmetic elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from records.wrapping import table, wrapped

if TYPE_CHECKING:
    from records.record import Records

SETS = 10_000
"""Sets of the library that is thought of."""


@dataclass(frozen=True)
class Machine:
    """A machine that nothing was measured on, or many of them.

    Args:
        cores: of all of them. memory: GiB of all of them. disk: GB/s that all of them read and write together.
        network_free: whether networks cost the processor nothing, because a graphics card runs them.
    """

    name: str
    cores: int
    memory: int
    disk: float
    network_free: bool = False


MACHINES = (
    Machine("laptop: 8 cores, 16 GiB, an NVMe disk", 8, 16, 3.0),
    Machine("workstation: 32 cores, 128 GiB, an NVMe disk", 32, 128, 6.0),
    Machine("host of one H200: 16 cores, 128 GiB, an NVMe disk", 16, 128, 6.0, network_free=True),
    Machine("farm: 32 workstations, one file server of 25 Gbit/s", 1024, 4096, 3.1),
)


LARGE = "throughput-large"


def throughput_by_size(records: Records, name: str = "throughput") -> str:
    rows = []
    for size, row in records[name]["sizes"].items():
        for program in (name for name in row if name != "sets"):
            one, two = row[program]["1"], row[program]["2"]
            rows.append([f"{size} x {size}", program, _count(one), _count(two), f"{two / one:.2f}",
                         f"{one / row['maketx']['1']:.2f}"])  # fmt: skip
    heads = ["maps", "program", "sets an hour, 1 process", "2 processes", "gain", "of maketx"]
    return "\n\n".join([table(heads, rows), _where(records, name)])


def throughput_by_format(records: Records) -> str:
    found = records["throughput"]
    rows = [
        [name, _count(each["1"]), _count(each["2"]), f"{each['2'] / each['1']:.2f}"]
        for name, each in found["formats"].items()
    ]
    return table(["format", "sets an hour, 1 process", "2 processes", "gain"], rows)


def throughput_parts(records: Records) -> str:
    found = records[LARGE]
    phases = list(dict.fromkeys(name for each in found["parts"].values() for name in each["phases"]))
    rows = [
        [
            method,
            *(f"{each['phases'].get(name, 0):.1f}" for name in phases),
            f"{each['seconds']:.1f}",
            f"{each['processor']:.1f}",
            f"{each['memory'] / 2**30:.2f}",
            f"{each['held']['processor']:.1f}",
            f"{each['held']['memory'] / 2**30:.2f}",
            f"{each['read'] / 1e6:.0f}",
            f"{each['written'] / 1e6:.0f}",
        ]
        for method, each in found["parts"].items()
    ]
    heads = ["method", *phases, "in all, s", "processor, s", "GiB", "held: processor, s", "held: GiB", "MB read",
             "MB written"]  # fmt: skip
    return "\n\n".join([table(heads, rows), _where(records, LARGE)])


def in_use(found: Mapping[str, Any], method: str) -> float:
    """Share of the cores that a batch keeps busy, of the largest size, with as many processes as were measured."""
    size = max(found["sizes"], key=int)
    return min(1.0, found["sizes"][size][method]["2"] / 3600 * found["parts"][method]["processor"] / found["cores"])


def hours(found: Mapping[str, Any], method: str, machine: Machine) -> tuple[float, str]:
    """Hours that a machine takes for all sets, and what holds it up. Every process is held to little memory."""
    part = found["parts"][method]["held"]
    processor = part["processor"]
    if machine.network_free and method in ("neural", "auto"):
        processor -= processor * part["phases"]["prefilter"] / sum(part["phases"].values()) * (method == "neural")
    fitting = machine.memory * 2**30 / part["memory"]
    cores = min(machine.cores, fitting)
    by_cores = SETS * processor / (cores * in_use(found, method)) / 3600
    by_disk = SETS * (part["read"] + part["written"]) / (machine.disk * 1e9) / 3600
    if by_disk > by_cores:
        return by_disk, "disk"
    return by_cores, "memory" if fitting < machine.cores else "cores"


def ten_thousand(records: Records) -> str:
    found = records[LARGE]
    methods = list(found["parts"])
    rows = []
    for machine in MACHINES:
        cells = []
        for method in methods:
            time, limit = hours(found, method, machine)
            cells.append(f"{_time(time)}, {limit}")
        rows.append([machine.name, *cells])
    size = max(found["sizes"], key=int)
    used = ", ".join(f"{in_use(found, method):.0%} with {method}" for method in methods)
    words = wrapped(f"Two processes kept this share of two cores busy at {size} x {size}: {used}.")
    return "\n\n".join([table(["machine", *methods], rows), words])


def library_words(records: Records) -> str:
    found = records["library"]
    whole, again, one, there = (found[name] for name in ("whole", "again", "one changed", "cluster"))
    killed = [each for each in found["killed"] if each["code"] < 0 or each["code"] > 128]
    same = "the same files, byte for byte" if found["same"] and found["same on cluster"] else "other files"
    return wrapped(
        f"A library of {found['count']} generated sources was baked by {found['jobs']} processes with `linear`. "
        f"{found['broken']} of them are broken, {found['doubles']} have the name of another one, and the others became "
        f"{whole['baked']} results in {whole['seconds']:.0f} s. A second call with nothing changed took "
        f"{again['seconds']:.1f} s; a call after one source was touched took {one['seconds']:.1f} s and baked "
        f"{one['baked']}. Then the command was killed {len(killed)} times with all its processes and called again: "
        f"{found['baked twice']} results were baked twice. On a Ray cluster of two machines of one core each, "
        f"{found['cluster deaths']} processes were killed meanwhile; it took {there['seconds']:.0f} s, and "
        f"{there['failed']} sources were reported. All ways left {same} ({found['files']} files). "
        f"{_where(records, 'library')}"
    )


def soak_table(records: Records) -> str:
    found = records["soak"]
    rows = []
    for method, windows in found["methods"].items():
        for window in (windows[0], windows[len(windows) // 2 - 1], windows[-1]):
            rows.append([method, _count(window["bakes"]), f"{window['memory'] / 2**20:.0f}", str(window["handles"]),
                         str(window["threads"]), f"{window['seconds']:.2f}"])  # fmt: skip
    heads = ["method", "bakes", "memory, MiB", "open files", "threads", "processor, median of a bake, s"]
    return "\n\n".join([table(heads, rows), _where(records, "soak")])


def _where(records: Records, name: str) -> str:
    record = records.record(name)
    return f"Measured {record.measured.on} on {record.measured.machine}."


def _count(value: float) -> str:
    return f"{value:,.0f}"


def _time(value: float) -> str:
    return f"{value * 60:.0f} min" if value < 1.5 else f"{value:.1f} h" if value < 36 else f"{value / 24:.1f} days"


SCALING_VIEWS: Mapping[str, Callable[[Records], str]] = {
    "throughput/by-size": throughput_by_size,
    "throughput-large/by-size": lambda records: throughput_by_size(records, LARGE),
    "throughput/by-format": throughput_by_format,
    "throughput-large/parts": throughput_parts,
    "throughput-large/ten-thousand": ten_thousand,
    "library/words": library_words,
    "soak/table": soak_table,
}
