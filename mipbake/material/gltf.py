"""`gltf` and `gltf-anisotropic`: glTF 2.0, appendix B of its specification, with KHR_materials_anisotropy."""

from __future__ import annotations

import numpy as np

from mipbake.material.kinds import MIN_ROUGHNESS, Kind
from mipbake.material.model import GGX_LEAST_ALPHA2, GGX_LOBE, MaterialModel, ModelMap, View, rgb
from mipbake.material.tensors import Array, axes_to_tensor, lift_normal, tensor_exp, tensor_log, tensor_to_axes

DIELECTRIC_F0 = 0.04
"""Reflectance at normal incidence of every non-metal in the metallic-roughness model."""


def gltf_to_ggx(stored: Array) -> Array:
    """`gltf` or `gltf-anisotropic` channels to `ggx`: albedo = (1 - metallic) base, F0 = mix(0.04, base, metallic).

    Roughness is raised to MIN_ROUGHNESS. What remains of the difference between the models is the factor (1 - F) that
    glTF puts on the diffuse term and `ggx` does not.
    """
    base, metallic = stored[..., 0:3], stored[..., 3:4]
    alpha = np.square(np.maximum(stored[..., 4], MIN_ROUGHNESS))
    if stored.shape[-1] > 8:
        abc = tensor_log(axes_to_tensor(alpha, stored[..., 10], stored[..., 8:10]))
    else:
        log_alpha2 = 2 * np.log(alpha)
        abc = np.stack([log_alpha2, log_alpha2, np.zeros_like(log_alpha2)], -1)
    specular = DIELECTRIC_F0 + (base - DIELECTRIC_F0) * metallic
    return np.concatenate([base * (1 - metallic), specular, stored[..., 5:7], abc], -1)


def base_and_metallic(albedo: Array, specular: Array) -> tuple[Array, Array]:
    """Base colour (..., 3) and metallic (..., 1) from diffuse albedo and F0 (..., 3), exact on what glTF can represent.

    Dark metals (F0 below 0.04) have two representations: base colour and metallic may differ where albedo and F0 agree.
    base = albedo + F0 - 0.04 (1 - m) in every channel; with channel means, m solves
    0.04 m^2 + (albedo + F0 - 0.08) m - (F0 - 0.04) = 0.
    """
    excess = specular.mean(-1, keepdims=True) - DIELECTRIC_F0
    b = albedo.mean(-1, keepdims=True) + specular.mean(-1, keepdims=True) - 2 * DIELECTRIC_F0
    root = np.sqrt(np.maximum(b * b + 4 * DIELECTRIC_F0 * excess, 0))
    # Without cancellation on either side of b = 0. Below F0 = 0.04 there are two solutions; the less metallic is taken.
    shiny = np.where(b >= 0, 2 * excess / np.maximum(b + root, 1e-12), (root - b) / (2 * DIELECTRIC_F0))
    dark = np.where(b < 0, -2 * excess / np.maximum(root - b, 1e-12), 0)
    metallic = np.clip(np.where(excess > 0, shiny, dark), 0, 1)
    return np.clip(albedo + specular - DIELECTRIC_F0 * (1 - metallic), 0, 1), metallic


def ggx_to_gltf(stored: Array) -> Array:
    """`ggx` channels to `gltf`. Anisotropy is lost: alpha^2 becomes the geometric mean of the tensor's eigenvalues."""
    base, metallic = base_and_metallic(stored[..., 0:3], stored[..., 3:6])
    roughness = np.exp((stored[..., 8:9] + stored[..., 9:10]) / 8)
    return np.concatenate([base, metallic, np.clip(roughness, 0, 1), lift_normal(stored[..., 6:8])], -1)


def ggx_to_gltf_anisotropic(stored: Array) -> Array:
    """`ggx` channels to `gltf-anisotropic`, exact where both axes are at most 1."""
    base, metallic = base_and_metallic(stored[..., 0:3], stored[..., 3:6])
    alpha, strength, direction = tensor_to_axes(tensor_exp(stored[..., 8:11]))
    return np.concatenate(
        [base, metallic, np.sqrt(alpha)[..., None], lift_normal(stored[..., 6:8]), direction, strength[..., None]], -1
    )


def gltf_to_gltf_anisotropic(stored: Array) -> Array:
    """`gltf` channels to `gltf-anisotropic`, exactly: strength 0, direction +X."""
    direction = np.broadcast_to(np.array([1, 0, 0], stored.dtype), (*stored.shape[:-1], 3))
    return np.concatenate([stored, direction], -1)


