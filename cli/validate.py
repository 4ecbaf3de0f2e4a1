"""`mipbake validate`: a stack and the closed forms against the supersampled, pixel-filtered reference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import mipbake
from mipbake import TextureSet, UsageError, Validation
from mipbake.cli import options
from mipbake.cli.session import Session, timings
from mipbake.cli.sources import Sources, over_sets, stack_of
from mipbake.cli.tables import ranked_table
from mipbake.comparing.validate import DEFAULT_SEED
from mipbake.source.jobs import Job
from mipbake.source.options import LoadOptions
from mipbake.stack.gltf.glb import multiple_of_side
from mipbake.stack.gltf.glb_stacks import stack_in_glb
from mipbake.stack.output import GLB

if TYPE_CHECKING:
    from rich.table import Table


@options.reads_sets
def validate(
    session: Session,
    load: LoadOptions,
    sources: Sources,
    stack: Annotated[
        Path,
        typer.Argument(
            metavar="STACK",
            help="What was baked from the set: OUT/<set>, or OUT/<file>.glb. With several sets, give OUT, the folder "
            "that they were baked into.",
            show_default=False,
            readable=False,
        ),
    ],
    seed: Annotated[
        int,
        typer.Option(help="Seed of the pixels, light-view pairs and samples that are drawn; 0 or more."),
    ] = DEFAULT_SEED,
) -> None:
    """Measure stacks against their sources: SNR in dB, higher is better.

    The reference is the supersampled source, at several levels of detail. Pass the reading options that the stack was
    baked with. Every material of a GLB is measured, from the textures in the file. A set whose stack cannot be measured
    is reported, and the other sets are measured all the same.
    """
    if seed < 0:
        raise UsageError(f"--seed is {seed}: expected 0 or more")

    in_glb = stack.suffix.lower() == f".{GLB}"

    def measure(job: Job, texture_set: TextureSet, alone: bool) -> dict[str, Any]:
        place = stack if in_glb else stack_of(stack, job, texture_set, alone)
        if in_glb:
            texture_set = multiple_of_side(texture_set)
        baked = stack_in_glb(stack, job, texture_set) if in_glb else mipbake.open_stack(place)
        with timings(session, texture_set.name) as progress:
            measured = mipbake.validate(texture_set, baked, seed=seed, progress=progress)
        name = f"{place}: " + (f"{measured.name}, " if in_glb else "")
        session.print(f"{name}{measured.method}, {measured.model}, pixel filter {measured.pixel_filter}")
        for pair_set in dict.fromkeys(row.pair_set for row in measured.rows):
            session.print("", snr_table(measured, pair_set))
        session.print("", *(f"note: {note}" for note in measured.notes))
        session.details(f"time: {progress.summary()}")
        return {"stack": place, **measured.to_dict(), "seconds": progress.seconds}

    session.results(over_sets(session, sources, load, measure))


def snr_table(measured: Validation, pair_set: str) -> Table:
    """Methods by level of detail, for one pair set."""
    rows = {
        method: [(f"{snr:.1f}", -snr) for snr in (measured.snr(method, pair_set, lod) for lod in measured.lods)]
        for method in measured.methods
    }
    return ranked_table(f"{pair_set}, SNR in dB", [f"lod {lod:g}" for lod in measured.lods], rows)
