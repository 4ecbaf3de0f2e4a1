"""What the doors to the native core refuse, of arrays and tensors in the same words: one sentence that names the
argument, what it is and what was expected."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from mipbake import _native, stochastic
from mipbake.base.errors import UsageError
from mipbake.base.stream import current_stream
from mipbake.raster import (
    DepthPeeler,
    RasterizeContext,
    _device,
    antialias,
    antialias_construct_topology_hash,
    interpolate,
    rasterize,
)
from mipbake.sampling import texture, texture_construct_mip
from mipbake.shading import shade, shade_lit
from mipbake.stochastic import Channels, Contributions, Moments

from .raster_scenes import needs_cuda

Of = Callable[[Any], Any]
Case = Callable[[Of], Any]
"""A call whose arrays `Of` makes of NumPy's."""


def made(of: Of, value: Any) -> Any:
    if isinstance(value, list):
        return [made(of, each) for each in value]
    return of(value) if isinstance(value, np.ndarray) else value


def calls(function: Callable[..., Any], **usual: Any) -> Callable[..., Case]:
    """Cases of a function that differ from what is usual."""
    return lambda **changes: lambda of: function(**{name: made(of, value) for name, value in (usual | changes).items()})


def changed(array: Any, at: Any, value: Any) -> Any:
    copy = array.copy()
    copy[at] = value
    return copy


KINDS: dict[str, Of] = {"numpy": np.copy, "torch": lambda array: torch.from_numpy(np.copy(array))}

# ---- raster ----

POS = np.float32([[-1, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1], [0, 0, 0, 1]])[None].repeat(2, 0)
TRI, SIZE = np.int32([[0, 1, 2], [1, 2, 3]]), (3, 5)
RAST, DB = rasterize(None, POS, TRI, SIZE)
ATTR, COLOR, RANGES = np.ones((4, 3), np.float32), np.ones((2, *SIZE, 3), np.float32), np.int32([[0, 2], [1, 1]])
INDICES = "expected vertex indices from 0 to 3"

drawn = calls(rasterize, ctx=None, pos=POS, tri=TRI, resolution=SIZE)
interpolated = calls(interpolate, attr=ATTR, rast=RAST, tri=TRI, rast_db=DB, diff_attrs="all")
blended = calls(antialias, color=COLOR, rast=RAST, pos=POS, tri=TRI)
other_mesh = np.concatenate([TRI, TRI[:1]])

