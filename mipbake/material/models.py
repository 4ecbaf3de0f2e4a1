"""Every material model, by name, and what is done with any of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mipbake.base.names import known_name
from mipbake.material.beckmann import BECKMANN
from mipbake.material.ggx import GGX
from mipbake.material.gltf import GLTF, GLTF_ANISOTROPIC
from mipbake.material.kinds import MAX_LOG_ALPHA2, Kind
from mipbake.material.model import MaterialModel
from mipbake.material.tensors import Array

MODELS: Mapping[str, MaterialModel] = {m.name: m for m in (GLTF, GLTF_ANISOTROPIC, GGX, BECKMANN)}
"""Name to description of every model; csrc/shading/models.h lists their formulas."""


COMMON = GGX.name
"""The model that any two models are converted through."""

GLTF_MODELS = tuple(model.name for model in MODELS.values() if model.gltf)
"""Names of the models that glTF has."""


def model_named(name: str) -> MaterialModel:
    """The model of that name; UsageError with the list of names when there is none."""
    return MODELS[known_name("material model", name, MODELS)]


def least_alpha2(model: str) -> float:
    """The least eigenvalue of S that stacks hold: narrower lobes are not shaded, or in `beckmann` their twins."""
    return model_named(model).least_alpha2


def most_roughness(model: MaterialModel) -> float:
    """The greatest roughness of a lobe: 1, or beyond it where a model stores its logarithm."""
    return math.exp(MAX_LOG_ALPHA2 / 4) if model.of(Kind.LOG_TENSOR) else 1.0


def regularise(stored: Array, model: str) -> Array:
    """Clips stored channels to their limits and renormalises unit vectors, as a shader does after filtering.

    Vectors shorter than 1e-6 become +Z (normals) or +X (directions). Shape and dtype are kept.
    """
    layout = model_named(model)
    low, high = np.array(layout.limits, stored.dtype).T
    out = np.clip(stored, low, high)
    for each in layout.stored:
        if each.facts.unit_axis is not None:
            group = layout.maps[each.name]
            v = stored[..., group]
            length = np.linalg.norm(v, axis=-1, keepdims=True)
            axis = np.zeros(each.facts.channels, stored.dtype)
            axis[each.facts.unit_axis] = 1
            out[..., group] = np.where(length > 1e-6, v / np.maximum(length, 1e-6), axis)
    return out


def convert(stored: Array, source: str, target: str) -> Array:
    """Converts stored channels of one model to stored channels of another; `ggx`, COMMON, lies between any two."""
    given, wanted = model_named(source), model_named(target)
    if given is wanted:
        return stored
    if source in wanted.exact:
        return wanted.exact[source](stored)
    return wanted.from_ggx(given.to_ggx(stored))


class Losses(NamedTuple):
    """What a conversion loses or changes, whether it does; the gravest first, so that the least of several is the best
    one."""

    anisotropy: bool
    lobe: bool
    """Highlights get other tails."""
    gamma: bool
    reflectances: bool
    """One reflectance, and a share of metal, stands for two."""
    diffuse: bool
    """The diffuse term loses the light that a dielectric's surface reflects, in one of the models alone."""

    @property
    def blind(self) -> bool:
        """Whether the target cannot say what the source says; it may shade differently what both say."""
        return self.anisotropy or self.gamma or self.reflectances


def losses(source: str, target: str) -> Losses:
    """What a conversion loses."""
    given, wanted = model_named(source), model_named(target)
    return Losses(
        anisotropy=given.anisotropic and not wanted.anisotropic,
        lobe=given.lobe is not wanted.lobe,
        gamma=len(given.of(Kind.LOG_GAMMA)) > len(wanted.of(Kind.LOG_GAMMA)),
        reflectances=len(given.of(Kind.REFLECTANCE)) > len(wanted.of(Kind.REFLECTANCE)),
        diffuse=given.coated != wanted.coated,
    )
