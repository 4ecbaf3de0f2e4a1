"""Options that several commands share. Defaults, choices and ranges are the library's own."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Optional

import typer

from mipbake import UsageError
from mipbake.io.options import NORMAL_CONVENTIONS, NORMAL_LENGTHS, ROLES, WRAP_MODES, LoadOptions

DEFAULTS = LoadOptions()


def one_of(names: Iterable[str]) -> str:
    """Names as a placeholder for help texts: a|b|c. The library checks what is passed and lists them again."""
    return "|".join(names)


# typer evaluates annotations when a command is called, and needs Optional to do so on Python 3.10.
Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="A texture set.", show_default=False)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, and nothing else there.")]

Maps = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--map",
        metavar="ROLE=SOURCE",
        help="Fill a role yourself; repeat for more. SOURCE is a file of the folder (FILE, or FILE:G for one channel), "
        f"a number from 0 to 1, or none. Roles: {', '.join(ROLES)}.",
        show_default="by file name",
    ),
]
ColourSpace = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        metavar="NAME",
        help="Colour space of base colour and emissive: a name of colour-science, with 'linear ' before it for its "
        "linear values.",
        show_default="sRGB in 8 and 16 bit files, linear Rec.709 in float files",
    ),
]
Convention = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        "--normal-convention",
        metavar=one_of(NORMAL_CONVENTIONS),
        help="Whether green points up (opengl) or down (directx).",
        show_default="by file name, else by the curl of the normals",
    ),
]
Length = Annotated[
    str,
    typer.Option(
        "--normal-length",
        metavar=one_of(NORMAL_LENGTHS),
        help="What becomes of normals shorter than one: renormalised, or also turned into roughness.",
    ),
]
Gloss = Annotated[
    Optional[bool],  # noqa: UP045
    typer.Option("--gloss/--no-gloss", help="Whether the roughness map is inverted.", show_default="by file name"),
]
WrapU = Annotated[str, typer.Option(metavar=one_of(WRAP_MODES), help="Addressing along u.")]
WrapV = Annotated[str, typer.Option(metavar=one_of(WRAP_MODES), help="Addressing along v.")]


def load_options(
    maps: list[str] | None,
    colour_space: str | None,
    convention: str | None,
    length: str,
    gloss: bool | None,
    wrap_u: str,
    wrap_v: str,
) -> LoadOptions:
    """The library's options from the command line's; UsageError for what cannot be."""
    return LoadOptions(
        maps=dict(_role_and_source(text) for text in maps or []),
        colour_space=colour_space,
        normal_convention=convention,
        normal_length=length,
        roughness_is_gloss=gloss,
        wrap=(wrap_u, wrap_v),
    )


def _role_and_source(text: str) -> tuple[str, str | float | None]:
    role, separator, source = text.partition("=")
    if not (separator and source):
        raise UsageError(f"--map is {text!r}: expected ROLE=SOURCE, for example roughness=wear.png or metallic=1")
    if source.lower() == "none":
        return role, None
    try:
        return role, float(source)
    except ValueError:
        return role, source


def parse_lods(text: str) -> tuple[float, ...]:
    """Numbers separated by commas; UsageError for anything else."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--lods is {text!r}: expected numbers separated by commas, for example 0,1,3") from None


def spoken_lods(lods: Iterable[float]) -> str:
    """Inverse of parse_lods."""
    return ",".join(f"{lod:g}" for lod in lods)
