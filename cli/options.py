"""Options that several commands share. Defaults, choices and ranges are the library's own."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Container, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Optional, TypeAlias, get_type_hints

import typer

from mipbake.base.allocator import keep_freed_memory
from mipbake.base.device import PROCESSOR
from mipbake.base.errors import UsageError
from mipbake.base.memory import default, limited, parsed, told
from mipbake.cli.session import Session
from mipbake.material.aim import MOST_BIAS
from mipbake.material.pixel_filter import FILTERS
from mipbake.source.options import ALPHAS, NORMAL_CONVENTIONS, NORMAL_LENGTHS, ROLES, WRAP_MODES, LoadOptions

DEFAULTS = LoadOptions()

_LEAST_ADDRESS_SPACE = 1 << 30
"""Bytes of address space that a command needs which reads sets. Measured on x86-64 Linux with two threads: a search on
a small set ended well with 0.8 GB, and with 0.54 GB it crashed or hung."""


_MOST = 10**18
"""Whole numbers beyond fit nowhere, and mean nothing to any option."""


def one_of(names: Iterable[str]) -> str:
    """Names as a placeholder for help texts: a|b|c. The library checks what is passed and lists them again."""
    return "|".join(names)


def lod_bias(show_default: str) -> Any:
    """The option for the MIP bias of a sampler."""
    return typer.Option(
        metavar=f"-{MOST_BIAS:g}..{MOST_BIAS:g}",
        help="MIP bias of the sampler, added to the level of detail: engines that accumulate frames or upscale have a "
        "negative one.",
        show_default=show_default,
    )


# typer evaluates annotations when a command is called, and needs Optional to do so on Python 3.10.
OptionalPath: TypeAlias = Optional[Path]  # noqa: UP045
"""The type of options for a path that may be left out."""


def _reading(
    maps: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            "--map",
            metavar="ROLE=SOURCE",
            help="Fill a role yourself; repeat for more roles. SOURCE is a file of the folder (FILE, or FILE:G for one "
            "channel), a number from 0 to 1, or none. In a folder of several sets it is '*_FILE', where * stands for "
            f"the name of a set. Roles: {', '.join(ROLES)}.",
            show_default="by file name",
        ),
    ] = None,
    colour_space: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="NAME",
            help="Colour space of base colour and emissive: a name of colour-science, with 'linear ' before it for its "
            "linear values.",
            show_default="by file name, else sRGB for files of 8 or 16 bits and linear Rec.709 for float files",
        ),
    ] = DEFAULTS.colour_space,
    normal_convention: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=one_of(NORMAL_CONVENTIONS),
            help="Whether green points up (opengl) or down (directx).",
            show_default="by file name, else by the curl of the normals",
        ),
    ] = DEFAULTS.normal_convention,
    normal_length: Annotated[
        str,
        typer.Option(
            metavar=one_of(NORMAL_LENGTHS),
            help="What happens to normals shorter than one: they are renormalised, or also turned into roughness.",
        ),
    ] = DEFAULTS.normal_length,
    gloss: Annotated[
        Optional[bool],  # noqa: UP045
        typer.Option("--gloss/--no-gloss", help="Whether the roughness map is inverted.", show_default="by file name"),
    ] = DEFAULTS.roughness_is_gloss,
    alpha: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=one_of(ALPHAS),
            help="Whether colours beside an alpha are stored as they are, or multiplied by it.",
            show_default="as the file says",
        ),
    ] = DEFAULTS.alpha,
    wrap_u: Annotated[str, typer.Option(metavar=one_of(WRAP_MODES), help="Addressing along u.")] = DEFAULTS.wrap[0],
    wrap_v: Annotated[str, typer.Option(metavar=one_of(WRAP_MODES), help="Addressing along v.")] = DEFAULTS.wrap[1],
) -> LoadOptions:
    """The library's options from the command line's; UsageError for what cannot be."""
    return LoadOptions(
        maps=dict(_role_and_source(text) for text in maps or []),
        colour_space=colour_space,
        normal_convention=normal_convention,
        normal_length=normal_length,
        roughness_is_gloss=gloss,
        alpha=alpha,
        wrap=(wrap_u, wrap_v),
    )


def _talking(
    context: typer.Context,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, and nothing else, on stdout.")] = False,
) -> Session:
    session: Session = context.obj
    session.configure(quiet, json)
    session.given = frozenset(name for name in context.params if _is_given(context, name))
    return session


def _is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _memory(
    memory: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="SIZE",
            help="Memory that is held to, such as 4G or 800M. What does not fit lies in temporary files, in the folder "
            "that the environment variable TMPDIR names.",
            show_default="a quarter of what the machine has",
        ),
    ] = None,
) -> int | None:
    return default() if memory is None else parsed(memory)


def _check_address_space() -> None:
    """UsageError where the system limits the addresses of the process to too few.

    Without this, a process may end or hang before anything tells why: a thread that finds no addresses as it starts is
    waited for without end, and a stack that cannot grow ends the process.
    """
    try:
        import resource
    except ImportError:  # Windows limits no address space
        return
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most != resource.RLIM_INFINITY and most < _LEAST_ADDRESS_SPACE:
        raise UsageError(
            f"there is not enough memory: the system limits the address space of the process to {told(most)}, and "
            f"{told(_LEAST_ADDRESS_SPACE)} or more are needed: raise the limit (`ulimit -v` of the shell)"
        )


def reads_sets(
    command: Callable[..., None],
    without: Container[str] = (),
    more: Mapping[str, Callable[..., Any]] = MappingProxyType({}),
) -> Callable[..., None]:
    """Makes a command of a function whose `session` and `load` stand for the options that all commands share.

    They come after the function's own options: first how a set is read, then the memory that the command is held to,
    then what is printed. The options that a command is `without` change nothing that it does, and keep their defaults.
    A function with an argument `memory` is told the bytes that it is held to.

    Args:
        more: arguments that stand for options of the command's own, which come before all shared ones: argument to
            what makes it of the options.
    """
    shared: dict[str, Callable[..., Any]] = {**more, "load": _reading, "memory": _memory, "session": _talking}
    takes = _parameters(command)
    own = [p for name, p in takes.items() if name not in shared]
    others = {name: {key: p for key, p in _parameters(of).items() if key not in without} for name, of in shared.items()}

    @functools.wraps(command)
    def run(**given: Any) -> None:
        for name, value in given.items():
            if isinstance(value, int) and abs(value) > _MOST:
                raise UsageError(f"--{name.replace('_', '-')} is {value}: expected a whole number of at most 18 digits")
        parts = {name: shared[name](**{key: given.pop(key) for key in others[name]}) for name in reversed(shared)}
        most = parts["memory"] if "memory" in takes else parts.pop("memory")
        _check_address_space()
        keep_freed_memory(most)
        with limited(most):
            command(**given, **parts)

    parameters = [*own, *(p for part in others.values() for p in part.values())]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    return run


def _parameters(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Parameters by name, with their annotations evaluated, as typer reads them."""
    hints = get_type_hints(function, include_extras=True)
    return {
        name: p.replace(annotation=hints[name], kind=inspect.Parameter.KEYWORD_ONLY)
        for name, p in inspect.signature(function).parameters.items()
    }


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


