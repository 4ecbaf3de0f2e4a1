"""Options: fields of dataclasses that say all that there is to say of an option, once.

    method: str = option("auto", "How levels are made.", metavar="auto|neural")

Commands make their options of such fields, and the project file its keys.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import Field, dataclass, field, fields, replace
from functools import cache
from types import NoneType
from typing import Any, get_args, get_type_hints


@dataclass(frozen=True)
class Option:
    """What is said of an option.

    Args:
        help: what it means, in sentences.
        name: without dashes before it; "": the name of its field, with hyphens. short: one letter, or "".
        group: under which help lists it; "": among those that most people need.
        metavar: what its value looks like; "" for its type.
        otherwise: what holds where it is left out, in words, where the default does not say it.
        negative: whether there is a flag that says no.
        kind: of what is given, from the field: its type; text where that is one of several, as of a sampler.
        default: the default of the field.
    """

    help: str
    name: str = ""
    short: str = ""
    group: str = ""
    metavar: str = ""
    otherwise: str = ""
    negative: bool = False
    kind: type = str
    default: Any = None


_KEY = "option"


def option(default: Any, help: str, **about: Any) -> Any:
    """A field of a dataclass that is an option. `about`: the other arguments of `Option`."""
    return field(default=default, metadata={_KEY: Option(help, **about)})


def same(cls: type, name: str, **changes: Any) -> Any:
    """A field that is the option of another dataclass. `changes`: what is said of it otherwise."""
    found = options_of(cls)[name]
    return field(default=found.default, metadata={_KEY: replace(found, **changes)})


@cache
def options_of(cls: type) -> Mapping[str, Option]:
    """Field to option, of all fields of a dataclass that are options, each with its name and its kind."""
    hints = get_type_hints(cls)
    return {each.name: _complete(each, hints[each.name]) for each in fields(cls) if _KEY in each.metadata}


def _complete(each: Field[Any], hint: Any) -> Option:
    found: Option = each.metadata[_KEY]
    possible = [kind for kind in get_args(hint) or (hint,) if kind is not NoneType]
    kind = str if str in possible else possible[0]
    return replace(found, name=found.name or each.name.replace("_", "-"), kind=kind, default=each.default)


def one_of(names: Iterable[str]) -> str:
    """Names as a placeholder for help texts: a|b|c. The library checks what is given and lists them again."""
    return "|".join(names)
