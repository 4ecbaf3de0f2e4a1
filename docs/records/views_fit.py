"""Blocks of docs/fit.md: how good fits are beside bakes, in three renderers, and what they cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from records.scripts import script
from records.wrapping import wrapped

if TYPE_CHECKING:
    from records.record import Records

RECORD = "fit"


def _tables() -> Any:
    return script("benchmarks", "fit_tables")


def fit_words(records: Records) -> str:
    """How many figures there are of which the fit is behind."""
    data, tables = records[RECORD], _tables()
    shown, linear = (tables.words(data, measure) for measure in ("snr-displayed", "snr"))
    return f"{wrapped(f'As displays show it: {shown}')}\n\n{wrapped(f'In linear radiance: {linear}')}"


def fit_pictures(records: Records) -> str:
    """The pictures of each set in each renderer, in the folder of the page."""
    names = [(renderer, name) for renderer, sets in records[RECORD]["renderers"].items() for name in sets]
    lines = [f"![{name} in {renderer}](fit-{renderer.replace(' ', '-')}-{name}.png)" for renderer, name in names]
    return "\n\n".join(lines)


FIT_VIEWS: Mapping[str, Callable[[Any], str]] = {
    "fit/displayed": lambda records: _tables().means_table(records[RECORD], "snr-displayed"),
    "fit/linear": lambda records: _tables().means_table(records[RECORD], "snr"),
    "fit/single": lambda records: _tables().single_table(records[RECORD], "snr-displayed"),
    "fit/words": fit_words,
    "fit/pictures": fit_pictures,
    "fit/stages": lambda records: _tables().stages_table(records[RECORD], "snr-displayed"),
    "fit/cost": lambda records: _tables().cost_table(records[RECORD]),
}