RASTER: dict[str, Case] = {
    "ctx is a str: expected a RasterizeContext or None": drawn(ctx="cpu"),
    "pos has shape (2, 4, 3): expected (vertices, 4) or (batch, vertices, 4)": drawn(pos=POS[..., :3]),
    "pos is float16: expected float32 or float64": drawn(pos=POS.astype(np.float16)),
    "tri is int64: expected int32": drawn(tri=TRI.astype(np.int64)),
    "tri has shape (3,): expected (triangles, 3)": drawn(tri=TRI[0]),
    "resolution is (4, 5, 6): expected (height, width)": drawn(resolution=(4, 5, 6)),
    "resolution is (0, 5): expected (height, width), two integers from 1": drawn(resolution=(0, 5)),
    "resolution is (4.0, 5): expected (height, width), two integers": drawn(resolution=(4.0, 5)),
    "resolution is (4, 32769): expected (height, width), two integers from 1": drawn(resolution=(4, 32769)),
    "pos has shape (4, 4) and ranges is missing: expected ranges (batch, 2)": drawn(pos=POS[0]),
    "ranges is int64: expected int32": drawn(pos=POS[0], ranges=RANGES.astype(np.int64)),
    "ranges has shape (2,): expected (batch, 2), a start and a count": drawn(pos=POS[0], ranges=RANGES[0]),
    "ranges[1] is (1, 2): expected a start and": drawn(pos=POS[0], ranges=changed(RANGES, 1, [1, 2])),
    "ranges[0] is (-1, 2): expected a start and": drawn(pos=POS[0], ranges=changed(RANGES, 0, [-1, 2])),
    f"tri[1] is (1, 2, 4): {INDICES}": drawn(tri=changed(TRI, (1, 2), 4)),
    f"tri[0] is (-1, 1, 2): {INDICES}": drawn(tri=changed(TRI, (0, 0), -1)),
    "tri[0] is (0, 1, 2): expected no triangles": drawn(pos=POS[:, :0]),
    "pos[1, 3] is (nan, 0.0, 0.0, 1.0): expected finite numbers": drawn(pos=changed(POS, (1, 3, 0), np.nan)),
    "attr has shape (3,): expected (vertices, attributes) or (batch,": interpolated(attr=ATTR[0]),
    "attr has a batch of 3: expected 1 or 2, as rast has": interpolated(attr=ATTR[None].repeat(3, 0)),
    "attr has a batch of 3: expected 1, as": interpolated(attr=ATTR[None].repeat(3, 0), rast=RAST[:1], rast_db=DB[:1]),
    "rast is float64: expected float32, as attr is": interpolated(rast=RAST.astype(np.float64)),
    "rast has shape (2, 3, 5, 3): expected (batch, height, width, 4), u, v": interpolated(rast=RAST[..., :3]),
    "rast_db has shape (2, 2, 5, 4): expected (2, 3, 5, 4), as rast has": interpolated(rast_db=DB[:, :2]),
    "diff_attrs is 'some': expected 'all', a list of integers or None": interpolated(diff_attrs="some"),
    "diff_attrs is 1: expected 'all', a list of integers or None": interpolated(diff_attrs=1),
    "diff_attrs is [0.5]: expected 'all', a list of integers or None": interpolated(diff_attrs=[0.5]),
    "diff_attrs holds 3: expected indices of attributes from 0 to 2": interpolated(diff_attrs=[0, 3]),
    "rast[1, 2, 4] has triangle_id 3: expected at most 2": interpolated(rast=changed(RAST, (1, 2, 4, 3), 3)),
    "rast[0, 0, 1] has triangle_id -1: expected 0 where": interpolated(rast=changed(RAST, (0, 0, 1, 3), -1)),
    "rast[0, 1, 1] has triangle_id nan: expected 0 where": interpolated(rast=changed(RAST, (0, 1, 1, 3), np.nan)),
    "color is float64: expected float32, as pos is": blended(color=COLOR.astype(np.float64)),
    "color has shape (3, 5, 3): expected (batch, height, width, channels)": blended(color=COLOR[0]),
    "color has shape (2, 2, 5, 3): expected (batch, height, width) to be": blended(color=COLOR[:, :2]),
    "pos has a batch of 1: expected 2, as rast has": blended(pos=POS[:1]),
    "topology_hash is a str: expected what antialias_construct_topology_hash(tri)": blended(topology_hash="of tri"),
    "topology_hash has shape (3, 3): expected (2, 3), of": lambda of: blended(
        topology_hash=antialias_construct_topology_hash(of(other_mesh))
    )(of),
    "pos_gradient_boost is '2': expected a finite number": blended(pos_gradient_boost="2"),
    "pos_gradient_boost is inf: expected a finite number": blended(pos_gradient_boost=math.inf),
    "tri[1] is (1, -2, 3): expected vertex indices from 0": lambda of: antialias_construct_topology_hash(
        of(changed(TRI, (1, 1), -2))
    ),
}

# ---- sampling ----

TEX, UV, BIAS = np.ones((1, 4, 4, 3), np.float32), np.zeros((1, 2, 5, 2)), np.zeros((1, 2, 5))
DA, CUBE, DIRECTIONS = np.zeros((1, 2, 5, 4)), np.ones((1, 6, 4, 4, 3), np.float32), np.ones((1, 2, 5, 3))
looked_up, stacked = calls(texture, tex=TEX, uv=UV), calls(texture_construct_mip, tex=TEX)

