"""What holds of any reflectance model, checked by quadrature: energy, reciprocity, and a normalised distribution."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch

from mipbake.material import GGX_LOBE, Kind, axes_to_tensor, convert, tensor_log
from mipbake.material import MODELS as RECORDS
from mipbake.shading import shade

from .shading_inputs import MODELS, directions, material


def angles(cosines: Any, azimuths: Any) -> Any:
    """(n, m, 3) unit vectors."""
    sines = np.sqrt(1 - cosines**2)
    x, y = sines[:, None] * np.cos(azimuths), sines[:, None] * np.sin(azimuths)
    return np.stack([x, y, np.broadcast_to(cosines[:, None], x.shape)], -1)


def half_vectors(tensor: Any, rings: int = 160, spokes: int = 96) -> tuple[Any, Any]:
    """(S, 3) half vectors over the hemisphere around +z, dense where GGX of that tensor is, and their solid angles.

    h = normalize(L p, 1) with p over the plane in polar coordinates and S = L L^T: for S = I this is the hemisphere,
    and dw = det L |(L p, 1)|^-3 dp for any other.
    """
    L = np.linalg.cholesky(np.array([[tensor[0], tensor[2]], [tensor[2], tensor[1]]]))
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    angle, weight = (nodes + 1) * np.pi / 4, weights * np.pi / 4  # of p from the pole: |p| = tan(angle)
    azimuth = (np.arange(spokes) + 0.5) * 2 * np.pi / spokes
    radius = np.tan(angle)
    p = radius[:, None, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], -1)
    area = weight / np.cos(angle) ** 2 * radius * 2 * np.pi / spokes
    slope = np.concatenate([p @ L.T, np.ones((rings, spokes, 1))], -1)
    length = np.linalg.norm(slope, axis=-1, keepdims=True)
    solid = area[:, None] * np.linalg.det(L) / length[..., 0] ** 3
    return (slope / length).reshape(-1, 3), solid.reshape(-1)


def stored(model: str, alpha: float, strength: float, angle: float, base: float, g: float = 0.0) -> Any:
    """(1, C) stored channels of an upright metal: F0 = base, no diffuse term. g = ln(gamma), for `beckmann`."""
    tensor = tensor_log(tensor_of(alpha, strength, angle))
    texel = convert(np.concatenate([np.zeros(3), np.full(3, base), [0, 0], tensor])[None], "ggx", model)
    for group in RECORDS[model].of(Kind.LOG_TENSOR):
        texel[..., group] = tensor
    for group in RECORDS[model].of(Kind.LOG_GAMMA):
        texel[..., group] = g
    return texel


def tensor_of(alpha: float, strength: float, angle: float) -> Any:
    return axes_to_tensor(np.array(alpha), np.array(strength), np.array([np.cos(angle), np.sin(angle)]))


SHAPES = [(1.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.01, 0.0, 0.0), (0.1, 0.6, 0.0), (0.05, 0.9, 0.7), (0.4, 0.5, 2.0)]


def shapes(model: str) -> list[tuple[float, float, float]]:
    return [shape for shape in SHAPES if RECORDS[model].anisotropic or shape[1] == 0]


CASES = [(model, shape) for model in MODELS for shape in shapes(model)]
EXPONENTS = (-1.5, -1.0, -0.6, 0.0, 0.5, 1.5)  # g


@pytest.mark.parametrize(("model", "shape"), CASES)
def test_the_distribution_is_normalised(model: str, shape: tuple[float, float, float]) -> None:
    # With l = v = h, f = F0 D V l_n where V = 1 / (4 l_n G(l)); so D, from f. For GGX G(l)^2 = l_n^2 + s^2, with
    # s^2 = l_t^T S l_t; for Beckmann G(l) = l_n erf(l_n / s) + s exp(-(l_n / s)^2) / sqrt(pi).
    half, solid = half_vectors(tensor_of(*shape))
    s11, s22, s12 = tensor_of(*shape)
    x, y, z = half.T
    s = np.sqrt(s11 * x * x + 2 * s12 * x * y + s22 * y * y)
    smith = np.hypot(z, s)
    if RECORDS[model].of(Kind.LOG_GAMMA):
        smith = z * torch.erf(torch.from_numpy(z / s)).numpy() + s / np.sqrt(np.pi) * np.exp(-np.square(z / s))
    for g in EXPONENTS if RECORDS[model].of(Kind.LOG_GAMMA) else (0.0,):
        f = shade(model, stored(model, *shape, base=1.0, g=g), half, half)[:, 0, 0]
        assert np.sum(f * 4 * smith * z * solid) == pytest.approx(1, abs=2e-4)


def furnace(model: str, shape: tuple[float, float, float], elevation: float, g: float = 0.0) -> float:
    """What a white metal reflects of uniform light."""
    view = angles(np.array([elevation]), np.array([0.4])).reshape(3)
    half, solid = half_vectors(tensor_of(*shape), 240, 128)
    cosine = half @ view
    light = 2 * cosine[:, None] * half - view
    seen = cosine > 0
    f = shade(model, stored(model, *shape, base=1.0, g=g), light[seen], np.broadcast_to(view, light[seen].shape))
    return float(np.sum(f[:, 0, 0] * 4 * cosine[seen] * solid[seen]))  # dw_l = 4 (h.v) dw_h


@pytest.mark.parametrize(("model", "shape"), CASES)
@pytest.mark.parametrize("elevation", [0.99, 0.6, 0.2])
def test_white_furnace(model: str, shape: tuple[float, float, float], elevation: float) -> None:
    # A white metal under uniform light reflects at most what it receives; all but what bounces more than once.
    reflected = furnace(model, shape, elevation)
    assert reflected <= 1 + 2e-3
    if shape == (0.01, 0.0, 0.0):
        assert reflected > 0.99
    if shape == (1.0, 0.0, 0.0) and RECORDS[model].lobe is GGX_LOBE:
        # S = I, so G = 1 and D = 1 / pi: f = l_n / (2 pi (l_n + v_n)), with a known integral.
        assert reflected == pytest.approx(1 - elevation * np.log(1 + 1 / elevation), rel=1e-4)


@pytest.mark.parametrize("model", MODELS)
def test_reciprocity(model: str) -> None:
    rng = np.random.default_rng(7)
    texels = material(rng, model, 100)
    texels[:, RECORDS[model].normal][:, :2] = 0
    light, view = (np.abs(directions(rng, 50)) for _ in range(2))
    light, view = (each[each[:, 2] > 1e-4][:45] for each in (light, view))  # below it is held for the view alone
    forth = shade(model, texels, light, view) / light[:, 2, None, None]
    back = shade(model, texels, view, light) / view[:, 2, None, None]
    np.testing.assert_allclose(forth, back, rtol=1e-10)


def test_a_value_worked_out_by_hand() -> None:
    # Light and view both at 60 degrees from an upright normal, mirrored: h = n, so D = 1 / (pi alpha^2) and
    # V = 1 / (4 l_n sqrt(l_n^2 + alpha^2 (1 - l_n^2))); l.h = 1/2, so P = 1/32.
    light, view = [[np.sqrt(0.75), 0, 0.5]], [[-np.sqrt(0.75), 0, 0.5]]
    alpha, base = 0.25, np.array([0.8, 0.5, 0.2])
    specular = 1 / (np.pi * alpha**2) / (4 * 0.5 * np.sqrt(0.25 + alpha**2 * 0.75)) * 0.5
    f0 = 0.04 + (base - 0.04) * 0.3
    expected = base * 0.7 / np.pi * 0.96 * (1 - 1 / 32) * 0.5 + (f0 + (1 - f0) / 32) * specular
    got = shade("gltf", np.array([[*base, 0.3, 0.5, 0, 0, 1]]), light, view)
    np.testing.assert_allclose(got[0, 0], expected, rtol=1e-12)
    expected = base / np.pi * 0.5 + (f0 + (1 - f0) / 32) * specular
    got = shade("ggx", np.array([[*base, *f0, 0, 0, 4 * np.log(0.5), 4 * np.log(0.5), 0]]), light, view)
    np.testing.assert_allclose(got[0, 0], expected, rtol=1e-12)
    # Generalised Beckmann: q = 0, and Lambda(a) = (erf a - 1) / 2 + exp(-a^2) / (2 a sqrt pi) at a = l_n / (alpha sin).
    a = 0.5 / (alpha * np.sqrt(0.75))
    smith = (math.erf(a) - 1) / 2 + math.exp(-a * a) / (2 * a * math.sqrt(math.pi))
    for g in EXPONENTS:
        peak = 1 / (np.pi * math.gamma(1 + math.exp(-g)) * alpha**2)
        expected = base / np.pi * 0.5 + (f0 + (1 - f0) / 32) * peak / (4 * 0.5 * (1 + 2 * smith))
        got = shade("beckmann", np.array([[*base, *f0, 0, 0, 4 * np.log(0.5), 4 * np.log(0.5), 0, g]]), light, view)
        np.testing.assert_allclose(got[0, 0], expected, rtol=1e-12)
