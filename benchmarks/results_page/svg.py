"""Drawing charts as SVG by hand: a panel that follows the reader's dark or light mode, axes, marks and words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

STYLE = """\
svg { font: 12px system-ui, sans-serif; --ground: #ffffff; --ink: #1f2328; --dim: #59636e; --line: #d1d9e0;
      --a: #0969da; --b: #bf3989; --c: #9a6700; --rest: #818b98; }
@media (prefers-color-scheme: dark) {
  svg { --ground: #0d1117; --ink: #e6edf3; --dim: #9198a1; --line: #3d444d;
        --a: #58a6ff; --b: #f778ba; --c: #e3b341; --rest: #7d8590; }
}
.ground { fill: var(--ground); } .title { fill: var(--ink); font-size: 14px; font-weight: 600; }
.ink { fill: var(--ink); } .dim { fill: var(--dim); } .line { stroke: var(--line); stroke-width: 1; fill: none; }
.zero { stroke: var(--dim); stroke-width: 1; } .a { fill: var(--a); } .b { fill: var(--b); } .c { fill: var(--c); }
.rest { fill: var(--rest); } .end { text-anchor: end; } .middle { text-anchor: middle; }
"""


@dataclass
class Drawing:
    """An SVG picture that grows mark by mark; lengths in pixels, from the top left."""

    width: float
    height: float
    title: str
    parts: list[str] = field(default_factory=list)

    def text(self, x: float, y: float, words: str, kind: str = "ink", turned: bool = False) -> None:
        turn = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if turned else ""
        self.parts.append(f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}"{turn}>{escape(words)}</text>')

    def line(self, x1: float, y1: float, x2: float, y2: float, kind: str = "line") -> None:
        self.parts.append(f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" class="{kind}"/>')

    def rectangle(self, x: float, y: float, width: float, height: float, kind: str) -> None:
        self.parts.append(f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" class="{kind}"/>')

    def dot(self, x: float, y: float, radius: float, kind: str, hint: str = "") -> None:
        said = f"<title>{escape(hint)}</title>" if hint else ""
        self.parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" class="{kind}">{said}</circle>')

    def grid(self, x: Axis, y: Axis) -> None:
        """Lines and numbers at the ticks of both axes."""
        top, bottom = sorted((y.start, y.stop))
        for tick in x.ticks():
            self.line(x(tick), top, x(tick), bottom)
            self.text(x(tick), bottom + 16, f"{tick:g}", "dim middle")
        for tick in y.ticks():
            self.line(x.start, y(tick), x.stop, y(tick))
            self.text(x.start - 6, y(tick) + 4, f"{tick:g}", "dim end")

    def to_svg(self) -> str:
        return "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:g} {self.height:g}" '
                f'width="{self.width:g}" height="{self.height:g}" role="img">',
                f"<title>{escape(self.title)}</title>",
                f"<style>{STYLE}</style>",
                f'<rect width="{self.width:g}" height="{self.height:g}" rx="6" class="ground"/>',
                *self.parts,
                "</svg>\n",
            ]
        )


@dataclass(frozen=True)
class Axis:
    """Values to pixels.

    Args:
        low, high: values at its ends. start, stop: pixels there.
        logarithmic: whether equal factors are equally long.
    """

    low: float
    high: float
    start: float
    stop: float
    logarithmic: bool = False

    def __call__(self, value: float) -> float:
        low, high, at = self.low, self.high, value
        if self.logarithmic:
            low, high, at = (math.log(v) for v in (low, high, at))
        return self.start + (at - low) / (high - low) * (self.stop - self.start)

    def ticks(self) -> list[float]:
        """Some four to eight round values."""
        if self.logarithmic:
            first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
            values = [base * 10.0**power for power in range(first, last + 1) for base in (1, 3)]
        else:
            step = 10 ** math.floor(math.log10((self.high - self.low) / 3))
            step *= next(times for times in (5, 2, 1) if (self.high - self.low) / (step * times) >= 3)
            first, last = math.ceil(self.low / step), math.floor(self.high / step)
            values = [step * index for index in range(first, last + 1)]
        rounding = 1e-9 * (self.high - self.low)
        return [value for value in values if self.low - rounding <= value <= self.high + rounding]


def spread(places: Sequence[float], apart: float, low: float, high: float) -> list[float]:
    """Places moved as little as it takes to be `apart` from each other, in their order, from low to high."""
    order = sorted(range(len(places)), key=lambda index: places[index])
    moved = [0.0] * len(places)
    at = low - apart
    for index in order:
        at = moved[index] = max(places[index], at + apart)
    limit = high + apart
    for index in reversed(order):
        limit = moved[index] = min(moved[index], limit - apart)
    return moved
