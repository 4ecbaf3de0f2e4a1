"""Random texture lookups of every kind, for tests of the native core against its plain twin."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

FILTERS = ("nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear", "anisotropic")
BOUNDARIES = ("wrap", "clamp", "mirror", "zero")
PAIRS = tuple((u, v) for u in BOUNDARIES for v in BOUNDARIES)
SIDES = (1, 2, 3, 5, 8, 13)
GRID = 8192  # coordinates at odd multiples of 1 / GRID are never near a texel centre of these sizes, nor at an edge


@dataclass(frozen=True)
class Case:
    """Arguments of a lookup as torch leaves, and the gradient that flows back."""

    tex: Tensor
    uv: Tensor
    uv_da: Tensor | None
    bias: Tensor | None
    custom: tuple[Tensor, ...] | None  # levels 1 and coarser
    constructed: bool  # the stack comes from texture_construct_mip
    filter_mode: str
    boundary_mode: str | tuple[str, str]
    max_mip_level: int | None
    grad: Tensor

    def leaves(self) -> dict[str, Tensor]:
        named = {"tex": self.tex, "uv": self.uv, "uv_da": self.uv_da, "bias": self.bias}
        named |= {f"level {index + 1}": level for index, level in enumerate(self.custom or ())}
        return {name: leaf for name, leaf in named.items() if leaf is not None}

    def copy(self, device: str = "cpu", dtype: torch.dtype | None = None) -> Case:
        def leaf(tensor: Tensor) -> Tensor:
            return tensor.detach().to(device, dtype, copy=True).requires_grad_()

        return replace(
            self,
            tex=leaf(self.tex),
            uv=leaf(self.uv),
            uv_da=None if self.uv_da is None else leaf(self.uv_da),
            bias=None if self.bias is None else leaf(self.bias),
            custom=None if self.custom is None else tuple(leaf(level) for level in self.custom),
            grad=self.grad.to(device, dtype),
        )

    def call(self, door: Any) -> Any:
        """`door` has a texture and a texture_construct_mip: the module under test, or the twin."""
        cube = self.boundary_mode == "cube"
        mip = door.texture_construct_mip(self.tex, cube_mode=cube) if self.constructed else self.custom
        return door.texture(
            self.tex,
            self.uv,
            self.uv_da,
            self.bias,
            mip,
            filter_mode=self.filter_mode,
            boundary_mode=self.boundary_mode,
            max_mip_level=self.max_mip_level,
        )

    def values_and_gradients(self, door: Any, device: str = "cpu") -> dict[str, Tensor]:
        case = self.copy(device)
        out = case.call(door)
        assert out.shape == case.grad.shape
        out.backward(case.grad)
        found = {"out": out.detach(), **{name: leaf.grad for name, leaf in case.leaves().items()}}
        return {name: value.cpu() for name, value in found.items() if value is not None}


def coordinates(shape: tuple[int, ...], spread: float, generator: torch.Generator, dtype: torch.dtype) -> Tensor:
    """(..., 2), normally distributed, at odd multiples of 1 / GRID."""
    values = torch.randn(*shape, 2, generator=generator, dtype=torch.float64) * spread
    return ((2 * (values * GRID / 2).floor() + 1) / GRID).to(dtype)


def vectors(shape: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype) -> Tensor:
    """(..., 3) towards all faces of a cube, of lengths from 1/8 to 8, with (s, t) at odd multiples of 1 / GRID."""
    on_face = torch.randint(-GRID // 4, GRID // 4, (*shape, 3), generator=generator, dtype=torch.float64)
    vector = (2 * on_face + 1) / (GRID / 2)
    axis = torch.randint(0, 3, (*shape, 1), generator=generator)
    sign = 2.0 * torch.randint(0, 2, (*shape, 1), generator=generator) - 1
    length = 2.0 ** torch.randint(-3, 4, (*shape, 1), generator=generator)
    return (vector.scatter(-1, axis, sign.double()) * length).to(dtype)


def derivatives(uv: Tensor, size: int, last: int, generator: torch.Generator) -> Tensor:
    """(..., 4 | 6): footprints from below a texel to beyond the last level, round and oblique."""
    shape, axes = uv.shape[:-1], uv.shape[-1]
    options: dict[str, Any] = {"generator": generator, "dtype": torch.float64}
    length = torch.exp2(torch.rand(*shape, 1, **options) * (last + 3) - 1.5) / size
    thin = torch.exp2(torch.rand(*shape, 1, **options) * -5)
    along = torch.nn.functional.normalize(torch.randn(*shape, axes, **options), dim=-1)
    across = torch.nn.functional.normalize(torch.randn(*shape, axes, **options), dim=-1)
    jacobian = torch.stack([along * length, across * length * thin], -1)
    if axes == 3:
        jacobian = jacobian * uv.double().abs().amax(-1)[..., None, None]
    return jacobian.flatten(-2).to(uv.dtype)


def random_case(seed: int, dtype: torch.dtype, filters: tuple[str, ...] = FILTERS) -> Case:
    """A lookup that the seed decides: its kind, its shapes and its values."""
    draw = random.Random(seed)
    generator = torch.Generator().manual_seed(seed)
    options: dict[str, Any] = {"generator": generator, "dtype": dtype}
    filter_mode = draw.choice(filters)
    cube = filter_mode != "anisotropic" and draw.random() < 0.25
    batch = draw.choice([1, 3])
    items = [1, batch]
    channels = draw.choice([1, 2, 3, 4, 5, 8, 11, 17])
    h, w = draw.choice([(1, 1), (7, 1), (5, 8), (3, 25)])
    faces = (6,) if cube else ()

    def level(items: int) -> Tensor:
        height = draw.choice(SIDES)
        return torch.rand(items, *faces, height, height if cube else draw.choice(SIDES), channels, **options)

    tex = level(draw.choice(items))
    kind = draw.choice(["internal", "constructed", "custom"])
    custom = None
    if kind == "custom" and ("mipmap" in filter_mode or filter_mode == "anisotropic"):
        custom = tuple(level(tex.shape[0]) for _ in range(draw.randint(1, 4)))
    max_mip_level = draw.choice([None, None, 0, 2, 99])
    if custom is not None and max_mip_level is not None:
        max_mip_level = max(max_mip_level, len(custom))  # else a level has no gradient to compare
    uv_items = draw.choice(items)
    uv = (
        vectors((uv_items, h, w), generator, dtype)
        if cube
        else coordinates((uv_items, h, w), draw.choice([0.3, 1.0, 30.0]), generator, dtype)
    )
    has_uv_da = filter_mode == "anisotropic" or draw.random() < 0.5
    has_bias = not has_uv_da or draw.random() < 0.5
    last = max(tex.shape[-3:-1]).bit_length()
    uv_da = bias = None
    if "mipmap" in filter_mode or filter_mode == "anisotropic":
        if has_uv_da:
            uv_da = derivatives(uv, max(tex.shape[-3:-1]), last, generator)
            uv_da = uv_da[: draw.choice([1, uv_items])]
        if has_bias:
            shape = draw.choice(items), draw.choice([1, h]), draw.choice([1, w])
            bias = torch.rand(shape, **options) * (2 if has_uv_da else last + 2) - 1
    found = [t.shape[0] for t in (tex, uv, uv_da, bias) if t is not None]
    grad = torch.randn(max(found), h, w, channels, **options)
    boundary = "cube" if cube else draw.choice(PAIRS)
    return Case(tex, uv, uv_da, bias, custom, kind == "constructed", filter_mode, boundary, max_mip_level, grad).copy()