def stacks_folder() -> Any:
    """The option --out of commands that write stacks."""
    return typer.Option(
        "--out", "-o", metavar="OUT", help="Folder for the stacks, each in OUT/<set>/.", show_default=False
    )


def pixel_filter(meaning: str) -> Any:
    """The option --filter.

    Args:
        meaning: whose filter it is, as a sentence.
    """
    return typer.Option("--filter", metavar=one_of(FILTERS), help=meaning)


def formats(meaning: str, otherwise: str) -> Any:
    """The option --format of commands that write stacks.

    Args:
        meaning: which formats there are, as a sentence.
        otherwise: what is written where it is left out.
    """
    return typer.Option("--format", metavar="FORMAT[:TEXELS],...", help=meaning, show_default=otherwise)


def device(users: str) -> Any:
    """The option --device of commands that bake with networks.

    Args:
        users: what it is for, as in a sentence.
    """
    return typer.Option(
        "--device",
        metavar="cpu|cuda|cuda:N",
        help=f"Where networks run, for {users}: on the processor, or on a graphics card that torch reaches with CUDA, "
        "which needs the extra `train`. What searches does so on the processor. Levels differ by rounding. mipbake's "
        "tests have never run this on a graphics card.",
        show_default=PROCESSOR,
    )


def parse_lods(text: str) -> tuple[float, ...]:
    """Numbers separated by commas; UsageError for anything else."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--lods is {text!r}: expected numbers separated by commas, for example 0,1,3") from None


def spoken_lods(lods: Iterable[float]) -> str:
    """Inverse of parse_lods."""
    return ",".join(f"{lod:g}" for lod in lods)
