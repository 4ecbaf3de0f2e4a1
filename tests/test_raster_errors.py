"""What the raster primitives refuse: one sentence that names the argument, what was expected and what came."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from mipbake import _native
from mipbake.base.errors import UsageError
from mipbake.raster import (
    DepthPeeler,
    RasterizeContext,
    _device,
    antialias,
    antialias_construct_topology_hash,
    interpolate,
    rasterize,
)

from .raster_scenes import needs_cuda

POS = torch.tensor([[-1.0, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1], [0, 0, 0, 1]]).repeat(2, 1, 1)
TRI = torch.tensor([[0, 1, 2], [1, 2, 3]], dtype=torch.int32)
SIZE = (3, 5)
RAST = rasterize(None, POS, TRI, SIZE)[0]
DB = rasterize(None, POS, TRI, SIZE)[1]
ATTR = torch.rand(4, 3)
COLOR = torch.rand(2, *SIZE, 3)
RANGES = torch.tensor([[0, 2], [1, 1]], dtype=torch.int32)
INDICES = "expected vertex indices from 0 to 3"


def changed(tensor: Tensor, at: tuple[int, ...], value: Any) -> Tensor:
    copy = tensor.clone()
    copy[at] = torch.as_tensor(value, dtype=copy.dtype)
    return copy


def ranged(pos: Any, ranges: Any) -> dict[str, Any]:
    return {"ctx": None, "pos": pos, "tri": TRI, "resolution": SIZE, "ranges": ranges}


RASTERIZE: dict[str, tuple[dict[str, Any], str]] = {
    "context": ({"ctx": "cpu"}, "ctx is a str: expected a RasterizeContext or None"),
    "pos shape": ({"pos": POS[..., :3]}, "pos has shape (2, 4, 3): expected (vertices, 4) in range mode or"),
    "pos axes": ({"pos": POS[None]}, "pos has shape (1, 2, 4, 4): expected (vertices, 4) in range mode or"),
    "pos dtype": ({"pos": POS.half()}, "pos is float16: expected float32 or float64"),
    "pos integers": ({"pos": POS.int()}, "pos is int32: expected float32 or float64"),
    "tri dtype": ({"tri": TRI.long()}, "tri is int64: expected int32"),
    "tri shape": ({"tri": TRI[0]}, "tri has shape (3,): expected (triangles, 3)"),
    "tri quads": ({"tri": torch.zeros(2, 4, dtype=torch.int32)}, "tri has shape (2, 4): expected (triangles, 3)"),
    "resolution": ({"resolution": 7}, "resolution is 7: expected (height, width), two integers from 1 to 32768"),
    "resolution of three": ({"resolution": (4, 5, 6)}, "resolution is (4, 5, 6): expected (height, width)"),
    "no resolution": ({"resolution": (0, 5)}, "resolution is (0, 5): expected (height, width), two integers from 1"),
    "real resolution": ({"resolution": (4.0, 5)}, "resolution is (4.0, 5): expected (height, width), two integers"),
    "large": ({"resolution": (4, 32769)}, "resolution is (4, 32769): expected (height, width), two integers from 1"),
    "no ranges": ({"pos": POS[0]}, "pos has shape (4, 4) and ranges is missing: expected ranges (batch, 2)"),
    "ranges dtype": (ranged(POS[0], RANGES.long()), "ranges is int64: expected int32"),
    "ranges shape": (ranged(POS[0], RANGES[0]), "ranges has shape (2,): expected (batch, 2), a start and a count"),
    "beyond": (ranged(POS[0], changed(RANGES, (1,), [1, 2])), "ranges[1] is (1, 2): expected a start and a count"),
    "negative": (ranged(POS[0], changed(RANGES, (0,), [-1, 2])), "ranges[0] is (-1, 2): expected a start and a count"),
    "index": ({"tri": changed(TRI, (1, 2), 4)}, f"tri[1] is (1, 2, 4): {INDICES}"),
    "negative index": ({"tri": changed(TRI, (0, 0), -1)}, f"tri[0] is (-1, 1, 2): {INDICES}"),
    "no vertices": ({"pos": POS[:, :0]}, "tri[0] is (0, 1, 2): expected no triangles"),
    "nan": ({"pos": changed(POS, (1, 3, 0), np.nan)}, "pos[1, 3] is (nan, 0.0, 0.0, 1.0): expected finite numbers"),
    "infinite": (ranged(changed(POS[0], (2, 3), -np.inf), RANGES), "pos[2] is (-1.0, 3.0, 0.0, -inf): expected"),
}
INTERPOLATE: dict[str, tuple[dict[str, Any], str]] = {
    "attr dtype": ({"attr": ATTR.int()}, "attr is int32: expected float32 or float64"),
    "attr shape": ({"attr": ATTR[0]}, "attr has shape (3,): expected (vertices, attributes) in range mode or"),
    "attr batch": ({"attr": ATTR.expand(3, 4, 3)}, "attr has a batch of 3: expected 1 or 2, as rast has"),
    "attr batch of one": (
        {"attr": ATTR.expand(3, 4, 3), "rast": RAST[:1], "rast_db": DB[:1]},
        "attr has a batch of 3: expected 1, as rast has",
    ),
    "rast dtype": ({"rast": RAST.double()}, "rast is float64: expected float32, as attr is"),
    "rast shape": ({"rast": RAST[..., :3]}, "rast has shape (2, 3, 5, 3): expected (batch, height, width, 4), u, v"),
    "rast axes": ({"rast": RAST[0]}, "rast has shape (3, 5, 4): expected (batch, height, width, 4)"),
    "tri dtype": ({"tri": TRI.float()}, "tri is float32: expected int32"),
    "tri shape": ({"tri": TRI.T}, "tri has shape (3, 2): expected (triangles, 3)"),
    "db dtype": ({"rast_db": DB.double()}, "rast_db is float64: expected float32, as attr is"),
    "db shape": ({"rast_db": DB[:, :2]}, "rast_db has shape (2, 2, 5, 4): expected (2, 3, 5, 4), as rast has"),
    "name": ({"diff_attrs": "some"}, "diff_attrs is 'some': expected 'all', a list of attribute indices or None"),
    "number": ({"diff_attrs": 1}, "diff_attrs is 1: expected 'all', a list of integers or None"),
    "reals": ({"diff_attrs": [0.5]}, "diff_attrs is [0.5]: expected 'all', a list of integers or None"),
    "attribute": ({"diff_attrs": [0, 3]}, "diff_attrs holds 3: expected indices of attributes from 0 to 2"),
    "negative": ({"diff_attrs": [-1]}, "diff_attrs holds -1: expected indices of attributes from 0 to 2"),
    "index": ({"tri": changed(TRI, (1, 0), 9)}, f"tri[1] is (9, 2, 3): {INDICES}"),
    "id": ({"rast": changed(RAST, (1, 2, 4, 3), 3)}, "rast[1, 2, 4] has triangle_id 3: expected at most 2, the"),
    "negative id": ({"rast": changed(RAST, (0, 0, 1, 3), -1)}, "rast[0, 0, 1] has triangle_id -1: expected 0 where it"),
    "nan id": ({"rast": changed(RAST, (0, 1, 1, 3), np.nan)}, "rast[0, 1, 1] has triangle_id nan: expected 0 where it"),
}
ANTIALIAS: dict[str, tuple[dict[str, Any], str]] = {
    "color dtype": ({"color": COLOR.double()}, "color is float64: expected float32, as pos is"),
    "color axes": ({"color": COLOR[0]}, "color has shape (3, 5, 3): expected (batch, height, width, channels)"),
    "color shape": ({"color": COLOR[:, :2]}, "color has shape (2, 2, 5, 3): expected (batch, height, width) to be"),
    "rast dtype": ({"rast": RAST.double()}, "rast is float64: expected float32, as pos is"),
    "rast shape": ({"rast": RAST[..., :1]}, "rast has shape (2, 3, 5, 1): expected (batch, height, width, 4)"),
    "pos dtype": ({"pos": POS.to(torch.bfloat16)}, "pos is bfloat16: expected float32 or float64"),
    "pos batch": ({"pos": POS[:1]}, "pos has a batch of 1: expected 2, as rast has"),
    "tri dtype": ({"tri": TRI.short()}, "tri is int16: expected int32"),
    "index": ({"tri": changed(TRI, (0, 1), 4)}, f"tri[0] is (0, 4, 2): {INDICES}"),
    "nan": ({"pos": changed(POS, (0, 0, 1), np.nan)}, "pos[0, 0] is (-1.0, nan, 0.0, 1.0): expected finite numbers"),
    "id": ({"rast": changed(RAST, (0, 0, 0, 3), 3)}, "rast[0, 0, 0] has triangle_id 3: expected at most 2, the"),
    "topology": ({"topology_hash": TRI}, "topology_hash is a "),
    "another mesh": ({"topology_hash": "of three triangles"}, "topology_hash is of 3 triangles on cpu: expected the"),
    "boost": ({"pos_gradient_boost": "2"}, "pos_gradient_boost is '2': expected a finite number"),
    "infinite boost": ({"pos_gradient_boost": float("inf")}, "pos_gradient_boost is inf: expected a finite number"),
}
CALLS: dict[Callable[..., Any], dict[str, Any]] = {
    rasterize: {"ctx": None, "pos": POS, "tri": TRI, "resolution": SIZE},
    interpolate: {"attr": ATTR, "rast": RAST, "tri": TRI, "rast_db": DB, "diff_attrs": "all"},
    antialias: {"color": COLOR, "rast": RAST, "pos": POS, "tri": TRI},
}
CASES = [
    pytest.param(call, changes, sentence, id=f"{call.__name__}: {name}")
    for call, cases in ((rasterize, RASTERIZE), (interpolate, INTERPOLATE), (antialias, ANTIALIAS))
    for name, (changes, sentence) in cases.items()
]


@pytest.mark.parametrize("arrays", [False, True], ids=["torch", "numpy"])
@pytest.mark.parametrize(("call", "changes", "sentence"), CASES)
def test_wrong_arguments(call: Callable[..., Any], changes: dict[str, Any], sentence: str, arrays: bool) -> None:
    if arrays and "bfloat16" in sentence:
        pytest.skip("NumPy has no bfloat16")
    arguments = CALLS[call] | changes
    if arrays:
        arguments = {name: a.numpy() if isinstance(a, Tensor) else a for name, a in arguments.items()}
    if isinstance(changes.get("topology_hash"), str):
        three = torch.cat([TRI, TRI[:1]])
        arguments["topology_hash"] = antialias_construct_topology_hash(three.numpy() if arrays else three)
    with pytest.raises(UsageError) as raised:
        call(**arguments)
    assert str(raised.value).startswith(sentence), str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("call", "name"), [(c, n) for c, a in CALLS.items() for n, v in a.items() if isinstance(v, Tensor)]
)
@pytest.mark.parametrize("wrong", [None, [[1.0]], "array"])
def test_other_types(call: Callable[..., Any], name: str, wrong: Any) -> None:
    """Neither a tensor nor an array, or one where the rest are the other."""
    if wrong is None and name == "rast_db":
        return  # optional
    value = CALLS[call][name].numpy() if wrong == "array" else wrong
    with pytest.raises(UsageError, match=r" is an? \w+: expected a (torch tensor|NumPy array)"):
        call(**CALLS[call] | {name: value})


def test_ranges_and_topologies_of_the_other_kind() -> None:
    with pytest.raises(UsageError, match="ranges is a ndarray: expected a torch tensor"):
        rasterize(None, POS[0], TRI, SIZE, RANGES.numpy())
    with pytest.raises(UsageError, match="ranges is a Tensor: expected a NumPy array"):
        rasterize(None, POS[0].numpy(), TRI.numpy(), SIZE, RANGES)
    of_array, of_tensor = antialias_construct_topology_hash(TRI.numpy()), antialias_construct_topology_hash(TRI)
    with pytest.raises(UsageError, match=r"topology_hash is a Topology: expected .* for a torch tensor, or None"):
        antialias(COLOR, RAST, POS, TRI, of_array)
    with pytest.raises(UsageError, match=r"topology_hash is a Topology: expected .* for a NumPy array, or None"):
        antialias(*(t.numpy() for t in (COLOR, RAST, POS, TRI)), of_tensor)


@pytest.mark.parametrize("arrays", [False, True], ids=["torch", "numpy"])
def test_topologies_of_wrong_triangles(arrays: bool) -> None:
    cases = [(TRI.long(), "tri is int64: expected int32"), (TRI[0], "tri has shape (3,): expected (triangles, 3)")]
    cases += [(changed(TRI, (1, 1), -2), "tri[1] is (1, -2, 3): expected vertex indices from 0")]
    for tri, sentence in cases:
        with pytest.raises(UsageError, match=re.escape(sentence)):
            antialias_construct_topology_hash(tri.numpy() if arrays else tri)
    far = changed(TRI, (1, 1), 2**31 - 1)  # numbered anew instead of counted up to
    topology = antialias_construct_topology_hash(far.numpy() if arrays else far)
    assert sorted(np.asarray(topology.next).ravel().tolist()) == list(range(6))


def test_more_triangles_than_can_be_numbered() -> None:
    many = torch.zeros(1, 1, dtype=torch.int32).expand(2**24 + 1, 3)
    with pytest.raises(UsageError, match="tri has 16777217 triangles: expected at most 16777216, what float32 can num"):
        rasterize(None, POS, many, SIZE)


def test_peelers_check_when_they_draw() -> None:
    with pytest.raises(UsageError, match="ctx is a Tensor"):
        DepthPeeler(POS, TRI, SIZE, None)
    with (
        DepthPeeler(RasterizeContext(), POS.half(), TRI, SIZE) as peeler,
        pytest.raises(UsageError, match="pos is float16"),
    ):
        peeler.rasterize_next_layer()


def test_devices() -> None:
    meta = torch.empty_like(TRI, device="meta")
    with pytest.raises(UsageError, match="tri is on meta: expected cpu, where pos is"):
        rasterize(None, POS, meta, SIZE)
    with pytest.raises(UsageError, match="rast is on meta: expected cpu, where attr is"):
        interpolate(ATTR, RAST.to("meta"), TRI)
    with pytest.raises(UsageError, match="color is on meta: expected cpu, where pos is"):
        antialias(COLOR.to("meta"), RAST, POS, TRI)


def sentence_of(call: Callable[..., Any], *arguments: Any) -> str:
    with pytest.raises((UsageError, ValueError)) as raised:
        call(*arguments)
    return str(raised.value)


def test_sentences_of_other_devices_are_the_same() -> None:
    """The checks that torch makes with CUDA, here on the CPU: in the words of the native core's."""
    meshes: list[tuple[Any, ...]] = [
        (POS, changed(TRI, (1, 2), 4), None),
        (None, changed(TRI, (0, 0), -1), None),
        (changed(POS, (1, 3, 0), np.nan), TRI, None),
        (changed(POS[0], (2, 3), -np.inf), TRI, RANGES),
        (POS[0], TRI, changed(RANGES, (1,), [1, 2])),
        (POS[0], TRI, changed(RANGES, (0,), [-1, 2])),
    ]
    for pos, tri, ranges in meshes:
        with_torch = sentence_of(
            lambda p=pos, t=tri, r=ranges: _device.check_with_torch(t, 4, pos=p, ranges=r, rast=RAST)
        )
        assert with_torch == sentence_of(_native.check_mesh, pos, tri, 4, ranges)
    for value in (3.0, -1.0, np.nan, 1e6, 2.5):
        rast = changed(RAST, (1, 0, 2, 3), value)
        with_torch = sentence_of(lambda r=rast: _device.check_with_torch(TRI, 4, rast=r))
        assert with_torch == sentence_of(interpolate, ATTR, rast, TRI)
    _device.check_with_torch(TRI, 4, pos=POS[0], ranges=RANGES, rast=RAST)


