"""`mipbake convert`: texture sets in, the same materials in another material model out."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

import mipbake
from mipbake import MipbakeError, UsageError
from mipbake.baking.convert import (
    LEARNED,
    TARGETS,
    Material,
    check_device,
    check_material_output,
    image_container,
    is_material_folder,
    open_material,
)
from mipbake.baking.methods import method_named
from mipbake.baking.pipeline import Recipe
from mipbake.base.options import one_of, option, same
from mipbake.base.publish import temporary_folder
from mipbake.base.timings import Timings
from mipbake.cli import options
from mipbake.cli.session import Session, counted, succeeded, timings
from mipbake.cli.sources import Sources, out_option
from mipbake.cli.tables import describe, remark
from mipbake.material import model_named
from mipbake.source.inputs import expand
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet
from mipbake.stack.containers import DEFAULT_FORMAT, IMAGE_FORMATS


@dataclass(frozen=True)
class ConvertFlags:
    """What the command line says of a conversion, besides the model."""

    format: str = option(
        DEFAULT_FORMAT,
        "exr: half floats and linear colours; png: 8 bits and sRGB-encoded colours, for gltf and gltf-anisotropic.",
        metavar=one_of(IMAGE_FORMATS),
    )
    weights: str | None = option(
        None,
        "Trained weights that fit how the surface reflects under the pixel filter, such as paper-cross.",
        metavar="NAME",
        otherwise="none: a formula converts each texel, and nothing is filtered",
    )
    device: str | None = same(
        Recipe, "device", help="Where the network of --weights runs, as in `mipbake bake --device`.", group=""
    )


@options.reads_sets
def convert(
    session: Session,
    load: LoadOptions,
    sources: Sources,
    to: Annotated[str, typer.Option("--to", metavar=one_of(TARGETS), help="Material model.", show_default=False)],
    out: Annotated[Path, out_option("OUT", "Folder for the materials, each in OUT/<set>/.")],
    flags: ConvertFlags,
) -> None:
    """Convert texture sets, or materials that were converted before, to another material model.

    Only level 0 is made. A formula converts each texel, and nothing is filtered; with --weights, a trained network
    converts the set. A set that cannot be converted is reported, and the other sets are converted all the same.
    """
    session.in_files = True
    # Everything that is wrong for every set is said before the first is read.
    image_container(model_named(to).name, flags.format)
    check_device(flags.weights, flags.device)
    if flags.weights is not None:
        method_named(LEARNED, flags.weights, device=flags.device)
    every = expand(sources)
    materials = [path for path in every if is_material_folder(path)]
    results: list[dict[str, Any]] = []
    with temporary_folder() as scratch:
        found = jobs([str(path) for path in every if path not in materials], load, scratch)
        _check_names(materials, found)
        work: list[tuple[Path, Callable[[], _Read]]] = [
            (path, partial(_read_material, session, path, out, load)) for path in materials
        ]
        for job in found:
            if isinstance(job, Failure):
                results.append(session.failed(job.source, job.error))
                continue
            work += [(job.source, partial(_read_set, session, job, tile, out)) for tile in job.parts]
        for source, read in work:
            try:
                done = _write(session, read(), to, flags)
                results.append(succeeded(source, **done))
            except MipbakeError as error:
                results.append(session.failed(source, error))
    if len(results) > 1:
        session.print(f"{sum(r['ok'] for r in results)} of {len(results)} sets converted")
    session.results(results)


def _check_names(materials: Sequence[Path], found: Sequence[Job | Failure]) -> None:
    """UsageError when two sources would be written to one place."""
    named = [(name, job.source) for job in found if isinstance(job, Job) for name in job.names.values()]
    for path in materials:
        with contextlib.suppress(MipbakeError):  # it is said when its turn comes
            named.append((open_material(path).name, path))
    names: dict[str, Path] = {}
    for name, source in named:
        if name in names:
            raise UsageError(
                f"{names[name]} and {source} are both called {name}: convert them into different folders, one at a time"
            )
        names[name] = source


@dataclass(frozen=True)
class _Read:
    """What is converted: where to, what it took to read it, and what is said of it in JSON."""

    given: TextureSet | Material
    place: Path
    reading: Timings
    about: object


def _read_material(session: Session, source: Path, out: Path, load: LoadOptions) -> _Read:
    """Reads what was converted before, and prints what it is."""
    if load != LoadOptions():
        raise UsageError(
            f"{source} holds a converted material, which says itself how it is read: leave out the options for "
            "reading a set"
        )
    with timings(session, source.name) as reading:
        given = open_material(source)
        reading("read", 1.0)
    place = out / given.name
    if os.path.realpath(place) == os.path.realpath(source):
        raise UsageError(
            f"{source} would be replaced by the converted material, which may hold less: choose another --out"
        )
    check_material_output(place, given.provenance.sources)
    height, width = given.stored.shape[:2]
    session.print(f"{source}: {width} x {height}, {given.model}")
    return _Read(given, place, reading, {"name": given.name, "width": width, "height": height, "model": given.model})


def _read_set(session: Session, job: Job, tile: int, out: Path) -> _Read:
    """Reads a texture set, or a tile, and prints what it is."""
    place = out / job.place / job.names[tile]
    with job.naming():
        check_material_output(place, job.find(tile).hashes)
        with timings(session, place.name) as reading:
            reading("read", 0.0)
            given = job.read_tile(tile)
            reading("read", 1.0)
        check_material_output(place, given.found.hashes)
        describe(session, job, given)
        remark(session, job)
        return _Read(given, place, reading, job.named(given.found))


def _write(session: Session, read: _Read, to: str, flags: ConvertFlags) -> dict[str, Any]:
    """Converts and writes, prints what happened, and returns it for JSON."""
    with timings(session, read.place.name, {"convert": 3, "write": 1}) as converting:
        converting.seconds.update(read.reading.seconds)
        made = mipbake.convert(read.given, to, flags.weights, flags.device)
        converting("convert", 1.0)
        files = made.save(read.place, flags.format, lambda share: converting("write", share))
    size = sum(file.stat().st_size for file in files)
    by = made.provenance
    rule = f"by {by.weights} under the pixel filter {by.pixel_filter}" if by.weights else "unfiltered"
    session.print(
        f"converted from {by.source_model} to {made.model}, level 0 alone, {rule}",
        f"wrote {read.place}: {counted(len(files), 'file')}, {size / 1e6:.1f} MB",
    )
    session.details(f"time: {converting.summary()}")
    return {
        "out": read.place,
        "files": [{"path": file, "bytes": file.stat().st_size} for file in files],
        "bytes": size,
        "format": flags.format,
        "material": {"model": made.model, "provenance": by},
        "seconds": converting.seconds,
        "set": read.about,
    }
