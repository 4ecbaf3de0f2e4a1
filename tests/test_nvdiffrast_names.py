"""`mipbake.nvdiffrast` against nvdiffrast's documentation: names, arguments, defaults, shapes, and what is refused."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import mipbake.nvdiffrast as dr
from mipbake import raster, sampling
from mipbake.base.errors import UsageError

DOCUMENTED = {
    "RasterizeCudaContext": "device=None",
    "RasterizeGLContext": "output_db=True, mode='automatic', device=None",
    "rasterize": "glctx, pos, tri, resolution, ranges=None, grad_db=True",
    "DepthPeeler": "glctx, pos, tri, resolution, ranges=None, grad_db=True",
    "interpolate": "attr, rast, tri, rast_db=None, diff_attrs=None",
    "texture": "tex, uv, uv_da=None, mip_level_bias=None, mip=None, filter_mode='auto', boundary_mode='wrap', "
    "max_mip_level=None",
    "texture_construct_mip": "tex, max_mip_level=None, cube_mode=False",
    "antialias": "color, rast, pos, tri, topology_hash=None, pos_gradient_boost=1.0",
    "antialias_construct_topology_hash": "tri",
    "get_log_level": "",
    "set_log_level": "level",
}
"""Signatures of the chapter "PyTorch API reference"; DepthPeeler has the arguments of rasterize."""

METHODS = {
    "DepthPeeler.rasterize_next_layer": "self",
    "RasterizeGLContext.set_context": "self",
    "RasterizeGLContext.release_context": "self",
}

POS = torch.tensor(
    [
        *([-0.9, -0.9, 0, 1], [0.9, -0.9, 0, 1], [-0.9, 0.9, 0, 1]),
        *([-0.7, -0.9, 0.5, 1], [0.9, -0.9, 0.5, 1], [0.9, 0.9, 0.5, 1]),
    ]
)
TRI = torch.tensor([[0, 1, 2], [3, 4, 5]], dtype=torch.int32)
RANGES = torch.tensor([[0, 2], [1, 1], [0, 0]], dtype=torch.int32)
SIZE = (6, 8)


@pytest.fixture(autouse=True)
def no_graphics_card(monkeypatch: pytest.MonkeyPatch) -> None:
    """Contexts without a device are for tensors on the processor, on machines that have a graphics card too."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


def manual() -> dr.RasterizeGLContext:
    context = dr.RasterizeGLContext(mode="manual")
    context.set_context()
    return context


CONTEXTS: dict[str, Callable[[], Any]] = {
    "cuda": dr.RasterizeCudaContext,
    "gl": dr.RasterizeGLContext,
    "gl without derivatives": lambda: dr.RasterizeGLContext(output_db=False),
    "manual": manual,
}


def plain(thing: Any) -> str:
    found = inspect.signature(thing).parameters.values()
    return ", ".join(str(each.replace(annotation=inspect.Parameter.empty)) for each in found)


def test_the_names_are_the_documented_ones() -> None:
    assert set(dr.__all__) == set(DOCUMENTED)
    assert {name for name in dir(dr) if not name.startswith("_") and not inspect.ismodule(getattr(dr, name))} == {
        *DOCUMENTED,
        "annotations",
    }


@pytest.mark.parametrize("name", DOCUMENTED)
def test_signatures_are_the_documented_ones(name: str) -> None:
    assert plain(getattr(dr, name)) == DOCUMENTED[name]


@pytest.mark.parametrize("name", METHODS)
def test_methods_are_the_documented_ones(name: str) -> None:
    kind, method = name.split(".")
    assert plain(getattr(getattr(dr, kind), method)) == METHODS[name]


def test_there_is_one_implementation() -> None:
    for name in ("antialias", "antialias_construct_topology_hash"):
        assert getattr(dr, name) is getattr(raster, name)
    for name in ("texture", "texture_construct_mip"):
        assert getattr(dr, name) is getattr(sampling, name)
    assert issubclass(dr.DepthPeeler, raster.DepthPeeler)


# ---- shapes and meanings of results ----


