"""`mipbake bake`: texture sets in, MIP stacks out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Optional

import typer

import mipbake
from mipbake import MipbakeError, UsageError
from mipbake.bake import AUTO_TARGET, DEFAULT_FILTER, DEFAULT_METHOD, TARGETS
from mipbake.cli import options
from mipbake.cli.folders import check_names, file_hashes
from mipbake.cli.options import one_of
from mipbake.cli.session import Session, stages
from mipbake.cli.tables import map_table, remarks, set_report, sources_of
from mipbake.io.containers import DEFAULT_FORMAT, FORMATS, format_named
from mipbake.io.discover import find
from mipbake.io.options import LoadOptions
from mipbake.prefilter import METHODS, OPTIONS, method_named
from mipbake.prefilter.pixel_filter import FILTERS, filter_named
from mipbake.prefilter.time_budget import BEST
from mipbake.stack import Provenance, check_output, container_for

_METHODS = "; ".join(f"{name}: {method.summary}" for name, method in METHODS.items())
_FORMATS = "; ".join(f"{name}: {container.summary}" for name, container in FORMATS.items())


def _some_of(option: str) -> str:
    """The methods that have an option, as a sentence lists them."""
    *others, last = OPTIONS[option]
    return f"{', '.join(others)} or {last}" if others else last


@options.reads_sets
def bake(
    session: Session,
    load: LoadOptions,
    folders: Annotated[
        list[Path], typer.Argument(metavar="FOLDER", help="Texture sets, one a folder.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="OUT", help="Where the stacks go: OUT/<set>/.", show_default=False)
    ],
    method: Annotated[str, typer.Option(metavar=one_of(METHODS), help=f"{_METHODS}.")] = DEFAULT_METHOD,
    target: Annotated[
        str,
        typer.Option(
            metavar=one_of(TARGETS),
            help=f"Material model of the stack; {AUTO_TARGET} is gltf-anisotropic for sets with an anisotropy map, "
            "else gltf.",
        ),
    ] = AUTO_TARGET,
    pixel_filter: Annotated[
        str,
        typer.Option("--filter", metavar=one_of(FILTERS), help="Pixel filter of the renderer that shows the stack."),
    ] = DEFAULT_FILTER,
    format: Annotated[str, typer.Option(metavar=one_of(FORMATS), help=f"{_FORMATS}.")] = DEFAULT_FORMAT,
    weights: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="NAME",
            help=f"Trained weights, for {_some_of('weights')}.",
            show_default="those of the target and the filter",
        ),
    ] = None,
    budget: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=f"30s|2m|{BEST}",
            help=f"Time that {_some_of('budget')} may take to optimise: any number of seconds or minutes, or {BEST}, "
            "until nothing improves any more.",
            show_default="the method's own",
        ),
    ] = None,
) -> None:
    """Bake texture sets into MIP stacks.

    A set that cannot be baked is reported and the others are baked all the same.
    """
    # Everything that is wrong for every set is said before the first is read.
    method_named(method, weights, budget)
    filter_named(pixel_filter)
    if target not in TARGETS:
        raise UsageError(f"unknown target {target!r}: expected one of {', '.join(TARGETS)}")
    if target == AUTO_TARGET:
        format_named(format)
    else:
        container_for(target, format)
    check_names(folders, lambda folder: find(folder, load).name, "bake")

    results = []
    for folder in folders:
        try:
            results.append(_bake_one(session, folder, out, load, method, target, pixel_filter, format, weights, budget))
        except MipbakeError as error:
            session.fail(str(error), error.exit_code)
            results.append({"folder": folder, "ok": False, "exit_code": error.exit_code, "error": str(error)})
    if len(folders) > 1:
        session.print(f"{sum(r['ok'] for r in results)} of {len(folders)} sets baked")
    session.dump({"version": mipbake.__version__, "exit_code": session.exit_code, "results": results})


def _bake_one(
    session: Session,
    folder: Path,
    out: Path,
    load: LoadOptions,
    method: str,
    target: str,
    pixel_filter: str,
    format: str,
    weights: str | None,
    budget: str | None,
) -> dict[str, Any]:
    """Bakes and writes one set, prints what happened, and returns it for JSON."""
    found = find(folder, load)
    place = out / found.name
    check_output(place, file_hashes(found))
    with stages(session, place.name) as reading:
        reading("read", 0.0)
        texture_set = mipbake.load(folder, load)
        reading("read", 1.0)
    check_output(place, file_hashes(texture_set))
    session.print(f"{folder}: {texture_set.width} x {texture_set.height}", map_table(sources_of(texture_set)))
    session.print(*remarks(texture_set))
    with stages(session, place.name) as baking:
        baking.seconds.update(reading.seconds)
        stack = mipbake.bake(texture_set, method, target, pixel_filter, baking, weights, budget)
        files = stack.save(place, format, lambda share: baking("write", share))
    size = sum(file.stat().st_size for file in files)
    provenance = stack.provenance
    learned = f" with {provenance.weights}" if provenance.weights else ""
    session.print(
        f"baked by {provenance.method}{learned} to {stack.model}, pixel filter {provenance.pixel_filter}, "
        f"{len(stack.levels)} levels",
        *_promise(provenance),
        f"time: {baking.summary()}",
        f"wrote {place}: {len(files)} files, {size / 1e6:.2f} MB",
    )
    return {
        "folder": folder,
        "ok": True,
        "exit_code": 0,
        "out": place,
        "files": [{"path": file, "bytes": file.stat().st_size} for file in files],
        "bytes": size,
        "format": format,
        "stack": {"model": stack.model, "levels": len(stack.levels), "provenance": provenance},
        "seconds": baking.seconds,
        "set": set_report(texture_set),
    }


def _promise(provenance: Provenance) -> list[str]:
    """What was measured, in plain lines: one for each pair set."""
    promise = provenance.promise
    if promise is None:
        return []
    lines = [
        f"measured beside the best closed form of each level, {name}: {promise.summary(name)}"
        for name in promise.levels[0].snr
    ]
    if promise.left_out:
        lines.append(f"not measured, for want of time: {', '.join(promise.left_out)}")
    return lines
