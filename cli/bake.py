"""`mipbake bake`: texture sets in, MIP stacks out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Optional

import typer

import mipbake
from mipbake.baking import BakeOptions, NotBaked, bake_sources
from mipbake.baking.bake import AUTO_TARGET, DEFAULT_FILTER, DEFAULT_METHOD, TARGETS
from mipbake.baking.methods import METHODS
from mipbake.baking.search.time_budget import BEST
from mipbake.base.errors import UsageError
from mipbake.cli import options
from mipbake.cli.bake_batch import bake_batch, bake_project, suggest_recursive
from mipbake.cli.bake_output import Printer, told
from mipbake.cli.batch_options import BatchAsked, batching, with_project
from mipbake.cli.methods import some_of
from mipbake.cli.options import OptionalPath, one_of
from mipbake.cli.session import Session
from mipbake.cli.sources import SourcesOrProject
from mipbake.material.aim import DEFAULT_AIM, DEFAULT_SAMPLER, SAMPLERS
from mipbake.source.layout import PROJECT
from mipbake.source.options import NORMAL_CONVENTIONS, LoadOptions
from mipbake.stack.containers import DEFAULT_FORMAT, FORMATS
from mipbake.stack.costs import LIMIT
from mipbake.stack.output import GLB, GLB_TEXELS
from mipbake.stack.packing import PACKINGS, SOURCE
from mipbake.stack.presets import PRESETS
from mipbake.stack.sidecars import SIDECARS

_METHODS = "; ".join(f"{name}: {method.summary}" for name, method in METHODS.items())
_FORMATS = "; ".join(
    f"{name}: {next(iter(kinds.values())).summary} (texels {', '.join(kinds)})" for name, kinds in FORMATS.items()
)


@partial(options.reads_sets, more={"batch": batching})
def bake(
    *,
    session: Session,
    load: LoadOptions,
    batch: BatchAsked,
    memory: Optional[int],  # noqa: UP045
    sources: SourcesOrProject = None,
    out: Annotated[OptionalPath, options.stacks_folder()] = None,
    method: Annotated[str, typer.Option(metavar=one_of(METHODS), help=f"{_METHODS}.")] = DEFAULT_METHOD,
    target: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=one_of(TARGETS),
            help=f"Material model of the stack; {AUTO_TARGET} means gltf-anisotropic for sets with an anisotropy map, "
            "and gltf for others.",
            show_default=AUTO_TARGET,
        ),
    ] = None,
    pixel_filter: Annotated[
        str,
        options.pixel_filter("Pixel filter of the renderer that shows the stack."),
    ] = DEFAULT_FILTER,
    preset: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=one_of(PRESETS),
            help="Engine that loads the stack. Its preset chooses target, sampler, formats, packing, normals and names "
            "unless you do; see `mipbake presets`.",
            show_default=False,
        ),
    ] = None,
    format: Annotated[
        Optional[str],  # noqa: UP045
        options.formats(
            f"{_FORMATS}; {GLB}: the glTF source with KTX 2 textures in place of its own, or a square that shows "
            f"the material (texels {', '.join(GLB_TEXELS)}; with rgba8, textures that lose too much as blocks have 8 "
            "bits; the glTF standard does not allow these, but three.js and Babylon.js load them). The first texels "
            f"named are the default. Without texels, ktx2 and dds take the smallest that cost at most {LIMIT:g} dB.",
            f"{GLB} for glTF sources, {DEFAULT_FORMAT} for others",
        ),
    ] = None,
    packing: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=one_of(PACKINGS),
            help="Which channels share a file: as in the source, none, or as engines expect it.",
            show_default=SOURCE,
        ),
    ] = None,
    write_normals: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=one_of((SOURCE, *NORMAL_CONVENTIONS)),
            help="Whether green points up (opengl) or down (directx) in what is written.",
            show_default=f"{SOURCE}: as in the set",
        ),
    ] = None,
    alpha_cutoff: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            metavar="0..1",
            help="Opacity from which the renderer draws a texel. Every level then keeps the coverage of level 0.",
            show_default="opacity is blended",
        ),
    ] = None,
    max_level: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            min=0,
            metavar="LEVEL",
            help="The last level that is written; exr files hold all levels.",
            show_default="down to 1 x 1",
        ),
    ] = None,
    keep_level0: Annotated[
        bool,
        typer.Option("--keep-level0", help="Keep the level 0 of the source, which the pixel filter has not changed."),
    ] = False,
    strength: Annotated[
        float,
        typer.Option(
            metavar="0..1",
            help="1 writes what was baked, 0 writes plain averages, and a number between them mixes both.",
        ),
    ] = 1.0,
    min_roughness: Annotated[
        float, typer.Option(metavar="0..1", help="The least perceptual roughness that a texel may have.")
    ] = 0.0,
    weights: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar="NAME",
            help=f"Trained weights, for {some_of('weights')}.",
            show_default="the weights for the target and the filter",
        ),
    ] = None,
    budget: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=f"30s|2m|1h|{BEST}",
            help=f"Time that {some_of('budget')} may spend on optimising: a number of seconds, minutes or hours, "
            f"or {BEST}, which goes on until nothing improves. Ctrl-C ends it sooner, with the best so far, but not "
            "in a batch.",
            show_default="the default of the method",
        ),
    ] = None,
    sampler: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=one_of(SAMPLERS),
            help="How the engine looks the stack up where a pixel covers more of it in one direction than in another, "
            f"for {some_of('sampler')}: once; with 16x anisotropic filtering ('anisotropic 4x' for 4x); or once in "
            "each of the frames that it accumulates ('accumulated, anisotropic' for both).",
            show_default=f"as the preset chooses, else {DEFAULT_SAMPLER}",
        ),
    ] = None,
    lod_bias: Annotated[
        Optional[float],  # noqa: UP045
        options.lod_bias("as the preset chooses with the sampler, else 0"),
    ] = None,
    aim: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            metavar="0..1",
            help=f"What {some_of('aim')} aim at: 1 is pictures as people see them, 0 is decibels under single lights, "
            "and a number between them weighs the two.",
            show_default=f"{DEFAULT_AIM:g}",
        ),
    ] = None,
    sidecar: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar=one_of(SIDECARS),
            help="A file beside the maps that another program takes: ntc lists PNG files of all levels for NVIDIA's "
            "neural texture compression.",
            show_default=False,
        ),
    ] = None,
    device: Annotated[
        Optional[str],  # noqa: UP045
        options.device(some_of("device")),
    ] = None,
) -> None:
    """Bake texture sets into MIP stacks.

    A set that cannot be baked is reported, and the other sets are baked all the same. A search with a budget is
    kept in OUT/.<set>.search from time to time: after Ctrl-C or a crash, the same command goes on from there.
    With --recursive, or any option that says so, it is a batch, which leaves what has not changed since the last
    time. Ctrl-C ends a batch at once, and its searches go on the next time.
    """
    session.in_files = True
    wanted = BakeOptions(
        method=method,
        target=target,
        pixel_filter=pixel_filter,
        preset=preset,
        format=format,
        packing=packing,
        write_normals=write_normals,
        max_level=max_level,
        keep_level0=keep_level0,
        strength=strength,
        min_roughness=min_roughness,
        weights=weights,
        budget=budget,
        sampler=sampler,
        lod_bias=lod_bias,
        aim=aim,
        device=device,
        sidecar=sidecar,
    )
    load = replace(load, alpha_cutoff=alpha_cutoff)
    batch = with_project(batch, sources)
    if batch.config is not None:
        bake_project(session, sources or [], out, wanted, load, batch, memory)
        return
    if not sources:
        raise UsageError(f"missing argument 'SOURCE': expected one or more, or a {PROJECT} in this folder")
    if out is None:
        raise UsageError("missing option '--out' / '-o': expected a folder for the stacks")
    if Path(PROJECT).is_file():
        session.print(
            f"note: the {PROJECT} of this folder is not used, because sources are named; --config {PROJECT} uses it"
        )
    if batch.any:
        bake_batch(session, sources, out, wanted, load, batch, memory)
        return
    made = bake_sources(sources, out, wanted, load, Printer(session))
    results = [told(each) for each in made]
    sets = [result["ok"] for result in results if "document" not in result]
    if len(sets) > 1:
        session.print(f"{sum(sets)} of {len(sets)} sets baked")
    suggest_recursive(session, [each for each in made if isinstance(each, NotBaked)], out)
    session.dump({"version": mipbake.__version__, "exit_code": session.exit_code, "results": results})
