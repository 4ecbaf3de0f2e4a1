"""The record of golden results, and what differs from it."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from mipbake import _native

from .results import Arrays, digest, films, means, stacks, trainings

FILE = Path(__file__).with_name("record.json")

NEAR = 0.02
"""How far means may be apart on another machine: sums are rounded otherwise there, and searches decide otherwise."""

_TELLING = "model name", "cpu family", "model", "stepping", "cache size"  # in the system's list of processors


@dataclass(frozen=True)
class Golden:
    """A result.

    Args:
        bits: hash of all its bits. means: of its arrays.
    """

    bits: str
    means: list[float]

    def differs(self, found: Golden, same_machine: bool) -> bool:
        """Whether a result is another one: by any bit on the same machine, else by its means."""
        if same_machine:
            return self.bits != found.bits
        return len(self.means) != len(found.means) or not np.allclose(self.means, found.means, rtol=NEAR, atol=NEAR)


def everything() -> dict[str, Callable[[], Arrays]]:
    """Name of every result, and what makes it."""
    return dict([*stacks(), *trainings(), *films()])


def made(make: Callable[[], Arrays]) -> Golden:
    """A result as it is today. One thread of torch and of NumPy's library: their sums hang on the number."""
    torch.set_num_threads(1)
    with threadpool_limits(1):
        arrays = make()
    return Golden(digest(arrays), means(arrays))


def machine() -> str:
    """What bits hang on beside the code: the processor, and libraries that choose kernels for it.

    Virtual machines give processors of several generations one name; family, model and caches tell them apart.
    """
    info = Path("/proc/cpuinfo")
    lines = (line.partition(":") for line in info.read_text().splitlines()) if info.exists() else ()
    told = {key.strip(): value.strip() for key, _, value in lines}
    processor = " ".join(told[key] for key in _TELLING if key in told) or platform.processor()
    libraries = (f"{name} {version(name)}" for name in ("torch", "numpy"))
    return ", ".join((sys.platform, platform.machine(), processor, _native.isa(), *libraries))


def read() -> tuple[str, dict[str, Golden]]:
    """The machine of the record, and its results."""
    content = json.loads(FILE.read_text(encoding="utf-8"))
    return content["machine"], {name: Golden(**each) for name, each in content["results"].items()}


def write(results: Mapping[str, Golden]) -> None:
    """Takes results of this machine for the record."""
    lines = [f"  {json.dumps(name)}: {json.dumps(asdict(each))}" for name, each in results.items()]
    text = f'{{"machine": {json.dumps(machine())},\n "results": {{\n' + ",\n".join(lines) + "\n}}\n"
    FILE.write_text(text, encoding="utf-8")