@pytest.mark.parametrize("batch", [None, 1, 3])
@pytest.mark.parametrize("kind", CONTEXTS)
def test_rasterize(kind: str, batch: int | None) -> None:
    """Every context gives the results of `mipbake.raster`; both modes of geometry, by name and by place."""
    context = CONTEXTS[kind]()
    pos = POS if batch is None else POS.repeat(batch, 1, 1)
    ranges = RANGES if batch is None else None
    want, want_db = raster.rasterize(None, pos, TRI, SIZE, ranges)
    rast, rast_db = dr.rasterize(glctx=context, pos=pos, tri=TRI, resolution=SIZE, ranges=ranges, grad_db=True)
    assert torch.equal(rast, want) and rast.shape == (batch or 3, *SIZE, 4)
    if kind == "gl without derivatives":
        want_db = want_db.new_empty((*want.shape[:3], 0))
    assert torch.equal(rast_db, want_db)
    for each in (rast, rast_db):
        assert each.is_contiguous() and each.dtype == torch.float32 and each.device == pos.device
    again = dr.rasterize(context, pos, TRI, list(SIZE), ranges)
    assert torch.equal(again[0], rast) and torch.equal(again[1], rast_db)


@pytest.mark.parametrize("resolution", [list(SIZE), np.array(SIZE), torch.tensor(SIZE), torch.Size(SIZE)])
def test_resolutions_of_every_kind(resolution: Any) -> None:
    context = dr.RasterizeCudaContext()
    want, _ = raster.rasterize(None, POS[None], TRI, SIZE)
    assert torch.equal(dr.rasterize(context, POS[None], TRI, resolution)[0], want)
    with dr.DepthPeeler(context, POS[None], TRI, resolution) as peeler:
        assert torch.equal(peeler.rasterize_next_layer()[0], want)


@pytest.mark.parametrize("resolution", [np.array([4.0, 4.0]), torch.tensor([[4, 4]]), torch.tensor([4]), "44"])
def test_resolutions_that_cannot_be(resolution: Any) -> None:
    with pytest.raises(UsageError, match=r"resolution is .*: expected \(height, width\)"):
        dr.rasterize(dr.RasterizeCudaContext(), POS[None], TRI, resolution)


def test_ranges_are_ignored_in_instanced_mode() -> None:
    context = dr.RasterizeCudaContext()
    assert dr.rasterize(context, POS[None], TRI, SIZE, RANGES)[0].shape == (1, *SIZE, 4)


@pytest.mark.parametrize("grad_db", [True, False])
@pytest.mark.parametrize("kind", CONTEXTS)
def test_gradients_of_derivatives(kind: str, grad_db: bool) -> None:
    """They are left out on request, and where the context does not output derivatives."""
    pos = POS[None].clone().requires_grad_()
    rast, rast_db = dr.rasterize(CONTEXTS[kind](), pos, TRI, SIZE, grad_db=grad_db)
    assert rast.requires_grad
    assert rast_db.requires_grad == (grad_db and kind != "gl without derivatives")


@pytest.mark.parametrize("kind", CONTEXTS)
def test_depth_peeler(kind: str) -> None:
    """The first layer is what `rasterize` gives, the second lies behind it, and the third is empty."""
    context = CONTEXTS[kind]()
    with dr.DepthPeeler(context, POS[None], TRI, resolution=SIZE) as peeler:
        layers = [peeler.rasterize_next_layer() for _ in range(3)]
        inside = dr.rasterize(context, POS[None], TRI, SIZE)  # the context is not reserved
    for got, want in zip(layers[0], inside, strict=True):
        assert torch.equal(got, want)
    ids = [sorted(layer[..., 3].unique().tolist()) for layer, _ in layers]
    assert ids == [[0, 1, 2], [0, 2], [0]]
    assert all(db.shape == (1, *SIZE, 0 if kind == "gl without derivatives" else 4) for _, db in layers)