SAMPLING: dict[str, Case] = {
    "tex is uint8: expected float32, float64": looked_up(tex=TEX.astype(np.uint8)),
    "tex has shape (4, 4, 3): expected (B, H, W, C), H, W and C from 1 on": looked_up(tex=TEX[0]),
    "tex has shape (1, 0, 4, 3): expected (B, H, W, C), H, W and C from 1 on": looked_up(tex=TEX[:, :0]),
    "tex has shape (1, 6, 4, 4, 3): expected (B, H, W, C), H, W and C from 1 on; for a cube": looked_up(tex=CUBE),
    "tex has shape (1, 5, 4, 4, 3): expected (B, 6, S, S, C)": looked_up(tex=CUBE[:, :5], boundary_mode="cube"),
    "tex has shape (1, 6, 3, 4, 3): expected (B, 6, S, S, C)": looked_up(tex=CUBE[:, :, :3], boundary_mode="cube"),
    "uv has shape (1, 2, 5, 3): expected (B, h, w, 2)": looked_up(uv=DIRECTIONS),
    "uv has shape (1, 2, 5, 2): expected (B, h, w, 3)": looked_up(tex=CUBE, boundary_mode="cube"),
    "uv is complex128: expected real numbers": looked_up(uv=UV.astype(complex)),
    "uv_da is bool: expected real numbers": looked_up(uv_da=DA.astype(bool)),
    "uv_da has shape (1, 1, 5, 4): expected (B, 2, 5, 4), the lookups of uv": looked_up(uv_da=DA[:, :1]),
    "mip_level_bias has shape (2, 5): expected (B, 2, 5), the lookups": looked_up(mip_level_bias=BIAS[0]),
    "mip_level_bias has shape (1, 2, 4): expected (B, 2, 5)": looked_up(mip_level_bias=BIAS[:, :, :4]),
    "batch sizes do not fit: tex has 2, uv has 3; expected": looked_up(tex=TEX.repeat(2, 0), uv=UV.repeat(3, 0)),
    "filter_mode is 'cubic': expected 'auto', 'nearest',": looked_up(filter_mode="cubic"),
    "filter_mode is ['linear']: expected 'auto'": looked_up(filter_mode=["linear"]),
    "filter_mode is 'linear-mipmap-linear': expected uv_da or": looked_up(filter_mode="linear-mipmap-linear"),
    "filter_mode is 'anisotropic' and uv_da is missing": looked_up(filter_mode="anisotropic", mip_level_bias=BIAS),
    "filter_mode is 'anisotropic' and boundary_mode is 'cube': expected another filter": looked_up(
        tex=CUBE, uv=DIRECTIONS, uv_da=np.zeros((1, 2, 5, 6)), boundary_mode="cube", filter_mode="anisotropic"
    ),
    "boundary_mode is 'repeat': expected 'wrap', 'clamp', 'mirror', 'zero' or": looked_up(boundary_mode="repeat"),
    "boundary_mode is ('wrap', 'cube'): expected": looked_up(boundary_mode=("wrap", "cube")),
    "boundary_mode is 7: expected": looked_up(boundary_mode=7),
    "max_mip_level is -1: expected None or a whole number from 0": looked_up(max_mip_level=-1),
    "max_mip_level is True: expected None": looked_up(max_mip_level=True),
    "mip is a str: expected what texture_construct_mip returns, or": looked_up(mip_level_bias=BIAS, mip="all"),
    "mip[0] is float64: expected float32, as tex is": looked_up(mip_level_bias=BIAS, mip=[TEX.astype(np.float64)]),
    "mip[0] has shape (4, 4, 3): expected (B, H, W, C)": looked_up(mip_level_bias=BIAS, mip=[TEX[0]]),
    "mip[1] has shape (1, 4, 4, 2) where tex": looked_up(mip_level_bias=BIAS, mip=[TEX, TEX[..., :2]]),
    "mip has 32 levels: expected at most 31": looked_up(mip_level_bias=BIAS, mip=[TEX] * 32),
    "mip was made for a texture of shape (1, 2, 4, 3): expected": lambda of: looked_up(
        mip_level_bias=BIAS, mip=texture_construct_mip(of(TEX[:, :2]))
    )(of),
    "tex has shape (1, 6, 4, 4, 3): expected (B, H, W, C), H, W and C from 1 on; for a cube map set cube_mode": stacked(
        tex=CUBE
    ),
    "max_mip_level is -2: expected None or a whole number from 0": stacked(max_mip_level=-2),
}

# ---- shading ----

MATERIAL, LIGHT = np.zeros((4, 11), np.float32), np.zeros((5, 3), np.float32)
shaded = calls(shade, model="ggx", material=MATERIAL, light=LIGHT, view=LIGHT)

