"""Checks of the arguments of shading that its NumPy doors, torch op and twins share: shapes and names only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

from mipbake.base.errors import UsageError

Shape = tuple[int, ...]

TurnedAway = Literal["clamp", "black"]
"""What is shaded where the shading normal turns away from the viewer. `clamp`: masking holds n.v to 1e-4 and nothing
else knows of it, as real-time engines do. `black`: nothing, as pbrt does."""


def is_black(turned_away: str) -> bool:
    """Whether the rule is `black`; UsageError, with the list of rules, where it is no rule."""
    if turned_away not in get_args(TurnedAway):
        raise UsageError(f"turned_away is {turned_away!r}: expected one of {', '.join(get_args(TurnedAway))}")
    return turned_away == "black"


def batch_shape(channels: int, material: Shape, light: Shape, view: Shape) -> tuple[int | None, int, int]:
    """The batch size B, or None where no argument has a batch axis; K and N. UsageError where the shapes do not fit.

    `channels` is what the material model stores.
    """
    if len(material) not in (2, 3) or material[-1] != channels:
        raise UsageError(
            f"material has shape {_text(material)}: expected (N, {channels}) or (B, N, {channels}), "
            f"the model's {channels} stored channels"
        )
    for name, shape in (("light", light), ("view", view)):
        if len(shape) not in (2, 3, 4) or shape[-1] != 3:
            raise UsageError(f"{name} has shape {_text(shape)}: expected (K, 3), (B, K, 3) or (B, K, N, 3)")
        if len(shape) == 4 and shape[2] not in (1, material[-2]):
            raise UsageError(
                f"{name} has shape {_text(shape)} where the material has {material[-2]} texels: "
                f"expected directions for {material[-2]} texels, or for 1 to repeat"
            )
    if pair_count(view) != pair_count(light):
        raise UsageError(
            f"view has shape {_text(view)} where light has {_text(light)}: expected the same K, one view for each light"
        )
    given = {
        name: shape[0] for name, shape in (("material", material), ("light", light), ("view", view)) if len(shape) > 2
    }
    return _batch_size(given), pair_count(light), material[-2]


LIT_AXES = {"material": 2, "frame": 3, "view": 2, "light": 2, "radiance": 2}
"""Arguments of `shade_lit`, and axes of each without one for surfaces."""


def lit_batch(channels: int, *shapes: Shape) -> int | None:
    """The number of surfaces B of the arguments of `shade_lit`, or None where none has an axis for surfaces.

    UsageError where the shapes do not fit. `channels` is what the material model stores; `shapes` are in the order of
    LIT_AXES.
    """
    given = {
        name: shape[0] for (name, axes), shape in zip(LIT_AXES.items(), shapes, strict=True) if len(shape) == axes + 1
    }
    _check_lit(channels, *(shape[1:] if name in given else shape for name, shape in zip(LIT_AXES, shapes, strict=True)))
    return _batch_size(given)


def _batch_size(given: Mapping[str, int]) -> int | None:
    """The one batch size of the arguments that have one, or None; UsageError where there are several."""
    sizes = {size for size in given.values() if size != 1}
    if len(sizes) > 1:
        listed = ", ".join(f"{name} has {size}" for name, size in given.items())
        raise UsageError(f"batch sizes do not fit: {listed}; expected each to be 1 or the same number")
    return (sizes.pop() if sizes else 1) if given else None


def _check_lit(channels: int, material: Shape, frame: Shape, view: Shape, light: Shape, radiance: Shape) -> None:
    if len(material) != 2 or material[1] != channels:
        raise UsageError(
            f"material has shape {_text(material)}: expected (N, {channels}), the model's {channels} stored channels"
        )
    points = material[0]
    for name, shape, expected in (("frame", frame, (points, 3, 3)), ("view", view, (points, 3))):
        if shape != expected:
            raise UsageError(
                f"{name} has shape {_text(shape)} where the material has {points} points: expected {expected}"
            )
    if len(light) != 2 or light[1] != 3:
        raise UsageError(f"light has shape {_text(light)}: expected (K, 3)")
    if radiance != light:
        raise UsageError(
            f"radiance has shape {_text(radiance)} where light has {_text(light)}: expected one for each light"
        )


def pair_count(directions: Shape) -> int:
    """K of (K, 3), (B, K, 3) or (B, K, N, 3)."""
    return directions[1] if len(directions) == 4 else directions[-2]


def per_texel(light: Shape, view: Shape) -> bool:
    """Whether texels have directions of their own."""
    return any(len(shape) == 4 and shape[2] != 1 for shape in (light, view))


def _text(shape: Shape) -> str:
    return str(tuple(shape))
