"""What a fit gains in a renderer of 50 ms a frame, by the time that it has taken.

    python benchmarks/fit_slow.py MATERIALS --results RESULTS

MATERIALS is a folder of texture sets. The renderer is OpenGL with a clear coat, which waits until 50 ms have passed for
each frame, as an engine would that draws a whole scene. Nothing is prepared beforehand: the budget holds for all that
`mipbake fit` does after it has baked the stacks that it starts from. Stacks are kept as they are at some times, and
then shown in views that the fit never had, each by itself, without waiting.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import Any

from fit import FILTER, LEARNED, Effort, measured, texture_set_of
from fit_tables import OTHERS, START, slow_table, slow_words
from results_sets import folder_sets
from timing import arguments, effort_of, expect, keep

import mipbake
from mipbake import MipStack
from mipbake.fitting import Frame, Levels, Progress, View
from mipbake.fitting.named import RendererChoice

SETS = ("acg_metal007",)


@dataclass(frozen=True)
class Pace:
    """How slow the renderer is, and when stacks are kept.

    Args:
        frame: seconds of each frame. minutes: of the budget. kept: minutes at which stacks are kept.
    """

    frame: float = 0.05
    minutes: float = 10.0
    kept: tuple[float, ...] = (1.0, 2.0, 5.0)


class Slow:
    """A renderer that takes so many seconds for each frame, or as long as another one does."""

    def __init__(self, renderer: Any, frame: float) -> None:
        self._renderer, self._frame, self.frames = renderer, frame, 0
        self.called = f"{renderer.called}, slowed down"

    def render(self, levels: Levels, view: View) -> Frame:
        over = time.monotonic() + self._frame
        found: Frame = self._renderer.render(levels, view)
        time.sleep(max(0.0, over - time.monotonic()))
        self.frames += 1
        return found


def fitted(
    stacks: Mapping[str, MipStack], renderer: Any, texture_set: mipbake.TextureSet, pace: Pace
) -> tuple[dict[str, MipStack], dict[str, Any]]:
    """Stacks by the minutes that they took; and what the fit did."""
    size, wrap = (texture_set.height, texture_set.width), texture_set.wrap
    learned, checked, apart = RendererChoice("gl").views_of(size, wrap, 16, LEARNED)  # as on a command line
    slow, began, kept, told = Slow(renderer, pace.frame), time.monotonic(), dict[str, MipStack](), list[Progress]()

    def progress(now: Progress) -> None:
        told.append(now)
        for minutes in pace.kept:
            if now.seconds <= 60 * minutes:
                kept[f"{minutes:g}"] = now.stack()

    found = mipbake.fitting.fit(
        stacks[START],
        slow,
        learned,
        others=[stacks[name] for name in OTHERS],
        source=texture_set,
        held_out=checked,
        apart=apart,
        budget=60 * pace.minutes,
        progress=progress,
    )
    about = {"seconds": time.monotonic() - began, "first": told[0].seconds, "frames": slow.frames}
    said = found.provenance.adjustments[-1]
    return {**kept, f"{pace.minutes:g}": found}, {**about, "steps": told[-1].step, "said": said}


def main() -> None:
    """Measures what RESULTS does not hold."""
    options = arguments(__doc__, "materials", results=None, sets=SETS, **asdict(Pace()), **asdict(Effort()))
    effort, pace = effort_of(Effort, options), effort_of(Pace, options)
    known = folder_sets(options.materials.resolve())
    expect("set", options.sets, known)
    data: dict[str, Any] = {"pace": asdict(pace), "effort": asdict(effort), "sets": {}}
    with closing(RendererChoice("gl", "clearcoat").made()) as renderer:
        for name in options.sets:
            texture_set = texture_set_of(known[name], effort)
            stacks = {each: mipbake.bake(texture_set, each, pixel_filter=FILTER) for each in (START, *OTHERS)}
            found, about = fitted(stacks, renderer, texture_set, pace)
            shown = {START: stacks[START], **found}
            scales = measured(renderer, shown, texture_set, effort)
            data["sets"][name] = {**about, "stacks": list(shown), "scales": scales}
            keep(data, options.results and options.results.resolve())
    print(slow_words(data), slow_table(data), sep="\n\n")


if __name__ == "__main__":
    main()
