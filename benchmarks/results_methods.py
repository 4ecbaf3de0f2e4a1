"""Which methods a measurement takes, by name, and their bakes, each in a process of its own that is timed.

The names are as for `mipbake compare`, with two kinds more: `neural:WEIGHTS` is a network by the name of its
weights, and `refine@2m` is a method within that budget. Networks without weights for the target are left out.

Run as a script, this file bakes one request: it is the process of its own.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mipnet_network import register

from mipbake.baking.methods import METHODS, OPTIONS, method_named
from mipbake.base.errors import UsageError
from mipbake.comparing.candidates import chosen
from mipbake.models.registry import WEIGHTS_FOLDER, WeightsInfo, default_weights, find_weights, list_weights
from mipbake.quality.figures import Candidate, Method
from mipbake.source.texture_set import TextureSet


@dataclass(frozen=True)
class Spec:
    """A method as it is asked for.

    Args:
        name: what tables call it.
        method: a key of METHODS.
        kernel: averaging kernel of a closed form, else the pixel filter.
        target: material model of the stack.
        weights: of a network, by name; None for the default ones, or for none.
        folder: where the weights lie.
        sha256: of the weights that the name stands for today; None where there are none.
        budget: of methods that have one; None for their own.
    """

    name: str
    method: str
    kernel: str
    target: str
    weights: str | None = None
    folder: str = str(WEIGHTS_FOLDER)
    sha256: str | None = None
    budget: str | None = None

    def key(self) -> dict[str, Any]:
        """What its figures depend on: not where weights lie."""
        return {name: value for name, value in asdict(self).items() if name != "folder"}


@dataclass(frozen=True)
class Cost:
    """What a bake took: seconds of wall clock and of processors, and the peak memory of its process in MiB."""

    seconds: float
    processor_seconds: float
    peak_mib: float


@dataclass(frozen=True, eq=False)
class Baked:
    """A stack and what it took."""

    spec: Spec
    candidate: Candidate
    cost: Cost

    def to_dict(self) -> dict[str, Any]:
        return asdict(self.spec) | asdict(self.cost) | {"model": self.spec.target}


def specs(
    names: Sequence[str], target: str, pixel_filter: str, folders: Sequence[Path] = (), source: str = "gltf"
) -> list[Spec]:
    """What the names stand for, each once; without the networks that have no weights for the target.

    Args:
        folders: folders of weights, beside the weights of the release.

    Raises:
        UsageError: a name that means no method.
    """
    found: dict[str, Spec] = {}
    for text in names:
        plain, _, budget = text.partition("@")
        method, _, wanted = plain.partition(":")
        if wanted or method == "neural":
            info = _weights(wanted or None, source, target, pixel_filter, folders)
            if method != "neural":
                raise UsageError(f"{text!r} names weights: expected neural:{wanted}")
            if info is not None:
                name = wanted or method
                found[name] = Spec(name, method, pixel_filter, target, info.name, str(info.folder), info.sha256)
            continue
        if budget and method not in OPTIONS["budget"]:
            raise UsageError(f"{text!r} has a budget: expected one of {', '.join(OPTIONS['budget'])} before the @")
        for label, (one, kernel) in chosen([method], pixel_filter).items():
            default = _weights(None, source, target, pixel_filter, ()) if one in OPTIONS["weights"] else None
            name = f"{label} {budget}" if budget else label
            found[name] = Spec(
                name, one, kernel, target, sha256=default.sha256 if default else None, budget=budget or None
            )
    return list(found.values())


def _weights(
    name: str | None, source: str, target: str, pixel_filter: str, folders: Sequence[Path]
) -> WeightsInfo | None:
    """The weights that make the target of the source; None where there are none."""
    if name is None:
        try:
            return default_weights(target, pixel_filter, source=source)
        except UsageError:
            return None
    for folder in (WEIGHTS_FOLDER, *folders):
        if name in (info.name for info in list_weights(folder)):
            info = find_weights(name, folder)
            fits = target in info.targets and pixel_filter in info.pixel_filters and info.network.takes(source)
            return info if fits else None
    return None


def named_weights(prefix: str, folders: Sequence[Path] = ()) -> list[str]:
    """`neural:NAME` of all weights that there are whose names begin so."""
    every = (info.name for folder in (WEIGHTS_FOLDER, *folders) for info in list_weights(folder))
    return [f"neural:{name}" for name in dict.fromkeys(every) if name.startswith(prefix)]


@contextmanager
def bakes(source: TextureSet, wanted: Sequence[Spec]) -> Iterator[list[Baked]]:
    """The stacks of many methods, one process after the other; levels are mapped from files that end with the context.

    Raises:
        RuntimeError: a bake failed; its last words.
    """
    with tempfile.TemporaryDirectory(prefix="mipbake-", ignore_cleanup_errors=True) as folder:
        root = Path(folder)
        np.save(root / "stored.npy", source.material(source.source_model))
        made = []
        for index, spec in enumerate(wanted):
            out = root / str(index)
            out.mkdir()
            request = {"source": source.source_model, "wrap": source.wrap, "spec": asdict(spec)}
            (out / "request.json").write_text(json.dumps(request))
            run = subprocess.run([sys.executable, __file__, str(out)], capture_output=True, text=True, check=False)
            if run.returncode:
                raise RuntimeError(f"{spec.name} of {source.name} failed: {run.stderr.strip()[-500:]}")
            levels = [
                np.load(out / f"{level}.npy", mmap_mode="r") for level in range(len(list(out.glob("[0-9]*.npy"))))
            ]
            cost = Cost(**json.loads((out / "cost.json").read_text()))
            method = Method(spec.name, spec.method, spec.kernel, spec.target, cost.seconds)
            made.append(Baked(spec, Candidate(method, levels), cost))
        yield made


def _peak_mib() -> float:
    """The most memory that this process has held. `ru_maxrss` also knows what started it, so Linux's own is better."""
    status = Path("/proc/self/status")
    if status.exists():
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1024
    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def _bake(folder: Path) -> None:
    """The child: reads the request, bakes, writes levels and costs."""
    request = json.loads((folder / "request.json").read_text())
    spec = Spec(**request["spec"])
    stored = np.load(folder.parent / "stored.npy")
    arguments = (stored, request["source"], spec.target, spec.kernel, tuple(request["wrap"]))
    wall, processor = time.perf_counter(), time.process_time()
    if spec.method == "neural":
        from mipbake.models.registry import load_network

        network = load_network(find_weights(str(spec.weights), Path(spec.folder)))
        levels = network.bake(*arguments, lambda _share: None)
    else:
        prefilter = method_named(spec.method, None, spec.budget) if spec.budget else METHODS[spec.method]
        levels = prefilter(*arguments, lambda _share: None).levels
    cost = Cost(time.perf_counter() - wall, time.process_time() - processor, _peak_mib())
    for index, level in enumerate(levels):
        np.save(folder / f"{index}.npy", np.asarray(level, np.float32))
    (folder / "cost.json").write_text(json.dumps(asdict(cost)))


if __name__ == "__main__":
    register()
    _bake(Path(sys.argv[1]))
