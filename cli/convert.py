"""`mipbake convert`: texture sets in, the same materials in another material model out."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

import mipbake
from mipbake import MipbakeError, UsageError
from mipbake.baking.bake import Recipe
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
from mipbake.base.options import one_of, option, same
from mipbake.base.publish import temporary_folder
from mipbake.base.timings import Timings
from mipbake.cli import options
from mipbake.cli.folders import check_names
from mipbake.cli.session import Session, timings
from mipbake.cli.sources import Sources
from mipbake.cli.tables import description, remarks_of
from mipbake.material import model_named
from mipbake.source.inputs import expand
from mipbake.source.intake import jobs
from mipbake.source.jobs import Failure, Job
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet
from mipbake.stack.containers import DEFAULT_FORMAT, IMAGE_FORMATS

_Write: TypeAlias = "Callable[[TextureSet | Material, Path, Timings], dict[str, Any]]"


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
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="OUT", help="Folder for the materials, each in OUT/<set>/.", show_default=False
        ),
    ],
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
    results: list[dict[str, Any]] = []

    def attempt(source: Path, convert_one: Callable[[], dict[str, Any]]) -> None:
        try:
            results.append({"source": source, "ok": True, "exit_code": 0, **convert_one()})
        except MipbakeError as error:
            results.append(session.failed(source, error))

    def write(given: TextureSet | Material, place: Path, reading: Timings) -> dict[str, Any]:
        return _write(session, given, place, to, flags, reading)

    every = expand(sources)
    materials = [path for path in every if is_material_folder(path)]
    with temporary_folder() as scratch:
        found = jobs([str(path) for path in every if path not in materials], load, scratch)
        named = [(name, job.source) for job in found if isinstance(job, Job) for name in job.names.values()]
        check_names([*_names(materials), *named], "convert")
        for path in materials:
            attempt(path, partial(_convert_material, session, path, out, load, write))
        for job in found:
            if isinstance(job, Failure):
                attempt(job.source, partial(_raise, job.error))
                continue
            for tile in job.parts:
                attempt(job.source, partial(_convert_set, session, job, tile, out, write))
    if len(results) > 1:
        session.print(f"{sum(r['ok'] for r in results)} of {len(results)} sets converted")
    session.dump({"version": mipbake.__version__, "exit_code": session.exit_code, "results": results})


def _names(materials: Sequence[Path]) -> list[tuple[str, Path]]:
    """The names of converted materials; an error in one of them is left for when its turn comes."""
    named = []
    for path in materials:
        with contextlib.suppress(MipbakeError):
            named.append((open_material(path).name, path))
    return named


def _raise(error: MipbakeError) -> dict[str, Any]:
    raise error


def _convert_material(session: Session, source: Path, out: Path, load: LoadOptions, write: _Write) -> dict[str, Any]:
    """Converts what was converted before, prints what happened, and returns it for JSON."""
    if load != LoadOptions():
        raise UsageError(
            f"{source} holds a converted material, which says itself how it is read: leave out the options for "
            "reading a set"
        )
    with timings(session, source.name) as reading:
        reading("read", 0.0)
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
    read = {"name": given.name, "width": width, "height": height, "model": given.model}
    return {**write(given, place, reading), "set": read}


def _convert_set(session: Session, job: Job, tile: int, out: Path, write: _Write) -> dict[str, Any]:
    """Converts a texture set, or a tile, prints what happened, and returns it for JSON."""
    place = out / job.place / job.names[tile]
    with job.naming():
        check_material_output(place, job.find(tile).hashes)
        with timings(session, place.name) as reading:
            reading("read", 0.0)
            given = job.read_tile(tile)
            reading("read", 1.0)
        check_material_output(place, given.found.hashes)
        session.print(*description(job, given), *remarks_of(job))
        return {**write(given, place, reading), "set": job.named(given.found)}


def _write(
    session: Session,
    given: TextureSet | Material,
    place: Path,
    to: str,
    flags: ConvertFlags,
    reading: Timings,
) -> dict[str, Any]:
    with timings(session, place.name) as converting:
        converting.seconds.update(reading.seconds)
        made = mipbake.convert(given, to, flags.weights, flags.device)
        converting("convert", 1.0)
        files = made.save(place, flags.format, lambda share: converting("write", share))
    size = sum(file.stat().st_size for file in files)
    session.print(
        f"converted from {made.provenance.source_model} to {made.model}, level 0 alone, {_rule(made)}",
        f"time: {converting.summary()}",
        f"wrote {place}: {len(files)} files, {size / 1e6:.2f} MB",
    )
    return {
        "out": place,
        "files": [{"path": file, "bytes": file.stat().st_size} for file in files],
        "bytes": size,
        "format": flags.format,
        "material": {"model": made.model, "provenance": made.provenance},
        "seconds": converting.seconds,
    }


def _rule(made: Material) -> str:
    """How a material was converted, in a few words."""
    by = made.provenance
    return f"by {by.weights} under the pixel filter {by.pixel_filter}" if by.weights else "unfiltered"