SHADING: dict[str, Case] = {
    "unknown material model 'phong': expected one of gltf": shaded(model="phong"),
    "turned_away is 'white': expected one of clamp, black": shaded(turned_away="white"),
    "material has shape (4, 8): expected (N, 11) or (B, N, 11)": shaded(material=MATERIAL[:, :8]),
    "material is float16: expected float32 or float64": shaded(material=MATERIAL.astype(np.float16)),
    "light is complex64: expected real numbers": shaded(light=LIGHT.astype(np.complex64)),
    "light has shape (5, 2): expected (K, 3)": shaded(light=LIGHT[:, :2]),
    "light has shape (1, 5, 3, 3): expected": shaded(light=np.zeros((1, 5, 3, 3))),
    "view has shape (4, 3) where light has (5, 3): expected the same K": shaded(view=LIGHT[1:]),
    "batch sizes do not fit: material has 3, view has 2": shaded(
        material=np.zeros((3, 4, 11), np.float32), view=np.zeros((2, 5, 3))
    ),
}

lit = calls(
    shade_lit,
    model="ggx",
    material=MATERIAL,
    frame=np.zeros((4, 3, 3)),
    view=np.zeros((4, 3)),
    light=LIGHT,
    radiance=LIGHT,
)
ARRAYS: dict[str, Case] = {
    "material has shape (4, 8): expected (N, 11)": lit(material=MATERIAL[:, :8]),
    "frame has shape (3, 3): expected (4, 3, 3)": lit(frame=np.zeros((3, 3))),
    "view has shape (5, 3): expected (4, 3)": lit(view=np.zeros((5, 3))),
    "light has shape (5, 2): expected (K, 3)": lit(light=LIGHT[:, :2]),
    "radiance has shape (6, 3): expected (5, 3)": lit(radiance=np.zeros((6, 3))),
    "radiance holds a value that is not finite in float32": lit(radiance=np.full((5, 3), 1e39)),
    "batch sizes do not fit: material has 2, light has 3": lit(
        material=np.stack([MATERIAL] * 2), light=np.stack([LIGHT] * 3), radiance=np.stack([LIGHT] * 3)
    ),
    "material is >f4: expected float32 or float64": shaded(material=MATERIAL.astype(">f4")),
    "light is <U1: expected real numbers": shaded(light=[["a", "b", "c"]]),
    "light is not an array of numbers (": shaded(light=[[1.0], [1.0, 2.0]]),
    "uv is a Tensor: expected a NumPy array, as tex is": looked_up(uv=torch.zeros(1, 2, 5, 2)),
}
"""What only arrays can be."""

# ---- stochastic ----

CH = Channels((0.1,), (0.0,), (1.0,))
FOUR = Channels((0.1, 0.0, 0.02, 0.3), (0.0, -1.0, -0.5, 0.0), (1.0, 1.0, 2.0, 0.75))
V = np.zeros((4, 1), np.float32)
D, PLACES, LOD, IMAGE = (np.zeros(shape, np.float32) for shape in (3, (3, 2), 3, (3, 2)))
perturbed = calls(stochastic.perturb, values=V, channels=CH, step=0)
compared = calls(stochastic.pixel_differences, plus=IMAGE, minus=IMAGE, reference=IMAGE)
touched = calls(stochastic.touched_texels, sizes=[(4, 4), (2, 2)], uv=PLACES, lod=LOD)
vertices = calls(stochastic.touched_vertices, ids=np.int32([[1]]), triangles=TRI[:1])


def added(gradient: Any = V, differences: Any = D, **changes: Any) -> Case:
    def call(of: Of) -> None:
        made_of = stochastic.contributions(of(np.int32([[0], [1], [3]])))
        starts = made_of.starts[: changes.get("starts")]
        made_of = Contributions(made_of.elements, starts, made_of.pixels)
        stochastic.add_gradient(of(gradient), of(differences), made_of, changes.get("channels", CH), 0)

    return call


def descended(values: Any = V, gradient: Any = V, moments: Any = V, **changes: Any) -> Case:
    arguments = {"channels": CH, **changes}
    return lambda of: stochastic.descend(
        of(values), of(gradient), Moments.of(of(moments)), **{n: made(of, v) for n, v in arguments.items()}
    )


