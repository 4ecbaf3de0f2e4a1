"""HTML that is escaped by construction: text becomes markup in one place only."""

from __future__ import annotations

import html
from collections.abc import Iterable
from typing import TypeAlias

DASH, MINUS, TIMES, SPACE = "\N{EN DASH}", "\N{MINUS SIGN}", "\N{MULTIPLICATION SIGN}", "\N{NO-BREAK SPACE}"
"""Signs of print: of what is missing, of negative numbers, of sizes, and the space that no line ends at."""

_VOID = {"img", "input", "br", "col"}
_EMPTY = {"path", "line", "rect", "circle", "polygon"}  # empty elements of SVG, which closes them itself


class Html(str):
    """Markup. Every other string is text, which `element` and `joined` escape."""

    __slots__ = ()


Content: TypeAlias = "str | int | float | Iterable[Content] | None"
"""What goes into an element: markup, text, nothing, or several of them."""

Attribute: TypeAlias = str | int | float | bool | None


def element(tag: str, *children: Content, **attributes: Attribute) -> Html:
    """An element of HTML or SVG.

    Args:
        tag: its name.
        children: what it holds, text escaped.
        attributes: a final underscore is dropped and others become hyphens (`class_`, `aria_label`). None and False
            leave an attribute out, True gives one without a value.
    """
    parts = [tag]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        name = key.rstrip("_").replace("_", "-")
        parts.append(name if value is True else f'{name}="{html.escape(str(value))}"')
    start = " ".join(parts)
    if tag in _VOID or tag in _EMPTY:
        return Html(f"<{start}>" if tag in _VOID else f"<{start}/>")
    return Html(f"<{start}>{joined(children)}</{tag}>")


def region(label: str, *children: Content, class_: str = "scroll") -> Html:
    """A named part of the page that scrolls sideways where it is too wide."""
    return element("div", *children, class_=class_, tabindex=0, role="region", aria_label=label)


def note(*content: Content) -> Html:
    """A paragraph in small print."""
    return element("p", *content, class_="note")


def folded(label: str, content: Content) -> Html:
    """A part that is folded away until a reader opens it."""
    return element("details", element("summary", label), content)


def joined(content: Content) -> Html:
    """All parts as markup, one after the other."""
    if content is None:
        return Html("")
    if isinstance(content, Html):
        return content
    if isinstance(content, str | int | float):
        return Html(html.escape(str(content)))
    return Html("".join(joined(part) for part in content))


def listed(words: Iterable[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    names = list(words)
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else ""
