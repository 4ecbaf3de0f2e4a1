"""The description of a material model: all that the package knows of it, in one place."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from mipbake.material.kinds import FACTS, LOG, MIN_ROUGHNESS, Facts, Kind
from mipbake.material.tensors import (
    Array,
    axes_to_tensor,
    full_tensor,
    lift_normal,
    mean_eigenvalue,
    positive_definite,
    tensor_exp,
    tensor_log,
    tensor_to_axes,
)

Conversion: TypeAlias = Callable[[Array], Array]
"""(..., C) stored channels of one model to stored channels of another; dtype and leading shape are kept."""


@dataclass(frozen=True, eq=False)
class Lobe:
    """A distribution of half vectors, together with what alpha means in it. Models that share one share alpha.

    Args:
        tails: what its highlights have, in words.
    """

    tails: str


GGX_LOBE = Lobe("the long tails of GGX")

GGX_LEAST_ALPHA2 = (MIN_ROUGHNESS * MIN_ROUGHNESS) * (MIN_ROUGHNESS * MIN_ROUGHNESS)
"""The least eigenvalue of S that stacks with a GGX lobe hold: narrower lobes are not shaded."""


@dataclass(frozen=True)
class ModelMap:
    """A map of a model: channels that belong together, and that blends weigh together.

    Args:
        name: the stem of its files, unless it shares a file.
        kind: what its channels hold.
        meanings: what each of its channels holds, in words.
        file: the stem of the file that it shares with the maps beside it; empty where it has files of its own.
    """

    name: str
    kind: Kind
    meanings: tuple[str, ...]
    file: str = ""

    @property
    def facts(self) -> Facts:
        """What is true of its kind."""
        return FACTS[self.kind]


@dataclass(frozen=True)
class View:
    """A model in the interactive view of a report.

    Args:
        textures: the stored channels in the four channels of each texture. Where the first channels are red, green and
            blue of a colour, the texture is sRGB-encoded, and keeps its fourth channel linear.
        surface: the body of the GLSL function `Surface surfaceAt(vec2 uv, float lod)`. It reads the textures `uMap0`,
            `uMap1` ... What it may call, and what a `Surface` is, stands in `mipbake/comparing/viewer/shaders.js`.
    """

    textures: tuple[tuple[int, ...], ...]
    surface: str


class Lines(NamedTuple):
    """The stored channels of a model whose anisotropy has a direction: both d and -d, so a field of lines."""

    roughness: slice
    direction: slice
    strength: slice

    @property
    def channels(self) -> slice:
        """Direction and strength."""
        return slice(self.direction.start, self.strength.stop)


class MaterialPart(NamedTuple):
    """Neighbouring maps that are treated alike, as one.

    Args:
        kind: of the first of them.
        channels: their stored channels.
        coordinates: what stands for them where the coordinates of all parts are in a row.
        parameters: what stands for them where the parameters of all parts are in a row. Where a model has lines, a
            direction's are a, b, c of the log-roughness tensor, and roughness and strength have none.
    """

    kind: Kind
    channels: slice
    coordinates: slice
    parameters: slice


_ALIKE = (Kind.REFLECTANCE, Kind.SHARE)
"""Kinds whose neighbours make one part: they differ in how files hold them, and in nothing else."""


@dataclass(frozen=True, eq=False)
class MaterialModel:
    """A material model.

    Args:
        name: what users call it.
        formula: what it shades with, in a line.
        stored: the maps that it is stored in, in order.
        gltf: whether glTF has it: sets come in it, and engines, presets and GLB files hold it.
        coated: whether the diffuse term loses the light that a dielectric's surface reflects.
        lobe: its distribution.
        least_alpha2: the least eigenvalue of S that stacks hold: narrower lobes are not shaded, or stand for such.
        to_ggx, from_ggx: conversions. Any two models are converted through `ggx`.
        exact: other models that are converted without it, by name, each with its conversion to this one.
        decoded_from: the model whose decoder also serves for this one, where a network has no decoder for it; its
            texels are converted.
        view: how reports show it.
    """

    name: str
    formula: str
    stored: tuple[ModelMap, ...]
    gltf: bool
    coated: bool
    lobe: Lobe
    least_alpha2: float
    to_ggx: Conversion
    from_ggx: Conversion
    view: View
    exact: Mapping[str, Conversion] = field(default_factory=dict)
    decoded_from: str | None = None

    # ---- channels

    @cached_property
    def maps(self) -> Mapping[str, slice]:
        """Name of each map, in order, to its stored channels."""
        channels = _in_a_row(each.facts.channels for each in self.stored)
        return {each.name: found for each, found in zip(self.stored, channels, strict=True)}

    @cached_property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """(C, 2) lowest and highest value of each stored channel."""
        return tuple(each.facts.limits for each in self.stored for _ in range(each.facts.channels))

    @property
    def channels(self) -> int:
        """Number of stored channels C."""
        return len(self.limits)

    def of(self, *kinds: Kind) -> tuple[slice, ...]:
        """The stored channels of each map of these kinds."""
        return tuple(self.maps[each.name] for each in self.stored if each.kind in kinds)

    @cached_property
    def unit_vectors(self) -> tuple[slice, ...]:
        """Channel groups that are unit vectors and are renormalised after filtering."""
        return self.of(*(kind for kind, facts in FACTS.items() if facts.unit_axis is not None))

    @cached_property
    def normal(self) -> slice:
        """Its normal: x, y, z or x, y."""
        (found,) = self.of(Kind.NORMAL, Kind.NORMAL_XY)
        return found

    @cached_property
    def averaged(self) -> list[int]:
        """The channels that every closed form averages as they are stored: reflectances, shares and g of `beckmann`."""
        groups = self.of(*(kind for kind, facts in FACTS.items() if facts.averaged))
        return [channel for group in groups for channel in range(group.start, group.stop)]

    @cached_property
    def lines(self) -> Lines | None:
        """Where its anisotropy has a direction; None where it has none."""
        found = self.of(Kind.ROUGHNESS), self.of(Kind.DIRECTION), self.of(Kind.STRENGTH)
        if not all(found):
            return None
        lines = Lines(*(first for first, *_ in found))
        return lines if lines.direction.stop == lines.strength.start else None

    @property
    def anisotropic(self) -> bool:
        """Whether its lobes may be wider one way than the other."""
        return self.lines is not None or bool(self.of(Kind.LOG_TENSOR))

    @property
    def logarithms(self) -> bool:
        """Whether it has channels that only float containers hold."""
        return any(each.facts.encoding == LOG for each in self.stored)

    @cached_property
    def files(self) -> Mapping[str, tuple[ModelMap, ...]]:
        """Stem of each file, in order, to the maps in it."""
        groups = itertools.groupby(self.stored, lambda each: each.file or each.name)
        return {stem: tuple(maps) for stem, maps in groups}

    # ---- coordinates and parameters

    @cached_property
    def parts(self) -> tuple[MaterialPart, ...]:
        """Its maps in order, as few parts as can be."""
        lobe = {} if self.lines is None else {Kind.ROUGHNESS: 0, Kind.DIRECTION: 3, Kind.STRENGTH: 0}
        counts: list[tuple[Kind, int, int, int]] = []
        for _, group in itertools.groupby(self.stored, lambda each: each.kind in _ALIKE or each.name):
            maps = list(group)
            channels = sum(each.facts.channels for each in maps)
            coordinates = sum(each.facts.coordinates for each in maps)
            counts.append((maps[0].kind, channels, coordinates, lobe.get(maps[0].kind, coordinates)))
        kinds, *columns = zip(*counts, strict=True)
        return tuple(
            MaterialPart(*each) for each in zip(kinds, *(_in_a_row(column) for column in columns), strict=True)
        )

    @property
    def coordinates(self) -> int:
        """How many coordinates a descent moves a texel by."""
        return sum(each.facts.coordinates for each in self.stored)

    @property
    def parameters(self) -> int:
        """How many unconstrained parameters networks read and make."""
        return max(int(part.parameters.stop) for part in self.parts)

    # ---- lobes

    def unit_normals(self, stored: Array) -> Array:
        """(..., 3) unit normals of stored channels; +Z for a normal that has no length."""
        normal = stored[..., self.normal]
        return np.asarray(lift_normal(normal)) if normal.shape[-1] == 2 else with_unit_length(normal)

    def roughness_tensor(self, stored: Array) -> Array:
        """S, whose eigenvalues are alpha^2: (..., 3) S11, S22, S12; or (..., 1) of an isotropic model."""
        for channels in self.of(Kind.LOG_TENSOR):
            return tensor_exp(stored[..., channels])
        (roughness,) = self.of(Kind.ROUGHNESS)
        alpha = np.square(stored[..., roughness.start])
        if self.lines is None:
            return np.square(alpha)[..., None]
        return axes_to_tensor(alpha, stored[..., self.lines.strength.start], stored[..., self.lines.direction])

    def of_tensor(self, tensor: Array) -> Mapping[Kind, Array]:
        """What a model stores of a roughness tensor S: (..., 3) S11, S22, S12, or (..., 1) of a round lobe.

        An isotropic model stores the mean eigenvalue.
        """
        if self.of(Kind.LOG_TENSOR):
            if tensor.shape[-1] == 1:
                log_alpha2 = np.log(np.maximum(tensor, self.least_alpha2))
                return {Kind.LOG_TENSOR: np.concatenate([log_alpha2, log_alpha2, np.zeros_like(log_alpha2)], -1)}
            return {Kind.LOG_TENSOR: tensor_log(positive_definite(tensor, self.least_alpha2))}
        if self.lines is None:
            return {Kind.ROUGHNESS: np.sqrt(np.sqrt(np.maximum(mean_eigenvalue(tensor), 0)))}
        alpha, strength, direction = tensor_to_axes(full_tensor(tensor))
        return {
            Kind.ROUGHNESS: np.sqrt(alpha)[..., None],
            Kind.DIRECTION: direction,
            Kind.STRENGTH: strength[..., None],
        }


def _in_a_row(counts: Iterable[int]) -> list[slice]:
    """Slices of these lengths, one behind the other."""
    return [slice(*ends) for ends in itertools.pairwise(itertools.accumulate(counts, initial=0))]


def with_unit_length(vectors: Array) -> Array:
    """Unit vectors; +Z for those that cancelled."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(size > 1e-6, vectors / np.maximum(size, 1e-6), np.array([0, 0, 1], vectors.dtype))


def rgb(what: str) -> tuple[str, ...]:
    """Meanings of red, green and blue."""
    return tuple(f"{what}, {c}" for c in ("red", "green", "blue"))