STOCHASTIC: dict[str, Case] = {
    "channels have 0 magnitudes, 0 lower and 0 upper limits: expected 1 to 64": lambda _: Channels((), (), ()),
    "channels have 1 magnitudes, 2 lower and": lambda _: Channels((1.0,), (0.0, 0.0), (9.0,)),
    "magnitude holds inf: expected numbers, and": lambda _: Channels((math.inf,), (0.0,), (9.0,)),
    "low holds nan: expected numbers": lambda _: Channels((0.1,), (math.nan,), (9.0,)),
    "a lower limit of channels lies above the upper one": lambda _: Channels((0.1,), (2.0,), (1.0,)),
    "limits of a channel lie closer together than 2 magnitudes": lambda _: Channels((0.6,), (0.0,), (1.0,)),
    "lifted is 0: expected the first of three": lambda _: Channels((0.1,) * 3, (0.0,) * 3, (1.0,) * 3, 0),
    "values has shape (4, 1): expected (N, 4)": perturbed(channels=FOUR),
    "a step or a seed is -1: expected 0 to 2^32 - 1": perturbed(step=-1),
    "elements is int64: expected int32": perturbed(elements=np.int64([0])),
    "elements reach from 4 to 4: expected 0 to 3": perturbed(elements=np.int32([4])),
    "elements reach from -1 to 2": perturbed(elements=np.int32([2, -1])),
    "out[1] is float64: expected float32": perturbed(out=[V, V.astype(np.float64)]),
    "plus has shape (3,): expected (P, C)": compared(plus=D),
    "weights has shape (2,): expected (3,)": compared(weights=D[:2]),
    "touched is float64: expected int32": lambda of: stochastic.contributions(of(np.zeros((2, 2)))),
    "gradient has shape (4, 1): expected (N, 4)": added(channels=FOUR),
    "differences is float64: expected float32, as gradient is": added(differences=D.astype(np.float64)),
    "made_of.starts has shape (3,): expected (4,)": added(starts=-1),
    "differences has 2 pixels, and made_of names pixel 2": added(differences=D[:2]),
    "gradient has 3 elements, and made_of names element 3": added(gradient=V[:3]),
    "gradient is float64: expected float32, as values is": descended(gradient=V.astype(np.float64)),
    "moments.first has shape (2, 1): expected (4, 1)": descended(moments=V[:2]),
    "elements reach from 7 to 7: expected 0 to 3": descended(elements=np.int32([7])),
    "rate is nan: expected a finite number, 0 or more": descended(rate=math.nan),
    "texels is 'linear': expected nearest": touched(texels="linear"),
    "boundary is ('wrap', 'cube'): expected two of wrap": touched(boundary=("wrap", "cube")),
    "lod and uv_da are both given, or both missing": touched(lod=None),
    "uv_da is missing: expected it for anisotropic": touched(texels="anisotropic"),
    "seen is float32: expected uint8": touched(seen=LOD),
    "sizes has 33 levels: expected 1 to 32": touched(sizes=[(1, 1)] * 33),
    "sizes holds (0, 2): expected heights and widths of 1": touched(sizes=[(4, 4), (0, 2)]),
    "ids reach from 2 to 2: expected 0 for none, up to 1": vertices(ids=np.int32([[2]])),
    "ids holds numbers that are not whole: expected 0": vertices(ids=np.float32([[0.5]])),
    "ids is uint8: expected int32, int64, float32 or float64": vertices(ids=np.uint8([[1]])),
}

CASES = {**RASTER, **SAMPLING, **SHADING, **STOCHASTIC}


def sentence_of(call: Callable[..., Any], *arguments: Any) -> str:
    with pytest.raises((UsageError, ValueError)) as raised:
        call(*arguments)
    return str(raised.value)


@pytest.mark.parametrize("sentence", CASES)
@pytest.mark.parametrize("kind", KINDS)
def test_what_does_not_fit_is_named(kind: str, sentence: str) -> None:
    with pytest.raises(UsageError, match="^" + re.escape(sentence)) as raised:
        CASES[sentence](KINDS[kind])
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("sentence", ARRAYS)
def test_what_does_not_fit_of_arrays_is_named(sentence: str) -> None:
    with pytest.raises(UsageError, match="^" + re.escape(sentence)):
        ARRAYS[sentence](np.copy)


