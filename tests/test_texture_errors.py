"""What the texture lookups refuse, and in which words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from mipbake import _native
from mipbake.base.errors import UsageError
from mipbake.base.stream import current_stream
from mipbake.sampling import texture, texture_construct_mip

TEX, UV, BIAS = np.ones((1, 4, 4, 3), np.float32), np.zeros((1, 2, 5, 2)), np.zeros((1, 2, 5))
DA, CUBE, DIRECTIONS = np.zeros((1, 2, 5, 4)), np.ones((1, 6, 4, 4, 3), np.float32), np.ones((1, 2, 5, 3))
STACK = texture_construct_mip(TEX)

# Both doors refuse these, in the same words.
SHARED: list[tuple[dict[str, Any], str]] = [
    ({"tex": TEX[0]}, r"tex has shape \(4, 4, 3\): expected \(B, H, W, C\), H, W and C from 1 on$"),
    ({"tex": TEX[:, :0]}, r"tex has shape \(1, 0, 4, 3\): expected \(B, H, W, C\), H, W and C from 1 on$"),
    ({"tex": CUBE}, r"tex has shape \(1, 6, 4, 4, 3\): expected .* set boundary_mode to 'cube'"),
    ({"tex": CUBE[:, :5], "boundary_mode": "cube"}, r"tex has shape \(1, 5, 4, 4, 3\): expected \(B, 6, S, S, C\)"),
    ({"tex": CUBE[:, :, :3], "boundary_mode": "cube"}, r"tex has shape .*: expected \(B, 6, S, S, C\)"),
    ({"boundary_mode": "cube"}, r"tex has shape \(1, 4, 4, 3\): expected \(B, 6, S, S, C\)"),
    ({"uv": UV[0]}, r"uv has shape \(2, 5, 2\): expected \(B, h, w, 2\)"),
    ({"uv": DIRECTIONS}, r"uv has shape \(1, 2, 5, 3\): expected \(B, h, w, 2\)"),
    ({"tex": CUBE, "boundary_mode": "cube"}, r"uv has shape \(1, 2, 5, 2\): expected \(B, h, w, 3\)"),
    ({"uv_da": UV}, r"uv_da has shape \(1, 2, 5, 2\): expected \(B, h, w, 4\)"),
    ({"uv_da": DA[:, :1]}, r"uv_da has shape \(1, 1, 5, 4\): expected \(B, 2, 5, 4\), the lookups of uv"),
    ({"tex": CUBE, "uv": DIRECTIONS, "uv_da": DA, "boundary_mode": "cube"}, r"uv_da has shape \(1, 2, 5, 4\):"),
    ({"mip_level_bias": BIAS[0]}, r"mip_level_bias has shape \(2, 5\): expected \(B, 2, 5\), the lookups of uv"),
    ({"mip_level_bias": BIAS[:, :, :4]}, r"mip_level_bias has shape \(1, 2, 4\): expected \(B, 2, 5\)"),
    ({"tex": TEX.repeat(2, 0), "uv": UV.repeat(3, 0)}, "batch sizes do not fit: tex has 2, uv has 3; expected each"),
    ({"uv_da": DA.repeat(3, 0), "mip_level_bias": BIAS.repeat(2, 0)}, "batch sizes do not fit: tex has 1, uv has 1,"),
    ({"filter_mode": "cubic"}, "filter_mode is 'cubic': expected 'auto', 'nearest', .* or 'anisotropic'"),
    ({"filter_mode": None}, "filter_mode is None: expected 'auto'"),
    ({"filter_mode": ["linear"]}, r"filter_mode is \['linear'\]: expected 'auto'"),
    ({"filter_mode": "linear-mipmap-linear"}, "filter_mode is 'linear-mipmap-linear': expected uv_da or"),
    ({"filter_mode": "anisotropic", "mip_level_bias": BIAS}, "filter_mode is 'anisotropic' and uv_da is missing:"),
    (
        {
            "tex": CUBE,
            "uv": DIRECTIONS,
            "uv_da": np.zeros((1, 2, 5, 6)),
            "boundary_mode": "cube",
            "filter_mode": "anisotropic",
        },
        "filter_mode is 'anisotropic' and boundary_mode is 'cube': expected another filter",
    ),
    ({"boundary_mode": "repeat"}, "boundary_mode is 'repeat': expected 'wrap', 'clamp', 'mirror', 'zero' or 'cube'"),
    ({"boundary_mode": ("wrap",)}, r"boundary_mode is \('wrap',\): expected"),
    ({"boundary_mode": ("wrap", "cube")}, r"boundary_mode is \('wrap', 'cube'\): expected .* two of the first four"),
    ({"boundary_mode": (["wrap"], "wrap")}, "boundary_mode is .*: expected"),
    ({"boundary_mode": None}, "boundary_mode is None: expected"),
    ({"boundary_mode": 7}, "boundary_mode is 7: expected"),
    ({"max_mip_level": -1}, "max_mip_level is -1: expected None or a whole number from 0"),
    ({"max_mip_level": 1.5}, "max_mip_level is 1.5: expected None"),
    ({"max_mip_level": True}, "max_mip_level is True: expected None"),
    ({"mip_level_bias": BIAS, "mip": "all"}, "mip is a str: expected what texture_construct_mip returns, or a list"),
    ({"mip_level_bias": BIAS, "mip": [TEX[0]]}, r"mip\[0\] has shape \(4, 4, 3\): expected \(B, H, W, C\)"),
    ({"mip_level_bias": BIAS, "mip": [TEX, TEX[..., :2]]}, r"mip\[1\] has shape \(1, 4, 4, 2\) where tex has \(1, 4,"),
    ({"mip_level_bias": BIAS, "mip": [TEX.repeat(2, 0)]}, r"mip\[0\] has shape \(2, .*: expected the same minibatch"),
    ({"mip_level_bias": BIAS, "mip": [TEX] * 32}, "mip has 32 levels: expected at most 31"),
]


def default(**arguments: Any) -> dict[str, Any]:
    return {"tex": TEX, "uv": UV, **arguments}


def as_torch(value: Any) -> Any:
    if isinstance(value, list):
        return [as_torch(v) for v in value]
    return torch.from_numpy(value.copy()) if isinstance(value, np.ndarray) else value


@pytest.mark.parametrize(("arguments", "words"), SHARED)
def test_both_doors_name_what_does_not_fit(arguments: dict[str, Any], words: str) -> None:
    given = default(**arguments)
    with pytest.raises(UsageError, match=words):
        texture(**given)
    with pytest.raises(UsageError, match=words):
        texture(**{name: as_torch(value) for name, value in given.items()})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"tex": TEX.astype(np.uint8)}, "tex is uint8: expected float32, float64 or float16"),
        ({"uv": UV.astype(complex)}, "uv is complex128: expected real numbers"),
        ({"uv": "here"}, "uv is <U4: expected real numbers"),
        ({"uv": [[0, 0], [1]]}, "uv is not an array of numbers"),
        ({"uv": torch.zeros(1, 2, 5, 2, requires_grad=True)}, "uv is a Tensor: expected a NumPy array, as tex is"),
        ({"uv_da": DA.astype(bool)}, "uv_da is bool: expected real numbers"),
        ({"mip_level_bias": [None]}, "mip_level_bias is object: expected real numbers"),
        ({"mip_level_bias": BIAS, "mip": TEX}, "mip is a ndarray: expected what texture_construct_mip returns"),
        ({"mip_level_bias": BIAS, "mip": [TEX.astype(np.float64)]}, r"mip\[0\] is float64: expected float32, as tex"),
        ({"mip_level_bias": BIAS, "mip": [torch.ones(1, 2, 2, 3)]}, r"mip\[0\] is a Tensor: expected a NumPy array"),
        ({"mip_level_bias": BIAS, "mip": texture_construct_mip(TEX[:, :2])}, r"mip was made for a texture of shape"),
        ({"mip_level_bias": BIAS, "mip": texture_construct_mip(TEX.astype(np.float64))}, r"mip\[0\] is float64:"),
    ],
)
def test_the_numpy_door_names_what_does_not_fit(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        texture(**default(**arguments))


T, T_UV, T_BIAS = torch.ones(1, 4, 4, 3), torch.zeros(1, 2, 5, 2), torch.zeros(1, 2, 5)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"tex": [1.0]}, "tex is a list: expected a torch tensor or a NumPy array"),
        ({"tex": T.int()}, "tex is torch.int32: expected float32, float64, float16 or bfloat16"),
        ({"uv": UV}, "uv is a ndarray: expected a torch tensor, as tex is"),
        ({"uv": T_UV.to("meta")}, "uv is on meta: expected cpu, where tex is"),
        ({"uv": T_UV.to(torch.complex64)}, "uv is torch.complex64: expected real numbers"),
        ({"uv_da": [0.0]}, "uv_da is a list: expected a torch tensor"),
        ({"mip_level_bias": 2.0}, "mip_level_bias is a float: expected a torch tensor"),
        ({"mip_level_bias": T_BIAS.bool()}, "mip_level_bias is torch.bool: expected real numbers"),
        ({"mip_level_bias": T_BIAS.to("meta")}, "mip_level_bias is on meta: expected cpu"),
        ({"mip_level_bias": T_BIAS, "mip": T}, "mip is a Tensor: expected what texture_construct_mip returns"),
        ({"mip_level_bias": T_BIAS, "mip": [T.double()]}, r"mip\[0\] is torch.float64 on cpu: expected torch.float32"),
        ({"mip_level_bias": T_BIAS, "mip": [TEX]}, r"mip\[0\] is a ndarray: expected a torch tensor"),
        ({"mip_level_bias": T_BIAS, "mip": STACK}, r"mip\[0\] is a ndarray: expected a torch tensor"),
    ],
)
def test_the_torch_door_names_what_does_not_fit(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        texture(**{"tex": T, "uv": T_UV, **arguments})


@pytest.mark.parametrize("convert", [lambda array: array, as_torch])
def test_stacks_are_refused_in_the_same_words(convert: Any) -> None:
    for arguments, words in (
        ({"tex": CUBE}, "for a cube map set cube_mode to True$"),
        ({"tex": TEX, "cube_mode": True}, r"tex has shape \(1, 4, 4, 3\): expected \(B, 6, S, S, C\)"),
        ({"tex": TEX, "max_mip_level": -2}, "max_mip_level is -2: expected None or a whole number from 0"),
        ({"tex": TEX.astype(np.int32)}, "tex is .*int32: expected float32, float64"),
    ):
        with pytest.raises(UsageError, match=words):
            texture_construct_mip(**{name: convert(value) for name, value in arguments.items()})


@pytest.mark.parametrize("convert", [lambda array: array, as_torch])
def test_integers_of_numpy_are_whole_numbers(convert: Any) -> None:
    for level in (np.int64(1), np.uint8(1)):
        own, plain = (
            texture(**{k: convert(v) for k, v in default(mip_level_bias=BIAS).items()}, max_mip_level=n)
            for n in (level, 1)
        )
        assert (own == plain).all()
        stack = texture_construct_mip(convert(TEX), level)
        assert [tuple(made.shape) for made in stack.levels] == [(1, 2, 2, 3)]


@pytest.mark.skipif(_native.cuda_compiled(), reason="this build has CUDA kernels")
def test_a_build_without_cuda_says_so() -> None:
    with pytest.raises(UsageError, match=r"tex is on cuda:0: .* has no CUDA kernels"), current_stream(_OnCuda(), "tex"):
        pass


class _OnCuda:
    """Stands for a tensor on a GPU, which a machine without one cannot make."""

    device = torch.device("cuda", 0)
