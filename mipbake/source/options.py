"""The choices that loading a texture set leaves to the user; every interface shares these defaults."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeAlias, TypeVar

from mipbake.base.errors import UsageError
from mipbake.base.names import known_name, unknown
from mipbake.base.options import one_of, option

_Options = TypeVar("_Options", bound=Any)

MapChoice: TypeAlias = "str | os.PathLike[str] | float | None"

SHADING_ROLES = ("base_color", "normal", "roughness", "metallic", "anisotropy")
"""Roles that enter the shading model and are filtered together, at one common size."""

PLAIN_ROLES = ("occlusion", "height", "emissive", "opacity")
"""Roles that do not shade: kept at their own size and with their own values."""

ROLES = SHADING_ROLES + PLAIN_ROLES
CARRIED = "carried_"
"""Names of maps that have no role begin so: channels beside others in a packed file, kept for the way out."""

SPECULAR = "specular"
"""Specular colours, F0, which are converted with the diffuse ones to base colour and metallic when they are read."""

SCALAR_ROLES = ("roughness", "metallic", "occlusion", "height", "opacity")
COLOUR_ROLES = ("base_color", "emissive")

FACTORED_ROLES = ("roughness", "metallic", "normal", "anisotropy", "occlusion", "opacity")
"""Roles whose values a factor can scale."""

NORMAL_CONVENTIONS = ("opengl", "directx")
STRAIGHT, PREMULTIPLIED = "straight", "premultiplied"
ALPHAS = (STRAIGHT, PREMULTIPLIED)
CUSTOM = "custom"
"""What a file may say, but no user: alpha is something else than opacity."""

ORIGINS = ("option", "document")
WRAP_MODES = ("wrap", "clamp")

READING = "How sets are read"
"""Group of the options that most people need not know."""


@dataclass(frozen=True)
class LoadOptions:
    """How a texture set is read. Whatever is set here overrides what file names and pixels suggest.

    Args:
        maps: role to what fills it. `"FILE"` takes that file (relative to the folder, else to the working directory);
            `"FILE:G"` or `"FILE:RGB"` takes those channels of it, as they stand; a number is a constant in linear units
            (roughness, metallic and the maps that do not shade; a grey base colour); None leaves the role empty,
            whatever lies in the folder: a normal map left out is flat. `mipbake.load` and `load_all` also take
            `"*_FILE"`, where * stands for the name of a set in a folder of several. Roles: base_color, normal,
            roughness, metallic, anisotropy, occlusion, height, emissive, opacity; and specular, of sets in diffuse and
            specular colours.
        colour_space, normal_convention, roughness_is_gloss, alpha, alpha_cutoff: see their help.
        wrap: addressing along u and v, each "wrap" or "clamp".
        name: of the set, safe as a folder name. None: the name of the folder.
        factors: role to a number that its values are multiplied with after decoding: roughness, metallic, opacity,
            occlusion, anisotropy (its strength). The factor of normal scales x and y before the vectors are made unit.
        metadata: whether what files say of their orientation, alpha and colours counts. In glTF it does not.
        origin: who says all this, "option" or "document": a glTF or MaterialX file, where the user chose nothing.
    """

    maps: Mapping[str, MapChoice] = field(default_factory=dict)
    colour_space: str | None = option(
        None,
        "RGB colour space of base colour and emissive, by its name in colour-science (sRGB, ACEScg, 'ITU-R BT.2020'), "
        "with 'linear ' before it for its linear values.",
        group=READING,
        metavar="NAME",
        otherwise="by file name, else sRGB for files of 8 or 16 bits and linear Rec.709 for float files",
    )
    normal_convention: str | None = option(
        None,
        "Whether green points up (opengl) or down (directx).",
        metavar=one_of(NORMAL_CONVENTIONS),
        otherwise="by name, else by the pixels",
    )
    roughness_is_gloss: bool | None = option(
        None,
        "Whether the roughness map is inverted.",
        name="gloss",
        group=READING,
        otherwise="by file name",
        negative=True,
    )
    wrap: tuple[str, str] = ("wrap", "wrap")
    name: str | None = None
    factors: Mapping[str, float] = field(default_factory=dict)
    alpha: str | None = option(
        None,
        "Whether colours beside an alpha are stored as they are, or multiplied by it.",
        group=READING,
        metavar=one_of(ALPHAS),
        otherwise="as the file says",
    )
    alpha_cutoff: float | None = option(
        None,
        "Opacity from which the renderer draws a texel. Every level then keeps the coverage of level 0.",
        group=READING,
        metavar="0..1",
        otherwise="opacity is blended",
    )
    metadata: bool = True
    origin: str = "option"

    def __post_init__(self) -> None:
        """UsageError when a value is not in the list."""
        for role, choice in self.maps.items():
            _check_choice(role, choice)
        for name, allowed in (("normal_convention", NORMAL_CONVENTIONS), ("alpha", ALPHAS)):
            if (given := getattr(self, name)) is not None:
                object.__setattr__(self, name, known_name(name.replace("_", " "), given, allowed))
        _check_member("origin", self.origin, ORIGINS)
        if not isinstance(self.wrap, tuple) or len(self.wrap) != 2:
            raise UsageError(f"wrap is {self.wrap!r}: expected two modes, one for u and one for v")
        for mode in self.wrap:
            _check_member("wrap", mode, WRAP_MODES)
        for role, factor in self.factors.items():
            if role not in FACTORED_ROLES:
                raise UsageError(f"{role} takes no factor: expected one of {', '.join(FACTORED_ROLES)}")
            if not (math.isfinite(factor) and factor >= 0):
                raise UsageError(f"the factor of {role} is {factor}: expected 0 or more")
        if self.alpha_cutoff is not None and not 0 < self.alpha_cutoff <= 1:
            raise UsageError(f"alpha_cutoff is {self.alpha_cutoff}: expected a number above 0, up to 1")


def with_overrides(options: _Options, overrides: Mapping[str, Any]) -> _Options:
    """Options, a dataclass, with single fields replaced; UsageError for a field that there is not."""
    known = [f.name for f in fields(options)]
    for name in overrides:
        if name not in known:
            raise UsageError(unknown("option", name, known))
    return replace(options, **overrides)


def _check_member(option: str, value: object, allowed: tuple[object, ...]) -> None:
    if value not in allowed:
        raise UsageError(f"{option} is {value!r}: expected one of {', '.join(str(a) for a in allowed)}")


def _check_choice(role: str, choice: MapChoice) -> None:
    if role not in (*ROLES, SPECULAR):
        raise UsageError(unknown("map", role, (*ROLES, SPECULAR)))
    if isinstance(choice, bool) or not (choice is None or isinstance(choice, (str, os.PathLike, float, int))):
        raise UsageError(f"map {role} is {choice!r}: expected a file, a number or None")
    if isinstance(choice, (float, int)):
        if role not in (*SCALAR_ROLES, "base_color"):
            raise UsageError(f"map {role} cannot be the number {choice}: expected a file, or none to leave it out")
        if not math.isfinite(choice):
            expected = "a finite number" if role == "height" else "a number from 0 to 1"
            raise UsageError(f"map {role} is {choice}: expected {expected} or a file")
        if role != "height" and not 0 <= choice <= 1:
            raise UsageError(f"map {role} is {choice}: expected a number from 0 to 1")
    if role == "roughness" and choice is None:
        raise UsageError("map roughness cannot be left out: expected a file, or a number from 0 to 1 for a constant")
