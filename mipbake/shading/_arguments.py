"""Checks of the arguments of shading, and of its plain twins: shapes and names."""

from __future__ import annotations

from typing import Literal, get_args

from mipbake.base.arguments import batch_size, check_shape
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
    check_shape("material", material, [("N", channels), ("B", "N", channels)], "the stored channels of the model")
    directions = ("K", 3), ("B", "K", 3), ("B", "K", 1, 3), ("B", "K", material[-2], 3)
    for name, shape in (("light", light), ("view", view)):
        check_shape(name, shape, directions, f"for the material's {material[-2]} texels")
    if pair_count(view) != pair_count(light):
        raise UsageError(
            f"view has shape {tuple(view)} where light has {tuple(light)}: expected the same K, one view for each light"
        )
    named = {"material": material, "light": light, "view": view}
    given = {name: shape[0] for name, shape in named.items() if len(shape) > 2}
    return batch_size(given) if given else None, pair_count(light), material[-2]


LIT_AXES = {"material": 2, "frame": 3, "view": 2, "light": 2, "radiance": 2}
"""Arguments of `shade_lit`, and axes of each without one for surfaces."""


def lit_batch(channels: int, *shapes: Shape) -> int | None:
    """The number of surfaces B of the arguments of `shade_lit`, or None where none has an axis for surfaces.

    UsageError where the shapes do not fit. `channels` is what the material model stores; `shapes` are in the order of
    LIT_AXES.
    """
    named = dict(zip(LIT_AXES, shapes, strict=True))
    points, lights = (named[name][-2:-1] or (0,) for name in ("material", "light"))
    expected: dict[str, tuple[int | str, ...]] = {
        "material": ("N", channels),
        "frame": (*points, 3, 3),
        "view": (*points, 3),
        "light": ("K", 3),
        "radiance": (*lights, 3),
    }
    for name, shape in named.items():
        check_shape(name, shape, [expected[name], ("B", *expected[name])], "of N points and K lights")
    given = {name: shape[0] for name, shape in named.items() if len(shape) > LIT_AXES[name]}
    return batch_size(given) if given else None


def pair_count(directions: Shape) -> int:
    """K of (K, 3), (B, K, 3) or (B, K, N, 3)."""
    return directions[1] if len(directions) == 4 else directions[-2]


def per_texel(light: Shape, view: Shape) -> bool:
    """Whether texels have directions of their own."""
    return any(len(shape) == 4 and shape[2] != 1 for shape in (light, view))