@needs_cuda
@pytest.mark.parametrize(("call", "changes", "sentence"), CASES)
def test_wrong_arguments_with_cuda(call: Callable[..., Any], changes: dict[str, Any], sentence: str) -> None:
    if "topology_hash" in changes:
        return  # for which the device makes no difference but in its name
    arguments = CALLS[call] | changes
    arguments = {n: a.cuda() if isinstance(a, Tensor) and n != "ranges" else a for n, a in arguments.items()}
    with pytest.raises(UsageError) as raised:
        call(**arguments)
    wanted = [sentence, *(["float64 on cuda"] if "float64: expected" in sentence else [])]
    assert any(each in str(raised.value) for each in wanted), str(raised.value)


def test_tangents_are_refused() -> None:
    calls: list[tuple[Callable[[Tensor], Any], str, Tensor]] = [
        (lambda pos: rasterize(None, pos, TRI, SIZE), "pos", POS),
        (lambda attr: interpolate(attr, RAST, TRI), "attr", ATTR),
        (lambda rast: interpolate(ATTR, rast, TRI), "rast", RAST),
        (lambda rast_db: interpolate(ATTR, RAST, TRI, rast_db, "all"), "rast_db", DB),
        (lambda color: antialias(color, RAST, POS, TRI), "color", COLOR),
        (lambda pos: antialias(COLOR, RAST, pos, TRI), "pos", POS),
    ]
    for call, name, tensor in calls:
        sentence = f"{name} has a forward-mode tangent: expected none, .*; use torch.autograd.grad or backward"
        with pytest.raises(UsageError, match=sentence):
            torch.func.jvp(call, (tensor,), (tensor,))


def test_the_boost_may_be_a_number_of_numpy() -> None:
    pos = (POS * torch.tensor([0.5, 0.5, 1, 1])).requires_grad_()
    rast = rasterize(None, pos.detach(), TRI, SIZE)[0]
    gradients = [
        torch.autograd.grad(antialias(COLOR, rast, pos, TRI, None, boost).square().sum(), pos)[0]
        for boost in (2.5, np.float32(2.5), np.float64(2.5))
    ]
    assert gradients[0].any()
    assert all(torch.equal(gradient, gradients[0]) for gradient in gradients)
