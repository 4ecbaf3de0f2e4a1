"""What docs/primitives.md says of nvdiffrast: the same names, and arguments in the same order with its defaults."""

from __future__ import annotations

import inspect

import pytest

from mipbake import raster, sampling

DOCUMENTED = {
    "rasterize": "ctx, pos, tri, resolution, ranges=None, grad_db=True",
    "interpolate": "attr, rast, tri, rast_db=None, diff_attrs=None",
    "texture": "tex, uv, uv_da=None, mip_level_bias=None, mip=None, filter_mode='auto', boundary_mode='wrap', "
    "max_mip_level=None",
    "texture_construct_mip": "tex, max_mip_level=None, cube_mode=False",
    "antialias": "color, rast, pos, tri, topology_hash=None, pos_gradient_boost=1.0",
    "antialias_construct_topology_hash": "tri",
    "DepthPeeler": "ctx, pos, tri, resolution, ranges=None, grad_db=True",
}
"""Signatures of nvdiffrast's documentation, its `glctx` called `ctx`; DepthPeeler has the signatures of rasterize."""


@pytest.mark.parametrize("name", DOCUMENTED)
def test_signatures_are_those_that_nvdiffrast_documents(name: str) -> None:
    module = sampling if name.startswith("texture") else raster
    found = inspect.signature(getattr(module, name)).parameters.values()
    plain = [each.replace(annotation=inspect.Parameter.empty) for each in found]
    assert ", ".join(map(str, plain)) == DOCUMENTED[name]