@needs_cuda
@pytest.mark.parametrize("sentence", CASES)
def test_what_does_not_fit_with_cuda_is_named(sentence: str) -> None:
    said = sentence_of(CASES[sentence], lambda array: KINDS["torch"](array).cuda())
    assert said.startswith(sentence) or re.search(r"float64 on cuda|ranges is on cuda", said), said


DOORS: dict[str, tuple[Callable[..., Case], dict[str, Any]]] = {
    "rasterize": (drawn, {"pos": POS, "tri": TRI}),
    "interpolate": (interpolated, {"attr": ATTR, "rast": RAST, "tri": TRI}),
    "antialias": (blended, {"color": COLOR, "rast": RAST, "pos": POS, "tri": TRI}),
    "texture": (looked_up, {"tex": TEX}),
    "shade": (shaded, {"material": MATERIAL}),
    "perturb": (perturbed, {"values": V}),
}


@pytest.mark.parametrize("door", DOORS)
def test_arguments_of_another_kind_or_device(door: str) -> None:
    """Neither a tensor nor an array; one where the rest are the other; sparse; on another device."""
    call, arrays = DOORS[door]
    for name, array in arrays.items():
        wrongs = [
            ([1.0], f"{name} is a list: expected a"),
            (torch.from_numpy(array).to_sparse(), f"{name} is torch.sp"),
        ]
        if len(arrays) > 1:
            wrongs += [(array, " is an? .*: expected a (torch tensor|NumPy array), as")]
            wrongs += [(torch.from_numpy(array).to("meta"), " is on .*: expected .*, where .* is")]
        for wrong, sentence in wrongs:
            tensors = {n: torch.from_numpy(a) for n, a in arrays.items() if wrong is not a} | {name: wrong}
            with pytest.raises(UsageError, match=sentence):
                call(**tensors)(lambda each, own=wrong: each if each is own else torch.from_numpy(each))


def test_what_is_changed_in_place_can_be_written_to() -> None:
    frozen, strided = V.copy(), np.zeros((4, 2), np.float32)[:, :1]
    frozen.flags.writeable = False
    for wrong in (frozen, strided, torch.from_numpy(np.zeros((4, 2), np.float32))[:, :1]):
        with pytest.raises(UsageError, match=r"^values is not contiguous, or cannot be written to"):
            stochastic.descend(wrong, V, Moments.of(V), CH)


@pytest.mark.parametrize(
    ("call", "name", "tensor"),
    [
        (lambda pos: rasterize(None, pos, torch.from_numpy(TRI), SIZE), "pos", POS),
        (lambda rast: interpolate(torch.from_numpy(ATTR), rast, torch.from_numpy(TRI)), "rast", RAST),
        (lambda color: antialias(color, *map(torch.from_numpy, (RAST, POS, TRI))), "color", COLOR),
        (lambda tex: texture(tex, torch.zeros(1, 2, 3, 2)), "tex", TEX),
        (lambda mip: texture(torch.from_numpy(TEX), torch.zeros(1, 2, 3, 2), None, BIAS_3, [mip]), "mip[0]", TEX),
        (lambda light: shade("ggx", torch.from_numpy(MATERIAL), light, torch.from_numpy(LIGHT)), "light", LIGHT),
    ],
)
def test_tangents_are_refused(call: Callable[[Tensor], Any], name: str, tensor: Any) -> None:
    sentence = f"{re.escape(name)} has a forward-mode tangent: expected none, .*; use torch.autograd.grad or backward"
    with pytest.raises(UsageError, match=sentence):
        torch.func.jvp(call, (torch.from_numpy(tensor),), (torch.from_numpy(tensor),))


BIAS_3 = torch.zeros(1, 2, 3)


