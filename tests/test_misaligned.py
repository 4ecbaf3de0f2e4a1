"""Arrays whose elements lie at odd addresses, as views of files and packets do, give the same bits as aligned ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from mipbake import _native, raster, sampling, shading
from mipbake.base.aligned import aligned, contiguous
from mipbake.sampling.adjoint import scatter_linear
from mipbake.shading.adjoint import shade_adjoint


def odd(array: Any) -> Any:
    """The values of an array or a tensor, one byte past an aligned address."""
    values = np.asarray(array.detach() if isinstance(array, torch.Tensor) else array)
    buffer = bytearray(values.nbytes + 1)
    buffer[1:] = values.tobytes()
    moved = np.frombuffer(buffer, values.dtype, values.size, 1).reshape(values.shape)
    assert not moved.flags.aligned
    if not isinstance(array, torch.Tensor):
        return moved
    tensor = torch.frombuffer(buffer, dtype=array.dtype, count=array.numel(), offset=1).reshape(array.shape)
    assert tensor.data_ptr() % tensor.element_size()
    return tensor


def refusing(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of the native core, which refuses arrays at odd addresses here."""

    def watched(*arguments: Any, **named: Any) -> Any:
        for each in (*arguments, *named.values()):
            for array in each if isinstance(each, (list, tuple)) else [each]:
                if isinstance(array, np.ndarray):
                    assert array.flags.aligned, function.__name__
                elif isinstance(array, torch.Tensor):
                    assert array.data_ptr() % array.element_size() == 0, function.__name__
        return function(*arguments, **named)

    return watched


@pytest.fixture(autouse=True)
def watched(monkeypatch: pytest.MonkeyPatch) -> None:
    functions = {name: each for name, each in vars(_native).items() if callable(each) and not isinstance(each, type)}
    assert {"shade", "texture", "rasterize"} <= functions.keys()
    for name, function in functions.items():
        monkeypatch.setattr(_native, name, refusing(function))


def random(*shape: int, kind: str = "numpy", dtype: str = "float32") -> Any:
    values = np.random.default_rng(sum(shape)).random(shape).astype(dtype)
    return values if kind == "numpy" else torch.from_numpy(values)


def same(function: Callable[..., Any], *arguments: Any) -> None:
    """The function gives the same bits for the arguments as they are, and at odd addresses."""
    expected, found = function(*arguments), function(*(odd(each) for each in arguments))
    several = isinstance(expected, tuple)
    for one, other in zip(expected if several else [expected], found if several else [found], strict=True):
        assert np.array_equal(np.asarray(one), np.asarray(other))


def test_what_the_native_core_gets_is_aligned() -> None:
    array, tensor = random(3, 4), random(3, 4, kind="torch")
    assert contiguous(array) is array and aligned(tensor) is tensor
    assert contiguous(odd(array)).flags.aligned and np.array_equal(contiguous(odd(array)), array)
    assert aligned(odd(tensor)).data_ptr() % 4 == 0 and torch.equal(aligned(odd(tensor)), tensor)


@pytest.mark.parametrize(("kind", "dtype"), [("numpy", "float64"), ("torch", "float32")])
def test_lookups(kind: str, dtype: str) -> None:
    arguments = [random(*s, kind=kind, dtype=dtype) for s in ((1, 8, 8, 3), (1, 4, 4, 2), (1, 4, 4, 4), (1, 4, 4))]
    same(sampling.texture, *arguments)
    same(lambda tex: tuple(sampling.texture_construct_mip(tex).levels), arguments[0])


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_rasters(kind: str) -> None:
    pos = np.array([[-0.8, -0.8, 0, 1], [0.8, -0.7, 0, 1], [0.1, 0.9, 0, 1]], np.float32)[None]
    tri = np.array([[0, 1, 2]], np.int32)
    mesh = (pos, tri) if kind == "numpy" else (torch.from_numpy(pos), torch.from_numpy(tri))
    rast, rast_db = raster.rasterize(None, *mesh, (9, 11))
    same(lambda pos, tri: raster.rasterize(None, pos, tri, (9, 11)), *mesh)
    same(lambda *a: raster.interpolate(*a, "all"), random(1, 3, 5, kind=kind), rast, mesh[1], rast_db)
    same(raster.antialias, random(1, 9, 11, 3, kind=kind), rast, *mesh)


def test_shading() -> None:
    material, light, view = random(6, 8), random(2, 3), random(2, 3)
    same(lambda *a: shading.shade("gltf", *a), material, light, view)
    same(lambda *a: shading.shade("gltf", *a), *map(torch.from_numpy, (material, light, view)))
    frame, radiance = random(6, 3, 3), random(2, 3)
    same(lambda *a: shading.shade_lit("gltf", *a), material, frame, random(6, 3), light, radiance)
    each = [array[None] for array in (material, light, view)]
    same(lambda *a: shade_adjoint("gltf", *a), *each, random(1, 2, 6, 3))


def test_gradients() -> None:
    def of_lookups(tex: torch.Tensor, uv: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        leaf = tex.detach().requires_grad_()
        return torch.autograd.grad(sampling.texture(leaf, uv), leaf, weight)[0]

    def of_shading(material: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        leaf = material.detach().requires_grad_()
        return torch.autograd.grad(shading.shade("ggx", leaf, *directions), leaf, weight)[0]

    directions = random(2, 3, kind="torch"), random(2, 3, kind="torch")
    same(of_lookups, *(random(*shape, kind="torch") for shape in ((1, 8, 8, 3), (1, 4, 4, 2), (1, 4, 4, 3))))
    same(of_shading, random(6, 11, kind="torch"), random(2, 6, 3, kind="torch"))
    same(lambda uv, values: scatter_linear((4, 5), uv, values, ("wrap", "wrap")), random(7, 2), random(7, 3))
