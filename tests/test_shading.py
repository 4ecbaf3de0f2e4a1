"""The NumPy door of shading: against the plain twin, layouts, edge cases, and what it refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import torch

from mipbake import _native
from mipbake.base.errors import UsageError
from mipbake.material import MODELS as LAYOUTS
from mipbake.shading import TurnedAway, models, reference, shade

from .shading_inputs import MODELS, directions, material, pairs, relative_error

RELATIVE = 1e-5


RULES: tuple[TurnedAway, ...] = ("clamp", "black")


def twin(model: str, *arrays: Any, rule: TurnedAway = "clamp") -> Any:
    return reference.shade(
        model, *(torch.from_numpy(np.asarray(a, np.float64)) for a in arrays), turned_away=rule
    ).numpy()


def inputs(model: str, B: int, K: int, N: int, seed: int = 0) -> list[Any]:
    rng = np.random.default_rng(seed)
    return [a.astype(np.float32) for a in (material(rng, model, B, N), *pairs(rng, B, K))]


def test_the_kernels_know_every_model_of_the_library() -> None:
    assert models() == {name: layout.channels for name, layout in LAYOUTS.items()}
    assert set(models()) == set(reference.MODELS)


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


@pytest.mark.parametrize("model", MODELS)
def test_one_pair_or_one_texel_gives_the_same_as_many(model: str) -> None:
    stored, light, view = inputs(model, 1, 300, 70)
    whole = shade(model, stored, light, view)
    assert np.array_equal(shade(model, stored, light[:, 7:8], view[:, 7:8]), whole[:, 7:8])
    assert np.array_equal(shade(model, stored[:, 69:70], light, view), whole[:, :, 69:70])


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


def test_an_unknown_rule_is_named() -> None:
    with pytest.raises(UsageError, match="turned_away is 'white': expected one of clamp, black"):
        shade("ggx", *inputs("ggx", 1, 1, 1), turned_away="white")  # type: ignore[arg-type]


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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "phong"}, "unknown material model 'phong'.*gltf.*ggx"),
        ({"material": np.zeros((4, 8), np.float32)}, r"material has shape \(4, 8\).*\(N, 11\)"),
        ({"material": np.zeros(11, np.float32)}, r"material has shape \(11,\)"),
        ({"material": np.zeros((4, 11), np.float16)}, "material is float16: expected float32 or float64"),
        ({"material": np.zeros((4, 11), ">f4")}, "material is >f4: expected float32"),
        ({"material": np.zeros((4, 11), complex)}, "material is complex128: expected real"),
        ({"light": np.zeros((5, 4), np.float32)}, r"light has shape \(5, 4\): expected \(K, 3\)"),
        ({"light": [["a", "b", "c"]]}, "light is <U1: expected real numbers"),
        ({"light": [[1.0], [1.0, 2.0]]}, "light is not an array of numbers"),
        ({"view": np.zeros((6, 3), np.float32)}, r"view has shape \(6, 3\) where light has \(5, 3\)"),
        ({"light": np.zeros((1, 5, 3, 3))}, r"light has shape \(1, 5, 3, 3\) where the material has 4 texels"),
        ({"view": np.zeros((1, 6, 4, 3))}, r"view has shape \(1, 6, 4, 3\) where light has \(5, 3\)"),
        ({"view": np.zeros((2, 5, 3)), "material": np.zeros((3, 4, 11))}, "batch sizes.*material has 3, view has 2"),
    ],
)
def test_wrong_arguments_are_named(change: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {
        "model": "ggx",
        "material": np.zeros((4, 11), np.float32),
        "light": np.zeros((5, 3), np.float32),
        "view": np.zeros((5, 3), np.float32),
    }
    with pytest.raises(UsageError, match=message):
        shade(**(arguments | change))
