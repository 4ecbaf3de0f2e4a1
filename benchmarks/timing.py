"""What every benchmark here shares: fair timing of candidates against each other, and the machine's name."""

from __future__ import annotations

import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


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


def cpu_name() -> str:
    """The processor as it calls itself, and its cores."""
    info = Path("/proc/cpuinfo")
    names = [line for line in info.read_text().splitlines() if "model name" in line] if info.exists() else []
    name = names[0].split(":", 1)[1].strip() if names else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows))


def keep(found: dict[str, Any], file: Path | None) -> None:
    """Writes what was measured to a file, where one is named, and prints it."""
    text = json.dumps(found, indent=1)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text + "\n", encoding="utf-8")
    print(text)
