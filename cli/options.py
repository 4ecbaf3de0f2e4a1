"""How commands get their options: of the fields of dataclasses, and what all commands share."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Container
from dataclasses import dataclass, is_dataclass
from typing import Annotated, Any, Optional, get_type_hints

import typer

from mipbake.base.allocator import keep_freed_memory
from mipbake.base.errors import UsageError
from mipbake.base.memory import default, limited, parsed
from mipbake.base.options import one_of, option, options_of
from mipbake.cli.commands import SHOWS_ALL
from mipbake.cli.session import Session
from mipbake.source.options import READING, ROLES, WRAP_MODES, LoadOptions

COMMAND = "Command"
"""Group of the options that say how a command works, whatever it does."""

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


@dataclass(frozen=True)
class _Reading:
    """How the command line says what `LoadOptions` says in Python."""

    maps: list[str] | None = option(
        None,
        "Say what a map is: roughness=wear.png, or a number, as in metallic=1.\n\nRepeat for more roles. SOURCE is a "
        "file of the folder (FILE, or FILE:G for one channel), a number from 0 to 1, or none. In a folder of several "
        f"sets it is '*_FILE', where * stands for the name of a set. Roles: {', '.join(ROLES)}.",
        name="map",
        metavar="ROLE=SOURCE",
        otherwise="by file name",
    )
    wrap_u: str = option(WRAP_MODES[0], "Addressing along u.", metavar=one_of(WRAP_MODES), group=READING)
    wrap_v: str = option(WRAP_MODES[0], "Addressing along v.", metavar=one_of(WRAP_MODES), group=READING)


@dataclass(frozen=True)
class _Command:
    """How a command works, whatever it does."""

    memory: str | None = option(
        None,
        "Memory that is held to, such as 4G or 800M. What does not fit lies in temporary files, in the folder that the "
        "environment variable TMPDIR names.",
        metavar="SIZE",
        otherwise="a quarter of what the machine has",
        group=COMMAND,
    )
    verbose: bool = option(False, "Print what was found and chosen, decibels and times as well.", short="v")
    quiet: bool = option(False, "Print errors only.", short="q", group=COMMAND)
    json: bool = option(False, "Print one JSON object, and nothing else, on stdout.", group=COMMAND)


def _show_all(context: typer.Context, wanted: bool) -> None:
    if wanted:
        context.meta[SHOWS_ALL] = True
        typer.echo(context.get_help())
        raise typer.Exit


def _common(
    context: typer.Context,
    help_all: Annotated[
        bool,
        typer.Option("--help-all", callback=_show_all, is_eager=True, help="Show all options, with all they take."),
    ] = False,
) -> Session:
    del help_all
    session: Session = context.obj
    sources = {name: context.get_parameter_source(name) for name in context.params}
    session.given = frozenset(name for name, each in sources.items() if each and each.name == "COMMANDLINE")
    return session


def _loaded(maps: list[str] | None = None, wrap_u: str = "wrap", wrap_v: str = "wrap", **others: Any) -> LoadOptions:
    """The library's options from the command line's; UsageError for what cannot be."""
    return LoadOptions(maps=dict(_role_and_source(text) for text in maps or []), wrap=(wrap_u, wrap_v), **others)


def reads_sets(
    command: Callable[..., None], without: Container[str] = frozenset({"alpha_cutoff"})
) -> Callable[..., None]:
    """Makes a command of a function whose arguments are options, or stand for several.

    An argument whose type is a dataclass stands for its options (`mipbake.base.options`); `load` for how a set is read;
    `session` for what is printed. A function with an argument `memory` gets the bytes that it is held to.

    Args:
        without: options for reading that change nothing that the command does. They keep their defaults.
    """
    takes = _parameters(command)
    parts: dict[str, tuple[_Parameters, Callable[..., Any]]] = {
        name: (parameters_of(p.annotation), p.annotation)
        for name, p in takes.items()
        if name not in ("load", "session") and isinstance(p.annotation, type) and is_dataclass(p.annotation)
    }
    parts["load"] = (parameters_of(_Reading, without) | parameters_of(LoadOptions, without), _loaded)
    parts["flags of all"] = (parameters_of(_Command), _Command)
    parts["session"] = (_parameters(_common), _common)
    own = [p for name, p in takes.items() if name not in parts and name != "memory"]

    @functools.wraps(command)
    def run(**given: Any) -> None:
        for name, value in given.items():
            if isinstance(value, int) and abs(value) > _MOST:
                raise UsageError(f"--{name.replace('_', '-')} is {value}: expected a whole number of at most 18 digits")
        made = {name: make(**{key: given.pop(key) for key in of}) for name, (of, make) in reversed(parts.items())}
        flags: _Command = made.pop("flags of all")
        made["session"].configure(flags.quiet, flags.json, flags.verbose)
        most = default() if flags.memory is None else parsed(flags.memory)
        if "memory" in takes:
            made["memory"] = most
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
