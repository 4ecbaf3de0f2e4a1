"""The last part of a report: what was read, assumed and set, how long it took, and where the files are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from mipbake.base.version import __version__
from mipbake.comparing.page.markup import DASH, TIMES, Content, Html, element, folded
from mipbake.comparing.page.tables import word_table
from mipbake.comparing.result import Comparison
from mipbake.source.sources import DECISIONS

_CONVENTIONS = {"opengl": "OpenGL (green is up)", "directx": "DirectX (green is down)"}


def details(comparison: Comparison, results: str) -> list[Html]:
    """All of it.

    Args:
        results: the file of figures.
    """
    return [
        element("h3", "What was found and assumed"),
        _found(comparison.source),
        folded("The methods, and how long each took to bake", _methods(comparison)),
        _settings(comparison),
        element("p", element("a", results, href=results), ": every figure, curves in steps of a quarter level."),
    ]


def bullets(sentences: Sequence[str]) -> Html:
    """A list of sentences."""
    return element("ul", [element("li", sentence) for sentence in sentences])


def _found(source: Mapping[str, Any]) -> Html:
    """What was read of the texture set: `source` as `mipbake inspect --json` says it."""
    rows: list[Sequence[Content]] = []
    for role, entry in source.get("maps", {}).items():
        described: list[str] = ["constant " + ", ".join(f"{v:g}" for v in entry.get("constant") or ()), "", "", ""]
        if entry.get("path"):
            described = [
                PurePath(entry["path"]).name,
                f"{entry.get('width')} {TIMES} {entry.get('height')}",
                f"{entry.get('depth')} {entry.get('channels')}",
                f"{entry.get('encoding')}{', inverted' if entry.get('inverted') else ''}",
            ]
        spelt = role.replace("_", " ").replace("color", "colour")
        rows.append([spelt, *described, entry.get("reason", "")])
    parts: list[Content] = []
    if rows:
        parts.append(word_table(("Map", "From", "Size", "Stored as", "Read as", "Why"), rows, "Maps of the set"))
    convention = source.get("normal_convention")
    if convention:
        name, decided, confidence = (convention.get(key) for key in ("name", "decided_by", "confidence"))
        sure = f", confidence {confidence:.2f}" if confidence is not None else ""
        words = DECISIONS.get(decided, f"by {decided}")
        parts.append(element("p", f"Normal convention: {_CONVENTIONS.get(name, name)}, {words}{sure}."))
    left_out = [f"{PurePath(each['path']).name}: {each['reason']}" for each in source.get("ignored", ())]
    for label, sentences in (
        ("Warnings", source.get("warnings")),
        ("Notes", source.get("notes")),
        ("Files that were left out", left_out),
    ):
        parts += [element("h4", label), bullets(sentences)] if sentences else []
    return element("div", parts or element("p", "Nothing is known about the source of the set."), class_="facts")


def _methods(comparison: Comparison) -> Html:
    heads = ("Name", "Method", "Kernel", "Material model", "Made for sampler", "Aim", "Baking took")
    rows = []
    for each in comparison.methods:
        took = f"opened from {each.path}" if each.path else DASH
        took = took if each.seconds is None else f"{each.seconds:.1f} s"
        rows.append([each.name, each.method, each.kernel, each.model, _value(each.sampler), _value(each.aim), took])
    return word_table(heads, rows, "Methods that were compared")


def _settings(comparison: Comparison) -> Html:
    general = {
        "mipbake": __version__,
        "material model": comparison.model,
        "pixel filter": comparison.pixel_filter,
        **{key.replace("_", " "): _value(value) for key, value in comparison.settings.items()},
    }
    seconds = {phase: f"{value:.1f} s" for phase, value in comparison.seconds.items()}
    columns = [
        element(
            "div", element("h3", head), element("dl", [(element("dt", k), element("dd", v)) for k, v in each.items()])
        )
        for head, each in (("Settings", general), ("What it took", seconds))
        if each
    ]
    return element("div", columns, class_="columns")


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_value(item)}" for key, item in value.items())
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else DASH if value is None else str(value)
