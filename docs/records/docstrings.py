"""docs/primitives.md quotes the docstrings of the primitives, and an example, between markers."""

from __future__ import annotations

import importlib
import inspect
import re

from records.record import ROOT

PAGE = "docs/primitives.md"
MARKED = re.compile(r"(<!-- (docstring|file): (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
SECTION = re.compile(r"^(Args|Returns|Raises|Yields|Attributes):$")
LINE = 120
ENTRY = re.compile(r"^    (\w[\w, ]*): ")


def signature(name: str, thing: object) -> str:
    """`name(arguments)` without annotations, as people call it."""
    assert callable(thing)
    found = inspect.signature(thing)
    plain = [p.replace(annotation=inspect.Parameter.empty) for p in found.parameters.values() if p.name != "self"]
    call = str(found.replace(parameters=plain, return_annotation=inspect.Signature.empty)).replace("'", '"')
    return f"{name}{call}" if len(name + call) <= LINE else f"{name}(\n    {call[1:-1]}\n)"


def markdown(docstring: str) -> str:
    """A docstring with Args, Returns and Raises sections as Markdown."""
    lines: list[str] = []
    section = ""
    for line in inspect.cleandoc(docstring).splitlines():
        heading = SECTION.match(line)
        if heading:
            section = heading[1]
            lines += [f"**{section}**", ""]
        elif section and line and not line.startswith("    "):
            section = ""
            lines.append(line)
        elif section:
            entry = ENTRY.match(line) if section != "Returns" else None
            inside = line.startswith("      ")  # goes on with the entry or the list item above
            lines.append(f"- `{entry[1]}`: {line[entry.end() :]}" if entry else "  " * inside + line.strip())
        else:
            lines.append(line)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip()


def docstring_of(path: str) -> str:
    """What the page says of a function or a method, by its dotted name."""
    package, module, *names = path.split(".")
    thing: object = importlib.import_module(f"{package}.{module}")
    for name in names:
        thing = getattr(thing, name)
    assert thing.__doc__, path
    return f"```python\n{signature('.'.join([module, *names]), thing)}\n```\n\n{markdown(thing.__doc__)}\n"


def fill(page: str) -> str:
    """The page with everything between its markers renewed."""

    def renew(match: re.Match[str]) -> str:
        opening, kind, name, closing = match.groups()
        if kind == "docstring":
            return f"{opening}\n{docstring_of(name)}\n{closing}"
        return f"{opening}```python\n{(ROOT / name).read_text(encoding='utf-8').strip()}\n```\n{closing}"

    return MARKED.sub(renew, page)