def test_more_triangles_than_can_be_numbered() -> None:
    many = torch.zeros(1, 1, dtype=torch.int32).expand(2**31 // 3 + 1, 3)
    with pytest.raises(UsageError, match="tri has 715827883 triangles: expected at most 715827882; split the mesh"):
        rasterize(None, torch.from_numpy(POS), many, SIZE)


def test_peelers_check_when_they_draw() -> None:
    with pytest.raises(UsageError, match="ctx is a ndarray"):
        DepthPeeler(POS, TRI, SIZE, None)
    with DepthPeeler(RasterizeContext(), POS.astype(np.float16), TRI, SIZE) as peeler:
        assert sentence_of(peeler.rasterize_next_layer).startswith("pos is float16")


def test_sentences_of_other_devices_are_the_same() -> None:
    """The checks that torch makes with CUDA, here on the CPU: in the words of the native core's."""
    pos, tri, rast, ranges = (torch.from_numpy(each) for each in (POS, TRI, RAST, RANGES))
    meshes: list[tuple[Any, ...]] = [
        (POS, changed(TRI, (1, 2), 4), None),
        (None, changed(TRI, (0, 0), -1), None),
        (changed(POS[0], (2, 3), -np.inf), TRI, RANGES),
        (POS[0], TRI, changed(RANGES, 1, [1, 2])),
        (POS[0], TRI, changed(RANGES, 0, [-1, 2])),
    ]
    for mesh in meshes:
        p, t, r = (None if each is None else torch.from_numpy(each) for each in mesh)
        assert sentence_of(_device.check_with_torch, t, 4, p, r, rast) == sentence_of(_native.check_mesh, p, t, 4, r)
    for value in (3.0, -1.0, np.nan, 2.5):
        wrong = torch.from_numpy(changed(RAST, (1, 0, 2, 3), value))
        said = sentence_of(interpolate, torch.from_numpy(ATTR), wrong, tri)
        assert sentence_of(_device.check_with_torch, tri, 4, None, None, wrong) == said
    _device.check_with_torch(tri, 4, pos[0], ranges, rast)


@pytest.mark.skipif(_native.cuda_compiled(), reason="this build has CUDA kernels")
def test_a_build_without_cuda_says_so() -> None:
    class OnCuda:
        """Stands for a tensor on a GPU, which a machine without one cannot make."""

        device = torch.device("cuda", 0)

    with pytest.raises(UsageError, match=r"tex is on cuda:0: .* has no CUDA kernels"), current_stream(OnCuda(), "tex"):
        pass


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_of_numpy_are_numbers(kind: str) -> None:
    of = KINDS[kind]
    for level in (np.int64(1), np.uint8(1)):
        whole, plain = (texture(of(TEX), of(UV), None, of(BIAS), max_mip_level=n) for n in (level, 1))
        assert (whole == plain).all()
    boosts = (blended(pos_gradient_boost=boost)(of) for boost in (2.5, np.float32(2.5)))
    assert (next(boosts) == next(boosts)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_vertices_far_apart_are_numbered_anew(kind: str) -> None:
    far = KINDS[kind](changed(TRI, (1, 1), 2**31 - 1))
    following = np.asarray(antialias_construct_topology_hash(far).next)
    assert sorted(following.ravel().tolist()) == list(range(6))
    assert (following == np.asarray(antialias_construct_topology_hash(KINDS[kind](changed(TRI, (1, 1), 4))).next)).all()


def test_nothing_is_no_error() -> None:
    none = np.zeros((0, 4), np.float32)
    plus, minus = stochastic.perturb(none, FOUR, 0)
    assert plus.shape == minus.shape == (0, 4)
    stochastic.descend(none, none.copy(), Moments.of(none), FOUR)
    assert stochastic.pixel_differences(none, none, none).shape == (0,)
    stochastic.add_gradient(V.copy(), D, stochastic.contributions(np.zeros((3, 0), np.int32)), CH, 0)


def test_signs_that_torch_has_left_to_the_reader_are_read() -> None:
    values, elements = torch.rand(4, 1), torch.tensor([2, 0], dtype=torch.int32)
    wanted = stochastic.perturb(values, CH, 0, elements=elements)
    # The imaginary part of a conjugate is such a view: torch keeps its sign as a flag.
    flagged = torch.complex(torch.zeros(4, 1), -values).conj().imag
    assert flagged.is_neg()
    found = stochastic.perturb(flagged, CH, 0, elements=elements)
    assert all(torch.equal(a, b) for a, b in zip(found, wanted, strict=True))
