"""What the benchmarks share: arguments, fair timing of candidates beside each other, tables, the machine's name."""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

ROOT = Path(__file__).resolve().parent.parent
CONFIGS, BASELINES = ROOT / "training" / "configs", ROOT / "benchmarks" / "baselines"

MIPBAKE = (sys.executable, "-c", "from mipbake.cli.main import run; run()")
"""The command `mipbake`, as a process of its own."""

Effort = TypeVar("Effort")


def parser_of(doc: str | None, *places: str, **defaults: Any) -> argparse.ArgumentParser:
    """A parser of a script's arguments.

    Args:
        doc: what `--help` shows, the docstring of the script.
        places: names of paths that must be given, in order.
        defaults: name to default of each option. An option has its default's type: False is a switch, a tuple takes
            one value or more, and None is a path that may be left out. Numbers are at least 0; whole ones are at
            least 1 where no default is 0.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for place in places:
        parser.add_argument(place, type=Path)
    for name, value in defaults.items():
        flag = f"--{name.replace('_', '-')}"
        if value is False:
            parser.add_argument(flag, action="store_true")
        elif value is None:
            parser.add_argument(flag, type=Path)
        else:
            several = isinstance(value, tuple)
            kind = type((value or ("",))[0]) if several else type(value)
            counts = kind is int and 0 not in (value if several else (value,))
            reads = number(kind, int(counts)) if kind in (int, float) else kind
            more = {"nargs": "+"} if several else {}
            parser.add_argument(flag, type=reads, default=value, help="(default: %(default)s)", **more)
    return parser


def number(kind: Callable[[str], Any], least: int = 0) -> Callable[[str], Any]:
    """Reads a finite number that is at least `least`."""

    def read(text: str) -> Any:
        with suppress(ValueError):
            if least <= (value := kind(text)) < math.inf:
                return value
        wanted = f"{'whole ' * (kind is int)}number of at least {least}"
        raise argparse.ArgumentTypeError(f"expected a {wanted}, got {text!r}")

    return read


def arguments(doc: str | None, *places: str, **defaults: Any) -> argparse.Namespace:
    """A script's arguments, as `parser_of` reads them."""
    return parser_of(doc, *places, **defaults).parse_args()


def effort_of(kind: type[Effort], options: argparse.Namespace) -> Effort:
    """The dataclass whose fields are options. A tuple stays one."""
    given = {field.name: getattr(options, field.name) for field in fields(kind)}  # type: ignore[arg-type]
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in given.items()})


def expect(what: str, names: Iterable[str], known: Collection[str]) -> None:
    """Ends the program where names are unknown, and says which there are; `what` is named."""
    if unknown := [name for name in names if name not in known]:
        raise SystemExit(f"no {what} {', '.join(unknown)}: expected some of {', '.join(known)}")


@dataclass(frozen=True)
class Timing:
    """Seconds of the rounds: the median, and (largest - smallest) / median."""

    median: float
    spread: float


def measure(
    candidates: dict[str, Callable[[], object]], rounds: int, synchronize: Callable[[], object] = lambda: None
) -> dict[str, Timing]:
    """Times every candidate once a round, after one round that does not count; on a GPU, until `synchronize` returns.

    The rounds alternate between the candidates, so that all see the same machine.
    """
    seconds: dict[str, list[float]] = {name: [] for name in candidates}
    for index in range(rounds + 1):
        for name, call in candidates.items():
            synchronize()
            start = time.perf_counter()
            call()
            synchronize()
            if index > 0:
                seconds[name].append(time.perf_counter() - start)
    return {n: Timing(statistics.median(s), (max(s) - min(s)) / statistics.median(s)) for n, s in seconds.items()}


def on_device(name: str) -> tuple[str, Callable[[], object]]:
    """What a device of torch is called, and what waits until it is done: `cpu`, with its instruction set, or `cuda`."""
    import torch

    from mipbake import _native

    if torch.device(name).type == "cuda":
        return torch.cuda.get_device_name(), torch.cuda.synchronize
    return f"{cpu_name()}, {_native.isa()}", lambda: None


def cpu_name() -> str:
    """The processor as it calls itself, and its cores."""
    info = Path("/proc/cpuinfo")
    names = [line for line in info.read_text().splitlines() if "model name" in line] if info.exists() else []
    name = names[0].split(":", 1)[1].strip() if names else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores"


def lines(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """The lines of a table, in Markdown."""
    return (f"| {' | '.join(row)} |" for row in chain((heads, ["---"] * len(heads)), rows))


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown."""
    return "\n".join(lines(heads, rows))


def show(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Prints a table, each row as soon as it is measured."""
    for line in lines(heads, rows):
        print(line, flush=True)


def holds(file: Path, key: str, value: Any) -> bool:
    """Whether a file that `keep` wrote has this value under a key."""
    try:
        return bool(json.loads(file.read_text(encoding="utf-8"))[key] == json.loads(json.dumps(value)))
    except (OSError, ValueError, KeyError, TypeError):
        return False


def keep(found: Any, file: Path | None) -> None:
    """Writes what was measured to a file as a whole, where one is named, and prints it else."""
    text = json.dumps(found, indent=1) + "\n"
    if file is None:
        print(text, end="")
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_suffix(".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(file)
