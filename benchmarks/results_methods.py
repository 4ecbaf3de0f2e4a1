"""Which methods a measurement takes, by name, and their bakes.

The names are as for `mipbake compare`, with two kinds more: `neural:WEIGHTS` is a network by the name of its
weights, and `refine@2m` is a method within that budget. Networks without weights for the target are left out.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mipbake.baking.methods import METHODS, OPTIONS, method_named
from mipbake.base.errors import UsageError
from mipbake.comparing.candidates import chosen
from mipbake.models.registry import (
    WEIGHTS_FOLDER,
    WeightsInfo,
    default_weights,
    find_weights,
    list_weights,
    load_network,
)
from mipbake.quality.figures import Candidate, Method
from mipbake.source.texture_set import TextureSet


@dataclass(frozen=True)
class Spec:
    """A method, and what its stacks depend on.

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


def bakes(source: TextureSet, wanted: Sequence[Spec]) -> list[Candidate]:
    """The stacks of many methods, one after the other, with the seconds of processors that they took.

    Raises:
        RuntimeError: a bake failed, with the names of the method and the set.
    """
    stored, made = source.material(source.source_model), []
    for spec in wanted:
        arguments = (stored, source.source_model, spec.target, spec.kernel, source.wrap, lambda _share: None)
        began = time.process_time()
        try:
            if spec.method == "neural":
                levels = load_network(find_weights(str(spec.weights), Path(spec.folder))).bake(*arguments)
            else:
                prefilter = method_named(spec.method, None, spec.budget) if spec.budget else METHODS[spec.method]
                levels = prefilter(*arguments).levels
        except Exception as error:
            raise RuntimeError(f"{spec.name} of {source.name} failed: {error}") from error
        seconds = time.process_time() - began
        method = Method(spec.name, spec.method, spec.kernel, spec.target, seconds)
        made.append(Candidate(method, [np.array(level, np.float32) for level in levels]))
    return made
