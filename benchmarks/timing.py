"""What every benchmark here shares: arguments, fair timing of candidates against each other, and the machine's name."""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


def parser_of(doc: str | None, *places: str, **defaults: Any) -> argparse.ArgumentParser:
    """A parser of a script's arguments.

    Args:
        doc: what `--help` shows, the docstring of the script.
        places: names of paths that must be given, in order.
        defaults: name to default of each option. An option has its default's type: False is a switch, a tuple takes
            one value or more, and None is a path that may be left out.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for place in places:
        parser.add_argument(place, type=Path)
    for name, value in defaults.items():
        flag = f"--{name.replace('_', '-')}"
        if value is False:
            parser.add_argument(flag, action="store_true")
        elif isinstance(value, tuple):
            kind = type(value[0]) if value else str
            parser.add_argument(flag, type=kind, nargs="+", default=value, help="(default: %(default)s)")
        else:
            kind = Path if value is None else type(value)
            parser.add_argument(
                flag, type=kind, default=value, help=None if value is None else "(default: %(default)s)"
            )
    return parser


def arguments(doc: str | None, *places: str, **defaults: Any) -> argparse.Namespace:
    """A script's arguments, as `parser_of` reads them."""
    return parser_of(doc, *places, **defaults).parse_args()


@dataclass(frozen=True)
class Timing:
    """Seconds of the rounds: the median, and (largest - smallest) / median."""

    median: float
    spread: float

    def text(self, count: int) -> str:
        """Milliseconds, and nanoseconds for each of `count` things."""
        return f"{self.median * 1e3:.1f} ms ({self.median / count * 1e9:.1f} ns, spread {self.spread:.0%})"


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


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows))


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
