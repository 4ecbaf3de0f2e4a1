"""Closed forms: formulas, limits and ranges, and many of them in one pass."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from math import sqrt, tanh

import numpy as np
import pytest

from mipbake import material
from mipbake.baking.methods import METHODS
from mipbake.baking.rules import bands, vmf
from mipbake.baking.rules.closed_form import chain
from mipbake.baking.rules.form import Form, Part, Whole
from mipbake.material.pixel_filter import FILTERS, Wrap, filtered_levels, resample

from .search_cases import bumpy
from .stacks import constant, gltf_level

WRAP: Wrap = ("wrap", "wrap")


def toksvig(alpha2: float, r: float) -> float:
    s = 2 / alpha2 - 2
    return 2 / (r / (r + s * (1 - r)) * s + 2)


def banerjee(length: float) -> float:
    return 2 * (1 - length**2) / (length * (3 - length**2))


def mean_lobe(alpha2: float) -> float:
    return 1 / tanh(2 / alpha2) - alpha2 / 2


def unreal(alpha2: float, r: float) -> float:
    v = max(0.0, (1 - r) / r - 4e-5)
    return (alpha2 + 2 * v * (1 - alpha2)) / (1 + 2 * v * (1 - alpha2))


# alpha^2 of a level whose texels agree in roughness, as the methods' sources write it.
FORMULAS: dict[str, Callable[[float, float], float]] = {
    "toksvig": toksvig,
    "vmf": lambda alpha2, r: (
        banerjee(mean_lobe(alpha2) * r) + alpha2 - banerjee(mean_lobe(alpha2))  # less its error without spread
    ),
    "godot": lambda alpha2, r: (sqrt(alpha2) + min(0.75 * (1 - r * r) / (3 * r - r**3), 0.16)) ** 2,
    "filament": lambda alpha2, r: (sqrt(alpha2) + min(0.5 * (1 - r * r) / (3 * r - r**3), 0.04)) ** 2,
    "unreal": unreal,
}


def two_normals(slope: float, roughness: float | tuple[float, float], metallic: float = 0.0) -> np.ndarray:
    """A row of two texels with slopes +-slope along x: r is the cosine of their angle."""
    stored = np.zeros((1, 2, 8), np.float32)
    stored[..., 0:3], stored[..., 3], stored[..., 4] = 0.5, metallic, roughness
    stored[0, :, 5] = np.array([slope, -slope]) / np.hypot(slope, 1)
    stored[..., 7] = 1 / np.hypot(slope, 1)
    return stored


def run(
    method: str, stored: np.ndarray, target: str = "gltf", kernel: str = "box", source: str = "gltf"
) -> list[np.ndarray]:
    return METHODS[method](stored, source, target, kernel, WRAP, lambda _: None).levels


def tensor(levels: np.ndarray, model: str) -> np.ndarray:
    return material.MODELS[model].roughness_tensor(levels.astype(np.float64))


@pytest.mark.parametrize("method", FORMULAS)
@pytest.mark.parametrize(("slope", "roughness"), [(0.0, 0.05), (0.05, 0.3), (0.4, 0.05), (0.4, 0.7), (3.0, 0.95)])
def test_two_normals_give_what_the_formula_says(method: str, slope: float, roughness: float) -> None:
    stored = two_normals(slope, roughness)
    r = 1 / sqrt(1 + slope * slope)
    expected = min(FORMULAS[method](roughness**4, r), 1)
    gltf = run(method, stored)[1][0, 0]
    assert gltf[4] ** 4 == pytest.approx(expected, rel=2e-4)
    assert gltf == pytest.approx([0.5, 0.5, 0.5, 0, gltf[4], 0, 0, 1], abs=1e-6)
    anisotropic = run(method, stored, "gltf-anisotropic")[1]
    assert tensor(anisotropic, "gltf-anisotropic")[0, 0] == pytest.approx([expected, expected, 0], rel=2e-4, abs=1e-9)
    ggx = run(method, stored, "ggx")[1]
    assert tensor(ggx, "ggx")[0, 0] == pytest.approx([expected, expected, 0], rel=2e-4, abs=1e-9)
    assert ggx[0, 0, 0:8] == pytest.approx([0.5, 0.5, 0.5, 0.04, 0.04, 0.04, 0, 0], abs=1e-6)


def test_what_is_averaged_where_roughness_varies() -> None:
    """Flat texels of roughness 0.2 and 0.8: the mean of alpha^2, of lobes' means, or of what is stored."""
    stored = two_normals(0, (0.2, 0.8))
    alpha2 = {method: run(method, stored)[1][0, 0, 4] ** 4 for method in FORMULAS}
    assert alpha2["toksvig"] == pytest.approx((0.2**4 + 0.8**4) / 2, rel=1e-5)
    assert mean_lobe(alpha2["vmf"]) == pytest.approx((mean_lobe(0.2**4) + mean_lobe(0.8**4)) / 2, rel=1e-5)
    for method in ("godot", "filament", "unreal"):
        assert alpha2[method] == pytest.approx(0.5**4, rel=1e-5)


