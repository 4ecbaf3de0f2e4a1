"""`mipbake compare`: every method on one set, as figures and pictures on a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import mipbake
from mipbake.baking.methods import METHODS
from mipbake.baking.pipeline import AUTO_TARGET, Recipe, some_of
from mipbake.base.options import one_of, option, same
from mipbake.base.timings import Timings
from mipbake.cli import options
from mipbake.cli.session import Session, plain, timings
from mipbake.cli.sources import Sources, out_option, over_sets, stack_of
from mipbake.cli.tables import ranked_table
from mipbake.comparing.comparison import Settings
from mipbake.comparing.comparison import compare as compare_methods
from mipbake.comparing.conditions import GRAMMAR, parse
from mipbake.comparing.films import MOTIONS, RESOLUTION, motion_named
from mipbake.comparing.meshes.cache import default_folder
from mipbake.comparing.meshes.mesh_file import read_mesh
from mipbake.comparing.page import check_report, write_report
from mipbake.comparing.page.verdict import verdict
from mipbake.comparing.page.writing import PAGE
from mipbake.comparing.result import Comparison
from mipbake.comparing.scenes import SPHERE_RESOLUTION
from mipbake.quality.environment import ENVIRONMENTS, lighting_named
from mipbake.quality.figures import SCALES
from mipbake.quality.metrics import MEASURES, PAIR_SETS
from mipbake.quality.samplers import RENDER_SAMPLERS, render_sampler
from mipbake.quality.texture_space import DEFAULT_SEED
from mipbake.source.jobs import Job
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet

if TYPE_CHECKING:
    from rich.table import Table

EXIT_CONDITION = 5

_EFFORT = "Effort"

_PARTS = {
    **{"bake": 67, "texture space": 88, "sphere-near": 28, "sphere-1-1": 17, "sphere-middle": 17, "sphere-far": 28},
    **{"plane": 16, "film-floor": 54, "film-low-floor": 48, "film-wall": 41, "film-sphere": 58},
    **{"temporal slice": 7, "apparent BRDF": 1, "report": 10},
}
"""Phases of a comparison, with the seconds that they took for a set of 1024 x 1024 texels."""


@dataclass(frozen=True)
class CompareFlags:
    """What the command line says of a comparison."""

    baked: Path | None = option(
        None,
        "A stack that was baked from the set, OUT/<set>. Its name in the report is `baked`, and the verdict is about "
        "it. With several sets, give OUT, the folder that they were baked into.",
        metavar="STACK",
    )
    methods: str | None = option(
        None,
        f"What is baked: one or more, separated by commas, of {', '.join(METHODS)}, or a closed form with its kernel, "
        "such as 'lean (box)'.",
        metavar="NAMES",
        otherwise="auto (not with --baked), neural and all closed forms",
    )
    target: str | None = same(
        Recipe,
        "target",
        help="Material model of the stacks; with --baked, the model of that stack.",
        otherwise=AUTO_TARGET,
    )
    pixel_filter: str = same(
        Recipe, "pixel_filter", help="Pixel filter of the reference; with --baked, the filter of that stack.", group=""
    )
    aim: float | None = same(Recipe, "aim")
    device: str | None = same(Recipe, "device")
    fail_if: list[str] | None = option(
        None,
        f"End with exit code {EXIT_CONDITION} when the condition holds; repeat for more conditions. {GRAMMAR}",
        metavar="CONDITION",
    )
    light: str = option(
        next(iter(ENVIRONMENTS)),
        "Light of renders and films: generated, or a latitude-longitude HDR image.",
        metavar=f"{one_of(ENVIRONMENTS)}|FILE",
    )
    mesh: Path | None = option(None, "Render and film this mesh (.obj, .gltf, .glb) and nothing else.", metavar="FILE")
    sampler: str = option(
        RENDER_SAMPLERS[0],
        "How stacks are looked up: between texels and levels; with 16x anisotropic filtering ('anisotropic 4x' for "
        "4x); once in each of the frames that an engine accumulates; or a texel drawn at random, as renderers do that "
        f"filter what is shaded. Stacks of {some_of('sampler')} are made for it, or for trilinear where it is "
        "stochastic.",
        metavar=one_of(RENDER_SAMPLERS),
    )
    lod_bias: float | None = same(Recipe, "lod_bias", otherwise="0")
    films: bool = option(True, "Film floors, a wall and a sphere, or the mesh, and judge the films.", negative=True)
    motion: str = option(MOTIONS[0], "What moves in films.", metavar=one_of(MOTIONS), group=_EFFORT)
    size: int = option(
        SPHERE_RESOLUTION[0],
        f"Height of the renders in pixels, and of films up to {RESOLUTION[0]}; 16 or more.",
        group=_EFFORT,
    )
    seed: int = option(DEFAULT_SEED, "Seed of everything that is drawn at random; 0 or more.", group=_EFFORT)
    cache: bool = option(
        True, "Keep references of renders and films for the next comparison.", negative=True, group=_EFFORT
    )

    def settings(self) -> Settings:
        """What is compared, and how."""
        return Settings(
            methods=None if self.methods is None else tuple(name.strip() for name in self.methods.split(",")),
            recipe=Recipe(target=self.target, pixel_filter=self.pixel_filter, aim=self.aim, device=self.device),
            lighting=lighting_named(self.light),
            mesh=read_mesh(self.mesh) if self.mesh else None,
            sampler=render_sampler(self.sampler, self.lod_bias),
            side=self.size,
            films=self.films,
            motion=motion_named(self.motion),
            seed=self.seed,
            cache=default_folder() if self.cache else None,
        )


@options.reads_sets
def compare(
    session: Session,
    load: LoadOptions,
    flags: CompareFlags,
    sources: Sources,
    out: Annotated[
        Path,
        out_option(
            "REPORT",
            "Folder of the report: index.html and results.json. With several sets, each has its own in REPORT/<set>/.",
        ),
    ],
) -> None:
    """Compare methods on texture sets, and write a report for the browser.

    The report of a set holds measures, renders and a verdict. A set that cannot be compared is reported, and the other
    sets are compared all the same.
    """
    session.in_files = True
    conditions = [parse(text) for text in flags.fail_if or []]
    settings = flags.settings()
    parts = {phase: part for phase, part in _PARTS.items() if settings.films or not phase.startswith("film")}

    def compare_one(job: Job, texture_set: TextureSet, alone: bool) -> dict[str, Any]:
        place = out if alone else out / job.place / texture_set.name
        check_report(place)
        known = stack_of(flags.baked, job, texture_set, alone) if flags.baked else None
        stack = mipbake.open_stack(known) if known else None
        described = plain(job.named(texture_set.found))
        with timings(session, texture_set.name, parts) as progress:

            def written(found: Comparison, begun: bool = False) -> tuple[Comparison, list[Path]]:
                whole = replace(found, source=described)
                source = texture_set.filtered(found.pixel_filter)
                # The first page is no part of the whole work: the last one is, under the name of the page.
                step = (lambda _phase, share: progress("first page", share)) if begun else progress
                return whole, write_report(whole, source, place, step, begun)

            def begun(found: Comparison) -> None:
                first, *_ = written(found, begun=True)[1]
                session.print(f"wrote {first}: a first page, which the whole one replaces")

            found = compare_methods(texture_set, settings, stack, known, conditions, progress, begun)
            comparison, files = written(found)
        outcomes = [condition.check(comparison) for condition in conditions]
        _print(session, comparison, place, files, progress)
        for outcome in outcomes:
            if outcome.failed:
                told = outcome.sentence if alone else f"{texture_set.name}: {outcome.sentence}"
                session.fail(told, EXIT_CONDITION)
            else:
                session.print(outcome.sentence)
        return {"out": place, "files": files, "conditions": outcomes, **comparison.to_dict()}

    session.results(over_sets(session, sources, load, compare_one))


def _print(session: Session, comparison: Comparison, place: Path, files: Sequence[Path], progress: Timings) -> None:
    """What a comparison found, for people."""
    found = verdict(comparison)
    session.print(found.sentence)
    session.details(found.details)
    if comparison.films:
        session.details("", film_table(comparison))
    for pair_set in PAIR_SETS:
        session.details("", scale_table(comparison, pair_set))
    session.print(*(f"warning: {warning}" for warning in comparison.warnings))
    session.details(*(f"note: {note}" for note in comparison.notes), f"time: {progress.summary()}")
    size_of = sum(file.stat().st_size for file in files)
    session.print(f"wrote {place / PAGE}: {len(files)} files, {size_of / 1e6:.1f} MB")


def film_table(comparison: Comparison) -> Table:
    """Methods by film: what ColorVideoVDP says of each, or FLIP where it did not judge."""
    judged = any(figure.measure == "jod-37" for figure in comparison.figures)
    measure = MEASURES["jod-37" if judged else "flip"]
    scenes = [each.scene.name for each in comparison.films]
    rows = {}
    for name in (method.name for method in comparison.methods):
        found = [comparison.find(name, measure.name, scene, "") for scene in scenes]
        if any(found):
            digits = 2 if judged else 3
            rows[name] = [(f"{f.value:.{digits}f}", measure.loss(f.value)) if f else ("", math.inf) for f in found]
    return ranked_table(f"films, {measure.title}", [scene.removeprefix("film-") for scene in scenes], rows)


def scale_table(comparison: Comparison, pair_set: str) -> Table:
    """Methods by scale, for one pair set, with 95 % intervals."""
    rows = {}
    for method in comparison.methods:
        figures = [comparison.figure(method.name, "snr", pair_set, scale) for scale in SCALES]
        rows[method.name] = [(f"{each.value:.1f} [{each.low:.1f}, {each.high:.1f}]", -each.value) for each in figures]
    return ranked_table(f"{pair_set}, SNR in dB", list(SCALES), rows)
