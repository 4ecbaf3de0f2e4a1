"""`mipbake validate`: a stack and the closed forms against the supersampled, pixel-filtered reference."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import mipbake
from mipbake import MipStack, TextureSet, UsageError, Validation
from mipbake.cli import options
from mipbake.cli.options import parse_lods, spoken_lods
from mipbake.cli.session import Session, stages
from mipbake.cli.tables import table
from mipbake.glb import multiple_of_side
from mipbake.glb_stacks import stack_in_glb
from mipbake.intake import Failure, jobs
from mipbake.io.options import LoadOptions
from mipbake.output import GLB
from mipbake.validate import DEFAULT_LODS, DEFAULT_POINTS, DEFAULT_SAMPLES, DEFAULT_SEED

if TYPE_CHECKING:
    from rich.table import Table


@options.reads_sets
def validate(
    session: Session,
    load: LoadOptions,
    folder: options.Folder,
    stack: Annotated[
        Path,
        typer.Argument(
            metavar="STACK", help="What was baked from it: OUT/<set>, or OUT/<file>.glb.", show_default=False
        ),
    ],
    lods: Annotated[
        str, typer.Option(metavar="LODS", help="Levels of detail, numbers from 0 up, separated by commas.")
    ] = spoken_lods(DEFAULT_LODS),
    seed: Annotated[int, typer.Option(help="Fixes pixels, light-view pairs and samples; 0 or more.")] = DEFAULT_SEED,
    points: Annotated[int, typer.Option(help="Pixels per level of detail; 1 or more.")] = DEFAULT_POINTS,
    samples: Annotated[
        int, typer.Option(help="Samples per pixel in each of two estimates of the reference; 1 or more.")
    ] = DEFAULT_SAMPLES,
) -> None:
    """Measure a stack against its source: SNR in dB, higher is better.

    The reference is the supersampled source, at several levels of detail. Pass the reading options that it was baked
    with. Of a GLB every material is measured, from the textures that are in the file.
    """
    chosen = parse_lods(lods)
    if seed < 0:
        raise UsageError(f"--seed is {seed}: expected 0 or more")

    def measured(texture_set: TextureSet, baked: MipStack) -> dict[str, Any]:
        with stages(session, texture_set.name) as progress:
            found = mipbake.validate(texture_set, baked, chosen, seed, points, samples, progress)
        name = f"{stack}: " + (f"{found.name}, " if in_glb else "")
        session.print(f"{name}{found.method}, {found.model}, pixel filter {found.pixel_filter}")
        for pairs in dict.fromkeys(row.pair_set for row in found.rows):
            session.print("", snr_table(found, pairs))
        session.print("", *(f"note: {note}" for note in found.notes), f"time: {progress.summary()}")
        return {**found.to_dict(), "seconds": progress.seconds}

    in_glb = stack.suffix.lower() == f".{GLB}"
    told = {"version": mipbake.__version__, "folder": folder, "stack": stack}
    if not in_glb:
        baked = mipbake.open_stack(stack)
        session.dump({**told, **measured(mipbake.load(folder, load), baked)})
        return
    results = []
    with tempfile.TemporaryDirectory() as scratch:
        for job in jobs([str(folder)], load, Path(scratch)):
            if isinstance(job, Failure):
                raise job.error
            texture_set = job.read(multiple_of_side).texture_set
            results.append(measured(texture_set, stack_in_glb(stack, job, texture_set)))
    session.dump({**told, "materials": results})


def snr_table(measured: Validation, pairs: str) -> Table:
    """Methods by level of detail, for one pair set; the best of each column is bold."""
    from rich.text import Text

    made = table(f"{pairs}, SNR in dB", *(f"lod {lod:g}" for lod in measured.lods))
    for column in made.columns[1:]:
        column.justify = "right"
    columns = {lod: {m: measured.snr(m, pairs, lod) for m in measured.methods} for lod in measured.lods}
    for method in measured.methods:
        figures = [Text(f"{c[method]:.1f}", "bold" if c[method] == max(c.values()) else "") for c in columns.values()]
        made.add_row(method, *figures)
    return made