def test_a_broad_lobe_turns_the_mean_of_vmf_less() -> None:
    normal = run("vmf", two_normals(0.5, (0.1, 0.95)))[1][0, 0, 5:8]
    weights = np.array([mean_lobe(0.1**4), mean_lobe(0.95**4)])
    assert normal[0] / normal[2] == pytest.approx(0.5 * (weights[0] - weights[1]) / weights.sum(), rel=1e-4)
    assert run("toksvig", two_normals(0.5, (0.1, 0.95)))[1][0, 0, 5] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("target", material.MODELS)
def test_both_axes_of_an_anisotropic_material_follow_the_rule(target: str) -> None:
    """Axes of alpha 0.09 and 0.49 at 30 degrees, over slopes +-0.4: the formula for each, in the axes they had."""
    angle, alphas = np.pi / 6, np.array([0.49, 0.09])
    strength = sqrt((alphas[0] - alphas[1]) / (1 - alphas[1]))
    rest = np.broadcast_to(np.array([np.cos(angle), np.sin(angle), strength]), (1, 2, 3))
    stored = np.concatenate([two_normals(0.4, 0.3), rest], -1).astype(np.float32)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    r = 1 / sqrt(1.16)
    layout = material.MODELS[target]
    for method, formula in FORMULAS.items():
        level = run(method, stored, target, source="gltf-anisotropic")[1]
        if not layout.anisotropic:
            # One axis in the target: the geometric mean of the two, as in every conversion.
            assert tensor(level, target)[0, 0, 0] == pytest.approx(formula(float(alphas.prod()), r), rel=1e-3)
            continue
        if method == "vmf":
            # One weight for both axes: nothing here, where the texels agree in roughness.
            assert layout.unit_normals(level[0, 0])[:2] == pytest.approx(0, abs=1e-6)
        # The rule runs on the tensor that the target has for these texels.
        round_lobe = np.array([0.0] * 8 + [np.log(alphas.prod())] * 2 + [0])
        scale = layout.roughness_tensor(material.convert(round_lobe, "ggx", target))[0] / alphas.prod()
        expected = turn @ np.diag([formula(float(a), r) for a in alphas**2 * scale]) @ turn.T
        s11, s22, s12 = tensor(level, target)[0, 0]
        assert np.array([[s11, s12], [s12, s22]]) == pytest.approx(expected, abs=2e-4), method


@pytest.mark.parametrize("method", FORMULAS)
@pytest.mark.parametrize("target", material.MODELS)
@pytest.mark.parametrize("kernel", ["box", "mitchell"])
def test_extremes_stay_finite_and_in_range(method: str, target: str, kernel: str) -> None:
    """Opposite normals at the horizon, roughness 0 beside 1, under a kernel with negative lobes."""
    rng = np.random.default_rng(0)
    stored = bumpy(16, 16, 0.3, 1e4)
    stored[..., 4] = rng.integers(0, 2, (16, 16))
    stored[:8, :8, 5:8] = np.where(rng.random((8, 8, 1)) < 0.5, 1, -1) * np.array([1, 0, 0])
    low, high = np.array(material.MODELS[target].limits).T
    for level in run(method, stored, target, kernel):
        assert np.isfinite(level).all()
        assert (level >= low).all()
        assert (level <= high).all()


