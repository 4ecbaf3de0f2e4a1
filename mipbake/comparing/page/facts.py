"""The last part of a report: what was read, assumed and set, how long it took, and where the files are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from mipbake.base.version import __version__
from mipbake.comparing.page.markup import DASH, TIMES, Content, Html, element
from mipbake.comparing.page.tables import plain_table
from mipbake.comparing.result import Comparison
from mipbake.source.sources import DECISIONS


def found(source: Mapping[str, Any]) -> Html:
    """What was read of the texture set: `source` in plain types, as `mipbake inspect --json` says it."""
    maps = source.get("maps")
    rows: list[Sequence[Content]] = []
    for role, entry in (maps if isinstance(maps, Mapping) else {}).items():
        path, constant = entry.get("path"), entry.get("constant")
        origin = PurePath(path).name if path else "constant " + ", ".join(f"{v:g}" for v in constant or ())
        size = f"{entry.get('width')} {TIMES} {entry.get('height')}" if path else ""
        stored = f"{entry.get('depth')} {entry.get('channels')}" if path else ""
        read = f"{entry.get('encoding')}{', inverted' if entry.get('inverted') else ''}" if path else ""
        rows.append(
            [role.replace("_", " ").replace("color", "colour"), origin, size, stored, read, entry.get("reason", "")]
        )
    parts: list[Content] = []
    if rows:
        parts.append(plain_table(("Map", "From", "Size", "Stored as", "Read as", "Why"), rows, "Maps of the set"))
    convention = source.get("normal_convention")
    if isinstance(convention, Mapping):
        spoken = {"opengl": "OpenGL (green is up)", "directx": "DirectX (green is down)"}
        name, confidence = str(convention.get("name")), convention.get("confidence")
        sure = f", confidence {confidence:.2f}" if isinstance(confidence, int | float) else ""
        decided = str(convention.get("decided_by"))
        words = DECISIONS.get(decided, f"by {decided}")
        parts.append(element("p", f"Normal convention: {spoken.get(name, name)}, {words}{sure}."))
    for key, label in (("warnings", "Warnings"), ("notes", "Notes"), ("ignored", "Files that were left out")):
        sentences = [_sentence(item) for item in source.get(key) or ()]
        if sentences:
            parts.append(element("h4", label))
            parts.append(bullets(sentences))
    return element("div", parts or element("p", "Nothing is known about the source of the set."), class_="facts")


def _sentence(item: Any) -> str:
    if isinstance(item, Mapping):  # an ignored file
        return f"{PurePath(str(item.get('path'))).name}: {item.get('reason')}"
    return str(item)


def bullets(sentences: Sequence[str]) -> Html:
    """A list of sentences."""
    return element("ul", [element("li", sentence) for sentence in sentences])


def methods(comparison: Comparison) -> Html:
    """What was compared."""
    rows: list[Sequence[Content]] = [
        [
            each.name,
            each.method,
            each.kernel,
            each.model,
            _value(each.sampler),
            _value(each.aim),
            f"{each.seconds:.1f} s" if each.seconds is not None else f"opened from {each.path}" if each.path else DASH,
        ]
        for each in comparison.methods
    ]
    return plain_table(
        ("Name", "Method", "Kernel", "Material model", "Made for sampler", "Aim", "Baking took"),
        rows,
        "Methods that were compared",
    )


def settings(comparison: Comparison) -> Html:
    """Settings and seconds, name and value."""
    general = {
        "mipbake": __version__,
        "material model": comparison.model,
        "pixel filter": comparison.pixel_filter,
        **{key.replace("_", " "): _value(value) for key, value in comparison.settings.items()},
    }
    seconds = {phase: f"{value:.1f} s" for phase, value in comparison.seconds.items()}
    return element(
        "div",
        element("div", element("h3", "Settings"), _listed(general)),
        element("div", element("h3", "What it took"), _listed(seconds)) if seconds else None,
        class_="columns",
    )


def _listed(entries: Mapping[str, str]) -> Html:
    return element("dl", [(element("dt", key), element("dd", value)) for key, value in entries.items()])


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_value(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_value(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else DASH if value is None else str(value)


def _count(names: Mapping[str, str]) -> str:
    renders = sum(name.endswith(".exr") for name in names)
    kept = f" and {renders} renders as EXR files" if renders else ""
    return f"{len(names) - renders} images as PNG files{kept}"


def files(results: str, images: Mapping[str, str]) -> Html:
    """Links to what lies beside the page; `images` is file to what it shows, pictures and kept renders."""
    links = [element("li", element("a", label, href=file)) for file, label in images.items()]
    return element(
        "div",
        element(
            "p", element("a", results, href=results), ": every figure on this page, curves in steps of a quarter level."
        ),
        element(
            "details",
            element("summary", _count(images)),
            element("ul", links, class_="files"),
        )
        if links
        else None,
    )
