"""The commands of the command line. Each is loaded when it is asked for: help on all of them loads none."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

import typer
import typer.core
import typer.main

JSON = typer.Option("--json", help="Print one JSON object, and nothing else, on stdout.")
"""The option of commands that have few others."""

SHOWS_ALL = "help-all"
"""Key of what a context knows where help shows all options."""

SUMMARIES: Mapping[str, str] = {
    "bake": "Bake texture sets into MIP stacks.",
    "preview": "See a texture set in the browser, baked and not, beside the truth.",
    "gui": "Open a page to drop materials on, which bakes them and shows them beside the truth.",
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

EXAMPLES: Mapping[str, Sequence[str]] = {
    "bake": (
        "mipbake bake textures/wood -o baked",
        "mipbake bake textures/wood -o baked --preset unreal",
        "mipbake bake library -o baked --recursive --jobs 4",
    ),
}
"""Command to what is typed, for its help."""

_LONG = 16
"""Letters of a placeholder above which the first help has the name of the option in its place, where the other help
says more."""


def loaded(name: str) -> Callable[..., None]:
    """The function of a command, from the module of the same name."""
    function: Callable[..., None] = getattr(import_module(f"mipbake.cli.{name}"), name)
    return function


class Command(typer.core.TyperCommand):
    """A command with two helps: one of the options that most people need, with the first paragraph of each text, and
    one of everything, in groups, by --help-all."""

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Writes what the command does, and examples."""
        whole, self.help = self.help, _text(ctx, self.help)
        super().format_help_text(ctx, formatter)
        self.help = whole
        if examples := EXAMPLES.get(self.name or ""):
            with formatter.section("Examples"):
                formatter.write("".join(f"{'':{formatter.current_indent}}{each}\n" for each in examples))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Writes the options into the help text."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        each: Any
        for each in self.get_params(ctx):
            group = "Arguments" if each.param_type_name == "argument" else getattr(each, "rich_help_panel", None)
            if group in (None, "Arguments") or SHOWS_ALL in ctx.meta:
                short = _text(ctx, each.help)
                if "\n\n" in (each.help or "") and SHOWS_ALL not in ctx.meta and len(each.metavar or "") > _LONG:
                    each.metavar = each.name.upper()
                each.help = short
                flags, text = each.get_help_record(ctx) or ("", "")
                if flags:  # typer puts words for a default into brackets of two kinds
                    record = flags, re.sub(r"\[default: \((.*)\)\]$", r"[default: \1]", text)
                    groups.setdefault(group or "Options", []).append(record)
        for group, records in groups.items():
            if records:
                with formatter.section(group):
                    formatter.write_dl(records, col_max=26)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Writes the exit codes, where all is wanted."""
        if SHOWS_ALL in ctx.meta:
            super().format_epilog(ctx, formatter)


def _text(ctx: Any, text: str | None) -> str:
    """What help says of something: its first paragraph, or all of them."""
    first, *others = (text or "").split("\n\n")
    return " ".join([first, *others]) if SHOWS_ALL in ctx.meta else first


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
