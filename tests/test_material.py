"""Channel layouts and conversions between material models."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mipbake import material
from mipbake.shading import shade


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
@pytest.mark.parametrize(("through", "tolerance"), [("ggx", 1e-9), ("beckmann", 1e-8)])
def test_gltf_survives_the_way_through_another_model(model: str, through: str, tolerance: float) -> None:
    stored = random_gltf(2000, model == "gltf-anisotropic")
    back = material.convert(material.convert(stored, model, through), through, model)
    assert back == pytest.approx(stored, abs=tolerance)


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


def random_tensors(model: str, count: int) -> np.ndarray:
    """Stored channels of `ggx` or `beckmann`, alpha from 0.002 to 1.6, any anisotropy that stacks have."""
    rng = np.random.default_rng(4)
    mean, d, c = rng.uniform(-12, 1, count), rng.uniform(-2, 2, count), rng.uniform(-2, 2, count)
    parts = [rng.random((count, 8)), np.stack([mean + d, mean - d, c], -1)]
    if model == "beckmann":
        parts.append(rng.uniform(-material.MAX_LOG_GAMMA, material.MAX_LOG_GAMMA, (count, 1)))
    return np.concatenate(parts, -1)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 5e-6)])
def test_ggx_survives_the_way_through_beckmann(dtype: type, tolerance: float) -> None:
    stored = random_tensors("ggx", 2000).astype(dtype)
    there = material.convert(stored, "ggx", "beckmann")
    assert there.dtype == dtype and there.shape == (2000, 12)
    assert there[:, :8] == pytest.approx(stored[:, :8], abs=0)
    assert there[:, 8] - there[:, 9] == pytest.approx(stored[:, 8] - stored[:, 9], abs=tolerance)  # only scaled
    assert (there[:, 11] >= -0.617 - 1e-6).all() and (there[:, 11] < -0.05).all()
    assert material.convert(there, "beckmann", "ggx") == pytest.approx(stored, abs=tolerance)


def test_converted_mirrors_shade_alike() -> None:
    """Both ways, over half vectors around a narrow lobe: what the docstrings promise, less a decibel."""
    half = np.array([[x, 0.0, 1.0] for x in np.linspace(0, 0.1, 400)])
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    weight = half[:, 0]  # of rings

    def decibels(found: str, texel: np.ndarray, wanted: str) -> float:
        pair = [
            shade(m, t[None], half, half)[:, 0, 0]
            for m, t in ((found, material.convert(texel, wanted, found)), (wanted, texel))
        ]
        return float(10 * np.log10((weight @ pair[1] ** 2) / (weight @ (pair[0] - pair[1]) ** 2)))

    log_alpha2 = 2 * np.log(0.01)
    ggx = np.array([0, 0, 0, 1, 1, 1, 0, 0, log_alpha2, log_alpha2, 0])
    assert decibels("beckmann", ggx, "ggx") > 20.8
    for g, promised in ((-1.0, 15), (-0.5, 21), (0.0, 13.6), (1.0, 8), (1.5, 7)):
        assert decibels("ggx", np.append(ggx, g), "beckmann") > promised - 1


def twins_that_were_fitted() -> dict[str, list[float]]:
    """alpha to ln(alpha_b / alpha), g and the decibels kept of the lobes that docs/fit_beckmann.py found."""
    record = Path(__file__).parents[1] / "benchmarks" / "records" / "beckmann.json"
    found: dict[str, list[float]] = json.loads(record.read_text(encoding="utf-8"))["data"]["nearest"]
    return found


@pytest.mark.parametrize("alpha", twins_that_were_fitted())
def test_the_rule_follows_the_lobes_that_were_fitted(alpha: str) -> None:
    shift, g, *_ = twins_that_were_fitted()[alpha]
    log_alpha2 = 2 * np.log(float(alpha))
    there = material.ggx_to_beckmann(np.array([0] * 8 + [log_alpha2, log_alpha2, 0.0]))
    assert (there[8] - log_alpha2) / 2 == pytest.approx(shift, abs=0.0035)
    assert there[11] == pytest.approx(g, abs=0.0065)


def test_conversion_is_the_one_that_weights_were_trained_with() -> None:
    """`paper-cross` learned to shade as this conversion does: its constants cannot move without a new training."""
    alpha = np.array([0.01, 0.1, 0.2, 0.35, 0.5, 0.8, 1.0])
    zero = np.zeros_like(alpha)
    stored = np.stack([zero] * 8 + [2 * np.log(alpha), 2 * np.log(alpha), zero], -1)
    there = material.ggx_to_beckmann(stored)
    shift = -0.394 + 0.558 / (1 + (0.285 / alpha) ** 1.9)
    assert there[:, 8] == pytest.approx(2 * (np.log(alpha) + shift), abs=1e-12)
    assert there[:, 11] == pytest.approx(-0.617 + 0.561 / (1 + (0.479 / alpha) ** 1.76), abs=1e-12)


def test_conversions_of_beckmann_are_finite_over_its_whole_range() -> None:
    low, high = np.array(material.MODELS["beckmann"].limits).T
    corners = np.random.default_rng(0).choice([0, 0.5, 1], (3000, 12)) * (high - low) + low
    for target in material.MODELS:
        assert np.isfinite(material.convert(corners, "beckmann", target)).all()
    ggx_low, ggx_high = np.array(material.MODELS["ggx"].limits).T
    ggx = np.random.default_rng(0).choice([0, 0.5, 1], (3000, 11)) * (ggx_high - ggx_low) + ggx_low
    assert np.isfinite(material.convert(ggx, "ggx", "beckmann")).all()


def test_the_least_lobes_of_both_models_are_one() -> None:
    floor = 2 * np.log(material.MIN_ROUGHNESS**2)
    twin = material.ggx_to_beckmann(np.array([0] * 8 + [floor, floor, 0.0]))
    assert np.exp(floor) == pytest.approx(material.least_alpha2("ggx"))
    assert np.exp(twin[8]) == pytest.approx(material.least_alpha2("beckmann"))
