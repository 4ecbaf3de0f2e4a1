"""Which texels and vertices a pixel was made of: those, and no others, by which a gradient is not 0."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake import _native, raster, sampling, stochastic

BOUNDARIES = ("wrap", "clamp", "mirror", "zero")
STACKS = {
    "halved": [(8, 16), (4, 8), (2, 4), (1, 2), (1, 1)],
    "odd": [(7, 13), (3, 6), (1, 3), (1, 1)],
    "one level": [(5, 3)],
    "no halves": [(3, 4), (5, 2)],
}
SPECIAL = (np.nan, np.inf, -np.inf, 0.0, 1.0, 0.5, -0.5, -1.0, 2.0, 1e6, -1e6, 0.9999999, -1e-9)
LODS = (np.nan, np.inf, -np.inf, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 0.999999, 9.0)

Lookups = dict[str, NDArray[np.float32]]


def lookups(size: tuple[int, int], seed: int) -> Lookups:
    """Coordinates inside and outside of [0, 1], of texel centres and of no place at all; levels; derivatives."""
    generator = np.random.default_rng(seed)
    count, (height, width) = 240, size
    uv = generator.uniform(-2, 3, (count, 2))
    uv[:60] = (generator.integers(-20, 40, (60, 2)) + 0.5) / [width, height]  # centres
    uv[60:90, 0] = (generator.integers(-20, 40, 30) + 0.5) / width  # centres along one axis
    uv[90:110] = generator.integers(-20, 40, (20, 2)) / [width, height]  # corners
    uv[110 : 110 + len(SPECIAL), 0] = uv[130 : 130 + len(SPECIAL), 1] = SPECIAL
    lod = generator.uniform(-1, 6, count)
    lod[:180] = np.resize(LODS[3:], 180)  # NaN and infinity come by themselves
    lod[180 : 180 + len(LODS)] = LODS
    uv_da = generator.normal(size=(count, 4)) * 2.0 ** generator.uniform(-6, 1, (count, 1))
    uv_da[200:230] *= generator.choice([0.0, 1.0, 0.01], (30, 4))  # long footprints, and none
    uv_da[230, 0], uv_da[231, 1], uv_da[232] = np.nan, np.inf, 0
    return {name: array.astype(np.float32) for name, array in (("uv", uv), ("lod", lod), ("uv_da", uv_da))}


def slopes(sizes: list[tuple[int, int]], uv: Any, boundary: tuple[str, str], mode: str, **levels: Any) -> NDArray[Any]:
    """(P, texels): the gradient of each lookup by all texels. Every lookup has a stack of its own."""
    count = len(uv)
    stack = [torch.ones((count, *size, 1), requires_grad=True) for size in sizes]
    given = {name: torch.from_numpy(array)[:, None, None] for name, array in levels.items()}
    mip = stack[1:] if mode not in ("nearest", "linear") else None
    out = sampling.texture(
        stack[0], torch.from_numpy(uv)[:, None, None], mip=mip, filter_mode=mode, boundary_mode=boundary, **given
    )
    found = torch.autograd.grad(out.sum(), stack, allow_unused=True, materialize_grads=True)
    return torch.cat([grad.reshape(count, -1) for grad in found], 1).numpy()


def listed(touched: NDArray[np.int32], count: int) -> NDArray[np.bool_]:
    """(P, count): whether a pixel lists an element. Each is listed once, and -1 stands behind the last."""
    table = np.zeros((len(touched), count + 1), np.int64)
    np.add.at(table, (np.arange(len(touched))[:, None], touched), 1)
    assert table[:, :count].max(initial=0) <= 1
    assert np.all((touched[:, :-1] >= 0) | (touched[:, 1:] < 0))
    return table[:, :count] == 1


def same(found: NDArray[np.bool_], expected: NDArray[Any], given: Lookups) -> None:
    wrong = np.flatnonzero((found != (expected != 0)).any(1))
    assert not len(wrong), [{name: array[w].tolist() for name, array in given.items()} for w in wrong[:5]]


@pytest.mark.parametrize("name", STACKS)
@pytest.mark.parametrize("boundary", [*zip(BOUNDARIES, BOUNDARIES[1:] + BOUNDARIES[:1], strict=True)])
def test_texels_are_listed_where_the_gradient_is_not_0(name: str, boundary: tuple[str, str]) -> None:
    sizes = STACKS[name]
    given = lookups(sizes[0], 1)
    uv, lod, uv_da = given["uv"], given["lod"], given["uv_da"]
    with np.errstate(invalid="ignore"):
        level = np.clip(np.floor(lod + np.float32(0.5)), 0, len(sizes) - 1)
    single = [slopes([size], uv, boundary, "nearest") * (level == n)[:, None] for n, size in enumerate(sizes)]
    for texels, places, levels, expected in (
        ("nearest", 1, (lod, None), np.concatenate(single, 1)),
        ("trilinear", 8, (lod, None), slopes(sizes, uv, boundary, "linear-mipmap-linear", mip_level_bias=lod)),
        ("trilinear", 8, (None, uv_da), slopes(sizes, uv, boundary, "linear-mipmap-linear", uv_da=uv_da)),
        ("anisotropic", 128, (None, uv_da), slopes(sizes, uv, boundary, "anisotropic", uv_da=uv_da)),
    ):
        found = stochastic.touched_texels(sizes, uv, *levels, None, texels, boundary)
        assert found.shape == (len(uv), places)
        same(listed(found, expected.shape[1]), expected, given)


@pytest.mark.skipif(
    not (torch.cuda.is_available() and _native.cuda_compiled()),
    reason="no CUDA device and CUDA kernels here: touched texels with CUDA are not tested",
)
@pytest.mark.parametrize("texels", ["nearest", "trilinear", "anisotropic"])
def test_cuda_lists_what_the_cpu_lists(texels: str) -> None:
    for name, sizes in STACKS.items():
        given = {key: torch.from_numpy(each) for key, each in lookups(sizes[0], 6).items()}
        for boundary in zip(BOUNDARIES, BOUNDARIES[1:] + BOUNDARIES[:1], strict=True):
            on = {key: each.cuda() for key, each in given.items()}
            lists = [
                stochastic.touched_texels(sizes, each["uv"], None, each["uv_da"], None, texels, boundary)
                for each in (given, on)
            ]
            # A level of detail may be rounded to either side of a whole number.
            same_rows = (lists[0] == lists[1].cpu()).all(1).float().mean()
            assert same_rows > 0.98, name


# Vertices

TRIANGLES = np.int32([[0, 1, 2], [2, 1, 3], [7, 5, 6]])


@pytest.mark.parametrize("dtype", ["int32", "int64", "float32", "float64"])
def test_vertices_of_deep_ids(dtype: str) -> None:
    ids = np.array([[1, 2, 0], [0, 0, 0], [3, 3, 1]], dtype)
    expected = [[0, 1, 2, 2, 1, 3, -1, -1, -1], [-1] * 9, [7, 5, 6, 7, 5, 6, 0, 1, 2]]
    assert stochastic.touched_vertices(ids, TRIANGLES).tolist() == expected
    tensor = stochastic.touched_vertices(torch.from_numpy(ids), torch.from_numpy(TRIANGLES))
    assert tensor.dtype == torch.int32 and tensor.tolist() == expected
    assert stochastic.touched_vertices(ids[:0], TRIANGLES).shape == (0, 9)
    assert stochastic.touched_vertices(ids[:, :0], TRIANGLES).shape == (3, 0)
    assert np.all(stochastic.touched_vertices(ids * 0, TRIANGLES[:0]) == -1)


@pytest.mark.parametrize("layers", [1, 3])
def test_vertices_are_listed_where_the_gradient_of_a_layer_is_not_0(layers: int) -> None:
    """Of one layer, and of several layers in a deep buffer."""
    generator = torch.Generator().manual_seed(layers)
    pos = torch.rand(1, 24, 4, generator=generator, dtype=torch.float64) * 2 - 1
    pos[..., 3] = 1
    triangles = torch.arange(24, dtype=torch.int32).reshape(8, 3)
    values = torch.rand(24, 1, generator=generator, dtype=torch.float64, requires_grad=True)
    size = (9, 11)
    found: list[Tensor] = []
    image = torch.zeros(size, dtype=torch.float64)
    with raster.DepthPeeler(None, pos, triangles, size) as peeler:
        for _ in range(layers):
            rast, _ = peeler.rasterize_next_layer()
            image = image + raster.interpolate(values, rast, triangles)[0][0, ..., 0]
            found.append(rast[0, ..., 3].reshape(-1, 1))
    rows = [torch.autograd.grad(pixel, values, retain_graph=True)[0][:, 0] for pixel in image.reshape(-1)]
    touched = stochastic.touched_vertices(torch.cat(found, 1), triangles).numpy()
    assert touched.shape == (99, 3 * layers)
    expected = torch.stack(rows).numpy() != 0
    assert expected.sum() > 50
    table = np.zeros((99, 25), bool)
    table[np.arange(99)[:, None], touched] = True
    assert np.array_equal(table[:, :24], expected)
