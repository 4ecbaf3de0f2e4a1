"""What is held: stacks by every method, training steps of every kind, and films. Each name begins with its kind."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.methods import METHODS, Prefilter
from mipbake.baking.search.methods import Optimum, Refine
from mipbake.baking.search.texel_descent import DescentEffort
from mipbake.comparing.filming import taken
from mipbake.comparing.films import films_of
from mipbake.comparing.pictures import RenderSettings
from mipbake.material.aim import SAMPLERS
from mipbake.material.filtered_source import FilteredSource
from mipbake.quality.environment import lamps
from mipbake.quality.figures import Candidate, Method
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.training import loop
from mipbake.training.batches import batches
from mipbake.training.config import TrainingConfig
from mipbake.training.data import load_materials
from mipbake.training.procedural import procedural_set

from ..small_training import tiny, tiny_balanced
from ..stacks import gltf_level

Arrays = Sequence[NDArray[np.float32]]

TARGETS = ("gltf", "gltf-anisotropic")

SEARCHES, SEARCHED = ("auto", "refine", "optimum"), ("bumps", "gltf")
"""Methods that take seconds for a set, and the only set and target that they are held for."""

_STEPS = 2


@dataclass(frozen=True)
class Source:
    """A set, as methods take it."""

    stored: NDArray[np.float32]
    model: str
    wrap: tuple[str, str]


def sources() -> dict[str, Source]:
    """Two tiny sets: an uneven one with directions, and bumps that repeat."""
    return {
        "waves": Source(gltf_level((16, 32), 0, anisotropic=True), "gltf-anisotropic", ("wrap", "clamp")),
        "bumps": Source(procedural_set(3, 16), "gltf", ("wrap", "wrap")),
    }


def methods() -> dict[str, Prefilter]:
    """Every method; those that stop by the clock, whose results differ from run to run, stop by rounds here."""
    few = Optimum(descent=DescentEffort(rounds=4, looks=ProbeEffort(groups=4)))
    return {**METHODS, "refine": Refine(budget="best"), "optimum": few}


def stacks() -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Name of a stack, and what bakes it."""
    for name, source in sources().items():
        for target in TARGETS:
            for method in methods().values():
                if method.name in SEARCHES and (name, target) != SEARCHED:
                    continue
                for kernel in ("gaussian", "box") if method.averages else ("gaussian",):
                    yield (
                        f"stacks, {name}, {target}, {method.name} ({kernel})",
                        partial(_baked, source, target, method, kernel),
                    )


def _baked(source: Source, target: str, method: Prefilter, kernel: str) -> Arrays:
    return method(source.stored, source.model, target, kernel, source.wrap, lambda _: None).levels


def trainings() -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Name of a training, and what makes some steps of it and gives the weights and their averages."""
    kinds = {
        "latent": tiny(),
        "latent ggx": tiny(network={"encoders": ["ggx"], "decoders": ["ggx"]}),
        "latent cross": tiny(network={"encoders": ["gltf", "ggx"], "decoders": ["gltf", "ggx"], "latent_channels": 20}),
        "moments": tiny_balanced(),
        "moments anisotropic": tiny_balanced(network={"decoders": ["gltf-anisotropic"]}),
        "moments ggx": tiny_balanced(network={"decoders": ["ggx"]}),
        "moments signed filter": tiny_balanced(loss={"pixel_filter": "mitchell", "any_filter": 0.0}),
    }
    for name, config in kinds.items():
        yield f"trainings, {name}", partial(_trained, config)


def _trained(config: TrainingConfig) -> Arrays:
    config = dataclasses.replace(config, run=dataclasses.replace(config.run, steps=_STEPS))
    materials, _ = load_materials(config)
    state = loop.new_state(config)
    loop.fit_whitening(state.network, materials, config)
    losses = [state.advance(batch).reshape(1) for batch in batches(materials, config, 0)]
    values = [value for each in (state.network, state.average) for value in each.state_dict().values()]
    return [np.asarray(value.numpy(), np.float32) for value in (*losses, *values)]


def films() -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Name of a film, and what makes its frames: the reference, then every candidate."""
    for scene in ("floor", "sphere"):
        for sampler in ("trilinear", "anisotropic"):
            yield f"films, {scene}, {sampler}", partial(_filmed, scene, sampler)


def _filmed(scene: str, sampler: str) -> Arrays:
    source = sources()["bumps"]
    size = source.stored.shape[:2]
    level = FilteredSource(source.stored, source.model, source.wrap, "gaussian")
    candidates = [
        Candidate(
            Method(f"{name} ({kernel})", name, kernel, "gltf", 0.0), _baked(source, "gltf", METHODS[name], kernel)
        )
        for name, kernel in (("linear", "box"), ("lean", "gaussian"), ("neural", "gaussian"))
    ]
    (shown,) = (each for each in films_of(size, lamps(), 4, None, "camera", 24) if each.name == f"film-{scene}")
    short = dataclasses.replace(shown, shots=shown.shots[:2])
    take = taken(short, level, candidates, RenderSettings(0, 16, SAMPLERS[sampler]))
    frames = (take.shown.mean, *map(take.shown.displayed, take.frames.values()))
    return [np.asarray(each, np.float32) for each in frames]


def digest(arrays: Arrays) -> str:
    """A hash of all bits."""
    made = hashlib.sha256()
    for array in arrays:
        made.update(repr(array.shape).encode())
        made.update(np.ascontiguousarray(array).tobytes())
    return made.hexdigest()[:16]


def means(arrays: Arrays) -> list[float]:
    """A number an array, near another machine's: the mean of what it holds."""
    return [round(float(array.mean(dtype=np.float64)), 6) for array in arrays]
