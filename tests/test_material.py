"""Channel layouts and conversions between material models."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake import material
from mipbake.errors import UsageError


def random_gltf(count: int, anisotropic: bool) -> np.ndarray:
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(count, 3)) * [0.4, 0.4, 0] + [0, 0, 1]
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    angle = rng.uniform(-np.pi / 2, np.pi / 2, count)
    parts = [rng.uniform(0.02, 1, (count, 3)), rng.random((count, 1)), rng.uniform(0.05, 1, (count, 1)), normal]
    if anisotropic:
        parts += [np.stack([np.cos(angle), np.sin(angle)], -1), rng.uniform(0.05, 0.99, (count, 1))]
    return np.concatenate(parts, -1)


@pytest.mark.parametrize("model", ["gltf", "gltf-anisotropic"])
def test_gltf_survives_the_way_through_ggx(model: str) -> None:
    stored = random_gltf(2000, model == "gltf-anisotropic")
    back = material.convert(material.convert(stored, model, "ggx"), "ggx", model)
    assert back == pytest.approx(stored, abs=1e-9)


def test_tensor_exp_is_the_matrix_exponential() -> None:
    a, b, c = 0.3, -1.2, 0.7
    values, vectors = np.linalg.eigh(np.array([[a, c], [c, b]]))
    expected = vectors @ np.diag(np.exp(values)) @ vectors.T
    s11, s22, s12 = material.tensor_exp(np.array([a, b, c]))
    assert np.array([[s11, s12], [s12, s22]]) == pytest.approx(expected)


def test_tensor_log_inverts_tensor_exp_also_where_isotropic() -> None:
    rng = np.random.default_rng(0)
    logs = rng.uniform(-8, 0, (1000, 3)) * [1, 1, 0.3]
    logs[:100, 1], logs[:100, 2] = logs[:100, 0], 0
    assert material.tensor_log(material.tensor_exp(logs)) == pytest.approx(logs, abs=1e-7)


def test_anisotropic_axes_are_those_of_the_extension() -> None:
    """KHR_materials_anisotropy: alpha_t = mix(alpha, 1, s^2) along the direction, alpha across it."""
    tensor = material.axes_to_tensor(np.array(0.2), np.array(0.5), np.array([0.0, 1.0]))
    assert tensor == pytest.approx([0.2**2, (0.2 + 0.8 * 0.25) ** 2, 0])


def test_metals_and_dielectrics_convert_exactly() -> None:
    base = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.9, 0.5, 0.1]])
    for metallic in (0.0, 1.0):
        albedo, specular = base * (1 - metallic), 0.04 + (base - 0.04) * metallic
        base_back, metallic_back = material.base_and_metallic(albedo, specular)
        assert base_back == pytest.approx(base, abs=1e-12)
        assert metallic_back[1:] == pytest.approx(metallic, abs=1e-12)


def test_dark_metals_keep_albedo_and_reflectance() -> None:
    rng = np.random.default_rng(0)
    base, metallic = rng.uniform(0, 0.04, (500, 1)).repeat(3, 1), rng.random((500, 1))
    albedo, specular = base * (1 - metallic), 0.04 + (base - 0.04) * metallic
    base_back, metallic_back = material.base_and_metallic(albedo, specular)
    assert base_back * (1 - metallic_back) == pytest.approx(albedo, abs=1e-9)
    assert 0.04 + (base_back - 0.04) * metallic_back == pytest.approx(specular, abs=1e-9)
    assert material.base_and_metallic(np.zeros(3), np.full(3, 0.04))[1] == 0


def test_regularise_clips_and_renormalises() -> None:
    stored = np.array([[1.5, -0.2, 0.5, 0.3, 0.4, 0.0, 0.3, 0.4], [0, 0, 0, 0, 0, 0, 0, 0]], np.float32)
    out = material.regularise(stored, "gltf")
    assert out[0] == pytest.approx([1, 0, 0.5, 0.3, 0.4, 0, 0.6, 0.8])
    assert out[1, 5:8] == pytest.approx([0, 0, 1])
    assert out.dtype == np.float32


def test_normals_outside_the_disc_are_scaled_onto_it() -> None:
    assert material.lift_normal(np.array([3.0, 4.0])) == pytest.approx([0.6, 0.8, 0])


def test_unknown_model_lists_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"'phong'.*gltf, gltf-anisotropic, ggx, beckmann"):
        material.model_named("phong")