def error_weights(stored: Array) -> tuple[Array, Array, Array]:
    """What a small squared error of a stored channel counts in the squared error of what is shaded, up to a factor.

    A lobe of the area A = alpha_x alpha_y and the reflectance F has the energy F^2 / A, since its peak is as high as
    1 / A and it is as wide as A; diffuse light has albedo^2 / pi^2. Derivatives of the lobe: its height follows
    alpha^-2, and a normal turns it away within an angle of alpha. Lobes that an axis stretches are told apart by A
    alone.

    Args:
        stored: (..., C) of `gltf` or `gltf-anisotropic`.

    Returns:
        (..., C) weights; of normals, for every direction across the normal. (...,) energies, diffuse and of the lobe.
    """
    base, metallic, rough = stored[..., 0:3], stored[..., 3], np.maximum(stored[..., 4], MIN_ROUGHNESS)
    alpha = np.square(rough)
    strength = stored[..., 10] if stored.shape[-1] > 8 else np.float32(0)
    along = alpha + (1 - alpha) * np.square(strength)
    area = alpha * along
    lobe = _mean_square(DIELECTRIC_F0 + (base - DIELECTRIC_F0) * metallic[..., None]) / area
    matte = _mean_square(base) / np.pi**2
    diffuse = matte * np.square(1 - metallic)
    tint = (np.square(metallic) / area + np.square(1 - metallic) / np.pi**2) / 3
    metal = _mean_square(base - DIELECTRIC_F0) / area + matte
    parts = [*[tint] * 3, metal, 16 * lobe / alpha, *[lobe / area + diffuse / 2] * 3]
    if stored.shape[-1] > 8:
        parts += [*[lobe * np.square(along / alpha - 1)] * 2, lobe * np.square(2 * strength * (1 - alpha) / along)]
    return np.stack(parts, -1), diffuse, lobe


def _mean_square(colours: Array) -> Array:
    """(...) means of squares of (..., 3) colours."""
    return np.asarray(np.einsum("...c,...c->...", colours, colours) / 3)


_MAPS = (
    ModelMap("base_color", Kind.REFLECTANCE, rgb("base colour")),
    ModelMap("metallic", Kind.SHARE, ("metallic",)),
    ModelMap("roughness", Kind.ROUGHNESS, ("perceptual roughness r; alpha = r^2",)),
    ModelMap("normal", Kind.NORMAL, ("normal, x", "normal, y", "normal, z")),
)

GLTF = MaterialModel(
    name="gltf",
    formula="glTF 2.0 metallic-roughness (its appendix B)",
    stored=_MAPS,
    gltf=True,
    coated=True,
    lobe=GGX_LOBE,
    least_alpha2=GGX_LEAST_ALPHA2,
    to_ggx=gltf_to_ggx,
    from_ggx=ggx_to_gltf,
    view=View(
        ((0, 1, 2, 3), (5, 6, 7, 4)),
        """
    vec4 first = textureLod(uMap0, uv, lod), second = textureLod(uMap1, uv, lod);
    return metallicRoughness(first, second);""",
    ),
)

GLTF_ANISOTROPIC = MaterialModel(
    name="gltf-anisotropic",
    formula="glTF 2.0 metallic-roughness with KHR_materials_anisotropy",
    stored=(
        *_MAPS,
        ModelMap(
            "anisotropy_direction",
            Kind.DIRECTION,
            ("anisotropy direction, along the rougher axis, x", "anisotropy direction, along the rougher axis, y"),
            file="anisotropy",
        ),
        ModelMap("anisotropy_strength", Kind.STRENGTH, ("anisotropy strength",), file="anisotropy"),
    ),
    gltf=True,
    coated=True,
    lobe=GGX_LOBE,
    least_alpha2=GGX_LEAST_ALPHA2,
    to_ggx=gltf_to_ggx,
    from_ggx=ggx_to_gltf_anisotropic,
    exact={"gltf": gltf_to_gltf_anisotropic},
    decoded_from="ggx",
    view=View(
        ((0, 1, 2, 3), (5, 6, 7, 4), (8, 9, 10)),
        """
    vec4 first = textureLod(uMap0, uv, lod), second = textureLod(uMap1, uv, lod), third = textureLod(uMap2, uv, lod);
    Surface s = metallicRoughness(first, second);
    vec2 d = third.xy * uSigned.x + uSigned.y;
    float len = length(d), alpha = pow2(max(second.w, 0.045));
    d = len > 1e-6 ? d / len : vec2(1, 0);
    float along = pow2(mix(alpha, 1.0, pow2(third.z))), across = pow2(alpha);
    s.tensor = vec3(along * d.x * d.x + across * d.y * d.y, along * d.y * d.y + across * d.x * d.x,
                    (along - across) * d.x * d.y);
    return s;""",
    ),
)
