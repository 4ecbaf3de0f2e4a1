"""`mipbake fit`: texture sets in, stacks that were fitted in a renderer out."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

import mipbake
from mipbake.baking.bake import DEFAULT_FILTER, DEFAULT_METHOD
from mipbake.baking.methods import METHODS
from mipbake.baking.search.time_budget import BEST, seconds_of
from mipbake.base.errors import UsageError
from mipbake.cli import options
from mipbake.cli.options import OptionalPath, one_of
from mipbake.cli.session import Session, timings
from mipbake.cli.sources import Sources, over_sets
from mipbake.cli.tables import description
from mipbake.fitting import Progress
from mipbake.fitting import fit as fit_stack
from mipbake.fitting.comparisons import ERRORS
from mipbake.fitting.exchange import EXCHANGES
from mipbake.fitting.loop import MOST, check_count
from mipbake.fitting.named import RENDERERS, RendererChoice
from mipbake.fitting.prepared import TEXELS
from mipbake.fitting.state import check_checkpoint
from mipbake.source.found import file_hashes
from mipbake.source.jobs import Job
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet
from mipbake.stack.manifest import check_output
from mipbake.stack.saving import open_stack
from mipbake.stack.stack import MipStack

DEFAULT_VIEWS = 16
"""Views at each level of detail."""

DEFAULT_STARTS = DEFAULT_METHOD, "linear"

DEFAULT_BUDGET = "5m"

_WITHOUT_END = 2**31 - 1
"""Steps that no fit makes: it ends where no level gains any more."""


@options.reads_sets
def fit(
    session: Session,
    load: LoadOptions,
    sources: Sources,
    out: Annotated[Path, options.stacks_folder()],
    renderer: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=f"{one_of(RENDERERS)}|MODULE:FACTORY",
            help="What renders: OpenGL with a fragment shader, three.js in Chromium, mipbake's own kernels, or what a "
            "function of a Python module makes.",
            show_default=False,
        ),
    ] = None,
    shader: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="NAME|FILE",
            help="For gl: gltf, clearcoat, ramp, or a file with a GLSL function shade. For three: physical, cloth or "
            "standard.",
            show_default="the first of them",
        ),
    ] = None,
    renderer_command: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="COMMAND",
            help="A program of your own that renders; docs/fit-protocol.md says what it reads and writes.",
            show_default=False,
        ),
    ] = None,
    exchange: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=one_of(EXCHANGES), help="How a program gets maps and gives frames back.", show_default="memory"
        ),
    ] = None,
    renderer_timeout: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            metavar="SECONDS", help="How long a program or a browser may take for a render.", show_default="60"
        ),
    ] = None,
    renderer_start_timeout: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(metavar="SECONDS", help="How long a program may take to start.", show_default="120"),
    ] = None,
    three: Annotated[
        OptionalPath,
        typer.Option(
            metavar="FOLDER",
            help="The folder of three.js that holds three.module.js.",
            show_default="node_modules/three/build",
        ),
    ] = None,
    start: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            metavar=f"{one_of(METHODS)}|STACK",
            help="Where the fit starts: a method to bake with, or the folder of a stack that was baked. Repeat for "
            "more: each level then starts from the one that the renderer shows best.",
            show_default=" and ".join(DEFAULT_STARTS),
        ),
    ] = None,
    pixel_filter: Annotated[
        str,
        options.pixel_filter("Pixel filter of the references; with a stack, the stack's."),
    ] = DEFAULT_FILTER,
    views: Annotated[
        int,
        typer.Option(
            metavar="NUMBER", help=f"Views of a plane at each level of detail, in steps of one half; 1 to {MOST}."
        ),
    ] = DEFAULT_VIEWS,
    views_file: Annotated[
        OptionalPath,
        typer.Option(
            metavar="FILE",
            help="A JSON list of views for a program or a module, in place of these.",
            show_default=False,
        ),
    ] = None,
    budget: Annotated[
        str,
        typer.Option(
            metavar=f"30s|2m|{BEST}",
            help=f"Time for the steps and rounds of each set; {BEST} goes on until no level gains any more.",
        ),
    ] = DEFAULT_BUDGET,
    steps: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            metavar="NUMBER",
            help="Steps at most; 0 leaves the choice of starts and the rounds.",
            show_default="as many as the budget allows",
        ),
    ] = None,
    renders: Annotated[
        int,
        typer.Option(
            metavar="NUMBER", help=f"How often a step is rendered, each time with new signs; 1 to {MOST} times."
        ),
    ] = 1,
    rounds: Annotated[
        int,
        typer.Option(
            metavar="NUMBER",
            help="Rounds of least squares after the steps, which move all texels of a level together; 0 for none.",
        ),
    ] = 1,
    texels: Annotated[
        str, typer.Option(metavar=one_of(TEXELS), help="Which texels of its lookup a pixel's error is credited to.")
    ] = TEXELS[0],
    error: Annotated[
        str,
        typer.Option(
            metavar=one_of(ERRORS),
            help="What is compared: radiance as a display shows it, linear radiance too, or numbers as they are.",
        ),
    ] = ERRORS[0],
    seed: Annotated[int, typer.Option(help="Seed of everything that is drawn at random; 0 or more.")] = 0,
    format: Annotated[
        Optional[str],  # noqa: UP045
        options.formats("Files that are written, as in `mipbake bake --format`.", "exr"),
    ] = None,
    preset: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="NAME", help="Engine that loads the stack, as in `mipbake bake --preset`.", show_default=False
        ),
    ] = None,
) -> None:
    """Fit stacks in a renderer of your own, which need not be differentiable.

    The state of a fit is kept in OUT/<set>.fit until the stack is written. The same command goes on from it where a fit
    was stopped, or where the renderer failed.
    """
    session.in_files = True
    choice = RendererChoice(
        renderer, shader, renderer_command, exchange, renderer_timeout, renderer_start_timeout, three, views_file
    )
    seconds = seconds_of(budget)
    check_count("views", views)
    check_count("renders", renders)
    most = _WITHOUT_END if steps is None and seconds is None else steps
    made = choice.made()

    def act(job: Job, texture_set: TextureSet, alone: bool) -> dict[str, Any]:
        place = out / job.place / texture_set.name
        kept = place.with_name(place.name + ".fit")
        check_output(place, file_hashes(texture_set))
        check_checkpoint(kept)
        with timings(session, texture_set.name) as phases:
            session.print(*description(job, texture_set))
            stack, *others = (
                _start(each, texture_set, pixel_filter, alone, phases) for each in start or DEFAULT_STARTS
            )
            learned, checked = choice.views_of(stack.size, stack.wrap, views, seed)
            session.kept = kept
            with warnings.catch_warnings(record=True) as found:
                warnings.simplefilter("always", UserWarning)
                fitted = fit_stack(
                    stack, made, learned, others=others, held_out=checked, source=texture_set, steps=most,
                    budget=seconds, renders=renders, rounds=rounds, texels=texels, seed=seed, error=error,
                    checkpoint=kept, progress=_shown(phases), preparing=partial(phases, "views"),
                )  # fmt: skip
                phases("fit", 1.0)
                files = fitted.save(place, format, partial(phases, "write"), preset=preset)
            kept.unlink(missing_ok=True)
            warned = [str(each.message) for each in found if issubclass(each.category, UserWarning)]
        told = fitted.provenance.adjustments[-1]
        session.print(
            f"fitted: {told}",
            *(f"warning: {sentence}" for sentence in warned),
            f"time: {phases.summary()}",
            f"wrote {place}: {len(files)} files",
        )
        return {"out": place, "files": files, "fitted": told, "warnings": warned, "seconds": dict(phases.seconds)}

    try:
        results = over_sets(session, sources, load, act)
    finally:
        close = getattr(made, "close", None)
        if close is not None:
            close()
    if len(results) > 1:
        session.print(f"{sum(result['ok'] for result in results)} of {len(results)} sets fitted")
    session.dump({"version": mipbake.__version__, "exit_code": session.exit_code, "results": results})


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


def _shown(phases: Any) -> Callable[[Progress], None]:
    def show(now: Progress) -> None:
        phases("fit", now.share)
        scores = ", ".join(f"{scale} {score:.1f}" for scale, score in now.scores.items())
        phases.note(f"{now.step} steps, {scores} dB")

    return show
