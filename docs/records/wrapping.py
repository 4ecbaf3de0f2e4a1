"""Lines of pages: paragraphs, which have at most 120 characters a line, and tables."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Sequence

from records.scripts import script

_PROSE = re.compile(r"(?!\d+\. |\* )[A-Za-z0-9*`\[(]")  # neither headings, tables and pictures nor lists

table: Callable[[Sequence[str], Sequence[Sequence[str]]], str] = script("benchmarks", "timing").table
"""Heads and rows to Markdown."""


def wrapped(words: str) -> str:
    """A paragraph as lines of at most 120 characters."""
    return "\n".join(textwrap.wrap(words, 120, break_long_words=False, break_on_hyphens=False))


def wrapped_page(page: str) -> str:
    """The page with paragraphs as lines of at most 120 characters; tables, headings and pictures stay as they are."""
    parts = page.split("\n\n")
    return "\n\n".join(wrapped(part) + "\n" * part.endswith("\n") if _PROSE.match(part) else part for part in parts)