@pytest.mark.parametrize("method", FORMULAS)
def test_the_box_leaves_level_0_and_a_pixel_filter_widens_it(method: str) -> None:
    stored = bumpy(16, 16, 0.3, 0.3)
    boxed, filtered = run(method, stored)[0], run(method, stored, kernel="gaussian")[0]
    changed = [4] if method == "unreal" else []
    same = [c for c in range(8) if c not in changed]
    assert boxed[..., same] == pytest.approx(stored[..., same], abs=1e-5)
    assert filtered[..., 4].min() > 0.3
    if method == "unreal":
        blurred = resample(stored[..., 5:8].copy(), (16, 16), "box", WRAP, width=2)
        r = np.linalg.norm(blurred[3, 4])
        assert boxed[3, 4, 4] ** 4 == pytest.approx(unreal(0.3**4, float(r)), rel=1e-3)


@pytest.mark.parametrize("method", FORMULAS)
def test_a_tilt_of_the_whole_map_changes_no_roughness(method: str) -> None:
    """The length of the mean normal does not depend on where it points, down to mirrors."""
    angle = np.radians(50)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    straight = bumpy(16, 16, 0.05, 0.01)
    tilted = straight.copy()
    tilted[..., 5:8] = straight[..., 5:8] @ turn.T
    for one, other in zip(run(method, straight), run(method, tilted), strict=True):
        assert other[..., 4] == pytest.approx(one[..., 4], rel=1e-4)


def test_lobe_means_invert() -> None:
    alpha2 = np.concatenate([[0.0], np.geomspace(1e-8, 16, 200)])
    assert vmf.shortening(alpha2[1:])[60:] == pytest.approx([1 - mean_lobe(a) for a in alpha2[61:]], abs=1e-9)
    assert vmf.alpha2_of(vmf.shortening(alpha2)) == pytest.approx(alpha2, rel=1e-6)
    # What Banerjee's approximation loses without spread, and vmf gives back.
    lost = np.array([a - banerjee(mean_lobe(a)) for a in np.linspace(0.01, 1, 100)])
    assert 0 < lost.min() < lost.max() < 0.026


@pytest.mark.parametrize("wrap", [("wrap", "clamp"), ("clamp", "clamp")])
@pytest.mark.parametrize("kernel", FILTERS)
def test_levels_of_bands_are_levels_of_the_whole(monkeypatch: pytest.MonkeyPatch, wrap: Wrap, kernel: str) -> None:
    monkeypatch.setattr(bands, "ROWS", 16)
    monkeypatch.setattr(bands, "BAND", 1)
    stored = gltf_level((70, 61), 4)
    shares: list[float] = []
    squares = Part("squares", lambda texels: np.square(texels.stored), range(8))
    form = Form([squares], lambda averages, _: np.negative(averages))
    found = chain(Whole(stored, "gltf"), form, 8, kernel, wrap, shares.append)
    expected = filtered_levels(np.square(stored), kernel, wrap)
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, -other)
    assert shares == sorted(shares) and shares[-1] == 1


@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if method.averages])
@pytest.mark.parametrize("model", material.MODELS)
def test_closed_forms_leave_a_constant_material_alone(method: str, model: str) -> None:
    stored = constant((6, 5), model)
    for kernel in FILTERS:
        for level in run(method, stored, model, kernel, model):
            assert level == pytest.approx(np.broadcast_to(stored[:1, :1], level.shape), abs=2e-5)


def test_linear_box_averages_stored_channels() -> None:
    stored = gltf_level((2, 2), 1)
    expected = stored.mean((0, 1))
    expected[5:] /= np.linalg.norm(expected[5:])
    levels = run("linear", stored)
    assert levels[0] == pytest.approx(stored, abs=1e-6)
    assert levels[1][0, 0] == pytest.approx(expected, abs=1e-6)


