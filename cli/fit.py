"""`mipbake fit`: texture sets in, stacks that were fitted in a renderer out."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import mipbake
from mipbake.baking import BakeOptions
from mipbake.baking.methods import METHODS
from mipbake.baking.pipeline import DEFAULT_METHOD, Recipe
from mipbake.baking.search.long_run import BEST, seconds_of
from mipbake.base.errors import UsageError
from mipbake.base.options import one_of, option, same
from mipbake.base.timings import Timings
from mipbake.cli import options
from mipbake.cli.session import Session, counted, timings
from mipbake.cli.sources import Sources, over_sets, stacks_folder
from mipbake.cli.tables import describe
from mipbake.fitting import Progress
from mipbake.fitting import fit as fit_stack
from mipbake.fitting.loop import MOST, check_count
from mipbake.fitting.named import RENDERERS, RendererChoice
from mipbake.fitting.process import TIMEOUT
from mipbake.fitting.state import checkpoint_at
from mipbake.source.jobs import Job
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet
from mipbake.stack.manifest import check_output
from mipbake.stack.saving import open_stack
from mipbake.stack.stack import MipStack

DEFAULT_VIEWS = 16
"""Views at each level of detail."""

DEFAULT_STARTS = DEFAULT_METHOD, "linear"

DEFAULT_BUDGET = "10m"

_WITHOUT_END = 2**31 - 1
"""Steps that no fit makes: it ends where no level gains any more."""


_STEPS = "Steps"

_PARTS = {"prefilter": 10, "fit": 88, "write": 2}
"""Phases of a fit, with their parts of the time; a guess, because budgets and renderers differ."""


@dataclass(frozen=True)
class FitFlags:
    """What the command line says of a fit."""

    renderer: str | None = option(
        None,
        "What renders: OpenGL with a fragment shader, three.js in Chromium, mipbake's own kernels, or what a function "
        "of a Python module makes.",
        metavar=f"{one_of(RENDERERS)}|MODULE:FACTORY",
    )
    shader: str | None = option(
        None,
        "For gl: gltf, clearcoat, ramp, or a file with a GLSL function shade. For three: physical, cloth or standard.",
        metavar="NAME|FILE",
        otherwise="the first of them",
    )
    renderer_command: str | None = option(
        None,
        "A program of your own that renders; docs/fit-protocol.md says what it reads and writes.",
        metavar="COMMAND",
    )
    renderer_timeout: float | None = option(
        None,
        "How long a program or a browser may take to start, and for a render.",
        metavar="SECONDS",
        otherwise=f"{TIMEOUT:g}",
    )
    start: list[str] | None = option(
        None,
        "Where the fit starts: a method to bake with, or the folder of a stack that was baked. Repeat for more: each "
        "level then starts from the one that the renderer shows best.",
        metavar=f"{one_of(METHODS)}|STACK",
        otherwise=" and ".join(DEFAULT_STARTS),
    )
    pixel_filter: str = same(
        Recipe, "pixel_filter", help="Pixel filter of the references; with a stack, the stack's.", group=""
    )
    views: int = option(
        DEFAULT_VIEWS,
        f"Views of a plane at each level of detail, in steps of one half; 1 to {MOST}.",
        metavar="NUMBER",
        group=_STEPS,
    )
    views_file: Path | None = option(
        None, "A JSON list of views for a program or a module, in place of these.", metavar="FILE", group=_STEPS
    )
    budget: str = option(
        DEFAULT_BUDGET,
        f"Time for all renders and steps of each set; {BEST} prepares all views, and goes on until no level gains.",
        metavar=f"30s|2m|{BEST}",
    )
    steps: int | None = option(
        None,
        "Steps at most; 0 leaves the choice of starts and the rounds.",
        metavar="NUMBER",
        otherwise="as many as the budget allows",
        group=_STEPS,
    )
    seed: int = option(0, "Seed of everything that is drawn at random; 0 or more.", group=_STEPS)
    format: str | None = same(
        BakeOptions, "format", help="Files that are written, as in `mipbake bake --format`.", otherwise="exr"
    )
    preset: str | None = same(Recipe, "preset", help="Engine that loads the stack, as in `mipbake bake --preset`.")

    @property
    def choice(self) -> RendererChoice:
        """What renders."""
        return RendererChoice(self.renderer, self.shader, self.renderer_command, self.renderer_timeout, self.views_file)


@options.reads_sets
def fit(
    session: Session, load: LoadOptions, flags: FitFlags, sources: Sources, out: Annotated[Path, stacks_folder]
) -> None:
    """Fit stacks in a renderer of your own, which need not be differentiable. Use it where that renderer shades
    otherwise than `mipbake bake` assumes, with a clear coat, a ramp or a lobe of your own. Textures that several
    engines show are better baked. A set takes the time of --budget, references and all, and a first stack is there
    after a tenth of it. Ctrl-C writes the stack as it is by then, and the same command goes on from OUT/<set>.fit.

    The state of a fit is kept in OUT/<set>.fit until the stack is written. It is kept where the renderer fails, too.
    """
    session.in_files = True
    choice = flags.choice
    seconds = seconds_of(flags.budget)
    check_count("views", flags.views)
    most = _WITHOUT_END if flags.steps is None and seconds is None else flags.steps
    made = choice.made()

    def act(job: Job, texture_set: TextureSet, alone: bool) -> dict[str, Any]:
        place = out / job.place / texture_set.name
        kept = place.with_name(place.name + ".fit")
        check_output(place, texture_set.found.hashes)
        checkpoint_at(kept).check()
        with timings(session, texture_set.name, _PARTS) as phases:
            describe(session, job, texture_set)
            stack, *others = (
                _start(each, texture_set, flags.pixel_filter, alone, phases) for each in flags.start or DEFAULT_STARTS
            )
            learned, checked, apart = choice.views_of(stack.size, stack.wrap, flags.views, flags.seed)
            reached: list[Progress] = []
            session.kept = kept
            with warnings.catch_warnings(record=True) as found:
                warnings.simplefilter("always", UserWarning)
                try:
                    fitted = fit_stack(
                        stack, made, learned, others=others, held_out=checked, apart=apart, source=texture_set,
                        steps=most, budget=seconds, seed=flags.seed, checkpoint=kept,
                        progress=_shown(phases, reached), working=partial(phases, "fit"),
                    )  # fmt: skip
                except Exception:
                    raise
                except BaseException:  # somebody stops it
                    if reached:
                        reached[-1].stack().save(place, flags.format, preset=flags.preset)
                        session.print(f"wrote {place}, as far as it was fitted")
                    raise
                phases("fit", 1.0)
                files = fitted.save(place, flags.format, partial(phases, "write"), preset=flags.preset)
            kept.unlink(missing_ok=True)
            warned = [str(each.message) for each in found if issubclass(each.category, UserWarning)]
        said = fitted.provenance.adjustments[-1]
        session.print(f"fitted: {said}", *(f"warning: {sentence}" for sentence in warned))
        session.details(f"time: {phases.summary()}")
        session.print(f"wrote {place}: {counted(len(files), 'file')}")
        return {"out": place, "files": files, "fitted": said, "warnings": warned, "seconds": dict(phases.seconds)}

    try:
        results = over_sets(session, sources, load, act)
    finally:
        close = getattr(made, "close", None)
        if close is not None:
            close()
    if len(results) > 1:
        session.print(f"{sum(result['ok'] for result in results)} of {len(results)} sets fitted")
    session.results(results)


def _start(
    start: str, texture_set: TextureSet, pixel_filter: str, alone: bool, phases: Callable[[str, float], None]
) -> MipStack:
    """What the fit of a set starts from."""
    if start in METHODS:
        return mipbake.bake(texture_set, start, pixel_filter=pixel_filter, progress=phases)
    if not Path(start).exists():
        raise UsageError(f"there is no method and no stack {start}: expected {', '.join(METHODS)}, or a folder")
    stack = open_stack(start if alone else Path(start) / texture_set.name)
    if stack.provenance.source_hash != texture_set.source_hash:
        raise UsageError(
            f"the stack {start} was not baked from {texture_set.name}, as it is read now: bake it again, or choose "
            "another one"
        )
    return stack


def _shown(phases: Timings, reached: list[Progress]) -> Callable[[Progress], None]:
    def show(now: Progress) -> None:
        reached[:] = [now]
        scores = ", ".join(f"{scale} {score:.1f}" for scale, score in now.scores.items())
        phases.note(f"{now.step} steps, {scores} dB")

    return show
