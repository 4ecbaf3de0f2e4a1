"""The surface shaders of MaterialX that are read: which input holds which role, and what it is by default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mipbake.source.options import ROLES


@dataclass(frozen=True)
class Shader:
    """A surface shader.

    Args:
        inputs: role to the input that holds it.
        defaults: what base_color, metallic and roughness are where the document says nothing.
        weights: role to the input that multiplies it, and that input's default.
    """

    inputs: Mapping[str, str]
    defaults: Mapping[str, float]
    weights: Mapping[str, tuple[str, float]] = field(default_factory=dict)


def _inputs(names: str) -> Mapping[str, str]:
    """Role to input, of inputs in the order of `ROLES`: base colour, normal, roughness, metallic, anisotropy,
    occlusion, height, emissive, opacity. A hyphen stands for none."""
    return {role: name for role, name in zip(ROLES, names.split(), strict=True) if name != "-"}


SHADERS: Mapping[str, Shader] = {
    "standard_surface": Shader(
        _inputs("base_color normal specular_roughness metalness specular_anisotropy - - emission_color opacity"),
        {"base_color": 0.8, "roughness": 0.2, "metallic": 0.0},
        {"base_color": ("base", 1.0), "emissive": ("emission", 0.0)},
    ),
    "open_pbr_surface": Shader(
        _inputs(
            "base_color geometry_normal specular_roughness base_metalness specular_roughness_anisotropy - - "
            "emission_color geometry_opacity"
        ),
        {"base_color": 0.8, "roughness": 0.3, "metallic": 0.0},
        {"base_color": ("base_weight", 1.0), "emissive": ("emission_luminance", 0.0)},
    ),
    "gltf_pbr": Shader(
        _inputs("base_color normal roughness metallic anisotropy_strength occlusion - emissive alpha"),
        {"base_color": 1.0, "roughness": 1.0, "metallic": 1.0},
        {"emissive": ("emissive_strength", 1.0)},
    ),
    "UsdPreviewSurface": Shader(
        _inputs("diffuseColor normal roughness metallic - occlusion displacement emissiveColor opacity"),
        {"base_color": 0.18, "roughness": 0.5, "metallic": 0.0},
    ),
}
"""The surface shaders that are read, with the inputs and defaults of their definitions in MaterialX 1.39."""