def test_a_context_without_derivatives_serves_interpolation_without_them() -> None:
    rast, rast_db = dr.rasterize(dr.RasterizeGLContext(output_db=False), POS[None], TRI, SIZE)
    assert dr.interpolate(POS, rast, TRI, rast_db)[1].shape == (1, *SIZE, 0)
    with pytest.raises(UsageError, match=r"rast_db has shape \(1, 6, 8, 0\) and diff_attrs is .all.: expected"):
        dr.interpolate(POS, rast, TRI, rast_db, diff_attrs="all")


# ---- what is refused ----

WRONG: dict[str, tuple[Callable[[], Any], str]] = {
    "no context": (lambda: dr.rasterize(None, POS[None], TRI, SIZE), "glctx is a NoneType: expected a"),
    "another context": (lambda: dr.rasterize(raster.RasterizeContext(), POS[None], TRI, SIZE), "glctx is a Rasterize"),
    "no context to peel": (lambda: dr.DepthPeeler(POS, TRI, SIZE, None), "glctx is a Tensor: expected"),
    "mode": (lambda: dr.RasterizeGLContext(mode="auto"), "mode is 'auto': expected 'automatic' or 'manual'"),
    "output_db": (lambda: dr.RasterizeGLContext(output_db=1), "output_db is 1: expected True or False"),
    "device": (lambda: dr.RasterizeCudaContext("tpu"), "unknown device 'tpu': expected cpu, cuda, or cuda:1"),
    "kind of device": (lambda: dr.RasterizeGLContext(device=1.5), "device is 1.5: expected a torch.device, a name"),
    "negative device": (lambda: dr.RasterizeCudaContext(-1), "unknown device 'cuda:-1': expected"),
    "set": (lambda: dr.RasterizeGLContext().set_context(), "set_context was called on a context in automatic mode"),
    "release": (lambda: dr.RasterizeGLContext().release_context(), "release_context was called on a context in auto"),
    "unset": (
        lambda: dr.rasterize(dr.RasterizeGLContext(mode="manual"), POS[None], TRI, SIZE),
        "glctx is in manual mode and not set in this thread: expected a call of set_context() before",
    ),
    "outside": (
        lambda: dr.DepthPeeler(dr.RasterizeCudaContext(), POS[None], TRI, SIZE).rasterize_next_layer(),
        "the depth peeler is not open",
    ),
    "range mode": (lambda: dr.rasterize(dr.RasterizeCudaContext(), POS, TRI, SIZE), "ranges is missing"),
    "indices": (lambda: dr.rasterize(dr.RasterizeCudaContext(), POS[None], TRI.long(), SIZE), "tri is int64: expected"),
    "no mips": (
        lambda: dr.texture(torch.rand(1, 4, 4, 1), torch.rand(1, 2, 2, 2), filter_mode="linear-mipmap-linear"),
        "expected uv_da or mip_level_bias",
    ),
    "not set to cube": (
        lambda: dr.texture(torch.rand(1, 6, 4, 4, 1), torch.rand(1, 2, 2, 3)),
        "for a cube map set bou",
    ),
    "log level": (lambda: dr.set_log_level(4), "level is 4: expected 0 (info), 1 (warning), 2 (error) or 3 (fatal)"),
    "kind of log level": (lambda: dr.set_log_level("info"), "level is 'info': expected 0 (info)"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_use(case: str) -> None:
    call, sentence = WRONG[case]
    with pytest.raises(UsageError, match=re.escape(sentence)):
        call()


# ---- beyond nvdiffrast ----


def test_compiled_equals_eager() -> None:
    contexts = [dr.RasterizeCudaContext(), dr.RasterizeGLContext(output_db=False)]

    def both(pos: Tensor) -> Tensor:
        color, _ = dr.interpolate(pos, dr.rasterize(contexts[0], pos, TRI, SIZE)[0], TRI)
        with dr.DepthPeeler(contexts[1], pos, TRI, SIZE) as peeler:
            peeler.rasterize_next_layer()
            behind, _ = peeler.rasterize_next_layer()
        return color + behind

    assert torch.equal(torch.compile(both, fullgraph=True, backend="aot_eager")(POS[None]), both(POS[None]))
