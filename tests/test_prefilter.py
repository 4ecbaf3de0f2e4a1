"""The closed forms, and what every method promises."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mipbake import material
from mipbake.baking.methods import METHODS, method_named
from mipbake.base.errors import UsageError
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import FILTERS, level_sizes
from mipbake.models import list_weights
from mipbake.quality.metrics.pairs import pair_set
from mipbake.quality.reference.estimate import bilinear, reference
from mipbake.shading import shade

from .no_default_weights import hide_defaults
from .quick_methods import quick_methods

WRAP = ("wrap", "wrap")


QUICK = quick_methods()


def bumpy(height: int = 24, width: int = 20, spread: float = 0.3) -> np.ndarray:
    rng = np.random.default_rng(1)
    normal = np.concatenate([spread * rng.standard_normal((height, width, 2)), np.ones((height, width, 1))], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.concatenate([rng.random((height, width, 4)), np.full((height, width, 1), 0.3), normal], -1).astype("f4")


def run(method: str, stored: np.ndarray, target: str = "gltf", pixel_filter: str = "gaussian") -> list[np.ndarray]:
    return QUICK[method](stored, "gltf", target, pixel_filter, WRAP, lambda _: None).levels


@pytest.mark.long
@pytest.mark.parametrize("target", material.MODELS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [(24, 20), (1, 7), (1, 1)])
def test_every_method_fills_a_complete_valid_chain(method: str, target: str, size: tuple[int, int]) -> None:
    levels = run(method, bumpy(*size), target)
    assert [level.shape for level in levels] == [(*s, material.MODELS[target].channels) for s in level_sizes(*size)]
    low, high = np.array(material.MODELS[target].limits).T
    for level in levels:
        assert level.dtype == np.float32
        assert np.isfinite(level).all()
        assert (level >= low).all()
        assert (level <= high).all()
        for group in material.MODELS[target].unit_vectors:
            assert np.linalg.norm(level[..., group], axis=-1) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if method.averages])
@pytest.mark.parametrize("pixel_filter", ["box", "gaussian", "mitchell"])
def test_closed_forms_leave_a_constant_material_alone(method: str, pixel_filter: str) -> None:
    stored = np.broadcast_to(np.array([0.2, 0.4, 0.6, 1, 0.35, 0, 0, 1], np.float32), (12, 10, 8)).copy()
    for level in run(method, stored, pixel_filter=pixel_filter):
        assert level == pytest.approx(np.broadcast_to(stored[:1, :1], level.shape), abs=1e-5)


def test_linear_box_averages_stored_channels() -> None:
    stored = bumpy(2, 2)
    expected = stored.mean((0, 1))
    expected[5:] /= np.linalg.norm(expected[5:])
    levels = run("linear", stored, pixel_filter="box")
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


def test_lean_takes_the_covariance_about_the_mean_slope_of_each_texel() -> None:
    """Two halves of a map lean to opposite sides: within a half only the difference of its slopes counts."""
    slopes = np.array([0.2, 0.4, -0.6, -0.1])  # along x; means 0.3 and -0.35, deviations 0.1 and 0.25
    stored = np.zeros((1, 4, 8), np.float32)
    stored[..., 4] = 0.3
    stored[0, :, 5], stored[0, :, 7] = slopes / np.hypot(slopes, 1), 1 / np.hypot(slopes, 1)
    level = run("lean", stored, "ggx", "box")[1][0]
    for texel, mean, deviation in zip(level, (0.3, -0.35), (0.1, 0.25), strict=True):
        tensor = material.tensor_exp(texel[8:11].astype(np.float64))
        assert tensor == pytest.approx([0.3**4 + 2 * deviation**2, 0.3**4, 0], rel=1e-4, abs=1e-6)
        assert texel[6:8] == pytest.approx([mean / np.hypot(mean, 1), 0], abs=1e-6)


def test_lean_keeps_the_roughness_of_a_constant_tilt() -> None:
    for degrees in (60, 80):
        angle = np.radians(degrees)
        texel = np.array([0.5, 0.5, 0.5, 0, 0.05, np.sin(angle), 0, np.cos(angle)], np.float32)
        for level in run("lean", np.broadcast_to(texel, (16, 16, 8)).copy()):
            assert level[..., 4] == pytest.approx(0.05, rel=1e-3)


@pytest.mark.parametrize("angle", [0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4])
def test_anisotropy_directions_agree_within_and_between_levels(angle: float) -> None:
    """Around the vertical, principal axes come with either sign; averages of opposite directions would vanish."""
    rng = np.random.default_rng(0)
    stored = bumpy(16, 16, 0.02)
    spread = angle + 0.3 * rng.standard_normal((16, 16))
    direction = np.stack([np.cos(spread), np.sin(spread), np.full_like(spread, 0.8)], -1)
    stored = np.concatenate([stored, direction], -1).astype(np.float32)
    levels = METHODS["lean"](stored, "gltf-anisotropic", "gltf-anisotropic", "gaussian", WRAP, lambda _: None).levels
    means = [level[..., 8:10].mean((0, 1)) for level in levels]
    assert min(np.linalg.norm(mean) for mean in means) > 0.8
    assert min(a @ b for a, b in itertools.pairwise(means)) > 0


def test_neural_says_which_weights_it_used() -> None:
    result = METHODS["neural"](bumpy(), "gltf", "gltf", "gaussian", WRAP, lambda _: None)
    assert result.weights
    assert len(result.weights_sha256 or "") == 64


def test_neural_refuses_what_it_was_not_trained_for(monkeypatch: pytest.MonkeyPatch) -> None:
    hide_defaults(monkeypatch)
    with pytest.raises(UsageError, match=r"no trained weights.*'mitchell'") as error:
        run("neural", bumpy(), "beckmann", pixel_filter="mitchell")
    others = [i.name for i in list_weights() if "beckmann" in i.targets and "mitchell" in i.pixel_filters]
    assert others and all(name in str(error.value) for name in others)


def test_unknown_method_lists_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"'toksvig2'.*auto, neural, refine, optimum, lean, .*, linear"):
        method_named("toksvig2")


def test_a_supersampled_renderer_takes_the_stack_with_a_bias() -> None:
    """4 x 4 samples of a pixel at lod 3, looked up two levels finer: nearer to the reference than one lookup, and than
    as many samples without a bias, which blur twice."""
    rng, size, pixels, lod = np.random.default_rng(2), 64, 256, 3
    stored = bumpy(size, size)
    levels = METHODS["neural"](stored, "gltf", "gltf", "gaussian", WRAP, lambda _: None).levels
    pairs, uv = pair_set("near-mirror", 0, 24), rng.random((pixels, 2))
    wanted = reference(FilteredSource(stored, "gltf", WRAP, "gaussian"), uv, lod, pairs, 512, rng).astype(float)

    def radiance(offsets: np.ndarray, level: int) -> np.ndarray:
        shades = [
            shade("gltf", bilinear(levels[level], uv + 2**lod / size * offset, WRAP), pairs.light, pairs.view)
            for offset in offsets
        ]
        return np.mean(shades, 0, dtype=np.float64)

    strata = (np.indices((4, 4)).reshape(2, -1).T + 0.5) / 4
    offsets, _ = FILTERS["gaussian"].offsets(strata)
    once, biased, plain = (
        np.square(radiance(samples, level) - wanted).sum()
        for samples, level in ((np.zeros((1, 2)), lod), (offsets, lod - 2), (offsets, lod))
    )
    assert biased < 0.7 * once
    assert biased < 0.7 * plain
