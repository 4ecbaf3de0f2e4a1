"""How commands get their options: of the fields of dataclasses, and what all commands share."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Container
from dataclasses import is_dataclass
from typing import Annotated, Any, Optional, get_type_hints

import typer

from mipbake.base.allocator import keep_freed_memory
from mipbake.base.errors import UsageError
from mipbake.base.memory import default, limited, parsed, told
from mipbake.base.options import one_of, options_of
from mipbake.cli.commands import SHOWS_ALL
from mipbake.cli.session import Session
from mipbake.source.options import READING, ROLES, WRAP_MODES, LoadOptions

COMMAND = "Command"
"""Group of the options that say how a command works, whatever it does."""

_LEAST_ADDRESS_SPACE = 1 << 30
"""Bytes of address space that a command needs which reads sets. Measured on x86-64 Linux with two threads: a search on
a small set ended well with 0.8 GB, and with 0.54 GB it crashed or hung."""


_MOST = 10**18
"""Whole numbers beyond fit nowhere, and mean nothing to any option."""


_Parameters = dict[str, inspect.Parameter]


def parameters_of(cls: type, without: Container[str] = ()) -> _Parameters:
    """The options of a dataclass as parameters of a command, by field."""
    made = {}
    for name, each in options_of(cls).items():
        if name in without:
            continue
        flag = f"--{each.name}/--no-{each.name}" if each.negative else f"--{each.name}"
        about = typer.Option(
            *(flag, *([f"-{each.short}"] if each.short else [])),
            metavar=each.metavar or None,
            help=each.help,
            show_default=each.otherwise or True,
            rich_help_panel=each.group or None,
        )
        # typer evaluates annotations when a command is called, and needs Optional to do so on Python 3.10.
        kind = Optional[each.kind] if each.default is None else each.kind  # noqa: UP045
        made[name] = _parameter(name, Annotated[kind, about], each.default)
    return made


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _loading(
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
    wrap_u: Annotated[
        str, typer.Option(metavar=one_of(WRAP_MODES), help="Addressing along u.", rich_help_panel=READING)
    ] = WRAP_MODES[0],
    wrap_v: Annotated[
        str, typer.Option(metavar=one_of(WRAP_MODES), help="Addressing along v.", rich_help_panel=READING)
    ] = WRAP_MODES[0],
    **others: Any,
) -> LoadOptions:
    """The library's options from the command line's; UsageError for what cannot be."""
    return LoadOptions(maps=dict(_role_and_source(text) for text in maps or []), wrap=(wrap_u, wrap_v), **others)


def _show_all(context: typer.Context, wanted: bool) -> None:
    if wanted:
        context.meta[SHOWS_ALL] = True
        typer.echo(context.get_help())
        raise typer.Exit


def _talking(
    context: typer.Context,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.", rich_help_panel=COMMAND)] = False,
    json: Annotated[
        bool,
        typer.Option("--json", help="Print one JSON object, and nothing else, on stdout.", rich_help_panel=COMMAND),
    ] = False,
    help_all: Annotated[
        bool, typer.Option("--help-all", callback=_show_all, is_eager=True, help="Show all options and exit.")
    ] = False,
) -> Session:
    del help_all
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
            rich_help_panel=COMMAND,
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
    command: Callable[..., None], without: Container[str] = frozenset({"alpha_cutoff"})
) -> Callable[..., None]:
    """Makes a command of a function whose arguments are options, or stand for several.

    An argument whose type is a dataclass stands for its options (`mipbake.base.options`); `load` for how a set is read;
    `session` for what is printed. A function with an argument `memory` is told the bytes that it is held to.

    Args:
        without: options for reading that change nothing that the command does. They keep their defaults.
    """
    load = {name: p for name, p in _parameters(_loading).items() if name != "others"} | parameters_of(LoadOptions)
    always: dict[str, tuple[_Parameters, Callable[..., Any]]] = {
        "load": ({name: p for name, p in load.items() if name not in without}, _loading),
        "memory": (_parameters(_memory), _memory),
        "session": (_parameters(_talking), _talking),
    }
    takes = _parameters(command)
    several: dict[str, tuple[_Parameters, Callable[..., Any]]] = {
        name: (parameters_of(p.annotation), p.annotation)
        for name, p in takes.items()
        if name not in always and isinstance(p.annotation, type) and is_dataclass(p.annotation)
    }
    parts = several | always
    own = [p for name, p in takes.items() if name not in parts]

    @functools.wraps(command)
    def run(**given: Any) -> None:
        for name, value in given.items():
            if isinstance(value, int) and abs(value) > _MOST:
                raise UsageError(f"--{name.replace('_', '-')} is {value}: expected a whole number of at most 18 digits")
        made = {name: make(**{key: given.pop(key) for key in of}) for name, (of, make) in reversed(parts.items())}
        most = made["memory"] if "memory" in takes else made.pop("memory")
        _check_address_space()
        keep_freed_memory(most)
        with limited(most):
            command(**given, **made)

    parameters = [*own, *(p for of, _ in parts.values() for p in of.values())]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    return run


def _parameters(function: Callable[..., Any]) -> _Parameters:
    """Parameters by name, with their annotations evaluated, as typer reads them."""
    hints = get_type_hints(function, include_extras=True)
    return {
        name: _parameter(name, hints[name], p.default) for name, p in inspect.signature(function).parameters.items()
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