def test_lean_adds_twice_the_slope_covariance() -> None:
    """Two texels with slopes +-0.5 along x: S' = S + 2 * 0.25 along x, S across it, and a straight mean normal."""
    stored = np.zeros((1, 2, 8), np.float32)
    stored[..., 0:3], stored[..., 4] = 0.5, 0.4
    for column, slope in enumerate((0.5, -0.5)):
        normal = np.array([slope, 0, 1])
        stored[0, column, 5:8] = normal / np.linalg.norm(normal)
    alpha2 = 0.4**4
    ggx = run("lean", stored, "ggx", "box")[1][0, 0]
    assert ggx[6:8] == pytest.approx([0, 0], abs=1e-6)
    assert material.tensor_exp(ggx[8:11].astype(float)) == pytest.approx([alpha2 + 0.5, alpha2, 0], rel=1e-4, abs=1e-6)
    isotropic = run("lean", stored, "gltf", "box")[1][0, 0]
    assert isotropic[4] == pytest.approx((alpha2 + 0.25) ** 0.25, rel=1e-5)
    anisotropic = run("lean", stored, "gltf-anisotropic", "box")[1][0, 0]
    assert anisotropic[4] == pytest.approx(0.4, rel=1e-4)
    assert abs(anisotropic[8]) == pytest.approx(1, abs=1e-4)


def test_lean_averages_the_kurtosis_of_beckmann() -> None:
    """As section 4 of the paper has it: ln(gamma), the last channel, is averaged."""
    stored = constant((1, 2), "beckmann")
    stored[0, :, -1] = 0.1, 0.5
    found = run("lean", stored, "beckmann", "box", "beckmann")
    assert found[1][0, 0, -1] == pytest.approx(0.3, abs=1e-5)


def test_lean_keeps_the_roughness_of_a_constant_tilt() -> None:
    for degrees in (60, 80):
        angle = np.radians(degrees)
        texel = np.array([0.5, 0.5, 0.5, 0, 0.05, np.sin(angle), 0, np.cos(angle)], np.float32)
        for level in run("lean", np.broadcast_to(texel, (16, 16, 8)).copy(), kernel="gaussian"):
            assert level[..., 4] == pytest.approx(0.05, rel=1e-3)


@pytest.mark.parametrize("angle", [np.pi / 4, np.pi / 2])
def test_anisotropy_directions_agree_within_and_between_levels(angle: float) -> None:
    """Around the vertical, principal axes come with either sign; averages of opposite directions would vanish."""
    rng = np.random.default_rng(0)
    stored = bumpy(16, 16, 0.3, 0.02)
    spread = angle + 0.3 * rng.standard_normal((16, 16))
    direction = np.stack([np.cos(spread), np.sin(spread), np.full_like(spread, 0.8)], -1)
    stored = np.concatenate([stored, direction], -1).astype(np.float32)
    levels = METHODS["lean"](stored, "gltf-anisotropic", "gltf-anisotropic", "gaussian", WRAP, lambda _: None).levels
    means = [level[..., 8:10].mean((0, 1)) for level in levels]
    assert min(np.linalg.norm(mean) for mean in means) > 0.8
    assert min(a @ b for a, b in itertools.pairwise(means)) > 0


def test_values_worked_out_by_hand() -> None:
    """Slopes +-3/4: r = 4/5, 1 / kappa = 0.36 / 1.888, v = 1/4; alpha^2 = 1/16 at roughness 1/2."""
    stored = two_normals(0.75, 0.5)
    toksvig_alpha2 = (1 / 16 + 15 / 32) / (1 + 15 / 32)
    assert run("toksvig", stored)[1][0, 0, 4] == pytest.approx(toksvig_alpha2**0.25, rel=1e-5)
    assert run("godot", stored)[1][0, 0, 4] == pytest.approx(sqrt(0.25 + 0.75 * 0.36 / 1.888), rel=1e-5)
    assert run("filament", stored)[1][0, 0, 4] == pytest.approx(sqrt(0.25 + 0.04), rel=1e-5)
    assert run("unreal", stored)[1][0, 0, 4] == pytest.approx(toksvig_alpha2**0.25, rel=1e-4)  # but for the dead zone
    assert run("unreal", two_normals(0.005, 0.1))[1][0, 0, 4] == pytest.approx(0.1, rel=1e-6)  # v = 1.25e-5
    # A = 31/32 (coth 32 is 1): R = 0.775.
    by_hand = 2 * (1 - 0.775**2) / (0.775 * (3 - 0.775**2))
    assert run("vmf", stored)[1][0, 0, 4] ** 4 == pytest.approx(by_hand, abs=1e-3)
