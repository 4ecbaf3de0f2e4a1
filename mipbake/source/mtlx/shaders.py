"""The surface shaders of MaterialX that are read: which input holds which role, and what it is by default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


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


SHADERS: Mapping[str, Shader] = {
    "standard_surface": Shader(
        {
            "base_color": "base_color",
            "normal": "normal",
            "roughness": "specular_roughness",
            "metallic": "metalness",
            "anisotropy": "specular_anisotropy",
            "emissive": "emission_color",
            "opacity": "opacity",
        },
        {"base_color": 0.8, "roughness": 0.2, "metallic": 0.0},
        {"base_color": ("base", 1.0), "emissive": ("emission", 0.0)},
    ),
    "open_pbr_surface": Shader(
        {
            "base_color": "base_color",
            "normal": "geometry_normal",
            "roughness": "specular_roughness",
            "metallic": "base_metalness",
            "anisotropy": "specular_roughness_anisotropy",
            "emissive": "emission_color",
            "opacity": "geometry_opacity",
        },
        {"base_color": 0.8, "roughness": 0.3, "metallic": 0.0},
        {"base_color": ("base_weight", 1.0), "emissive": ("emission_luminance", 0.0)},
    ),
    "gltf_pbr": Shader(
        {
            "base_color": "base_color",
            "normal": "normal",
            "roughness": "roughness",
            "metallic": "metallic",
            "anisotropy": "anisotropy_strength",
            "occlusion": "occlusion",
            "emissive": "emissive",
            "opacity": "alpha",
        },
        {"base_color": 1.0, "roughness": 1.0, "metallic": 1.0},
        {"emissive": ("emissive_strength", 1.0)},
    ),
    "UsdPreviewSurface": Shader(
        {
            "base_color": "diffuseColor",
            "normal": "normal",
            "roughness": "roughness",
            "metallic": "metallic",
            "occlusion": "occlusion",
            "height": "displacement",
            "emissive": "emissiveColor",
            "opacity": "opacity",
        },
        {"base_color": 0.18, "roughness": 0.5, "metallic": 0.0},
    ),
}
"""The surface shaders that are read, with the inputs and defaults of their definitions in MaterialX 1.39."""
