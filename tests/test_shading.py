"""Shading of arrays, under pairs and under many lights at once: against the plain twins, layouts and edge cases."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import torch

from mipbake import _native
from mipbake.material import MODELS as LAYOUTS
from mipbake.shading import TurnedAway, reference, shade, shade_lit

from .shading_inputs import MODELS, directions, frames, material, pairs, relative_error

RELATIVE = 1e-5


RULES: tuple[TurnedAway, ...] = ("clamp", "black")


def twin(model: str, *arrays: Any, rule: TurnedAway = "clamp", call: Any = reference.shade) -> Any:
    return call(model, *(torch.from_numpy(np.asarray(a, np.float64)) for a in arrays), turned_away=rule).numpy()


def inputs(model: str, B: int, K: int, N: int, seed: int = 0) -> list[Any]:
    rng = np.random.default_rng(seed)
    return [a.astype(np.float32) for a in (material(rng, model, B, N), *pairs(rng, B, K))]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_shades_too() -> None:
    script = (
        "import os, numpy as np\nfrom mipbake import _native, shading\n_native.set_num_threads(4)\n"
        "rng = np.random.default_rng(0)\nu = lambda *shape: rng.random(shape) + 0.1\n"
        "arrays = u(20000, 11), u(8, 3), u(8, 3)\nexpected = shading.shade('ggx', *arrays)\n"
        "child = os.fork()\nsame = np.array_equal(shading.shade('ggx', *arrays), expected)\n"
        "if child == 0: os._exit(0 if same else 1)\n"
        "assert same and os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float32, RELATIVE), (np.float64, 1e-8)])
def test_values_agree_with_the_twin(model: str, rule: TurnedAway, dtype: Any, tolerance: float) -> None:
    case = [a.astype(dtype) for a in inputs(model, 2, 40, 171)]
    expected = twin(model, *case, rule=rule)
    assert (expected > 0).mean() > 0.1
    assert relative_error(shade(model, *case, turned_away=rule), expected) < tolerance


def test_shapes_with_and_without_a_batch_axis() -> None:
    stored, light, view = inputs("ggx", 3, 5, 4)
    whole = shade("ggx", stored, light, view)
    assert whole.shape == (3, 5, 4, 3) and whole.dtype == np.float32
    plain = shade("ggx", stored[1], light[1], view[1])
    assert plain.shape == (5, 4, 3)
    assert np.array_equal(plain, whole[1])
    assert np.array_equal(shade("ggx", stored[1], light, view)[2], shade("ggx", stored[1], light[2], view[2]))
    assert np.array_equal(shade("ggx", stored, light[:1], view[1])[2], shade("ggx", stored[2], light[0], view[1]))
    assert shade("ggx", stored[:, :0], light, view).shape == (3, 5, 0, 3)
    assert shade("ggx", stored, light[:, :0], view[:, :0]).shape == (3, 0, 4, 3)


def per_texel(model: str, B: int, K: int, N: int) -> list[Any]:
    rng = np.random.default_rng(5)
    return [a.astype(np.float32) for a in (material(rng, model, B, N), *pairs(rng, B, K, N))]


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float32, RELATIVE), (np.float64, 1e-8)])
def test_directions_of_each_texel_agree_with_the_twin(model: str, dtype: Any, tolerance: float) -> None:
    case = [a.astype(dtype) for a in per_texel(model, 2, 9, 171)]
    expected = twin(model, *case)
    assert (expected > 0).mean() > 0.1
    assert relative_error(shade(model, *case), expected) < tolerance
    stored, light, view = case  # one view for all lights, repeated without a copy
    one_view = np.broadcast_to(view[:, :1], view.shape)
    assert (
        relative_error(shade(model, stored, light, one_view), twin(model, stored, light, one_view.copy())) < tolerance
    )


@pytest.mark.parametrize("model", MODELS)
def test_directions_of_each_texel_give_the_bits_of_one_texel_at_a_time(model: str) -> None:
    stored, light, view = per_texel(model, 2, 5, 83)
    whole = shade(model, stored, light, view)
    for n in (0, 15, 64, 82):
        assert np.array_equal(
            shade(model, stored[:, n : n + 1], light[:, :, n], view[:, :, n])[:, :, 0], whole[:, :, n]
        )
    mixed = shade(model, stored, light, view[:1, :, 3])
    assert np.array_equal(mixed[1, :, 82], shade(model, stored[1, 82:], light[1, :, 82], view[0, :, 3])[:, 0])
    planar = np.ascontiguousarray(light.transpose(3, 0, 1, 2)).transpose(1, 2, 3, 0)
    assert np.array_equal(shade(model, stored, planar, view[:, :, ::-1][:, :, ::-1]), whole)
    repeated = shade(model, stored, light[:, :, :1], view[:, :, :1])
    assert np.array_equal(repeated, shade(model, stored, light[:, :, 0], view[:, :, 0]))


def test_any_strides_are_read_in_place() -> None:
    stored, light, view = inputs("gltf", 2, 6, 9)
    expected = shade("gltf", stored, light, view)
    planar = np.ascontiguousarray(stored.transpose(2, 0, 1)).transpose(1, 2, 0)
    assert not planar.flags.c_contiguous
    assert np.array_equal(shade("gltf", planar, light[:, ::-1][:, ::-1], np.asfortranarray(view)), expected)
    assert np.array_equal(shade("gltf", stored[:, ::-1], light, view), expected[:, :, ::-1])
    record = np.zeros((2, 9), [("pad", "u1"), ("texel", "f4", 8)])  # unaligned, strides no multiple of 4
    record["texel"] = stored
    assert np.array_equal(shade("gltf", record["texel"], light, view), expected)
    frozen = stored.copy()
    frozen.flags.writeable = False
    assert np.array_equal(shade("gltf", frozen, light.astype(np.float64), view.tolist()), expected)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_nothing_below_the_horizon_of_the_light_and_black_below_that_of_the_view(model: str, dtype: Any) -> None:
    rng = np.random.default_rng(3)
    stored = material(rng, model, 20).astype(dtype)
    normal = LAYOUTS[model].normal
    stored[:, normal] = [0, 0, 1][: normal.stop - normal.start]
    up, down, level = [0, 0, 1], [0.6, 0, -0.8], [1, 0, 0]
    assert not shade(model, stored, [down, level, down], [up, up, down]).any()
    assert not shade(model, stored, [up, up], [down, level], turned_away="black").any()
    assert shade(model, stored, [up, up, up], [up, down, level]).any((1, 2)).all()


EXTREMES = (0.0, -0.0, 1.0, -1.0, 1e-30, -1e-30, 1e30, -1e30, 80.0, -80.0, 3e38, -3e38)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_finite_input_never_gives_nan(model: str, dtype: Any) -> None:
    rng = np.random.default_rng(4)
    C = MODELS[model]
    stored = material(rng, model, 4096)
    stored = np.where(rng.random(stored.shape) < 0.4, rng.choice(EXTREMES, stored.shape), stored).astype(dtype)
    stored[:2] = 0
    axes = np.concatenate([np.eye(3), -np.eye(3), np.zeros((1, 3)), directions(rng, 9)])
    light, view = (a.reshape(-1, 3).astype(dtype) for a in np.broadcast_arrays(axes[:, None], axes[None]))
    out = shade(model, stored, light, view)
    assert not np.isnan(out).any()
    grad = np.empty((1, 4096, C), dtype)
    _native.shade_backward(model, stored[None], light[None], view[None], np.ones((1, *out.shape), dtype), grad)
    assert not np.isnan(grad).any()


# ---- many lights ----


def lit_inputs(model: str, N: int, K: int, dtype: Any = np.float32, seed: int = 0) -> list[Any]:
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


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float32, 1e-5), (np.float64, 1e-9)])
def test_points_agree_with_the_twin(model: str, dtype: Any, tolerance: float) -> None:
    case = lit_inputs(model, 171, 70, dtype)
    expected = twin(model, *case, call=reference.shade_lit)
    assert (expected > 0).mean() > 0.5
    assert relative_error(shade_lit(model, *case), expected) < tolerance


def test_any_strides_dtypes_and_sequences_of_points_are_read() -> None:
    stored, frame, view, light, radiance = lit_inputs("gltf", 9, 6)
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
    stored, frame, *_ = lit_inputs("gltf", 4, 1)
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


@pytest.mark.parametrize("surfaces", [1, 3])
def test_surfaces_have_points_and_lights_of_their_own(surfaces: int) -> None:
    """An argument without an axis for surfaces is the same for all of them."""
    rng = np.random.default_rng(4)
    stored, frame, view, _, radiance = lit_inputs("gltf", 70, 5)
    lights = np.stack([directions(rng, 5) for _ in range(surfaces)]).astype(np.float32)
    texels = np.stack([np.roll(stored, index, 0) for index in range(surfaces)])
    found = shade_lit("gltf", texels, frame, view, lights, radiance)
    assert found.shape == (surfaces, 70, 3)
    for index in range(surfaces):
        assert np.array_equal(found[index], shade_lit("gltf", texels[index], frame, view, lights[index], radiance))
    expected = twin("gltf", texels, frame, view, lights, radiance, call=reference.shade_lit)
    assert relative_error(found, expected) < 1e-5
