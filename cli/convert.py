"""`mipbake convert`: texture sets in, the same materials in another material model out."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

import mipbake
from mipbake import MipbakeError, UsageError
from mipbake.cli import options
from mipbake.cli.folders import check_names, file_hashes, names_of
from mipbake.cli.options import one_of
from mipbake.cli.session import Session, stages
from mipbake.cli.tables import map_table, remarks, set_report, sources_of
from mipbake.convert import (
    LEARNED,
    TARGETS,
    Material,
    check_material_output,
    image_container,
    is_material_folder,
    open_material,
)
from mipbake.io.containers import DEFAULT_FORMAT, IMAGE_FORMATS
from mipbake.io.discover import find
from mipbake.io.options import LoadOptions
from mipbake.material import model_named
from mipbake.prefilter import method_named
from mipbake.texture_set import TextureSet


@options.reads_sets
def convert(
    session: Session,
    load: LoadOptions,
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE",
            help="Texture sets, or materials that were converted before, one a folder.",
            show_default=False,
            readable=False,
        ),
    ],
    to: Annotated[str, typer.Option("--to", metavar=one_of(TARGETS), help="Material model.", show_default=False)],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="OUT", help="Where the materials go: OUT/<set>/.", show_default=False)
    ],
    format: Annotated[
        str,
        typer.Option(
            metavar=one_of(IMAGE_FORMATS),
            help="exr: half floats, colours linear; png: 8 bits, colours sRGB-encoded, for gltf and gltf-anisotropic.",
        ),
    ] = DEFAULT_FORMAT,
    weights: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="NAME",
            help="Trained weights that fit how the surface reflects under the pixel filter, such as paper-cross.",
            show_default="none: by formula, texel by texel, nothing filtered",
        ),
    ] = None,
) -> None:
    """Convert texture sets to another material model, level 0 alone.

    By formula, texel by texel, and nothing is filtered, or by trained weights. A set that cannot be converted is
    reported and the others are converted all the same.
    """
    session.in_files = True
    # Everything that is wrong for every set is said before the first is read.
    image_container(model_named(to).name, format)
    if weights is not None:
        method_named(LEARNED, weights)
    check_names(names_of(sources, lambda source: _name(source, load)), "convert")

    results = []
    for source in sources:
        try:
            results.append(_convert_one(session, source, out, load, to, format, weights))
        except MipbakeError as error:
            session.fail(str(error), error.exit_code)
            results.append({"source": source, "ok": False, "exit_code": error.exit_code, "error": str(error)})
    if len(sources) > 1:
        session.print(f"{sum(r['ok'] for r in results)} of {len(sources)} sets converted")
    session.dump({"version": mipbake.__version__, "exit_code": session.exit_code, "results": results})


def _name(source: Path, load: LoadOptions) -> str:
    return open_material(source).name if is_material_folder(source) else find(source, load).name


def _convert_one(
    session: Session, source: Path, out: Path, load: LoadOptions, to: str, format: str, weights: str | None
) -> dict[str, Any]:
    """Converts and writes one set, prints what happened, and returns it for JSON."""
    given: TextureSet | Material
    if is_material_folder(source):
        if load != LoadOptions():
            raise UsageError(
                f"{source} holds a converted material, which says itself how it is read: leave the options for reading "
                "a set out"
            )
        with stages(session, source.name) as reading:
            reading("read", 0.0)
            given = open_material(source)
            reading("read", 1.0)
        place = out / given.name
        if os.path.realpath(place) == os.path.realpath(source):
            raise UsageError(
                f"{source} would be replaced by what is made of it, which may hold less: choose another --out"
            )
        check_material_output(place, given.provenance.sources)
        height, width = given.stored.shape[:2]
        read = {"name": given.name, "width": width, "height": height, "model": given.model}
        session.print(f"{source}: {width} x {height}, {given.model}")
    else:
        found = find(source, load)
        place = out / found.name
        check_material_output(place, file_hashes(found))
        with stages(session, place.name) as reading:
            reading("read", 0.0)
            given = mipbake.load(source, load)
            reading("read", 1.0)
        check_material_output(place, file_hashes(given))
        read = set_report(given)
        session.print(f"{source}: {given.width} x {given.height}", map_table(sources_of(given)), *remarks(given))
    with stages(session, place.name) as converting:
        converting.seconds.update(reading.seconds)
        made = mipbake.convert(given, to, weights)
        converting("convert", 1.0)
        files = made.save(place, format, lambda share: converting("write", share))
    size = sum(file.stat().st_size for file in files)
    session.print(
        f"converted from {made.provenance.source_model} to {made.model}, level 0 alone, {_rule(made)}",
        f"time: {converting.summary()}",
        f"wrote {place}: {len(files)} files, {size / 1e6:.2f} MB",
    )
    return {
        "source": source,
        "ok": True,
        "exit_code": 0,
        "out": place,
        "files": [{"path": file, "bytes": file.stat().st_size} for file in files],
        "bytes": size,
        "format": format,
        "material": {"model": made.model, "provenance": made.provenance},
        "seconds": converting.seconds,
        "set": read,
    }


def _rule(made: Material) -> str:
    """How, in a few words."""
    by = made.provenance
    return f"by {by.weights} under the pixel filter {by.pixel_filter}" if by.weights else "unfiltered"
