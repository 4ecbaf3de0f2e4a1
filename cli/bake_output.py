"""What `mipbake bake` says of what is baked: lines as it happens, and JSON in the end."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from mipbake.baking import BakedDocument, BakedSet, Listener, NotBaked
from mipbake.baking.methods import OPTIONS, Stop
from mipbake.baking.options import BakePlan
from mipbake.baking.results import DEFECT, Planned, Result, Unchanged, WrittenFile
from mipbake.base.timings import Timings
from mipbake.cli.session import Session, counted, failed, succeeded, timings
from mipbake.cli.tables import describe, remark
from mipbake.source.jobs import Failure, Job
from mipbake.source.texture_set import TextureSet
from mipbake.stack.costs import Cost
from mipbake.stack.gltf.glb import output
from mipbake.stack.output import GLB
from mipbake.stack.packing import Normals
from mipbake.stack.presets import Preset
from mipbake.stack.stack import MipStack, Provenance
from mipbake.stack.verdict import verdict

_PARTS = {"read": 4, "prefilter": 76, "other maps": 2, "encode": 4, "write": 6, "check": 8}
"""Phases of a bake, with their parts of the time by `auto` of sets of 1024 x 1024 texels, roughly."""


class Stopping:
    """Hears the first Ctrl-C of a command that comes while a search has something to keep.

    The second one, and any that comes at another time, ends the command as it always does.
    """

    def __init__(self) -> None:
        self.asked = False

    @contextmanager
    def descending(self) -> Iterator[Stop]:
        """A search has something to keep while the block runs."""
        before = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is not threading.main_thread() or not callable(before):
            yield lambda: self.asked  # nobody can press it here, or it is ignored
            return

        def hear(number: int, frame: FrameType | None) -> None:
            if self.asked:
                before(number, frame)
            self.asked = True

        signal.signal(signal.SIGINT, hear)
        try:
            yield lambda: self.asked
        finally:
            signal.signal(signal.SIGINT, before)


@dataclass(frozen=True)
class Printer(Listener):
    """Prints what happens: for a person on stdout, failures on stderr."""

    session: Session
    stopping: Stopping = field(default_factory=Stopping)

    @contextmanager
    def descending(self) -> Iterator[Stop]:
        """See Listener: Ctrl-C stops the search."""
        with self.stopping.descending() as stop:
            yield stop

    def ends(self) -> bool:
        """See Listener."""
        return self.stopping.asked

    @contextmanager
    def timings(self, label: str) -> Iterator[Timings]:
        """See Listener: with a line of progress."""
        with timings(self.session, label, _PARTS) as made:
            yield made

    def found(self, plan: BakePlan, jobs: Sequence[Job | Failure]) -> None:
        """See Listener."""
        if plan.preset:
            self.session.details(_preset_line(plan.preset, plan, [job for job in jobs if isinstance(job, Job)]))

    def read(self, job: Job, sets: Sequence[TextureSet]) -> None:
        """See Listener."""
        for texture_set in sets:
            describe(self.session, job, texture_set)
        remark(self.session, job)

    def note(self, sentence: str) -> None:
        """See Listener."""
        self.session.print(f"note: {sentence}")

    def baked(self, job: Job, stack: MipStack, result: BakedSet, timings: Timings) -> None:
        """See Listener."""
        made = result.provenance
        learned = f" with {made.weights}" if made.weights else ""
        aimed = f", sampler {made.sampler}" if made.sampler else ""
        aimed += "" if made.aim is None else f", aim {made.aim:g}"
        self.session.details(
            f"baked by {made.method}{learned} to {stack.model}, pixel filter {made.pixel_filter}{aimed}, "
            f"{len(stack.levels)} levels",
            *(f"adjusted: {line}" for line in made.adjustments),
            *measured_lines(made),
            *(line for each in result.costs for line in _cost_lines(each)),
            f"time: {timings.summary()}",
        )
        self.session.print(
            *(f"{stack.name}: {line}" if job.tiled else line for line in verdict_lines(result)),
            *(f"warning: {line}" for line in result.warnings if line not in job.warnings),  # which `read` has told
            *([_wrote(result.out, result.files, sized=not made.promise)] if result.files and not job.tiled else []),
        )
        for line in result.defects:
            self.session.fail(f"{result.out}: {line}", DEFECT)

    def gathered(self, folder: Path, tiles: Sequence[BakedSet]) -> None:
        """See Listener."""
        self.session.print(_wrote(folder, [file for tile in tiles for file in tile.files], f"{len(tiles)} tiles, "))

    def document(self, result: BakedDocument, bytes_before: int) -> None:
        """See Listener."""
        plain = ["textures with plain levels, PSNR of their blocks:"] if result.plain else []
        self.session.details(*plain, *(f"  {cost}" for cost in result.plain))
        self.session.print(f"wrote {result.out}: {bytes_before / 1e6:.1f} MB in, {result.bytes / 1e6:.1f} MB out")

    def failed(self, failure: NotBaked) -> None:
        """See Listener."""
        self.session.fail(failure.error.full, failure.error.exit_code)


def told(result: Result) -> dict[str, Any]:
    """What was done with a source, for JSON."""
    if isinstance(result, NotBaked):
        return failed(result.source, result.error)
    if isinstance(result, Unchanged):
        return succeeded(result.source, out=result.out, unchanged=True)
    if isinstance(result, Planned):
        return succeeded(result.source, out=result.out, planned=result.why)
    if isinstance(result, BakedDocument):
        about = {"document": True, "files": result.files, "measured": result.measured, "plain": result.plain}
        return succeeded(result.source, out=result.out, **about)
    return {
        "source": result.source,
        "ok": not result.defects,
        "exit_code": result.exit_code,
        **({"error": " ".join(result.defects)} if result.defects else {}),
        "out": result.out,
        "files": result.files,
        "bytes": result.bytes,
        "costs": result.costs,
        "warnings": result.warnings,
        "stack": {"model": result.model, "levels": result.levels, "provenance": result.provenance},
        "seconds": result.seconds,
        "set": result.set,
    }


def verdict_lines(result: BakedSet) -> list[str]:
    """How a stack looks beside plain MIP maps, and what to do; no line of methods that measure nothing."""
    made = result.provenance
    if made.promise is not None:
        found = verdict(made.promise)
        size = f" {result.bytes / 1e6:.1f} MB." if result.files else ""
        return [f"{found.sentence}{size} {found.advice}"]
    if made.method not in OPTIONS["budget"]:
        return []
    return [f"No verdict: it was changed after it was measured ({'; '.join(made.adjustments) or 'for its opacity'})."]


def _wrote(out: Path, files: Sequence[WrittenFile], of: str = "", sized: bool = True) -> str:
    size = f", {sum(file.bytes for file in files) / 1e6:.1f} MB" if sized else ""
    return f"wrote {out}: {of}{counted(len(files), 'file')}{size}"


def _cost_lines(cost: Cost) -> list[str]:
    """What files cost, in plain lines."""
    losses = (f"{view} {'0.00' if abs(loss) < 0.005 else f'{loss:+.2f}'} dB" for view, loss in cost.loss.items())
    width = max(map(len, cost.psnr), default=0)
    files = (
        f"  {name:{width}}  {'exact' if psnr == float('inf') else f'{psnr:.1f} dB':>8}  {cost.texels[name]}"
        for name, psnr in cost.psnr.items()
    )
    covered = [f"  {cost.coverage}"] if cost.coverage else []
    return [
        f"{cost.format} costs in SNR of the shaded result: {', '.join(losses)}; PSNR of the files:",
        *files,
        *covered,
    ]


def measured_lines(made: Provenance) -> list[str]:
    """What was measured, in plain lines: one for each pair set."""
    measured = made.promise
    if measured is None:
        return []
    pair_sets = measured.levels[0].snr
    lines = [
        f"measured at levels and between levels, compared with the best closed form there, {name}: "
        f"{measured.summary(name)}"
        for name in pair_sets
    ]
    if measured.visible is not None:
        lines.append(f"visible error in small pictures: {measured.visible:.0%} of what plain MIP maps have")
    if made.aim and any(sum(each.gain(name) for each in measured.levels) < 0 for name in pair_sets):
        lines.append(
            f"note: aim {made.aim:g} weighs what people see in moving pictures beside these figures, which are "
            "SNR under single lights; --aim 0 asks for the SNR alone"
        )
    return lines


def _preset_line(preset: Preset, plan: BakePlan, found: list[Job]) -> str:
    """What a preset chose for these sources."""
    outputs = plan.outputs if any(plan.writes_maps(job) for job in found) else ()
    files = [f"{o.format}, packing {o.packing}, normals {_normals(o.normals)}" for o in outputs]
    files += [f"{GLB} with {output(plan.glb_texels).format} in it"] if any(plan.wants_glb(job) for job in found) else []
    written = f", {'; '.join(files)}" if files else ""
    sampler = f", sampler {plan.options.sampler}" if plan.options.sampler else ""
    return f"preset {preset.name} for {preset.engine}: target {plan.target}{sampler}{written}"


def _normals(normals: Normals) -> str:
    return normals.convention + (" of two channels" if normals.channels == 2 else "")
