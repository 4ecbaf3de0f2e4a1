"""Points under many lights at once: against the plain twin; what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from mipbake.base.errors import UsageError
from mipbake.shading import reference, shade_lit

from .shading_inputs import MODELS, directions, frames, material, relative_error


def inputs(model: str, N: int, K: int, dtype: Any = np.float32, seed: int = 0) -> list[Any]:
    """Material, frame, view, light and radiance: most points see something, and a third of the lights in a mirror."""
    rng = np.random.default_rng(seed)
    stored, frame, light = material(rng, model, N), frames(rng, N), directions(rng, K)
    view = directions(rng, N)
    # The mirror directions of lights, in the point's own tangent space.
    local = np.einsum("nij,nj->ni", frame, light[rng.integers(0, K, N)]) * [-1, -1, 1]
    local[:, 2] = np.abs(local[:, 2])
    near = local + 0.03 * rng.standard_normal((N, 3))
    mirrored = np.einsum("nij,ni->nj", frame, near / np.linalg.norm(near, axis=-1, keepdims=True))
    view[::3] = mirrored[::3]
    return [a.astype(dtype) for a in (stored, frame, view, light, rng.uniform(0.1, 3, (K, 3)))]


def twin(model: str, case: list[Any]) -> Any:
    return reference.shade_lit(model, *(torch.from_numpy(np.asarray(a, np.float64)) for a in case)).numpy()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float32, 1e-5), (np.float64, 1e-9)])
def test_points_agree_with_the_twin(model: str, dtype: Any, tolerance: float) -> None:
    case = inputs(model, 171, 70, dtype)
    expected = twin(model, case)
    assert (expected > 0).mean() > 0.5
    assert relative_error(shade_lit(model, *case), expected) < tolerance


@pytest.mark.parametrize("model", MODELS)
def test_a_point_has_the_same_bits_alone_and_in_any_company(model: str) -> None:
    stored, frame, view, light, radiance = inputs(model, 1500, 70, seed=2)
    whole = shade_lit(model, stored, frame, view, light, radiance)
    for n in (0, 5, 63, 64, 700, 1499):
        one = slice(n, n + 1)
        assert np.array_equal(shade_lit(model, stored[one], frame[one], view[one], light, radiance), whole[one])
    order = np.random.default_rng(0).permutation(1500)
    assert np.array_equal(shade_lit(model, stored[order], frame[order], view[order], light, radiance), whole[order])


def test_any_strides_dtypes_and_sequences_are_read() -> None:
    stored, frame, view, light, radiance = inputs("gltf", 9, 6)
    expected = shade_lit("gltf", stored, frame, view, light, radiance)
    planar = np.asfortranarray(stored)
    assert not planar.flags.c_contiguous
    turned = np.ascontiguousarray(frame.transpose(1, 2, 0)).transpose(2, 0, 1)
    assert np.array_equal(shade_lit("gltf", planar, turned, np.asfortranarray(view), light, radiance), expected)
    assert np.array_equal(shade_lit("gltf", stored[::-1], frame[::-1], view[::-1], light, radiance), expected[::-1])
    record = np.zeros(9, [("pad", "u1"), ("texel", "f4", 8)])  # unaligned, strides no multiple of 4
    record["texel"] = stored
    assert np.array_equal(
        shade_lit("gltf", record["texel"], frame.astype(np.float64), view.tolist(), light.tolist(), radiance), expected
    )
    same = shade_lit("gltf", np.broadcast_to(stored[4], (9, 8)), frame, view, light, radiance)
    assert np.array_equal(same[4], expected[4])


def test_nothing_below_the_horizon_of_light_or_viewer_and_nothing_without_light() -> None:
    stored, frame, *_ = inputs("gltf", 4, 1)
    stored[:, 5:8] = [0, 0, 1]
    n = frame[:, 2]
    up, down = n[:1], -n[:1]
    same = np.repeat(frame[:1], 4, 0)
    white = np.ones((1, 3), np.float32)
    assert shade_lit("gltf", stored, same, np.repeat(up, 4, 0), up, white).all()
    assert not shade_lit("gltf", stored, same, np.repeat(down, 4, 0), up, white).any()
    assert not shade_lit("gltf", stored, same, np.repeat(up, 4, 0), down, white).any()
    assert not shade_lit("gltf", stored, same, np.repeat(up, 4, 0), up[:0], white[:0]).any()
    assert shade_lit("gltf", stored[:0], same[:0], up[:0], up, white).shape == (0, 3)
    # A light that only the last point sees is not passed over for the packet, nor shown to the others.
    turned = same.copy()
    turned[3] = -turned[3]
    views = np.concatenate([np.repeat(up, 3, 0), down])
    got = shade_lit("gltf", stored, turned, views, down, white)
    assert not got[:3].any() and got[3].all()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_finite_input_never_gives_nan(model: str, dtype: Any) -> None:
    rng = np.random.default_rng(4)
    stored = material(rng, model, 4096)
    extremes = (0.0, -0.0, 1.0, -1.0, 1e-30, -1e-30, 1e30, -1e30, 80.0, -80.0, 3e38, -3e38)
    stored = np.where(rng.random(stored.shape) < 0.4, rng.choice(extremes, stored.shape), stored).astype(dtype)
    axes = np.concatenate([np.eye(3), -np.eye(3), np.zeros((1, 3)), directions(rng, 9)])
    frame = np.repeat(np.eye(3)[None], 4096, 0)
    out = shade_lit(model, stored, frame, axes[rng.integers(0, 16, 4096)], axes, np.ones((16, 3)))
    assert out.dtype == dtype and np.isfinite(out).all() and out.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "phong"}, "unknown material model 'phong'.*gltf.*ggx"),
        ({"material": np.zeros((4, 8), np.float32)}, r"material has shape \(4, 8\): expected \(N, 11\)"),
        ({"material": np.zeros((1, 1, 4, 11), np.float32)}, r"material has shape \(1, 1, 4, 11\)"),
        ({"material": np.zeros((4, 11), np.int32)}, "material is int32: expected float32 or float64"),
        ({"frame": np.zeros((3, 3))}, r"frame has shape \(3, 3\) where the material has 4 points.*\(4, 3, 3\)"),
        ({"view": np.zeros((5, 3))}, r"view has shape \(5, 3\) where the material has 4 points: expected \(4, 3\)"),
        ({"view": [["a", "b", "c"]]}, "view is <U1: expected real numbers"),
        ({"light": np.zeros((5, 4))}, r"light has shape \(5, 4\): expected \(K, 3\)"),
        ({"radiance": np.zeros((6, 3))}, r"radiance has shape \(6, 3\) where light has \(5, 3\)"),
        ({"radiance": np.full((5, 3), 1e39)}, "radiance holds a value that is not finite in float32"),
        ({"radiance": np.full((5, 3), np.nan)}, "radiance holds a value that is not finite"),
    ],
)
def test_wrong_arguments_are_named(change: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {
        "model": "ggx",
        "material": np.zeros((4, 11), np.float32),
        "frame": np.zeros((4, 3, 3), np.float32),
        "view": np.zeros((4, 3), np.float32),
        "light": np.zeros((5, 3), np.float32),
        "radiance": np.ones((5, 3), np.float32),
    }
    with pytest.raises(UsageError, match=message):
        shade_lit(**(arguments | change))


@pytest.mark.parametrize("surfaces", [1, 3])
def test_surfaces_have_points_and_lights_of_their_own(surfaces: int) -> None:
    """An argument without an axis for surfaces is the same for all of them."""
    rng = np.random.default_rng(4)
    stored, frame, view, _, radiance = inputs("gltf", 70, 5)
    lights = np.stack([directions(rng, 5) for _ in range(surfaces)]).astype(np.float32)
    texels = np.stack([np.roll(stored, index, 0) for index in range(surfaces)])
    found = shade_lit("gltf", texels, frame, view, lights, radiance)
    assert found.shape == (surfaces, 70, 3)
    for index in range(surfaces):
        assert np.array_equal(found[index], shade_lit("gltf", texels[index], frame, view, lights[index], radiance))
    twin_of_all = reference.shade_lit(
        "gltf", *(torch.from_numpy(np.asarray(a, np.float64)) for a in (texels, frame, view, lights, radiance))
    )
    assert relative_error(found, twin_of_all.numpy()) < 1e-5


def test_numbers_of_surfaces_must_fit() -> None:
    stored, frame, view, light, radiance = inputs("gltf", 4, 2)
    with pytest.raises(UsageError, match="material has 2, light has 3"):
        shade_lit("gltf", np.stack([stored] * 2), frame, view, np.stack([light] * 3), radiance)
