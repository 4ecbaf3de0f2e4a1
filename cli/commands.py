"""The commands of the command line. Each is loaded when it is asked for: help on all of them loads none."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

import typer
import typer.core
import typer.main

SHOWS_ALL = "help-all"
"""Key of what a context knows where help shows all options."""

SUMMARIES: Mapping[str, str] = {
    "bake": "Bake texture sets into MIP stacks.",
    "compare": "Compare methods on texture sets, and write a report for the browser.",
    "fit": "Fit stacks in a renderer of your own, which need not be differentiable.",
    "validate": "Measure stacks against their sources: SNR in dB, higher is better.",
    "convert": "Convert texture sets, or materials that were converted before, to another material model.",
    "inspect": "Show what is found in texture sets and why.",
    "info": "Show what is in a texture file, or in every file of a stack.",
    "presets": "Show what each preset of `mipbake bake --preset` chooses.",
    "init": "Write a project file, mipbake.toml, for a library of texture sets.",
}
"""Commands in the order of the help text, each with the first sentence of its docstring, which can be shown without
loading the command."""


def loaded(name: str) -> Callable[..., None]:
    """The function of a command, from the module of the same name."""
    function: Callable[..., None] = getattr(import_module(f"mipbake.cli.{name}"), name)
    return function


class Command(typer.core.TyperCommand):
    """A command whose help shows the options that most people need, and all of them in groups by --help-all."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Writes the options into the help text."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for each in self.get_params(ctx):
            record = each.get_help_record(ctx)
            group = "Arguments" if each.param_type_name == "argument" else getattr(each, "rich_help_panel", None)
            if record is not None and (group in (None, "Arguments") or SHOWS_ALL in ctx.meta):
                groups.setdefault(group or "Options", []).append(record)
        for group, records in groups.items():
            if records:
                with formatter.section(group):
                    formatter.write_dl(records)


class Commands(typer.core.TyperGroup):
    """The group of all commands."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Names of all commands."""
        return list(SUMMARIES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002
        """A command, loaded; None where there is none of that name."""
        if cmd_name not in SUMMARIES:
            return None
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        alone.command(cmd_name, cls=Command, epilog=self.epilog)(loaded(cmd_name))
        return typer.main.get_command(alone)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """Writes the list of commands into the help text."""
        with formatter.section("Commands"):
            formatter.write_dl(list(SUMMARIES.items()))
