"""`ggx`: diffuse albedo and specular reflectance of their own, and an anisotropic GGX lobe.

Its log-roughness tensor is equation 6 of Kemppinen et al. 2023: S = exp([[a, c], [c, b]]) with eigenvalues alpha_x^2,
alpha_y^2, in the tangent frame of the shading normal. Conversions between any two other models go through `ggx`.
"""

from __future__ import annotations

from mipbake.material.kinds import Kind
from mipbake.material.model import GGX_LEAST_ALPHA2, GGX_LOBE, MaterialModel, ModelMap, View, rgb
from mipbake.material.tensors import Array

GGX_MAPS = (
    ModelMap("diffuse", Kind.REFLECTANCE, rgb("diffuse albedo")),
    ModelMap("specular", Kind.REFLECTANCE, rgb("specular reflectance at normal incidence")),
    ModelMap("normal", Kind.NORMAL_XY, ("normal, x", "normal, y")),
    ModelMap(
        "log_roughness",
        Kind.LOG_TENSOR,
        tuple(f"log-roughness tensor, {entry}" for entry in ("a (xx)", "b (yy)", "c (xy)")),
    ),
)


def _same(stored: Array) -> Array:
    return stored


GGX = MaterialModel(
    name="ggx",
    formula="anisotropic GGX with roughness tensor S = exp([[a, c], [c, b]]), eigenvalues alpha_x^2 and alpha_y^2; "
    "normal z = sqrt(1 - x^2 - y^2)",
    stored=GGX_MAPS,
    gltf=False,
    coated=False,
    lobe=GGX_LOBE,
    least_alpha2=GGX_LEAST_ALPHA2,
    to_ggx=_same,
    from_ggx=_same,
    view=View(
        ((0, 1, 2, 6), (3, 4, 5, 7), (8, 9, 10)),
        """
    return tensorModel(textureLod(uMap0, uv, lod), textureLod(uMap1, uv, lod), textureLod(uMap2, uv, lod));""",
    ),
)
