"""`mipbake preview`: plain MIP maps, a bake and the truth beside each other in the browser, nothing measured."""

from __future__ import annotations

import tempfile
import webbrowser
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Optional

from mipbake.baking.methods import METHODS
from mipbake.baking.neural import Neural
from mipbake.baking.pipeline import AUTO_TARGET, Recipe
from mipbake.base.options import one_of, option, same
from mipbake.cli import options
from mipbake.cli.session import Session, plain, timings
from mipbake.cli.sources import Sources, out_option, over_sets
from mipbake.cli.streams import has_screen
from mipbake.comparing.comparison import preview as baked_now
from mipbake.comparing.page import check_preview, write_report
from mipbake.source.jobs import Job
from mipbake.source.options import LoadOptions
from mipbake.source.texture_set import TextureSet


@dataclass(frozen=True)
class PreviewFlags:
    """What the command line says of a preview."""

    method: str = option(
        Neural.name, "What is shown beside plain MIP maps; see `mipbake bake`.", metavar=one_of(METHODS)
    )
    target: str | None = same(Recipe, "target", help="Material model of the stacks.", otherwise=AUTO_TARGET)
    pixel_filter: str = same(Recipe, "pixel_filter", help="Pixel filter of the truth.", group="")
    device: str | None = same(Recipe, "device")
    open: bool = option(True, "Open the page in the browser.", negative=True)


@options.reads_sets
def preview(
    session: Session,
    load: LoadOptions,
    flags: PreviewFlags,
    sources: Sources,
    out: Annotated[
        Optional[Path],  # noqa: UP045
        out_option(
            "REPORT",
            "Folder of the page. With several sets, each has its own in REPORT/<set>/.  [default: (a temporary folder, "
            "which stays)]",
        ),
    ] = None,
) -> None:
    """See a texture set in the browser, baked and not, beside the truth.

    Nothing is measured, so it takes seconds. `mipbake compare` measures, and adds the view to its report.
    """
    session.in_files = True
    recipe = Recipe(target=flags.target, pixel_filter=flags.pixel_filter, device=flags.device)

    def show(job: Job, texture_set: TextureSet, alone: bool) -> dict[str, Any]:
        if out is None:
            folder = Path(tempfile.mkdtemp(prefix="mipbake-preview-")) / texture_set.name
        else:
            folder = out if alone else out / job.place / texture_set.name
        check_preview(folder)
        with timings(session, texture_set.name, {"bake": 3, "report": 1}) as progress:
            found = baked_now(texture_set, flags.method, recipe, progress)
            found = replace(found, source=plain(job.named(texture_set.found)))
            page, *_ = write_report(found, texture_set.filtered(found.pixel_filter), folder, progress)
        session.print(f"wrote {page}", f"for a verdict, which takes minutes: mipbake compare {job.source} -o report")
        if flags.open and has_screen():
            webbrowser.open(page.absolute().as_uri())
        return {"page": page}

    session.results(over_sets(session, sources, load, show))
